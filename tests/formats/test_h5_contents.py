"""HDF5 is read in a process of its own, and what would never end there is refused."""

from __future__ import annotations

import os
import shutil
import struct
from collections.abc import Callable
from pathlib import Path

import h5py
import pytest

import mixseq
from mixseq.errors import FormatError
from mixseq_io import isolation
from mixseq_io.hdf5.contents import MODEL_FORMAT, read_attributes, read_contents
from tests.formats.models.model_cases import GOLDEN

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("read", [mixseq.open_sequence, mixseq.load])
def test_strings_that_have_no_end_are_not_read(tmp_path: Path, read: Callable[[Path], object]) -> None:
    """HDF5 would search for ever in strings of any length: the size of what is free is too small."""
    path = Path(shutil.copy(GOLDEN / "sequence-v1.h5", tmp_path / "endless.h5"))
    with h5py.File(path, "r+", libver="v110") as file:
        file.attrs["name"] = "walk"
    data = bytearray(path.read_bytes())
    place = data.index(b"GCOL") + 16
    while struct.unpack_from("<H", data, place)[0]:
        place += 16 + -(-struct.unpack_from("<Q", data, place + 8)[0] // 8) * 8
    free = struct.unpack_from("<Q", data, place + 8)[0]
    struct.pack_into("<Q", data, place + 8, free - 16)  # what follows is of no size, again and again
    path.write_bytes(data)
    with pytest.raises(FormatError, match=r"endless\.h5: /, attribute name, has strings of any length"):
        read(path)


def test_a_pipe_is_not_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.h5")
    with pytest.raises(FormatError, match=r"pipe\.h5 is a pipe"):
        read_attributes(tmp_path / "pipe.h5")


def test_the_same_without_a_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    path = GOLDEN / "model-v1.h5"
    there = read_contents(path, MODEL_FORMAT)
    monkeypatch.setattr(isolation, "can_isolate", lambda: False)
    here = read_contents(path, MODEL_FORMAT)
    assert there.attributes == here.attributes
    assert there.attributes["space"]["scale"] > 1.0
    assert {name: array.tolist() for name, array in there.arrays.items()} == {
        name: array.tolist() for name, array in here.arrays.items()
    }
