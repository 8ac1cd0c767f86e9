"""``mixseq batch``: many assets, one report, and no failure that stops the others."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.shell_completion import ShellComplete
from click.testing import CliRunner, Result

import mixseq
from mixseq.cli import main
from mixseq.cli.batch import on_workers, run, run_asset
from mixseq.cli.batch_report import Entry, Report, files_of, find_sources, in_markdown, plan, read_report
from mixseq.cli.group import length_text
from mixseq.errors import FormatError, MixseqWarning, OutputError
from mixseq.runtime.progress import log_progress
from mixseq.sequence.sequence import MeshSequence
from tests.formats.gltf_maker import moving

pytestmark = pytest.mark.slow

SETTINGS = {
    "job": "encode",
    "between": [],
    "options": {"space": ["--space=vertex"], "exact": ["--exact"]},
    "files": "",
}


@pytest.fixture
def shots(tmp_path: Path, bent_bar: MeshSequence, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with three sequences, of which the second is damaged; the current folder is above it."""
    folder = tmp_path / "shots"
    folder.mkdir()
    monkeypatch.chdir(tmp_path)
    mixseq.write(folder / "one.npz", bent_bar)
    (folder / "three.npz").write_text("no mesh")
    mixseq.write(folder / "two.usdc", bent_bar)
    return folder


def batch(*arguments: str) -> Result:
    command = ["batch", "encode", "shots", "--out", "models", "--space", "vertex", *arguments]
    return CliRunner().invoke(main, command, prog_name="mixseq", catch_exceptions=False)


def states(folder: str = "models") -> dict[str, str]:
    stored = json.loads((Path(folder) / "report.json").read_text())
    return {Path(asset["source"]).name: asset["state"] for asset in stored["assets"]}


def times() -> dict[str, int]:
    return {file.name: file.stat().st_mtime_ns for file in Path("models").glob("*.h5")}


@pytest.mark.usefixtures("shots")
def test_a_failure_does_not_stop_the_batch(bent_bar: MeshSequence) -> None:
    result = batch()
    assert result.exit_code == 1
    assert states() == {"one.npz": "done", "three.npz": "failed", "two.usdc": "done"}
    lines = [line for line in result.stdout.splitlines() if not line.startswith(" ")]  # without wrapped cells
    assert [line.split()[0] for line in lines] == ["asset", "one", "three", "two", "wrote"]
    assert "failed:" in lines[2] and "three.npz" in result.stdout
    assert lines[-1].endswith("report.md (2 done, 1 failed)")
    assert sorted(path.name for path in Path("models").iterdir()) == [
        "one.h5",
        "report.json",
        "report.md",
        "two.h5",
    ]
    assert mixseq.compare(bent_bar, mixseq.load("models/one.h5").sample()).max_error < 0.0005


@pytest.mark.usefixtures("shots")
def test_report_has_the_measured_values(bent_bar: MeshSequence) -> None:
    batch("--tolerance", "0.01")
    entry = read_report(Path("models")).entries[str(Path("models/one.h5").resolve())]
    model = Path("models/one.h5")
    error = mixseq.compare(bent_bar, mixseq.load(model).sample())
    assert (entry.frames, entry.vertices) == (bent_bar.frame_count, bent_bar.vertex_count)
    assert entry.bytes == model.stat().st_size
    assert entry.bits == 8 * model.stat().st_size / bent_bar.points[..., 0].size
    assert entry.max_error == pytest.approx(error.max_error)
    assert entry.kg_percent == pytest.approx(error.kg_percent)
    assert entry.seconds is not None and entry.seconds > 0
    text = Path("models/report.md").read_text()
    assert length_text(error.max_error, error.diagonal * bent_bar.metres_per_unit, digits=2) in text
    assert "3 assets: 2 done, 1 failed.\n" in text
    assert "| one | 4 | 77 |" in text


@pytest.mark.usefixtures("shots")
def test_finished_assets_are_skipped(bent_bar: MeshSequence) -> None:
    batch()
    before = times()
    mixseq.write("shots/three.npz", bent_bar)  # repaired
    assert batch().exit_code == 0
    assert states() == dict.fromkeys(("one.npz", "three.npz", "two.usdc"), "done")
    after = times()
    assert {name: after[name] for name in before} == before
    mixseq.write("shots/one.npz", bent_bar.with_points(bent_bar.points * 2))  # changed
    Path("models/three.h5").unlink()
    batch()
    assert {name for name, time in times().items() if after.get(name) != time} == {"one.h5", "three.h5"}


