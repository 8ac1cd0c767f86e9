"""Nothing is replaced that nobody said may be, and nothing that is read: asked before the work, by every command."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

import mixseq
from mixseq.cli import files, main
from mixseq.errors import FormatError, OutputError, SettingsError
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.model import Model
from tests.cli.conftest import Contents, Run

WRITING = {
    "demo": ("--out", "fox", "fox/model.h5"),
    "plot": ("model.h5", "old.png", "old.png"),
    "plot --video": ("old.gif", "model.h5", "old.gif"),
    "view": ("model.h5", "--export", "old.html", "old.html"),
    "convert": ("bar.npz", "old.usdc", "old.usdc"),
    "encode": ("bar.npz", "old.h5", "old.h5"),
    "decode": ("model.h5", "old.npz", "old.npz"),
    "decode --as skin": ("model.h5", "old.glb", "old.glb"),
    "resample": ("model.h5", "old.npz", "old.npz"),
    "edit --script edits.toml": ("model.h5", "old.npz", "old.npz"),
    "interpolate --pose 0=1": ("bar.npz", "old.npz", "old.npz"),
    "transfer": ("bar.npz", "bar.usdc", "new.npz", "new-transfer.png"),
    "transfer --no-picture --save-map old.npz": ("bar.npz", "bar.usdc", "new.usdc", "old.npz"),
    "segment": ("bar.npz", "parts.npz", "parts-parts.png"),
    "batch encode --out .": ("bar.npz", "bar.h5"),
}
"""Arguments, the last is a file that is there already."""


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let somebody sit at a terminal."""
    monkeypatch.setattr(files, "on_terminal", lambda: True)


def answer(text: str, *arguments: str) -> Result:
    return CliRunner().invoke(main, list(arguments), input=text, prog_name="mixseq", catch_exceptions=False)


def prepared(name: str) -> tuple[list[str], Path]:
    *arguments, exists = WRITING[name]
    Path("edits.toml").write_text('[[edit]]\noperation = "reverse"\n')
    Path(exists).parent.mkdir(exist_ok=True)
    Path(exists).write_bytes(b"somebody's work")
    return [*name.split(), *arguments], Path(exists)


@pytest.mark.parametrize("name", WRITING)
def test_refused_by_all_commands(folder: Path, contents: Contents, name: str) -> None:
    arguments, exists = prepared(name)
    before = contents()
    result = answer("", *arguments, "--no-overwrite")
    assert (result.exit_code, result.stderr) == (
        2,
        f"mixseq: error: {exists} exists; give another name, or --overwrite\n",
    )
    assert contents() == before


@pytest.mark.parametrize("name", WRITING)
def test_asked_by_all_commands(folder: Path, contents: Contents, terminal: None, name: str) -> None:
    arguments, exists = prepared(name)
    before = contents()
    result = answer("n\n", *arguments)
    assert f"{exists} exists; replace it? [y/N]" in result.stderr
    assert f"error: {exists} stayed as before" in result.stderr
    assert result.exit_code == 2
    assert contents() == before


@pytest.mark.parametrize("name", WRITING)
def test_a_pipe_behind_a_link_is_replaced_by_no_command(folder: Path, contents: Contents, name: str) -> None:
    arguments, exists = prepared(name)
    exists.unlink()
    os.mkfifo("pipe")
    exists.symlink_to(Path("pipe").resolve())
    before = contents()
    result = answer("", *arguments, "--overwrite")
    assert f"{exists.name} is a device, a pipe or a socket, through a link to {folder / 'pipe'}" in " ".join(
        result.output.split()
    )
    assert "Traceback" not in result.output
    assert exists.is_symlink()
    assert exists.is_fifo()
    if name == "batch encode --out .":  # which goes on with other sequences
        assert (result.exit_code, json.loads(Path("report.json").read_text())["assets"][0]["state"]) == (1, "failed")
    else:
        assert (result.exit_code, result.stderr.count("\n")) == (2, 1)
        assert contents() == before


@pytest.mark.usefixtures("terminal")
def test_yes_replaces_and_ctrl_d_does_not(folder: Path) -> None:
    result = answer("", "convert", "bar.npz", "old.usdc")
    assert (result.exit_code, (folder / "old.usdc").read_bytes()) == (130, b"somebody's work")
    result = answer("y\n", "convert", "bar.npz", "old.usdc")
    assert result.exit_code == 0
    assert mixseq.read("old.usdc").vertex_count == 77
    assert "replace" not in answer("", "convert", "bar.npz", "old.usdc", "--overwrite").stderr


