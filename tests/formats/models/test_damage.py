"""Models in HDF5: nothing damaged is believed, and files of other versions are told."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import mixseq
from mixseq.errors import FormatError
from mixseq.signals.model import Model
from tests.formats.models.model_cases import ATTRIBUTES, DATASETS, EACH_DATASET, assert_equal, replace, with_nan
from tests.meshes import bar

pytestmark = pytest.mark.slow

# Damage ---------------------------------------------------------------------------------------------------


def test_truncated_files_are_format_errors(stored: Path, tmp_path: Path) -> None:
    whole = stored.read_bytes()
    cut = tmp_path / "cut.h5"
    for size in [0, 1, 7, 8, 47, 48, 95, 96, *range(100, len(whole), len(whole) // 40), len(whole) - 1]:
        cut.write_bytes(whole[:size])
        with pytest.raises(FormatError, match=r"cut\.h5"):
            mixseq.load(cut)


SPOILER = """
import sys
from pathlib import Path
import numpy as np
import mixseq
from mixseq.errors import FormatError

source, target, seed, count = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])
original, whole = mixseq.load(source), source.read_bytes()
rng = np.random.default_rng(seed)
refused = silent = 0
for place in rng.integers(0, len(whole), count):
    spoilt = bytearray(whole)
    spoilt[place] ^= int(rng.integers(1, 256))
    target.write_bytes(spoilt)
    try:
        loaded = mixseq.load(target)
    except FormatError as error:
        assert target.name in str(error), error
        refused += 1
        continue
    # Bytes that nothing depends on may differ; numbers may not.
    assert np.array_equal(loaded.vectors, original.vectors), f"byte {place} changed the signals"
    assert np.array_equal(loaded.times, original.times), f"byte {place} changed the frames"
    for name in ("shapes", "reference"):
        assert np.array_equal(getattr(loaded.space, name), getattr(original.space, name)), f"byte {place}: {name}"
    weights = (model.space.skinning_weights.toarray() for model in (loaded, original))
    assert np.array_equal(*weights), f"byte {place}: skinning weights"
    silent += 1