@pytest.mark.usefixtures("shots")
def test_files_beside_failures_are_not_replaced_unasked(bent_bar: MeshSequence) -> None:
    batch()
    assert entry_of("three.npz").state == "failed"
    Path("models/three.h5").write_text("somebody's own")
    mixseq.write("shots/three.npz", bent_bar)  # repaired
    result = batch()
    assert result.exit_code == 2
    assert "three.h5" in result.stderr
    Path("models/three.h5").unlink()
    Path("shots/one.npz").write_text("no mesh any more")
    assert batch().exit_code == 1
    mixseq.write("shots/one.npz", bent_bar)
    assert batch().exit_code == 0  # the older model was made by the first batch


@pytest.mark.usefixtures("shots")
def test_model_of_equal_size_is_not_replaced_unasked() -> None:
    batch()
    model = Path("models/one.h5")
    own = bytes(reversed(model.read_bytes()))
    model.write_bytes(own)
    result = batch()
    assert result.exit_code == 2
    assert "one.h5" in result.stderr and "--overwrite" in result.stderr
    assert model.read_bytes() == own
    batch("--overwrite")
    assert entry_of("one.npz").is_unchanged()
    assert mixseq.load(model).header.frame_count == 4


@pytest.mark.usefixtures("shots")
@pytest.mark.parametrize("arguments", [["--force"], ["--exact"], ["--tolerance", "0.1"], ["--up-axis", "Z"]])
def test_changed_settings_encode_again(arguments: list[str]) -> None:
    batch()
    before = times()
    batch(*arguments)
    assert all(time != before[name] for name, time in times().items())


@pytest.mark.usefixtures("shots")
@pytest.mark.parametrize("aim", [("--max-error", "0.003"), ("--kg", "2"), ("--size", "20kB")])
def test_assets_are_compressed(aim: tuple[str, str], bent_bar: MeshSequence) -> None:
    arguments = ["batch", "encode", "shots", "--out", "models", *aim]
    CliRunner().invoke(main, arguments, catch_exceptions=False)
    assert states() == {"one.npz": "done", "three.npz": "failed", "two.usdc": "done"}
    found = mixseq.verify("models/one.h5", bent_bar)
    assert found.holds
    (stored, *_) = json.loads(Path("models/report.json").read_text())["assets"]
    assert stored["max_error"] == pytest.approx(found.max_error, rel=1e-6)
    assert stored["bytes"] <= 20_000
    before = times()
    CliRunner().invoke(main, arguments, catch_exceptions=False)
    assert times() == before
    CliRunner().invoke(main, [*arguments[:-2], "--max-error", "0.02"], catch_exceptions=False)
    assert times() != before


@pytest.mark.usefixtures("shots")
def test_progress_counts_and_names_assets() -> None:
    told: list[tuple[int, int, str]] = []
    assets = plan(find_sources([Path("shots")]), Path("models").resolve(), (), SETTINGS, ".h5")
    Path("models").mkdir()
    list(on_workers(None, lambda *step: told.append(step))(assets))
    assert told[0] == (0, 3, "assets")
    assert [step[:2] for step in told[1:]] == [(1, 3), (2, 3), (3, 3)]
    assert {step[2] for step in told[1:]} == {"assets, one", "assets, two", "assets, three"}


@pytest.mark.usefixtures("shots")
def test_interrupted_and_continued(monkeypatch: pytest.MonkeyPatch) -> None:
    fit, calls = mixseq.fit, []

    def interrupted(*arguments: Any, **settings: Any) -> Any:
        calls.append(arguments)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return fit(*arguments, **settings)

    with monkeypatch.context() as patch:
        patch.setattr(mixseq, "fit", interrupted)
        result = batch()
    assert (result.exit_code, result.stderr.strip()) == (130, "mixseq: interrupted")
    assert states() == {"one.npz": "done", "three.npz": "left", "two.usdc": "left"}  # larger ones first
    assert not read_report(Path("models")).finished
    assert "2 left. Not finished: the same command goes on" in Path("models/report.md").read_text()
    assert sorted(path.name for path in Path("models").iterdir()) == ["one.h5", "report.json", "report.md"]
    before = times()
    batch()
    assert states() == {"one.npz": "done", "three.npz": "failed", "two.usdc": "done"}
    assert times()["one.h5"] == before["one.h5"]
    assert read_report(Path("models")).finished


