"""``mixseq view --markers``: what is refused, what is opened, and what is left when it ends."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import mixseq
from mixseq.cli import view as module
from mixseq.retargeting.markers import Markers
from mixseq.viewer.live import ViewSettings
from mixseq.viewer.live import marking as live
from mixseq.viewer.live.marking import MarkedMeshes
from mixseq.viewer.marking import Marking, Pair
from tests.cli.conftest import Run
from tests.meshes import bar, tube

pytestmark = pytest.mark.slow
pytest.importorskip("viser", reason="the extra viewer is not installed")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    points, faces = tube(8, 25)
    mixseq.write("bar.npz", bar(frames=3))
    mixseq.write("thick.obj", mixseq.MeshSequence.from_arrays(2 * points[None], faces))
    Path("pairs.txt").write_text("0 0  # end\n5 7\n")
    Path("wrong.txt").write_text("0 99999\n")
    Path("notes.txt").write_text("no markers\n")
    return tmp_path


class Room:
    """A viewer in which somebody sets pairs, and which ends at once, as by Ctrl-C."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.meshes: MarkedMeshes
        self.settings: ViewSettings
        self.save: Callable[[Markers], str]
        self.marking = Marking()
        self.has_changes = False
        monkeypatch.setattr(live, "run_marking_viewer", self._viewer)
        monkeypatch.setattr(module, "threading", SimpleNamespace(Event=lambda: self))

    @contextmanager
    def _viewer(self, meshes: MarkedMeshes, settings: ViewSettings, save: Any) -> Iterator[Any]:
        self.meshes, self.settings, self.save = meshes, settings, save
        yield SimpleNamespace(address="http://127.0.0.1:8080", session=self)

    def wait(self) -> None:
        raise KeyboardInterrupt


@pytest.fixture
def room(monkeypatch: pytest.MonkeyPatch) -> Room:
    return Room(monkeypatch)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("bar.npz --markers pairs.txt", "markers are of two meshes, a source and a target; 1 files were given"),
        ("bar.npz thick.obj bar.npz --markers p.txt", "3 files were given"),
        ("bar.npz thick.obj --markers notes.txt", "notes.txt, line 1"),
        ("bar.npz thick.obj --markers wrong.txt", "wrong.txt: marker 1.*the target has"),
        ("bar.npz thick.obj --markers thick.obj", "markers are a text; end the name in .txt, .json or .yml"),
        ("bar.npz thick.obj --markers none/pairs.txt", "the folder .*none does not exist"),
        ("bar.npz thick.obj --markers pairs.txt --read-only", "--read-only is not about setting markers"),
        ("bar.npz thick.obj --markers pairs.txt --export a.html", "--export is not about setting markers"),
        ("bar.npz thick.obj --markers pairs.txt --against bar.npz", "--against is not about setting"),
        ("bar.npz thick.obj --markers pairs.txt --overlaid", "--overlaid is not about setting markers"),
        ("bar.npz thick.obj --markers pairs.txt --prim /a", "none of the files is read with an option 'prim'"),
    ],
)
@pytest.mark.usefixtures("folder", "room")
def test_refused(run: Run, line: str, message: str) -> None:
    result = run("view", *line.split(), "--no-browser")
    assert result.exit_code == 2
    assert len(result.stderr.splitlines()) == 1
    assert re.search(message, result.stderr), result.stderr


@pytest.mark.usefixtures("folder")
def test_a_file_is_continued(run: Run, room: Room) -> None:
    result = run("view", "bar.npz", "thick.obj", "--markers", "pairs.txt", "--no-browser", "--port", "9000")
    assert (result.exit_code, result.stderr) == (0, "")
    assert room.meshes.names == ("bar.npz", "thick.obj")
    assert room.meshes.file == "pairs.txt"
    assert room.meshes.markers.names == ("end", "")
    assert room.meshes.source.frame_count == 4  # proposals compare motions
    assert room.settings.port == 9000
    sizes = [np.linalg.norm(np.ptp(item.pose(0.0), axis=0)) for item in room.meshes.scene.items]
    np.testing.assert_allclose(sizes, 1.0, rtol=1e-6)


@pytest.mark.usefixtures("folder")
def test_markers_are_saved_to_the_file(run: Run, room: Room) -> None:
    run("view", "bar.npz", "thick.obj", "--markers", "new.txt", "--no-browser")
    assert len(room.meshes.markers) == 0
    told = room.save(Markers.from_pairs([[1, 2], [3, 4]], ("nose", "")))
    assert told == "2 markers are in new.txt, for mixseq transfer --markers"
    again = mixseq.read_markers("new.txt")
    assert (again.source.tolist(), again.target.tolist(), again.names) == ([1, 3], [2, 4], ("nose", ""))


@pytest.mark.usefixtures("folder")
def test_what_is_not_saved_is_kept(run: Run, room: Room) -> None:
    room.marking, room.has_changes = Marking((Pair((1, 2)),)), True
    result = run("view", "bar.npz", "thick.obj", "--markers", "pairs.txt", "--no-browser")
    assert "the markers were not saved; they are in pairs-unsaved.txt" in result.stderr
    assert mixseq.read_markers("pairs-unsaved.txt").source.tolist() == [1]
    assert len(mixseq.read_markers("pairs.txt")) == 2
