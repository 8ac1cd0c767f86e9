"""The choice of a format, and what it costs to have so many."""

from __future__ import annotations

import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mixseq.errors import FormatError, InvalidSequenceError, OutputError
from mixseq.mesh.surface import Origin, Surface
from mixseq.sequence.sequence import MeshSequence
from mixseq_io import FORMATS, read, write


def test_importing_loads_no_format() -> None:
    code = "import sys, mixseq_io; print([m for m in ('pxr', 'h5py', 'trimesh', 'scipy') if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "[]\n"


def test_extensions_are_unique() -> None:
    extensions = [extension for each in FORMATS for extension in each.extensions]
    assert len(extensions) == len(set(extensions))


def test_extensions_may_be_capitals(plain: MeshSequence, tmp_path: Path) -> None:
    write(tmp_path / "WALK.NPZ", plain)
    assert read(tmp_path / "WALK.NPZ").frame_count == plain.frame_count


@pytest.mark.parametrize(
    ("written", "named", "message"),
    [
        ("a.h5", "b.usd", "holds HDF5 sequence data, not USD"),
        ("a.usdc", "b.npz", "holds USD data, not npz"),
        ("a.npz", "b.h5", r"holds zip \(npz or usdz\) data, not HDF5 sequence"),
        ("a.usda", "b.obj", "holds USD data, not OBJ"),
        ("a.npz", "b.usdz", "cannot be read as USD"),
        ("a.h5", "b.xyz", "the extension '.xyz' is not known, and it holds HDF5 sequence data; known are .usd"),
    ],
)
def test_files_under_a_wrong_name(plain: MeshSequence, tmp_path: Path, written: str, named: str, message: str) -> None:
    write(tmp_path / written, plain)
    shutil.move(tmp_path / written, tmp_path / named)
    with pytest.raises(FormatError, match=f"{named}.* ?{message}"):
        read(tmp_path / named)


def test_foreign_files(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_bytes(b"Ogawa\xff\x00\x01")
    with pytest.raises(FormatError, match="holds Alembic data, not OBJ"):
        read(tmp_path / "a.obj")


def test_unknown_extensions(plain: MeshSequence, tmp_path: Path) -> None:
    with pytest.raises(
        OutputError, match=r"the extension '.fbx' is not known; write one of .usd, .usda, .usdc, .usdz, "
    ):
        write(tmp_path / "a.fbx", plain)
    (tmp_path / "a.fbx").write_bytes(b"?")
    with pytest.raises(FormatError, match="its contents are of no known format"):
        read(tmp_path / "a.fbx")
    with pytest.raises(FormatError, match="does not exist"):
        read(tmp_path / "b.fbx")


def test_axes_and_units_can_be_told(plain: MeshSequence, tmp_path: Path) -> None:
    write(tmp_path / "walk.pc2", plain)
    told = read(tmp_path / "walk.pc2", up_axis="Z", metres_per_unit=0.01)
    assert (told.up_axis, told.metres_per_unit) == ("Z", 0.01)
    np.testing.assert_array_equal(told.points, plain.points)
    with pytest.raises(InvalidSequenceError, match=r"walk.pc2: up axis is 'W'"):
        read(tmp_path / "walk.pc2", up_axis="W")


@pytest.mark.parametrize("extension", ["npz", "h5"])
def test_the_origin_may_move_with_the_file(plain: MeshSequence, tmp_path: Path, extension: str) -> None:
    (tmp_path / "new").mkdir()
    surface = Surface(origin=Origin("USD", str(tmp_path / "old" / "fox.usd")))
    write(tmp_path / "new" / f"walk.{extension}", replace(plain, surface=surface))
    assert read(tmp_path / "new" / f"walk.{extension}").surface.origin == surface.origin
    (tmp_path / "new" / "fox.usd").touch()
    found = read(tmp_path / "new" / f"walk.{extension}").surface.origin
    assert found == Origin("USD", str(tmp_path / "new" / "fox.usd"))