@pytest.mark.usefixtures("shots")
def test_a_bug_is_a_failure_of_one_asset(monkeypatch: pytest.MonkeyPatch) -> None:
    def buggy(*_: object, **__: object) -> None:
        raise ZeroDivisionError("one\ntwo")

    monkeypatch.setattr(mixseq, "fit", buggy)
    assert batch().exit_code == 1
    entry = entry_of("one.npz")
    assert entry.message.startswith("a bug in mixseq, ZeroDivisionError: one two; `mixseq encode`")


@pytest.mark.usefixtures("shots")
def test_warnings_are_in_the_report(bent_bar: MeshSequence) -> None:
    mixseq.write("shots/four.npz", bent_bar)
    fit = mixseq.fit

    def warning(*arguments: Any, **settings: Any) -> Any:
        import warnings

        warnings.warn("a loss", mixseq.errors.MixseqWarning, stacklevel=1)
        return fit(*arguments, **settings)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mixseq, "fit", warning)
        assert batch().stderr == ""
    assert "- four: a loss\n- one: a loss\n" in Path("models/report.md").read_text()


def test_names_and_messages_are_no_html_in_the_report() -> None:
    name = "<script>alert(1)<"
    entry = Entry(name, name, 0, "", {}, "failed", message="<b>|&</b>", warnings=("<i>lost</i>",))
    text = in_markdown(Report({name: entry}))
    assert "<" not in text
    assert "failed: &lt;b&gt;\\|&amp;&lt;/b&gt; |" in text
    assert "- &lt;script&gt;alert(1)&lt;: &lt;i&gt;lost&lt;/i&gt;\n" in text


def entry_of(name: str) -> Entry:
    return read_report(Path("models")).entries[str(Path("models", name).with_suffix(".h5").resolve())]


@pytest.mark.usefixtures("shots")
def test_a_failure_keeps_and_reports_the_older_model() -> None:
    batch()
    before = Path("models/one.h5").read_bytes()
    Path("shots/one.npz").write_text("no mesh any more")
    assert batch().exit_code == 1
    assert entry_of("one.npz").message.endswith("; an older file is left at one.h5")
    assert "older" not in entry_of("three.npz").message
    assert Path("models/one.h5").read_bytes() == before
    assert entry_of("one.npz").state == "failed"


@pytest.mark.usefixtures("shots")
def test_missing_sources_leave_the_report() -> None:
    batch()
    Path("shots/three.npz").unlink()
    Path("shots/one.npz").unlink()
    result = batch()
    assert result.exit_code == 0
    assert result.stdout.splitlines()[-1].endswith("(1 done)")
    assert states() == {"two.usdc": "done"}
    assert Path("models/one.h5").exists()


@pytest.mark.usefixtures("shots")
def test_exit_code_covers_the_given_sources() -> None:
    batch()
    arguments = ["batch", "encode", "shots/one.npz", "--out", "models", "--space", "vertex"]
    result = CliRunner().invoke(main, arguments, catch_exceptions=False)
    assert (result.exit_code, result.stdout.splitlines()[-1][-8:]) == (0, "(1 done)")
    assert len(states()) == 3


def test_any_of_the_numbered_files_may_change(tmp_path: Path, bent_bar: MeshSequence) -> None:
    files = touched(tmp_path, "walk_1.obj", "walk_2.obj", "walk_3.obj")
    for number, file in enumerate(files):
        os.utime(file, (1000, 1000 + number))

    def signature() -> str:
        (asset,) = plan([tmp_path / "walk_#.obj"], tmp_path / "out", (), SETTINGS, ".h5")
        return asset.source_signature

    before = signature()
    assert signature() == before
    os.utime(files[0], (1000, 999))  # neither the last change nor the size of all
    assert signature() != before
    os.utime(files[0], (1000, 1000))
    assert signature() == before
    files[1].rename(tmp_path / "walk_4.obj")
    assert signature() != before


