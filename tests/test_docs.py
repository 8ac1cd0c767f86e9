"""The documentation says what is true: its code runs, its links lead somewhere, its tables are complete."""

from __future__ import annotations

import atexit
import os
import re
import shlex
import shutil
import tomllib
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import fields
from functools import cache
from importlib import import_module
from itertools import takewhile
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import click
import h5py
import numpy as np
import pytest
from click.testing import CliRunner

import mixseq
from mixseq import creature, operations
from mixseq.cli import main
from mixseq.cli.batch import JOBS
from mixseq.cli.formats import as_markdown
from mixseq.cli.group import max_memory
from mixseq.cli.options import Setting
from mixseq.compression.bitstream.compressed_sequence import CodingParameters, TemporalInterpolation
from mixseq.operations.script import OPERATIONS, Readers, read_script
from mixseq.segmentation.motion import MotionSettings
from mixseq.segmentation.silhouettes import SilhouetteSettings, SpanningTreeSettings
from mixseq.shells.fitting import ShellSettings
from mixseq.spaces.edge import EdgeSettings
from mixseq.spaces.mixed.mixed_space import Projection
from mixseq_io import FORMATS
from mixseq_io.coded.streams import LABEL_COUNT
from mixseq_io.registry import capability_table, motion_table
from mixseq_io.surfaces import SURFACE_ARRAY_NAMES
from scripts.paper_study.main import STAGES
from tests import given
from tests.cli.conftest import SerialPool
from tests.meshes import COARSE_CELL_METRES, bar, coarse_walk
from tests.pictures.conftest import LOW_RESOLUTION, set_resolution

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted([ROOT / "README.md", ROOT / "CHANGELOG.md", *(ROOT / "docs").glob("*.md")])
EVERY_PAGE = [str(path.relative_to(ROOT)) for path in (*PAGES, *sorted((ROOT / "docs").glob("*/*.md")))]
RESAMPLING = ("Retiming", "read_retiming", "resample")
COMMANDS = main.list_commands(click.Context(main))

FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")


