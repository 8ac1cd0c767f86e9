"""Alembic, reading: what is refused."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

import pytest

imath = pytest.importorskip("imath")
from alembic3d import Abc, AbcGeom  # noqa: E402

from mixseq.errors import FormatError, InvalidSequenceError, MissingExtraError  # noqa: E402
from mixseq_io.alembic.reader import open_alembic  # noqa: E402
from tests.formats.alembic.alembic_maker import SQUARE, add_mesh, filled, load, moving, positions, rising, save  # noqa: E402


def test_no_meshes(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    for name in ("left", "right"):
        AbcGeom.OCamera(archive.getTop(), name)
    AbcGeom.OPoints(archive.getTop(), "dust")
    del archive
    with pytest.raises(FormatError, match=r"has no mesh; it has 2 Camera, 1 Points\. Export meshes"):
        load(path)


def test_only_hidden_meshes(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    AbcGeom.CreateVisibilityProperty(add_mesh(archive.getTop(), "ghost", rising()), 0).setValue(0)
    del archive
    with pytest.raises(FormatError, match=r"its meshes are hidden; name one by prim .*: '/ghost'"):
        load(path)


def test_faces_that_change(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    mesh = add_mesh(archive.getTop(), "square", rising(2))
    add = [filled(imath.IntArray, row) for row in ([0, 1, 3], [3])]
    mesh.getSchema().set(AbcGeom.OPolyMeshSchemaSample(positions(SQUARE), *add))
    del archive, mesh
    with pytest.raises(InvalidSequenceError, match=r"walk.abc: the faces of /square change at 1 s \(index 2\)"):
        load(path)


def test_points_that_change_in_number(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    mesh = add_mesh(archive.getTop(), "square", rising(2))
    mesh.getSchema().set(AbcGeom.OPolyMeshSchemaSample(positions([*SQUARE, [5, 5, 5]])))
    del archive, mesh
    with pytest.raises(
        InvalidSequenceError, match=r"the frame at 1 s \(index 2\) of /square has 5 points, the first frame 4"
    ):
        load(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\x89HDF\r\n\x1a\n" + bytes(100), "old Alembic based on HDF5; convert it with abcconvert"),
        (b"Ogawa\x00\x00\x01" + bytes(100), "is not complete"),
        (b"Ogawa", "is not complete"),
        (b"Ogawa\xff\x00\x01" + b"\xff" * 8, "is not complete"),
        (b"PK\x03\x04 something else", "cannot be read as Alembic"),
        (b"", "cannot be read as Alembic"),
    ],
    ids=["HDF5", "unfinished", "short", "truncated", "zip", "empty"],
)
def test_files_of_other_kinds(path: Path, content: bytes, message: str) -> None:
    path.write_bytes(content)
    with pytest.raises(FormatError, match=rf"walk\.abc.*{message}"):
        open_alembic(path)


def test_without_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "mixseq_io.alembic.samples")
    monkeypatch.setitem(sys.modules, "alembic3d", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'mixseq\[alembic\]'"):
        import_module("mixseq_io.alembic.samples")


def test_missing_file(path: Path) -> None:
    with pytest.raises(FormatError, match="does not exist"):
        open_alembic(path)


def test_a_closed_reader(path: Path) -> None:
    save(path, moving())
    with open_alembic(path) as reader:
        blocks = reader.blocks(1)
        next(blocks)
    with pytest.raises(FormatError, match="is closed"):
        next(blocks)


def test_truncated_files(path: Path) -> None:
    save(path, moving())
    content = path.read_bytes()
    for end in range(0, len(content), 50):
        path.write_bytes(content[:end])
        with pytest.raises(FormatError, match="walk"):
            load(path)