# Sources and names ----------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore::mixseq.errors.MixseqWarning")
def test_sequences_in_a_folder_are_found(tmp_path: Path, bent_bar: MeshSequence) -> None:
    for name in ("a.npz", "b.h5", "walk_####.obj", "run7_##.ply"):
        mixseq.write(tmp_path / name, MeshSequence.from_header(bent_bar.header, bent_bar.points))
    mixseq.save(tmp_path / "model.h5", mixseq.fit(bent_bar, space="vertex"))
    for name in ("notes.txt", ".hidden.npz", "still.obj", "still01.obj"):
        (tmp_path / name).touch()
    (tmp_path / "deeper").mkdir()
    mixseq.write(tmp_path / "deeper" / "c.npz", bent_bar)
    (tmp_path / "cloth.obj").touch()
    (tmp_path / "cloth.pc2").touch()
    expected = r"single meshes are no sequences and are left out: still\.obj, still01\.obj$"
    with pytest.warns(MixseqWarning, match=expected):
        cached = find_sources([tmp_path])
    assert [path.name for path in cached] == ["a.npz", "b.h5", "cloth.pc2", "run7_##.ply", "walk_####.obj"]
    (tmp_path / "cloth.pc2").unlink()
    found = find_sources([tmp_path, tmp_path / "a.npz", tmp_path / "deeper" / ".." / "b.h5"])
    assert [path.name for path in found] == ["a.npz", "b.h5", "run7_##.ply", "walk_####.obj"]
    assets = plan(found, tmp_path / "out", (), SETTINGS, ".h5")
    assert [asset.path.name for asset in assets] == ["a.h5", "b.h5", "run7.h5", "walk.h5"]
    assert assets[3].source_bytes == sum(file.stat().st_size for file in tmp_path.glob("walk_*.obj"))


def touched(folder: Path, *names: str) -> list[Path]:
    for name in names:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).touch()
    return [folder / name for name in names]


def test_two_of_the_same_stem_have_two_names(tmp_path: Path) -> None:
    sources = touched(tmp_path, "walk.usdc", "Walk.abc", "run.abc")
    assert [a.path.name for a in plan(sources, tmp_path, (), SETTINGS, ".h5")] == [
        "walk.usdc.h5",
        "Walk.abc.h5",
        "run.h5",
    ]


def test_names_are_kept_when_sources_are_added(tmp_path: Path) -> None:
    first, second = touched(tmp_path, "walk.usdc", "walk.abc")
    earlier = plan([first], tmp_path, (), SETTINGS, ".h5")
    assert [a.path.name for a in plan([first, second], tmp_path, earlier, SETTINGS, ".h5")] == [
        "walk.h5",
        "walk.abc.h5",
    ]
    assert [a.path.name for a in plan([second], tmp_path, earlier, SETTINGS, ".h5")] == ["walk.abc.h5"]


def test_two_of_the_same_name_are_refused(tmp_path: Path) -> None:
    sources = touched(tmp_path, "a/walk.usdc", "b/walk.usdc")
    with pytest.raises(OutputError, match=r"b/walk.usdc and .*a/walk.usdc would both be written to .*another --out"):
        plan(sources, tmp_path / "out", (), SETTINGS, ".h5")
    earlier = [
        *plan(sources[:1], tmp_path / "out", (), SETTINGS, ".h5"),
        Entry("gone.usdc", str(tmp_path / "out/walk.usdc.h5"), 0, "", SETTINGS),
    ]
    with pytest.raises(OutputError, match=r"b/walk.usdc and gone.usdc would both"):
        plan(sources, tmp_path / "out", earlier, SETTINGS, ".h5")


def test_a_source_is_never_a_target(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"walk.h5 is a source itself"):
        plan(touched(tmp_path, "walk.h5"), tmp_path, (), SETTINGS, ".h5")


# Refusals -------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("shots")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("shots none.npz --out models", "none.npz does not exist"),
        ("empty --out models", "empty: there are no sequences in this folder"),
        ("shots --out models --exact --rank 3", "--exact, --tolerance and --rank exclude each other"),
        ("shots --out models --kg 1 --size 1MB", "give one of --kg and --size"),
        ("shots --out models --kg 1 --exact", "--exact is for models that are not compressed"),
        ("shots --out shots/one.npz", "one.npz is a file; give the name of a folder"),
        ("shots --out none/models", "cannot make the folder none/models: No such file"),
        ("shots --out models --animation Run", "none of the sequences is read with an option 'animation'"),
        ("shots --out models --threads 2 --cluster local:2", "--threads and --cluster exclude each other"),
        ("shots --out models --cluster local:many", "'local:many' is no cluster"),
        ("shots --out damaged", "report.json is damaged; delete it"),
    ],
)
def test_refusals(arguments: str, message: str) -> None:
    Path("empty").mkdir()
    Path("damaged").mkdir()
    Path("damaged/report.json").write_text("{")
    result = CliRunner().invoke(
        main, ["batch", "encode", *arguments.split()], prog_name="mixseq", catch_exceptions=False
    )
    assert result.exit_code == 2
    assert message in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert not list(Path("models").glob("*.h5"))


