"""A folder with files of every kind, and the command line as the console script runs it."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from pxr import Gf, Usd, UsdGeom

import mixseq
from mixseq.cli import main
from mixseq.mesh.polygons import Polygons
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.model import Model
from tests.pictures.conftest import LOW_RESOLUTION, set_resolution

Run = Callable[..., Result]
Contents = Callable[[], dict[str, bytes | None]]


def succeed(result: Result) -> str:
    """Return what a command printed that ended without an error or a warning."""
    assert (result.exit_code, result.stderr) == (0, "")
    return result.stdout


@pytest.fixture(autouse=True)
def _low_resolution(monkeypatch: pytest.MonkeyPatch) -> None:
    set_resolution(monkeypatch, LOW_RESOLUTION)


class SerialPool:
    """Run tasks here, as a `ProcessPool` does in processes that take seconds to start."""

    def as_completed(
        self, function: Callable[..., Any], shared: object, items: Iterable[Any]
    ) -> Iterator[tuple[Any, Callable[[], Any]]]:
        """Yield items in their order."""
        for item in items:
            yield item, partial(lambda result: result, function(shared, item))


@pytest.fixture
def processes() -> None:
    """Let batches start processes."""


@pytest.fixture(autouse=True)
def _batches_in_this_process(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    if "processes" not in request.fixturenames:
        monkeypatch.setattr("mixseq.runtime.processes.process_pool", lambda *_: nullcontext(SerialPool()))


@pytest.fixture(scope="session")
def pantry(tmp_path_factory: pytest.TempPathFactory, bent_bar: MeshSequence, bar_model: Model) -> Path:
    """What `folder` is a copy of."""
    place = tmp_path_factory.mktemp("pantry")
    for name in ("bar.npz", "bar.usdc", "bar_sequence.h5"):
        mixseq.write(place / name, bent_bar)
    mixseq.save(place / "model.h5", bar_model)
    mixseq.save(place / "model.hdf5", bar_model)
    quad = Polygons.from_triangles([[0, 1, 2], [0, 2, 3]])
    mixseq.write(place / "other.npz", MeshSequence.from_arrays(bent_bar.points[:, :4], quad, fps=10))
    for name in ("bar.npz", "bar.usdc", "bar_sequence.h5", "model.h5"):
        whole = (place / name).read_bytes()
        (place / f"cut_{name}").write_bytes(whole[: len(whole) // 2])
    (place / "notes.txt").write_text("no mesh")
    (place / "notes.npz").write_text("no mesh")
    (place / "empty.h5").write_bytes(b"")
    for name in ("old.npz", "old.usdc", "old.h5"):
        (place / name).write_bytes(b"somebody's work")
    (place / "folder.h5").mkdir()
    (place / "folder.usdc").mkdir()
    return place


@pytest.fixture
def folder(pantry: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with files of every kind."""
    place = tmp_path / "work"
    shutil.copytree(pantry, place)
    monkeypatch.chdir(place)
    return place


@pytest.fixture
def run(folder: Path) -> Run:
    """Run ``mixseq`` in the folder; what is no error of the user's is raised."""

    def run_it(*arguments: str) -> Result:
        return CliRunner().invoke(main, list(arguments), prog_name="mixseq", catch_exceptions=False)

    return run_it


@pytest.fixture(scope="session")
def files_made() -> dict[tuple[str, ...], bytes]:
    """What commands made, see `made_once`."""
    return {}


@pytest.fixture
def made_once(run: Run, folder: Path, files_made: dict[tuple[str, ...], bytes]) -> Callable[..., Path]:
    """Run ``mixseq COMMAND SOURCE TARGET ...`` where no other test did, and return the target."""

    def make(*arguments: str) -> Path:
        target = folder / arguments[2]
        if arguments not in files_made:
            result = run(*arguments)
            assert (result.exit_code, result.stderr) == (0, "")
            files_made[arguments] = target.read_bytes()
        target.write_bytes(files_made[arguments])
        return target

    return make


@pytest.fixture
def contents(folder: Path) -> Contents:
    """Return the names and contents of everything in the folder."""
    return lambda: {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }


@pytest.fixture
def scene(folder: Path) -> Path:
    """A mesh that bends, below something that slides, and a camera that slides."""
    stage = Usd.Stage.CreateNew(str(folder / "scene.usda"))
    stage.GetRootLayer().subLayerPaths.append("./bar.usdc")
    stage.SetTimeCodesPerSecond(10)
    (bar,) = stage.GetPseudoRoot().GetChildren()
    for prim in (bar, UsdGeom.Camera.Define(stage, "/camera").GetPrim()):
        slide = UsdGeom.Xformable(prim).AddTranslateOp()
        for code in range(4):
            slide.Set(Gf.Vec3d(code, 0, 0), code)
    stage.Save()
    return folder / "scene.usda"