def test_without_a_terminal_scripts_may_run_twice(run: Run) -> None:
    for _ in range(2):
        assert (result := run("convert", "bar.npz", "new.usdc")).exit_code == 0
        assert result.stderr == ""


def test_all_files_are_named_in_one_question(folder: Path, terminal: None) -> None:
    for number in range(1, 5):
        (folder / f"new_{number}.obj").touch()
    assert "new_1.obj, new_2.obj, new_3.obj and new_4.obj exist; replace them?" in (
        answer("n\n", "convert", "bar.npz", "new_#.obj").stderr
    )
    (folder / "new_05.obj").touch()
    Path("new-parts.png").touch()
    assert "new_1.obj ... new-parts.png (6 files) exist" in answer("n\n", "segment", "bar.npz", "new_#.obj").stderr
    assert "exist" not in answer("", "convert", "bar.npz", "new_#.npz").stderr  # no numbers in names of npz


def test_files_beside_count(folder: Path, run: Run, bent_bar: MeshSequence) -> None:
    mixseq.write("new.mdd", bent_bar)
    (folder / "new.mdd").unlink()
    result = run("convert", "bar.npz", "new.mdd", "--no-overwrite")
    assert "new.obj exists; give another name, or --overwrite" in result.stderr
    mixseq.write("new.usda", bent_bar, clips=2, flatten=True)
    (folder / "new.usda").unlink()
    arguments = ("convert", "bar.npz", "new.usda", "--flatten", "--no-overwrite")
    assert "new.usda.clips exists" in run(*arguments, "--clips", "2").stderr
    assert run(*arguments).exit_code == 0  # with a warning of the clips, which stay


@pytest.mark.parametrize(
    ("arguments", "lost"),
    [
        ("convert bar.mdd other.mdd --mesh other.obj", "other.obj"),
        ("convert other.obj other.pc2", "other.obj"),
        ("encode bar.npz new.h5 --labels new.h5", "new.h5"),
        ("interpolate bar.npz parts.npz --pose 0=1 --labels parts.npz", "parts.npz"),
        ("plot model.h5 old.npz.png --against old.npz.png", "old.npz.png"),
        ("edit model.h5 old.h5 --script old.h5", "old.h5"),
        ("view model.h5 --export page.html --against page.html", "page.html"),
        ("plot --video film.gif model.h5 film.gif", "film.gif"),
        ("convert bar.usdc new.usdc --onto new.usdc", "new.usdc"),
        ("transfer bar.npz bar.usdc rest.npz --rest rest.npz --no-picture", "rest.npz"),
    ],
)
def test_nothing_that_is_read_is_written(folder: Path, run: Run, contents: Contents, arguments: str, lost: str) -> None:
    for name in (lost, "bar.mdd"):
        (folder / name).touch()
    before = contents()
    result = run(*arguments.split(), "--overwrite")
    assert result.exit_code == 2
    assert f"{lost} is the source itself and would be lost; give another name" in result.stderr
    assert contents() == before


def test_folders_that_a_script_may_read_are_no_sources(run: Run, folder: Path) -> None:
    (folder / "edits.toml").write_text('[[edit]]\noperation = "reverse"\n')
    (folder / "new_1.obj").touch()
    arguments = ("edit", "model.h5", "new_#.obj", "--script", "edits.toml", "--files-from", ".")
    assert "new_1.obj exists" in run(*arguments, "--no-overwrite").stderr


def test_two_outputs_of_one_name(run: Run) -> None:
    result = run("segment", "bar.npz", "new.npz", "--picture", "./new.png", "--overwrite")
    assert result.exit_code == 0
    result = run("transfer", "bar.npz", "bar.usdc", "new.npz", "--no-picture", "--save-map", "./new.npz")
    assert "new.npz is to be written twice" in result.stderr


def test_the_viewer_has_its_own_question(run: Run) -> None:
    assert "--overwrite is about pages; give --export as well" in run("view", "model.h5", "--overwrite").stderr