ASSET = '"source": "a", "target": "b", "source_bytes": 1, "source_signature": "", "settings": {}'


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        '{"assets": [1]}',
        '{"assets": [{"source": "a"}]}',
        '{"assets": [{' + ASSET + ', "state": "lost"}]}',
        '{"assets": [{' + ASSET + ', "state": []}]}',
        '{"assets": [{' + ASSET + ', "seconds": "many"}]}',
        '{"assets": [{' + ASSET + ', "source": []}]}',
        '{"assets": [{' + ASSET + ', "target": 5}]}',
    ],
)
def test_damaged_reports(text: str, tmp_path: Path) -> None:
    (tmp_path / "report.json").write_text(text)
    with pytest.raises(FormatError, match=r"report\.json is damaged"):
        read_report(tmp_path)


# Jobs -----------------------------------------------------------------------------------------------------


def do(*arguments: str) -> Result:
    return CliRunner().invoke(main, ["batch", *arguments], prog_name="mixseq", catch_exceptions=False)


@pytest.mark.usefixtures("shots")
@pytest.mark.parametrize(
    ("job", "extension", "options"),
    [
        ("convert", "npz", ["--frames", "1-2"]),
        ("convert", "obj", []),
        ("resample", None, ["--fps", "20"]),
        ("resample", "npz", ["--set", "conform=25"]),
        ("encode", None, ["--kg", "1", "--set", "inbetweens=no"]),
        ("segment", None, ["--parts", "2", "--no-picture"]),
        ("transfer", "npz", ["--target", "shots/one.npz", "--no-picture"]),
    ],
)
def test_every_job_writes_what_its_command_writes(job: str, extension: str | None, options: list[str]) -> None:
    Path("shots/three.npz").unlink()
    assert do(job, "shots", "--out", "out", *options, *(["--format", extension] if extension else [])).exit_code == 0
    between, rest = (options[1:2], options[2:]) if job == "transfer" else ([], options)
    for entry in read_report(Path("out")).entries.values():
        source, target = Path(entry.source), entry.path
        alone = target.with_name(f"alone-{target.name}")
        result = CliRunner().invoke(main, [job, str(source), *between, str(alone), *rest], catch_exceptions=False)
        assert (entry.state, result.exit_code) == ("done", 0)
        for made in files_of(target):
            assert made.read_bytes() == made.with_name(f"alone-{made.name}").read_bytes()
        assert entry.bytes == sum(file.stat().st_size for file in files_of(target))
        told = [line for line in result.stdout.replace("alone-", "").splitlines() if not line.startswith("time  ")]
        assert [line for line in entry.output if not line.startswith("time  ")] == told
        assert (entry.verdict in Path("out/report.md").read_text()) and bool(entry.verdict) == (job == "transfer")
    before = {file: file.stat().st_mtime_ns for file in Path("out").iterdir() if not file.name.startswith("report")}
    assert do(job, "shots", "--out", "out", *options, *(["--format", extension] if extension else [])).exit_code == 0
    assert {file: file.stat().st_mtime_ns for file in before} == before


def test_models_are_decoded_and_edited(shots: Path) -> None:
    batch()
    Path("reverse.toml").write_text('[[edit]]\noperation = "reverse"\n')
    assert do("decode", "models", "--out", "back", "--format", "npz", "--fps", "20").exit_code == 0
    assert [each.name for each in sorted(Path("back").glob("*.npz"))] == ["one.npz", "two.npz"]
    assert mixseq.read("back/one.npz").frame_count == 7
    assert do("edit", "models", "--out", "edited", "--script", "reverse.toml").exit_code == 0
    made = Path("edited/one.h5").stat().st_mtime_ns
    assert do("edit", "models", "--out", "edited", "--script", "reverse.toml").exit_code == 0
    assert Path("edited/one.h5").stat().st_mtime_ns == made
    Path("reverse.toml").write_text('[[edit]]\noperation = "speed"\nfactor = 2\n')
    assert do("edit", "models", "--out", "edited", "--script", "reverse.toml").exit_code == 0
    assert mixseq.load("edited/one.h5").header.times[-1] == pytest.approx(0.15)


