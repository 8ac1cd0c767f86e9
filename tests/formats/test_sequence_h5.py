"""HDF5 sequences: layout, versions, checksums, models, and a disk that fills up."""

from __future__ import annotations

import io
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest

import mixseq
from mixseq.errors import FormatError, InvalidSequenceError
from mixseq.sequence.sequence import LazyFrames, MeshSequence
from mixseq_io import read, write
from tests.formats.models.model_cases import GOLDEN

pytestmark = pytest.mark.slow


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "walk.h5"


def test_layout(path: Path, plain: MeshSequence) -> None:
    write(path, plain)
    with h5py.File(path) as file:
        assert (file.attrs["format"], file.attrs["version"]) == (b"mixseq-sequence", 1)
        for name in ("points", "times", "polygons/counts", "polygons/indices"):
            assert file[name].fletcher32 and file[name].shuffle and file[name].compression == "gzip"
        assert file["points"].chunks[1:] == (plain.vertex_count, 3)


def test_chunks_are_about_a_megabyte(path: Path) -> None:
    points = np.zeros((200, 3000, 3), np.float32)
    write(path, MeshSequence.from_arrays(points, [[0, 1, 2]]))
    with h5py.File(path) as file:
        assert file["points"].chunks == (29, 3000, 3)


def test_damage_names_the_frames(path: Path) -> None:
    points = np.random.default_rng(0).normal(size=(60, 3000, 3))  # 14 frames a chunk
    write(path, MeshSequence.from_arrays(points, [[0, 1, 2]]))
    with h5py.File(path) as file:
        chunk = file["points"].id.get_chunk_info(2)
    content = bytearray(path.read_bytes())
    content[chunk.byte_offset + chunk.size // 2] ^= 4
    path.write_bytes(content)
    with pytest.raises(FormatError, match=r"walk\.h5: points of frames 16 to 31 are damaged; restore"):
        read(path)


def test_another_version(path: Path, plain: MeshSequence) -> None:
    write(path, plain)
    with h5py.File(path, "a") as file:
        file.attrs["version"] = 2
    with pytest.raises(FormatError, match=r"version 2 .* reads version 1; it was written by another version of mixseq"):
        read(path)


def test_hdf5_of_others(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["points"] = [1, 2, 3]
    with pytest.raises(FormatError, match=r"not one of mixseq's \(format = None\)"):
        read(path)


@pytest.mark.parametrize("missing", ["points", "times", "polygons/counts", "fps", "version"])
def test_missing_pieces(path: Path, plain: MeshSequence, missing: str) -> None:
    write(path, plain)
    with h5py.File(path, "a") as file:
        del (file.attrs if missing in file.attrs else file)[missing]
    with pytest.raises(FormatError, match=r"walk\.h5"):
        read(path)


@pytest.mark.parametrize("name", ["points", "times", "polygons/counts"])
def test_groups_in_place_of_datasets(path: Path, plain: MeshSequence, name: str) -> None:
    write(path, plain)
    with h5py.File(path, "a") as file:
        del file[name]
        file.create_group(name)
    with pytest.raises(FormatError, match=r"walk\.h5"):
        read(path)


@pytest.mark.parametrize("name", ["version", "fps"])
def test_infinite_attributes(path: Path, plain: MeshSequence, name: str) -> None:
    write(path, plain)
    with h5py.File(path, "a") as file:
        file.attrs[name] = np.inf
    with pytest.raises((FormatError, InvalidSequenceError), match=r"walk\.h5"):
        read(path)


def damaged_bits(content: bytes, what: bytes) -> list[bytes]:
    """Flip every third bit of all places of some bytes, one at a time."""
    spoilt = []
    place = content.find(what)
    while place >= 0:
        for number in range(0, 8 * len(what), 3):
            data = bytearray(content)
            data[place + number // 8] ^= 1 << number % 8
            spoilt.append(bytes(data))
        place = content.find(what, place + 1)
    return spoilt


@pytest.mark.parametrize("kind", ["sequence", "model"])
def test_damage_to_names_and_axes_is_noticed(path: Path, plain: MeshSequence, kind: str) -> None:
    name = "Grünling"
    sequence = replace(plain, name=name, up_axis="Z")
    if kind == "model":
        mixseq.save(path, mixseq.fit(sequence, space="vertex"))
    else:
        write(path, sequence)
    content = path.read_bytes()
    assert b"GCOL" not in content  # where HDF5 keeps strings of any length, without checksums
    spoilt = damaged_bits(content, name.encode()) + damaged_bits(content, b"up_axis")
    assert len(spoilt) >= 8 * (9 + 7) // 3
    for data in spoilt:
        path.write_bytes(data)
        with pytest.raises(FormatError, match=r"walk\.h5"):
            read(path)
    path.write_bytes(content)
    assert (read(path).name, read(path).up_axis) == (name, "Z")


def test_the_golden_file_still_reads_the_same() -> None:
    found = read(GOLDEN / "sequence-v1.h5")
    with np.load(GOLDEN / "sequence-v1.npz") as expected:
        for what in ("points", "times", "velocities"):
            np.testing.assert_array_equal(getattr(found, what), expected[what])
    assert (found.name, found.up_axis, found.metres_per_unit) == ("bär", "Z", 0.01)
    assert [(each.name, each.material) for each in found.surface.face_sets] == [("end", "skin")]


def test_faces_out_of_range(path: Path, plain: MeshSequence) -> None:
    write(path, plain)
    with h5py.File(path, "a") as file:
        file["polygons/indices"][2] = 99
    with pytest.raises(InvalidSequenceError, match=r"walk\.h5: face 0 uses vertex 99"):
        read(path)


def test_a_model_is_sampled(path: Path, plain: MeshSequence, monkeypatch: pytest.MonkeyPatch) -> None:
    with h5py.File(path, "w") as file:
        file.attrs["format"] = np.bytes_("mixseq-model")
    model = SimpleNamespace(header=plain.header, frames=LazyFrames(plain.header, plain.blocks))
    monkeypatch.setattr("mixseq_io.model_files.load", lambda path: model)
    np.testing.assert_array_equal(read(path).points, plain.points)


FILL_THE_DISK = """
import resource, sys
from pathlib import Path
import numpy as np
from mixseq.errors import OutputError
from mixseq.sequence.sequence import MeshSequence
from mixseq_io import read, write

def noise(frames):
    points = np.random.default_rng(0).normal(size=(frames, 1000, 3)).astype(np.float32)
    return MeshSequence.from_arrays(points, [[0, 1, 2]])

folder = Path(sys.argv[1])
names = ["a.h5", "a.npz", "a.usdc", "a.usda", "a_#.obj"]
for name in names:
    write(folder / name, noise(1))
before = {file: file.read_bytes() for file in folder.iterdir()}
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, resource.RLIM_INFINITY))
for attempt in range(2):
    for name in names:
        try:
            write(folder / name, noise(5))
        except OutputError as error:
            assert str(error).startswith(f"cannot write {folder / name}: "), error
        else:
            raise SystemExit(f"{name} was written")
        assert {file: file.read_bytes() for file in folder.iterdir()} == before, name
resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
for name in names:
    write(folder / name, noise(2))
    assert read(folder / name).frame_count == 2
"""


@pytest.mark.skipif(sys.platform == "win32", reason="there are no file size limits")
def test_a_disk_that_fills_up(tmp_path: Path) -> None:
    # In a process of its own: HDF5, left to itself, dies of this later.
    run = subprocess.run(
        [sys.executable, "-c", FILL_THE_DISK, str(tmp_path)], capture_output=True, text=True, timeout=60
    )
    assert (run.returncode, run.stdout, run.stderr) == (0, "", "")


@pytest.mark.parametrize("error", [KeyboardInterrupt(), SystemExit(143)], ids=["interrupt", "termination"])
def test_what_is_raised_while_hdf5_writes_comes_through(
    path: Path,
    plain: MeshSequence,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    error: BaseException,
) -> None:
    """HDF5 calls Python to write, and cannot pass on what a signal raises there."""
    write(path, plain)
    before = path.read_bytes()

    class Broken(io.FileIO):
        def write(self, data: Any) -> int:
            raise error

    monkeypatch.setattr(Path, "open", lambda self, *mode, **options: Broken(self, "w+"))
    with pytest.raises(type(error)):
        write(path, plain)
    monkeypatch.undo()
    assert capfd.readouterr() == ("", "")
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]