@pytest.mark.slow
def test_batch_replaces_only_what_it_made(folder: Path, run: Run, contents: Contents) -> None:
    (folder / "models").mkdir()
    (folder / "models/bar.h5").write_bytes(b"somebody's work")
    batch = ("batch", "encode", "bar.npz", "--out", "models", "--space", "vertex")
    before = contents()
    result = run(*batch)
    assert (result.exit_code, contents()) == (2, before)
    assert "bar.h5 exists; give another name, or --overwrite" in result.stderr
    assert run(*batch, "--overwrite").exit_code == 0
    assert run(*batch, "--force").exit_code == 0  # its own
    with (folder / "models/bar.h5").open("ab") as file:
        file.write(b"and edited")
    assert run(*batch).exit_code == run(*batch, "--force").exit_code == 2
    (folder / "models/report.json").unlink()
    (folder / "models/bar.h5").unlink()
    assert "report.md exists" in run(*batch).stderr
    assert run(*batch, "--overwrite").exit_code == 0
    assert json.loads((folder / "models/report.json").read_text())["finished"]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo terminals")
def test_a_real_terminal_is_noticed(folder: Path) -> None:
    ours, theirs = os.openpty()
    command = [sys.executable, "-c", "from mixseq.cli import main; main()", "convert", "bar.npz", "old.usdc"]
    with subprocess.Popen(command, stdin=theirs, stderr=theirs, stdout=subprocess.DEVNULL) as process:
        os.close(theirs)
        os.write(ours, b"n\n")
        assert process.wait(60) == 2
    assert b"old.usdc exists; replace it?" in os.read(ours, 1000)
    os.close(ours)
    assert (folder / "old.usdc").read_bytes() == b"somebody's work"


# Sources, and what is not a model ------------------------------------------------------------------------


@pytest.mark.parametrize(
    "arguments",
    [
        ("convert", "bar.usdc", "bar.usdc"),
        ("convert", "bar.npz", "./bar.npz"),
        ("encode", "bar_sequence.h5", "bar_sequence.h5"),
        ("decode", "model.h5", "model.h5", "--fps", "60"),
    ],
)
def test_the_source_is_not_overwritten(run: Run, contents: Contents, arguments: tuple[str, ...]) -> None:
    before = contents()
    result = run(*arguments)
    assert result.exit_code == 2
    assert "is the source itself and would be lost; give another name" in result.stderr
    assert contents() == before


def test_another_name_for_the_source_is_noticed(run: Run, folder: Path) -> None:
    (folder / "link.usdc").symlink_to(folder / "bar.usdc")
    assert "is the source itself" in run("convert", "bar.usdc", "link.usdc").stderr


@pytest.mark.parametrize("target", ["bar_####.obj", "bar_%02d.obj"])
def test_numbered_sources_are_noticed(run: Run, contents: Contents, target: str) -> None:
    assert run("convert", "bar.npz", "bar_####.obj").exit_code == 0
    before = contents()
    for source in ("bar_####.obj", "bar_0001.obj"):
        result = run("convert", source, target)
        assert (result.exit_code, "is the source itself" in result.stderr) == (2, True)
    assert contents() == before


@pytest.mark.parametrize("options", [(), ("--flatten",)])
def test_what_a_model_was_made_from_is_not_overwritten(
    run: Run, folder: Path, contents: Contents, options: tuple[str, ...]
) -> None:
    assert run("encode", "bar.usdc", "bar.h5").exit_code == 0
    before = contents()
    for command in (("decode",), ("resample",)):
        result = run(*command, "bar.h5", "bar.usdc", *options)
        assert result.exit_code == 2
        assert "bar.usdc is the file that the sequence came from, which would be lost" in result.stderr
    assert contents() == before


def test_models_are_only_saved_under_their_extension(folder: Path, bar_model: Model) -> None:
    with pytest.raises(OutputError, match=r"old\.usdc: models are HDF5 or GLB files; end the name in \.h5"):
        mixseq.save("old.usdc", bar_model)
    assert (folder / "old.usdc").read_bytes() == b"somebody's work"


@pytest.mark.parametrize("name", ["bar.usdc", "bar.npz", "notes.txt"])
def test_forgetting_to_encode_is_explained(folder: Path, name: str) -> None:
    with pytest.raises(FormatError, match=f"{name} is not a model, .* make one with mixseq encode"):
        mixseq.load(name)


def test_times_may_be_rounded_as_printed(bar_model: Model) -> None:
    last = float(bar_model.times[-1])
    rounded = bar_model.header_at([last + 1e-6]).times
    assert rounded.tolist() == [last]
    with pytest.raises(SettingsError, match="outside the sequence"):
        bar_model.header_at([last + 0.01])