@pytest.mark.usefixtures("shots")
def test_formats_are_beside_each_other() -> None:
    for extension in ("usdc", "npz"):
        do("convert", "shots/one.npz", "--out", "out", "--format", extension)
    assert sorted(file.name for file in Path("out").iterdir()) == ["one.npz", "one.usdc", "report.json", "report.md"]
    assert len(read_report(Path("out")).entries) == 2


@pytest.mark.usefixtures("shots")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("shots --out out", "'shots' is not one of 'encode', 'convert'"),
        ("convert shots --out out --format doc", "'doc' is none of usd"),
        ("resample shots --out out --exact --tolerance 1", "--exact keeps everything and --tolerance does not"),
        ("transfer shots --out out", "Missing option '--target'"),
        ("encode shots --out out --fps 3", "No such option"),
        ("decode shots --out out", "shots: there are no models in this folder"),
        ("encode shots --out out --format npz", "models are HDF5 files"),
    ],
)
def test_wrong_jobs_are_refused_before_work(arguments: str, message: str) -> None:
    result = do(*arguments.split())
    assert (result.exit_code, result.stderr.count("\n")) == (2, 1)
    assert message in result.stderr
    assert not Path("out").exists()


def test_help_of_a_job_has_the_options_of_both() -> None:
    text = do("resample", "--help").stdout
    for option in ("--out FOLDER", "--format EXTENSION", "--fps N", "--reverse", "conform=N", "--cluster"):
        assert option in text
    assert text.count("--threads") == 1 and "TARGET" not in text.partition("Options:")[0]


def test_shells_complete_jobs_and_their_options() -> None:
    complete = ShellComplete(main, {}, "mixseq", "_MIXSEQ_COMPLETE").get_completions
    assert [each.value for each in complete(["batch"], "res")] == ["resample"]
    assert {"--reverse", "--retime"} <= {each.value for each in complete(["batch", "resample"], "--re")}


# Animations -----------------------------------------------------------------------------------------------