print(refused, silent)
"""


def test_a_flipped_byte_is_refused_or_does_no_harm(stored: Path, tmp_path: Path) -> None:
    """In a process of its own: a byte that makes HDF5 crash must not take the tests along."""
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", SPOILER, stored, tmp_path / "spoilt.h5", "3", "100"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert result.returncode == 0, result.stderr
    refused, harmless = map(int, result.stdout.split())
    assert refused + harmless == 100
    assert refused > 33


def test_noise_after_a_valid_start_is_refused(stored: Path, tmp_path: Path) -> None:
    whole = bytearray(stored.read_bytes())
    rng = np.random.default_rng(0)
    for start in range(48, len(whole), len(whole) // 20):
        spoilt = bytes(whole[:start]) + rng.bytes(len(whole) - start)
        (tmp_path / "noise.h5").write_bytes(spoilt)
        with pytest.raises(FormatError, match=r"noise\.h5"):
            mixseq.load(tmp_path / "noise.h5")


@pytest.mark.parametrize(
    ("name", "row"),
    [
        ("signals/time/values", 4),
        ("signals/pose/offset", 1),
        ("signals/pose/matrix", 0),
        ("signals/shape/lengths", 2),
        ("signals/shape/angles", 0),
        ("signals/shape/unposed", 1),
        ("signals/shape/part_rotations", 2),
        ("signals/shape/part_centres", 0),
        ("signals/shape/relation_rotations", 1),
        ("signals/shape/relation_points", 2),
        ("signals/placement/times", 0),
        ("signals/placement/rotations", 1),
        ("signals/placement/translations", 2),
        ("signals/correction/times", 0),
        ("signals/correction/rotations", 3),
        ("signals/correction/translations", 4),
        ("space/shapes", 7),
        ("space/reference", 1),
        ("space/skinning/weights", 3),
        ("space/steadiness/turns", 0),
        ("space/steadiness/centres", 1),
        ("space/steadiness/relation_turns", 1),
        ("space/steadiness/relation_points", 0),
    ],
)
def test_numbers_that_are_not_finite_are_refused(copy: Path, name: str, row: int) -> None:
    replace(copy, name, with_nan(row))
    with pytest.raises(FormatError, match=rf"bar\.h5: {name} is not finite in row {row}"):
        mixseq.load(copy)


def test_numbers_that_are_absurd_are_refused(copy: Path) -> None:
    def with_too_large(array: Any) -> Any:
        array[1] = 1e308
        return array

    replace(copy, "space/reference", with_too_large)
    with pytest.raises(FormatError, match=r"bar\.h5: space/reference has 1e\+308 in row 1, beyond 1e\+20"):
        mixseq.load(copy)


@pytest.mark.parametrize("name", ["signals/placement/rotations", "signals/pose/offset"])
def test_numbers_that_overflow_are_refused(copy: Path, name: str) -> None:
    def enlarged(values: Any) -> Any:
        values[1] = -1e300
        return values

    replace(copy, name, enlarged)
    with pytest.raises(FormatError, match=rf"bar\.h5: {name} has 1e\+300 in row 1, beyond 1e\+60; it is damaged"):
        mixseq.load(copy)


@pytest.mark.parametrize("scale", [0.0, -1.0, 1e-320, 1e300, np.inf, np.nan])
def test_scales_that_no_mesh_has_are_refused(copy: Path, scale: float) -> None:
    with h5py.File(copy, "r+") as file:
        file["space"].attrs["scale"] = scale
    with pytest.raises(FormatError, match=r"bar\.h5: the scale of the space is .* 1e-60 to 1e\+60 is expected"):
        mixseq.load(copy)


@pytest.mark.parametrize(("space", "name"), EACH_DATASET)
def test_missing_datasets_are_refused(files: Path, tmp_path: Path, space: str, name: str) -> None:
    copy = shutil.copy(files / f"{space}.h5", tmp_path / "bar.h5")
    with h5py.File(copy, "r+") as file:
        del file[name]
    with pytest.raises(FormatError, match=rf"bar\.h5.*{name.split('/')[-1]}"):
        mixseq.load(copy)


@pytest.mark.parametrize("name", sorted(ATTRIBUTES - {"created_by", "provenance"}))
def test_missing_attributes_are_refused(free: Path, name: str) -> None:
    with h5py.File(free, "r+") as file:
        del file.attrs[name]
    with pytest.raises(FormatError, match=r"bar\.h5"):
        mixseq.load(free)


OTHER_SHAPES: dict[str, Callable[[Any], Any]] = {
    "shorter": lambda values: values[:-1],
    "longer": lambda values: np.concatenate([values, values[-1:]]),
    "flat": lambda values: values.reshape(-1)[:, None, None],
    "text": lambda values: np.array([b"text"] * len(values)),
    "scalar": lambda values: values.reshape(-1)[0] if values.size else 0.0,
}


@pytest.mark.parametrize(("space", "name"), EACH_DATASET)
def test_datasets_of_another_size_or_type_are_refused_or_do_no_harm(
    files: Path, tmp_path: Path, models: dict[str, Model], space: str, name: str
) -> None:
    for how, change in OTHER_SHAPES.items():
        copy = Path(shutil.copy(files / f"{space}.h5", tmp_path / "bar.h5"))
        replace(copy, name, change)
        if (name, how) == ("signals/time/frames", "shorter"):  # an edit that makes sense
            np.testing.assert_array_equal(mixseq.load(copy).times, models[space].times[:-1])
            continue
        try:
            loaded = mixseq.load(copy)
        except FormatError as error:
            assert "bar.h5" in str(error), how
        else:
            assert_equal(loaded, models[space])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        (name, value)
        for name in sorted(DATASETS["mixed"])
        if name.startswith(
            ("polygons", "segmentation", "space/joint_faces", "space/skinning/sizes", "space/skinning/parts")
        )
        for value in (-1, 10**6)
        if (name, value) != ("segmentation/widths", 10**6)
    ],
)
def test_numbers_out_of_range_are_refused(copy: Path, name: str, value: int) -> None:
    def change(values: Any) -> Any:
        if not len(values):
            return np.array([value])
        values[len(values) // 2] = value
        return values

    replace(copy, name, change)
    with pytest.raises(FormatError, match=r"bar\.h5"):
        mixseq.load(copy)


@pytest.mark.parametrize(
    ("where", "name", "value"),
    [
        ("/", "settings", "{"),
        ("/", "settings", "[]"),
        ("/", "settings", '{"shell": {"glue": 1}}'),
        ("/", "settings", '{"projection": {"steps": 2}}'),
        ("/", "version", "new"),
        ("/", "vertex_count", -5),
        ("/", "fps", 0.0),
        ("/", "up_axis", "W"),
        ("/", "space", "edges"),
        ("/", "space", "vertex"),
        ("space", "scale", "wide"),
        ("space", "scale", float("nan")),
        ("space", "scale", 0.0),
    ],
)
def test_bad_attributes_are_refused(free: Path, where: str, name: str, value: Any) -> None:
    with h5py.File(free, "r+") as file:
        file[where].attrs[name] = np.bytes_(value) if isinstance(value, str) else value
    with pytest.raises(FormatError, match=r"bar\.h5"):
        mixseq.load(free)


@pytest.mark.parametrize("version", [0, 2, 8])
def test_other_versions_are_refused(copy: Path, version: int) -> None:
    with h5py.File(copy, "r+") as file:
        file.attrs["version"] = version
    with pytest.raises(
        FormatError, match=rf"has version {version} .* reads version 1; it was written by another version of mixseq"
    ):
        mixseq.load(copy)


def test_other_files_are_not_models(tmp_path: Path) -> None:
    mixseq.write(tmp_path / "sequence.h5", bar(sides=4, rings=3, frames=2))
    with pytest.raises(FormatError, match=r"sequence\.h5 .* not a mixseq model .*mixseq encode"):
        mixseq.load(tmp_path / "sequence.h5")
    with h5py.File(tmp_path / "foreign.h5", "w") as file:
        file["data"] = np.arange(3)
    with pytest.raises(FormatError, match=r"foreign\.h5 .* not a mixseq model"):
        mixseq.load(tmp_path / "foreign.h5")
    (tmp_path / "text.h5").write_text("no HDF5 at all")
    with pytest.raises(FormatError, match=r"text\.h5"):
        mixseq.load(tmp_path / "text.h5")
    with pytest.raises(FormatError, match=r"nowhere\.h5 does not exist"):
        mixseq.load(tmp_path / "nowhere.h5")
    with pytest.raises(FormatError, match="is a folder"):
        mixseq.load(tmp_path)
