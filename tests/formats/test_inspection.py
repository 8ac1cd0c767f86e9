"""HDF5 files that use what ours do not: each is refused before anything of it is read, and the object is named."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

import mixseq
from mixseq.errors import FormatError
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import FloatArray
from mixseq_io.hdf5.inspection import MAX_OBJECTS_PER_FILE
from tests.formats.models.model_cases import GOLDEN

pytestmark = pytest.mark.slow

NAME = "polygons/counts"
"""A dataset of sequences and models; it is replaced by what is refused."""

Spoil = Callable[[h5py.File], object]


def put(**stored: object) -> Spoil:
    """Store something of the same shape in another way."""
    return lambda file: file.create_dataset(NAME, **{"shape": (4,), "dtype": "i4"} | stored)


def virtual(source: str) -> Spoil:
    def spoil(file: h5py.File) -> None:
        layout = h5py.VirtualLayout((4,), "i4")
        layout[...] = h5py.VirtualSource(source, NAME, (4,), dtype="i4")
        file.create_virtual_dataset(NAME, layout)

    return spoil


def link(target: object) -> Spoil:
    return lambda file: file.__setitem__(NAME, target)


def second_name(file: h5py.File) -> None:
    file[NAME] = file["polygons/indices"]


def circle(file: h5py.File) -> None:
    file["polygons/round"] = file["polygons"]


def nested(file: h5py.File) -> None:
    file.create_group("/".join("abcdefghijklmn"))


def crowd(file: h5py.File) -> None:
    for number in range(MAX_OBJECTS_PER_FILE + 1):
        file.create_group(f"crowd/{number}")


def attribute(value: object, **stored: object) -> Spoil:
    return lambda file: file["polygons"].attrs.create("note", value, **stored)


def reference(file: h5py.File) -> None:
    file["polygons"].attrs.create("note", file["polygons"].ref, dtype=h5py.ref_dtype)


def lists(file: h5py.File) -> None:
    kind, space = h5py.h5t.vlen_create(h5py.h5t.NATIVE_INT32), h5py.h5s.create(h5py.h5s.SCALAR)
    h5py.h5a.create(file["polygons"].id, b"note", kind, space)


def many_attributes(file: h5py.File) -> None:
    for number in range(101):
        file["polygons"].attrs[str(number)] = number


REFUSED: dict[str, tuple[Spoil, str]] = {
    "soft link": (link(h5py.SoftLink("/polygons/indices")), "is a soft link"),
    "soft link onto itself": (link(h5py.SoftLink(f"/{NAME}")), "is a soft link"),
    "external link": (link(h5py.ExternalLink("other.h5", NAME)), "is a link to another file"),
    "second name": (second_name, "has a second name"),
    "virtual": (virtual("other.h5"), "is a virtual dataset"),
    "virtual of itself": (virtual("."), "is a virtual dataset"),
    "external storage": (put(external=[("other.bin", 0, 16)]), "keeps its data in another file"),
    "references": (put(dtype=h5py.ref_dtype), "has the type reference"),
    "region references": (put(dtype=h5py.regionref_dtype), "has the type reference"),
    "lists of any length": (put(dtype=h5py.vlen_dtype("i4")), "has the type list of any length"),
    "strings of any length": (put(dtype=h5py.string_dtype()), "has strings of any length"),
    "compound": (put(dtype=[("a", "i4"), ("b", "f4")]), "has the type compound"),
    "complex": (put(dtype="c16"), "has the type"),
    "arrays": (put(dtype=np.dtype(("i4", (3,)))), "has the type"),
    "opaque": (put(dtype="V8"), "has the type"),
    "enumeration": (put(dtype="?"), "has the type"),
    "long double": (put(dtype=np.longdouble), "has the type"),
    "lzf": (put(compression="lzf"), "is stored with the filter 32000"),
    "scale and offset": (put(scaleoffset=4), "is stored with the filter 6"),
    "named type": (link(np.dtype("i4")), "is neither a group nor a dataset"),
    "no shape": (lambda file: file.create_dataset(NAME, data=h5py.Empty("i4")), "has no shape"),
    "axes": (put(shape=(1, 1, 1, 1, 1)), "has 5 axes"),
    "never written": (put(shape=(1 << 30,), chunks=(1024,), compression="gzip"), r"claims 4294967296 bytes"),
    "never written, huge": (put(shape=(1 << 60,), chunks=(1024,)), r"claims \d+ bytes and has 0"),
    "never written, in one piece": (put(shape=(1 << 30,)), r"claims 4294967296 bytes and has 0"),
}
ELSEWHERE: dict[str, tuple[Spoil, str]] = {
    "circle": (circle, "polygons.* has a second name"),
    "nested": (nested, "is nested too deeply"),
    "crowd": (crowd, f"has more than {MAX_OBJECTS_PER_FILE} objects"),
    "reference": (reference, "/polygons, attribute note, has the type reference"),
    "attribute without value": (attribute(h5py.Empty("f8")), "attribute note, has no value"),
    "attribute of any length": (attribute("text"), "attribute note, has strings of any length"),
    "attribute of lists": (lists, "attribute note, has the type list"),
    "large attribute": (attribute(np.zeros(1 << 18)), "attribute note, is too large"),
    "many attributes": (many_attributes, "/polygons has 101 attributes"),
}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = Path(shutil.copy(GOLDEN / "model-v1-edge.h5", tmp_path / "strange.h5"))
    # What a link would find.
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other[NAME] = np.full(4, 3, np.int32)
    (tmp_path / "other.bin").write_bytes(bytes(16))
    return path


def assert_refused(path: Path, message: str) -> None:
    for read in (mixseq.open_sequence, mixseq.load):
        with pytest.raises(FormatError, match=rf"strange\.h5: .*{message}"):
            read(path)


@pytest.mark.parametrize("what", REFUSED)
def test_datasets(file: Path, what: str) -> None:
    spoil, message = REFUSED[what]
    with h5py.File(file, "r+", libver="latest") as opened:
        del opened[NAME]
        spoil(opened)
    assert_refused(file, message)


@pytest.mark.parametrize("what", ELSEWHERE)
def test_groups_and_attributes(file: Path, what: str) -> None:
    spoil, message = ELSEWHERE[what]
    with h5py.File(file, "r+", libver="latest") as opened:
        spoil(opened)
    assert_refused(file, message)


def test_the_same_bytes_are_not_claimed_twice(tmp_path: Path) -> None:
    path = tmp_path / "twice.h5"
    with h5py.File(path, "w", libver="earliest") as file:  # whose structure has no checksums
        first = file.create_dataset("first", data=np.arange(100_000))
        file.create_dataset("second", (100_000,), "i8")
        place = first.id.get_offset().to_bytes(8, "little")
    data = path.read_bytes()
    nowhere, size = b"\xff" * 8, (800_000).to_bytes(8, "little")
    assert data.count(nowhere + size) == 1
    path.write_bytes(data.replace(nowhere + size, place + size))
    with pytest.raises(
        FormatError, match=r"twice\.h5: /second and what is before it claim more bytes than the file has"
    ):
        mixseq.load(path)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("shape", [(500, 5000), (3, 200000), (1, 3), (2000, 50)])
def test_a_mesh_that_stands_still_is_no_bomb(tmp_path: Path, shape: tuple[int, int], dtype: type[np.float32]) -> None:
    frames, vertices = shape
    points: FloatArray = np.zeros((frames, vertices, 3), dtype)
    path = tmp_path / "still.h5"
    mixseq.write(path, MeshSequence.from_arrays(points, [[0, 1, 2]]))
    with mixseq.open_sequence(path) as reader:
        assert reader.header.vertex_count == vertices