@pytest.fixture
def fox(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A triangle of glTF with the animations Walk, Armature|Run, and Walk again, which go 1, 2 and 3 m far."""
    monkeypatch.chdir(tmp_path)
    maker = moving(values=[[0, 0, 0], [1, 0, 0]])
    for number, name in enumerate(("Armature|Run", "Walk"), start=2):
        maker.animate(0, "translation", [0, 1], [[0, 0, 0], [number, 0, 0]], name=name)
    maker.json["animations"][0]["name"] = "Walk"
    return maker.glb(tmp_path / "fox.glb")


ANIMATIONS = {"fox-Walk": 1, "fox-Run": 2, "fox-Walk_2": 3}
"""Distances in the files of the animations of `fox`."""


def distances(pattern: str) -> dict[str, float]:
    return {file.stem: float(np.ptp(mixseq.read(file).points[:, 0, 0])) for file in Path().glob(pattern)}


@pytest.mark.usefixtures("fox")
def test_all_animations_are_assets(bent_bar: MeshSequence) -> None:
    mixseq.write("bar.npz", bent_bar)
    arguments = ("convert", "fox.glb", "bar.npz", "--out", "out", "--format", "npz", "--animation", "all")
    assert do(*arguments).exit_code == 0
    assert distances("out/fox*.npz") == pytest.approx(ANIMATIONS)
    assert mixseq.read("out/bar.npz").frame_count == 4
    before = {file: file.stat().st_mtime_ns for file in Path("out").glob("*.npz")}
    assert do(*arguments).exit_code == 0
    assert {file: file.stat().st_mtime_ns for file in before} == before
    assert do("convert", "fox.glb", "--out", "one", "--format", "npz", "--animation", "Run").exit_code == 0
    assert distances("one/*.npz") == pytest.approx({"fox": 2})


@pytest.mark.usefixtures("fox")
def test_all_animations_are_files_of_a_command() -> None:
    result = CliRunner().invoke(main, ["convert", "fox.glb", "new.npz", "--animation", "all"], catch_exceptions=False)
    assert [line.split()[1] for line in result.stdout.splitlines()] == ["new-Walk.npz", "new-Run.npz", "new-Walk_2.npz"]
    assert distances("new*.npz") == pytest.approx({name.replace("fox", "new"): x for name, x in ANIMATIONS.items()})
    CliRunner().invoke(main, ["convert", "fox.glb", "run_##.obj", "--set", "animation=all"], catch_exceptions=False)
    assert len(list(Path().glob("run-Walk_2_0?.obj"))) == 2
    refused = CliRunner().invoke(main, ["convert", "fox.glb", "new.npz", "--animation", "all", "--no-overwrite"])
    assert (refused.exit_code, "new-Walk.npz, new-Run.npz and new-Walk_2.npz exist" in refused.stderr) == (2, True)
    still = CliRunner().invoke(main, ["convert", "new-Run.npz", "new.usdc", "--animation", "all"])
    assert (still.exit_code, "new-Run.npz has no animations to choose from" in still.stderr) == (2, True)


# Processes and clusters -----------------------------------------------------------------------------------


@pytest.mark.usefixtures("shots", "processes")
def test_processes_write_the_same(bent_bar: MeshSequence) -> None:
    assert do("convert", "shots", "--out", "two", "--format", "h5", "--threads", "2").exit_code == 1
    assert do("convert", "shots", "--out", "one", "--format", "h5", "--threads", "1").exit_code == 1
    for name in ("one.h5", "two.h5"):
        assert Path("one", name).read_bytes() == Path("two", name).read_bytes()
    assert states("two") == {"one.npz": "done", "three.npz": "failed", "two.usdc": "done"}


@pytest.mark.usefixtures("processes")
def test_assets_in_given_processes(tmp_path: Path, bent_bar: MeshSequence) -> None:
    """What happens when processes die is in ``tests/runtime``."""
    from mixseq.runtime.processes import process_pool

    for number in range(2):
        points = bent_bar.points * (1 + np.arange(4) * number)[:, None, None]
        mixseq.write(tmp_path / f"shot{number}.npz", bent_bar.with_points(points))
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
    here = plan(find_sources([tmp_path]), tmp_path / "here", (), SETTINGS, ".h5")
    there = plan(find_sources([tmp_path]), tmp_path / "there", (), SETTINGS, ".h5")
    for asset in here:
        assert run_asset(None, asset).state == "done"
    with process_pool(1) as workers:
        report = run(there, Report({}), tmp_path / "there", on_workers(workers, log_progress), force=False)
    assert report.finished and report.count("done") == 2
    for one, other in zip(here, there, strict=True):
        assert one.path.read_bytes() == other.path.read_bytes()


def test_work_that_was_given_up_is_a_failure(tmp_path: Path, bent_bar: MeshSequence) -> None:
    from mixseq.errors import GivenUpError

    def given_up(assets: Any) -> Any:
        def result() -> Entry:
            raise GivenUpError("several workers died")

        yield from ((asset, result) for asset in assets)

    assets = plan(touched(tmp_path, "walk.npz"), tmp_path, (), SETTINGS, ".h5")
    report = run(assets, Report({}), tmp_path, given_up, force=False)
    assert [(entry.state, entry.message) for entry in report.entries.values()] == [("failed", "several workers died")]


def test_silence(shots: Path) -> None:
    (shots / "three.npz").unlink()
    result = batch("--quiet")
    assert (result.exit_code, result.stderr) == (0, "")
    assert result.stdout.splitlines() == [f"wrote {Path('models/report.md')} (2 done)"]


def test_two_batches_do_not_write_to_one_folder(tmp_path: Path, bent_bar: MeshSequence) -> None:
    mixseq.write(tmp_path / "walk.npz", bent_bar)
    assets = plan(find_sources([tmp_path / "walk.npz"]), tmp_path, (), SETTINGS, ".h5")

    def meanwhile(assets: Any) -> Any:
        with pytest.raises(OutputError, match="another batch is writing here"):
            run(
                list(assets),
                Report({}),
                tmp_path,
                on_workers(None, log_progress),
                force=False,
            )
        yield from ()

    run(assets, Report({}), tmp_path, meanwhile, force=False)
    report = run(assets, Report({}), tmp_path, on_workers(None, log_progress), force=False)
    assert report.count("done") == 1  # the lock is lifted