def page(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def blocks(name: str, *languages: str) -> list[tuple[str, str]]:
    """Return the language and text of the fenced blocks of a page."""
    return [(language, text) for language, text in FENCE.findall(page(name)) if language in languages]


def prose(name: str) -> str:
    return FENCE.sub("", page(name))


def section(name: str, heading: str) -> str:
    """Return a page from a heading to the next one."""
    _, found, rest = page(name).partition(f"\n## {heading}\n")
    assert found, f"{name} has no heading {heading!r}"
    return rest.partition("\n## ")[0]


def rows(name: str) -> Iterator[list[str]]:
    """Yield the cells of all table rows of a page."""
    return rows_of(prose(name))


def rows_of(text: str) -> Iterator[list[str]]:
    """Yield the cells of all table rows of a text."""
    for line in text.splitlines():
        if line.startswith("|"):
            yield [cell.strip() for cell in line.strip("|").split("|")]


PAGE_CELL_METRES = 0.07
"""Cells in which the fox of pages has 494 vertices, and is still closed and manifold."""

PAGES_WITH_PAWS = ("docs/editing.md", "docs/transfer.md")
"""Pages on which soles are found by their height, and limbs are edited: their fox has 1,614 vertices."""

PROGRAM, PART, COMMANDS_SHOWN, FILE = "python", "py", ("console", "sh"), ("toml", "csv", "json")
RUN = (PROGRAM, PART, *COMMANDS_SHOWN, *FILE)
"""Languages of blocks that run. Programs go on from block to block of a page; parts of them take names as given."""

BROUGHT = {
    "README.md": "shot.usdc run.usdc gallop.usdc horse.glb pairs.txt character.usdz character.glb tall.obj",
    "docs/cli.md": "walk.usdc walk.h5 robot.glb shots/a.usdc shots/b.usdc ramp.csv run.h5 attack.toml edits.toml "
    "lion.npz tall.obj wolf.glb horse.glb pairs.txt feet.json man.glb painted.ply decoded.usdc",
    "docs/file-format.md": "walk.h5",
    "docs/formats.md": "robot.glb long.usdc man.usdz",
    "docs/web.md": "walk.usdc",
    "docs/how-to/blender.md": "shot.usdc shot.abc",
    "docs/how-to/houdini.md": "shot.usdc shot.abc",
    "docs/how-to/markers.md": "gallop.usdc horse.glb pairs.txt",
    "docs/how-to/maya.md": "shot.usdc shot.abc",
    "docs/how-to/unreal-unity.md": "shot.abc",
    "docs/how-to/web.md": "shot.glb",
    "docs/index.md": "shot.usdc",
    "docs/resampling.md": "character.glb",
    "docs/scale.md": "long.usdc walk.h5",
    "docs/segmentation.md": "man.glb npz/horse_gallop.npz npz/q_horse_gallop.npz npz/fox_run.npz "
    "npz/robotexpressive_dance.npz",
    "docs/transfer.md": "walk.usdc tall.obj gallop.usdc horse.glb pairs.txt Wolf.glb Horse.glb wolf_horse.txt",
}
"""Files that readers of a page bring; everything else it makes by itself."""

NOT_RUN = {
    r"pip install |python -m venv |\. \.?venv/bin/activate": "installs",
    r"(MIXSEQ_\w+=\S+ )?scripts/(demo|test|check|docs|fuzz)": "sets up and runs tools; continuous integration does so",
    r"export MIXSEQ_(DATA|NODE_MODULES)=": "names a folder of the reader's",
    r"(\w+=1 )*scripts/bench \w+|(MIXSEQ_DATA=FOLDER )?scripts/paper": "measures for minutes to hours, with other data",
    r"python docs/images/\w+.py": "draws for minutes",
    r"mixseq .* --cluster tcp:": "needs other machines; tests/runtime/test_cluster.py has a cluster here",
    r"mixseq decode .* --cluster local:4": "starts processes; tests/runtime/test_cluster.py does that",
    r"mixseq plot --video (\w+\.\w+) walk": "large; docs/how-to/film.md makes the same in small",
    r"mixseq blender ": "downloads 100 MB; tests/blender packs what it would",
    r"mixseq warm-up": "tests/cli/test_warm_up.py does that",
    r"mixseq view (?!.*--export)": "waits for a browser; tests/viewer has one",
}
"""Commands that are shown and not run, and why."""

NO_CODE = {
    "docs/architecture.md": 1,  # a diagram
    "docs/cli.md": 1,  # the form of commands
    "docs/how-to/blender.md": 2,  # scripts for Blender
    "docs/how-to/maya.md": 2,  # scripts for Maya
    "docs/file-format.md": 7,  # formulas of decoders, see tests/compression
    "docs/transfer.md": 2,  # a file of markers, and a report that is printed
}
"""How many blocks of plain text a page has, which are neither code nor commands."""


@pytest.mark.parametrize("name", [name for name in EVERY_PAGE if blocks(name, *RUN)])
def test_code_and_commands_run_from_top_to_bottom(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MIXSEQ_DATA", str(tmp_path))
    set_resolution(monkeypatch, LOW_RESOLUTION)
    monkeypatch.setattr("mixseq.runtime.processes.process_pool", lambda *_: nullcontext(SerialPool()))
    monkeypatch.setattr(creature, "CELL_METRES", COARSE_CELL_METRES if name in PAGES_WITH_PAWS else PAGE_CELL_METRES)
    for file in BROUGHT.get(name, "").split():
        given.make(file)
    names: dict[str, Any] = given.names() if blocks(name, PART) else {}
    for number, (language, text) in enumerate(blocks(name, *RUN)):
        if language in (PROGRAM, PART):
            exec(compile(text, f"{name}, block {number}", "exec"), names)
        elif language in COMMANDS_SHOWN:
            run_commands(text)
        else:
            write_text(text, Path(f"block{number}.{language}"))


def test_every_block_is_of_a_language_that_runs() -> None:
    for name in EVERY_PAGE:
        found = blocks(name, *RUN, "math", "text", "js")  # tests/web runs scripts
        assert len(re.findall(r"^ *(?:```|~~~)", page(name), re.MULTILINE)) == 2 * len(found)
        plain = [text for language, text in found if language == "text"]
        assert len(plain) == NO_CODE.get(name, 0)
        for text in plain:
            assert not re.search(r"^\$ |^(mixseq [a-z]+ |pip |python |scripts/\w)", text, re.MULTILINE), text


def test_what_is_not_run_is_shown() -> None:
    shown = [line for name in EVERY_PAGE for _, text in blocks(name, *COMMANDS_SHOWN) for line, _ in commands(text)]
    for pattern in NOT_RUN:
        assert any(re.match(pattern, line) for line in shown), f"no page has {pattern}; take it out"


def test_measurements_that_are_shown_are_there() -> None:
    for name in EVERY_PAGE:
        for _, text in blocks(name, "sh"):
            for line in (words(line) for line, _ in commands(text)):
                if "scripts/bench" in line:
                    name = line[line.index("scripts/bench") + 1]
                    assert (ROOT / "scripts" / "benchmarks" / f"{name}.py").is_file(), line
                elif "scripts/paper" in line:
                    names = takewhile(lambda word: not word.startswith("-"), line[line.index("scripts/paper") + 1 :])
                    assert set(names) <= set(STAGES), line
                elif line[0] == "python" and line[1].endswith(".py"):
                    assert (ROOT / line[1]).is_file(), line
                elif line[0].startswith("scripts/"):
                    assert os.access(ROOT / line[0], os.X_OK), line


def commands(text: str) -> list[tuple[str, str]]:
    """Return the commands of a block, each with what it shows of its output."""
    if "$ " in text:
        found = [command.partition("\n") for command in re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]]
        return [(line, shown) for line, _, shown in found]
    return [(line, "") for line in text.splitlines() if line.strip()]


@cache
def demo(*arguments: str) -> Path:
    """Run ``mixseq demo --out FOLDER``, of which several pages take the same files, and return the folder."""
    folder = Path(mkdtemp(prefix="mixseq-demo-"))
    result = CliRunner().invoke(main, ["demo", "--out", str(folder), *arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    assert not result.stderr
    atexit.register(shutil.rmtree, folder)
    return folder


def write_text(text: str, path: Path) -> None:
    """Write a block to the file that its first line names, if it does; if it is an edit script, run it."""
    named = re.match(r"# (\S+)\n", text)
    path = Path(named[1]) if named else path
    path.write_text(text, encoding="utf-8")
    if "[[edit]]" in text:
        model = mixseq.load("walk.h5")
        for edit in read_script(path, Readers(mixseq.load, mixseq.read)):
            model = edit(model)
        model(model.times[0])


def test_the_readme_leads_to_every_page() -> None:
    linked = {target.partition("#")[0] for target in LINK.findall(page("README.md"))}
    assert {f"docs/{file.name}" for file in (ROOT / "docs").glob("*.md")} <= linked


def test_every_operation_is_explained() -> None:
    scripts = [tomllib.loads(text) for _, text in blocks("docs/editing.md", "toml")]
    assert {edit["operation"] for script in scripts for edit in script["edit"]} == set(OPERATIONS)
    explained = {name for row in rows("docs/editing.md") for name in re.findall(r"`(\w+)`", row[0])}
    assert {name for name in operations.__all__ if name not in (*RESAMPLING, "Handle", "Moment")} <= explained


def words(line: str) -> list[str]:
    """Return the words of a command, without a comment at its end, with the files that a pattern means."""
    split = shlex.split(re.sub(r"\s+#\s.*", "", line))
    return [name for word in split for name in (sorted(map(str, Path().glob(word))) if "*" in word else [word])]


def run_commands(text: str) -> None:
    """Run the commands of a block; what the page shows of their output must be there.

    Shown lines are told apart by what stands before the first two blanks, as their numbers may differ a little
    elsewhere. Warnings must be shown.
    """
    found = commands(text)
    assert found, f"no command in\n{text}"
    for line, shown in found:
        if any(re.match(pattern, line) for pattern in NOT_RUN):
            continue
        program, *arguments = words(line)
        assert program == "mixseq", f"{line}: neither run nor among what is not run"
        if arguments[0] == "demo":
            shutil.copytree(demo(*(each for each in arguments[3:] if each != "--quiet")), arguments[2])
            continue
        result = CliRunner().invoke(main, arguments, catch_exceptions=False)
        assert result.exit_code == 0, f"{line}\n{result.output}"
        for expected in shown.splitlines():
            label = expected.split("  ")[0]
            assert any(each.startswith(label) for each in result.output.splitlines()), f"{line}: {expected}"
        warned = [each for each in shown.splitlines() if "warning: " in each]
        assert result.stderr.splitlines() == warned, line


def test_links_and_pictures_exist() -> None:
    for path in PAGES:
        for target in LINK.findall(prose(str(path.relative_to(ROOT)))):
            if target.startswith(("http://", "https://")):
                continue
            file, _, anchor = target.partition("#")
            linked = (path.parent / file) if file else path
            assert linked.exists(), f"{path.name}: {target}"
            if anchor:
                assert anchor in anchors(linked), f"{path.name}: {target}"


@cache
def anchors(path: Path) -> frozenset[str]:
    """Return the anchors that GitHub makes of a page's headings."""
    headings = re.findall(r"^#+ (.*)$", FENCE.sub("", path.read_text(encoding="utf-8")), re.MULTILINE)
    return frozenset(re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings)


def test_every_page_is_linked_from_the_overview() -> None:
    linked = set(LINK.findall(page("docs/index.md")))
    assert {path.name for path in (ROOT / "docs").glob("*.md")} - linked == {"index.md"}


def test_pages_name_no_folder_of_some_machine() -> None:
    for path in PAGES:
        assert not re.search(r"(?<![\w.])/(work|home|Users|tmp|root)/", path.read_text(encoding="utf-8")), path


def test_reference_has_what_all_commands_share() -> None:
    described = section("docs/cli.md", "Common options")
    assert f"`{max_memory.opts[0]} {max_memory.metavar}` | all |" in described


@pytest.mark.parametrize("name", COMMANDS)
def test_reference_has_every_option(name: str) -> None:
    command = main.get_command(click.Context(main), name)
    assert command is not None
    described = section("docs/cli.md", f"mixseq {name}")
    settings = [parameter for parameter in command.params if isinstance(parameter, Setting)]
    options = {
        option
        for parameter in command.params
        if isinstance(parameter, click.Option) and parameter not in (*settings, max_memory)
        for option in (*parameter.opts, *parameter.secondary_opts)
    }
    long = {option for each in settings for option in (*each.opts, *each.secondary_opts)}
    named = set(re.findall(r"(?<![\w-])--[a-z][\w-]*", described))
    if name == "batch":  # examples have options of its jobs
        jobs = [command.make_context(name, [job, "--help"], resilient_parsing=True).command for job in JOBS]
        named -= {option for job in jobs for each in job.params for option in each.opts} - options
    assert named - long == {option for option in options if option.startswith("--")}
    for setting in settings:
        assert re.search(rf"\b{setting.key}[`=]", described), setting.key
    for short in options - named:
        assert f"`{short}`" in page("docs/cli.md")


def test_reference_has_every_command() -> None:
    assert re.findall(r"^## mixseq ([\w-]+)$", page("docs/cli.md"), re.MULTILINE) == COMMANDS


def test_formats_are_complete() -> None:
    for form in FORMATS:
        for word in (*form.extensions, *form.read_options, *form.write_options):
            assert f"`{word}`" in page("docs/formats.md"), f"{form.name}: {word}"
        for extension in form.extensions:
            assert extension in page("README.md"), f"{form.name}: {extension}"


def test_table_of_formats_is_that_of_the_code() -> None:
    for table in (capability_table(), motion_table()):
        assert as_markdown(table) in page("docs/formats.md"), "run `mixseq formats --markdown`"


def test_specification_has_every_array_of_surfaces() -> None:
    specified = re.findall(r"^\| `surface/(\w+)` \|", page("docs/file-format.md"), re.MULTILINE)
    assert specified == list(SURFACE_ARRAY_NAMES)


@pytest.mark.parametrize(
    ("name", "heading", "settings"),
    [
        ("docs/segmentation.md", "Parts by motion", MotionSettings()),
        ("docs/segmentation.md", "Augmented silhouettes", SilhouetteSettings()),
        ("docs/segmentation.md", "Spanning-tree cut", SpanningTreeSettings()),
        ("docs/reconstruction.md", "Settings of the mixed space", Projection()),
        ("docs/reconstruction.md", "Gauss-Newton", ShellSettings()),
        ("docs/spaces.md", "Edge", EdgeSettings()),
    ],
    ids=["motion", "silhouettes", "spanning tree", "projection", "shell", "edge"],
)
def test_defaults_are_those_of_the_code(name: str, heading: str, settings: Any) -> None:
    table = {row[0]: row[1] for row in rows_of(section(name, heading))}
    for field in fields(settings):
        stated, default = table[f"`{field.name}`"].strip('`"'), getattr(settings, field.name)
        if default is None or isinstance(default, str):
            assert stated == (default or "none"), field.name
        else:
            assert float(stated) == default, field.name


def test_constants_of_the_specification_are_those_of_the_code() -> None:
    stated = list(rows_of(page("docs/file-format.md").partition("\n### Constants\n")[2]))[2:]
    assert len(stated) > 30
    for what, values, place in stated:
        module, _, name = place.strip("`").rpartition(".")
        constant = getattr(import_module(f"mixseq.compression.bitstream.{module}"), name)
        assert [float(value) for value in values.split(",")] == list(np.atleast_1d(constant)), what


def test_specification_has_every_parameter_of_the_coding() -> None:
    explained = {name for row in rows("docs/file-format.md") for name in re.findall(r"^\*(\w+)\*$", row[0])}
    stored = {field.name for each in (CodingParameters, TemporalInterpolation) for field in fields(each)}
    assert explained == stored | {LABEL_COUNT}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a sequence and models in both placements and all spaces."""
    path = tmp_path_factory.mktemp("docs")
    walk = coarse_walk(frames=3)
    moving = mixseq.MeshSequence.from_header(walk.header, walk.points, np.zeros_like(walk.points))
    mixseq.write(path / "sequence.h5", moving)
    mixseq.save(path / "walk.h5", mixseq.fit(walk, exact=True))
    mixseq.save(path / "free.h5", mixseq.fit(walk, placement="free"))
    mixseq.save(path / "vertex.h5", mixseq.fit(walk, space="vertex"))
    small = bar(sides=5, rings=13, frames=3)
    mixseq.save(path / "gradient.h5", mixseq.fit(small, rank=1, space="gradient"))
    mixseq.save(path / "lri.h5", mixseq.fit(small, rank=1, space="lri"))
    mixseq.save(path / "edge.h5", mixseq.fit(small, rank=1, space="edge", projection="dso", volume=1.0))
    keyed = mixseq.fit(small, exact=True)
    mixseq.save(path / "herd.h5", operations.with_body(keyed, operations.key_poses(keyed), "other"))
    mixseq.save(path / "compressed.h5", mixseq.compress(small, max_error=0.01))
    return path


MODELS = ("walk.h5", "free.h5", "vertex.h5", "gradient.h5", "lri.h5", "edge.h5", "herd.h5")


@pytest.mark.parametrize("name", ["sequence.h5", *MODELS])
def test_specification_has_every_dataset_and_attribute(name: str, folder: Path) -> None:
    table = {row[0].strip("`"): row for row in rows("docs/file-format.md") if row[0].startswith("`")}
    with h5py.File(folder / name) as file:
        attributes, datasets = contents(file)
        assert set(attributes) | set(datasets) <= set(table)
        for key, value in attributes.items():
            stated = {"string": bytes, "int64": np.int64, "float64": np.float64}[table[key][1]]
            assert isinstance(value, stated), key
        for key, dataset in datasets.items():
            shape, dtype = table[key][1:3]
            assert shape.count(",") + (not shape.endswith(",)")) == dataset.ndim, key
            kinds = dtype.split(" or ")
            if name in MODELS and key.startswith(("signals/", "space/")):
                kinds = {"float64": ["float64", "float32"]}.get(dtype, kinds)
            assert str(dataset.dtype) in kinds, key
            if dataset.size:
                filters = dataset.fletcher32, dataset.shuffle, dataset.compression, dataset.compression_opts
                assert filters == (True, True, "gzip", 6), key


def contents(file: h5py.File) -> tuple[dict[str, Any], dict[str, h5py.Dataset]]:
    attributes, datasets = dict(file.attrs), {}

    def visit(name: str, item: h5py.Group | h5py.Dataset) -> None:
        attributes.update(item.attrs)
        if isinstance(item, h5py.Dataset):
            datasets[name.removeprefix("bodies/0/")] = item

    file.visititems(visit)
    return attributes, datasets


def test_specification_has_nothing_else(folder: Path) -> None:
    known: set[str] = {
        "mixseq-sequence",
        "mixseq-model",
        *(f"surface/{name}" for name in SURFACE_ARRAY_NAMES),
    }
    for name in ("sequence.h5", "compressed.h5", *MODELS):
        with h5py.File(folder / name) as file:
            for each in contents(file):
                known |= set(each)
    assert {row[0].strip("`") for row in rows("docs/file-format.md") if row[0].startswith("`")} == known


def run_specification(number: int) -> dict[str, Any]:
    """Run one of the two snippets of the file format: the first edits a model, the second decodes a frame."""
    snippets = blocks("docs/file-format.md", "py")
    assert len(snippets) == 2
    names: dict[str, Any] = {}
    exec(snippets[number][1], names)
    return names


def test_specification_is_enough_to_decode(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    names, model = run_specification(1), mixseq.load("walk.h5")
    assert names["time"] == model.times[1]
    assert (np.diff(model.mixed.skinning_weights.indptr) > 1).any()
    np.testing.assert_allclose(names["points"], model(names["time"]), atol=1e-9 * model.mixed.scale)


def test_specification_edits_as_it_says(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    edited, model = run_specification(0)["edited"], mixseq.load("walk.h5")
    lengths = len(model.mixed.edge_ids)
    assert lengths > 10
    np.testing.assert_allclose(edited.shapes[:, :lengths], 1.1 * model.shapes[:, :lengths], rtol=1e-6)
    np.testing.assert_array_equal(edited.shapes[:, lengths:], model.shapes[:, lengths:])
    first = np.broadcast_to(model.placement.values[0], model.placement.values.shape)
    np.testing.assert_array_equal(edited.placement.values, first)
    np.testing.assert_array_equal(edited.pose.matrix[0], 1.5 * model.pose.matrix[0])
    half, last = model.time.times[:2].mean(), model.time.times[-1]
    np.testing.assert_array_equal(edited.time([half])[0], model.time.values[:2].mean(axis=0))
    np.testing.assert_array_equal(edited.time([last])[0], 0.5 * model.time.values[-1])
    assert np.isfinite(edited.sample().points).all()
