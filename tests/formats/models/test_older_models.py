"""Models of older versions: they become models of this one, and damaged ones are refused."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

import mixseq
from mixseq.errors import FormatError
from mixseq.geometry.lengths_angles import dihedral_angles, edge_lengths, unwrap_angles
from mixseq.geometry.rotations import continuous_vectors
from mixseq.retargeting.joint_solver import JointSolver
from mixseq.signals import Model
from tests.formats.models.model_cases import GOLDEN, anchored, points_at, replace, scaled, with_nan
from tests.formats.models.test_damage import OTHER_SHAPES
from tests.formats.models.test_kept import assert_kept
from tests.meshes import bar

pytestmark = pytest.mark.slow

# Version 1 ------------------------------------------------------------------------------------------------


def as_version_1(path: Path, model: Model) -> None:
    """Store an exact model in the anchored placement as version 1 did: lengths, angles and parts of all frames."""
    space, points = anchored(model), model.sample().points
    mixseq.save(path, model)
    solved = JointSolver(space.topology, space.decomposition, space.shapes, space.reference).solved
    edges, hinges = space.topology.edges[solved.edge_ids], space.topology.hinges[solved.hinge_ids]
    x = points / space.scale
    parts, turns, centres = zip(*(space.registered(frame) for frame in x), strict=True)
    lengths = edge_lengths(x, edges)
    with h5py.File(path, "r+") as file:
        file.attrs["version"] = 1
        file.attrs["settings"] = json.dumps({"shell": {"bending": 0.3}})
        del file["signals"], file["space/shares"]
        del file.attrs["space"]
        file["space/reference_lengths"] = lengths.mean(axis=0)
        file["signals/time/times"] = model.times
        file["signals/shape/lengths"] = lengths
        angles = dihedral_angles(x, hinges)
        file["signals/shape/angles"] = unwrap_angles(angles, dihedral_angles(space.reference, hinges))
        file["signals/shape/parts"] = np.stack(parts)
        file["signals/placement/rotations"] = continuous_vectors(np.stack(turns))
        file["signals/placement/translations"] = np.stack(centres)


@pytest.fixture
def old(tmp_path: Path) -> Path:
    path = tmp_path / "old.h5"
    as_version_1(path, mixseq.fit(bar(sides=5, rings=13, frames=6), parts=2, exact=True))
    return path


def test_version_1_becomes_an_exact_model_with_shares(old: Path, tmp_path: Path) -> None:
    sequence = bar(sides=5, rings=13, frames=6)
    expected, loaded = mixseq.fit(sequence, parts=2, exact=True), mixseq.load(old)
    shares = anchored(loaded).shares
    assert (np.diff(shares.indptr) > 1).any()
    np.testing.assert_allclose(shares.toarray(), anchored(expected).shares.toarray(), atol=1e-6)
    np.testing.assert_allclose(loaded.sample().points, sequence.points, atol=1e-9)
    between = [0.05, 0.33]
    np.testing.assert_allclose(loaded.sample(between).points, expected.sample(between).points, atol=1e-6)
    assert_kept(loaded, tmp_path / "new.h5")


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("signals/time/times", lambda values: values[::-1]),
        ("signals/time/times", lambda values: values[1:]),
        ("signals/shape/angles", lambda values: values[:, 1:]),
        ("signals/placement/rotations", lambda values: values[:, 1:]),
        ("signals/placement/translations", lambda values: values * np.nan),
    ],
)
def test_damaged_files_of_version_1_are_refused(old: Path, name: str, change: Callable[[Any], Any]) -> None:
    replace(old, name, change)
    with pytest.raises(FormatError, match=r"old\.h5: signals/"):
        mixseq.load(old)


# Versions 2 to 4 in the mixed space -----------------------------------------------------------------------
#
# Anchored models are decoded by the fit that they were made for, and encoded again.


@pytest.fixture
def second(tmp_path: Path) -> Path:
    """An exact model of version 2, to be edited or spoilt."""
    return Path(shutil.copy(GOLDEN / "model-v2.h5", tmp_path / "old.h5"))


def golden_points(name: str) -> NDArray[np.float64]:
    with np.load(GOLDEN / f"{name}.npz") as file:
        return np.array(file["points"])


def test_an_old_model_becomes_one_of_this_version(second: Path, tmp_path: Path) -> None:
    loaded = mixseq.load(second)
    assert len(loaded.time.times) == len(loaded.placement.times) == 11  # frames and middles
    assert_kept(loaded, tmp_path / "new.h5")
    with h5py.File(tmp_path / "new.h5") as file:
        assert file.attrs["version"] == 6
        assert "links" not in file["space"]


def test_old_models_with_few_knots_are_what_they_were_there() -> None:
    """Knots that are no frames are kept, too. At other frames links had a say, which is small: 0.0004 here."""
    model = mixseq.load(GOLDEN / "model-v2-rank.h5")
    with np.load(GOLDEN / "model-v2-rank.npz") as expected:
        points, knots, there = expected["points"], expected["between_times"], expected["between"]
    assert not np.isin(knots[1], model.times)
    assert np.isin(knots, model.time.times).all()
    np.testing.assert_allclose(model.sample(knots).points, there, atol=1e-9)
    np.testing.assert_allclose(model.sample().points, points, atol=1e-3)


def test_an_old_model_of_low_rank_loses_as_little_as_the_modes_are_worth(second: Path) -> None:
    """What is left out of pose space shows in the shapes of free vertices and parts, not in where parts are."""
    for name, change in (
        ("time/values", lambda values: values[:, :2]),
        ("pose/matrix", lambda matrix: matrix[:2]),
    ):
        replace(second, f"signals/{name}", change)
    model, points = mixseq.load(second), golden_points("model-v2")
    away = np.abs(model.sample().points - points)
    assert 1e-4 < away.max() < 0.1  # of a bar of length 4
    for part in model.decomposition.parts:
        centres, expected = model.sample().points[:, part].mean(axis=1), points[:, part].mean(axis=1)
        np.testing.assert_allclose(centres, expected, atol=1e-9)


def test_old_models_whose_frames_were_chosen_anew_keep_their_knots(second: Path) -> None:
    """Also those before the first of these frames, and after the last."""
    knots = mixseq.load(GOLDEN / "model-v2.h5").times
    replace(second, "signals/time/frames", lambda _: np.array([0.15, 0.33]))
    model = mixseq.load(second)
    np.testing.assert_array_equal(model.times, [0.15, 0.33])
    assert (model.start, model.end) == (0.0, 0.5)
    np.testing.assert_allclose(points_at(model, knots), golden_points("model-v2"), atol=1e-9)


def test_old_curves_may_have_knots_of_their_own(second: Path) -> None:
    """The placement loses a knot where its curve passes: there the other curve has one, and nothing moves far."""
    kept = [0, 1, 2, 4, 5]
    for name in ("times", "rotations", "translations"):
        replace(second, f"signals/placement/{name}", lambda values: values[kept])
    model, points = mixseq.load(second), golden_points("model-v2")
    np.testing.assert_allclose(model.sample().points[kept], points[kept], atol=1e-9)
    np.testing.assert_allclose(model.sample().points[3], points[3], atol=0.02)


def test_old_knots_that_differ_by_rounding_are_one(second: Path) -> None:
    replace(second, "signals/placement/times", lambda times: times + np.array([0, 0, 1e-12, 0, -1e-12, 0]))
    replace(second, "signals/time/times", lambda times: times + np.array([0, -1e-12, 0, 0, 1e-12, 0]))
    model = mixseq.load(second)
    assert len(model.time.times) == 11
    np.testing.assert_allclose(model.sample().points, golden_points("model-v2"), atol=1e-9)


def test_an_edited_translation_moves_an_old_model(second: Path) -> None:
    shift = np.array([1.0, 0.0, -0.5])
    with h5py.File(second, "r+") as file:
        file["signals/placement/translations"][...] += shift
        scale = file["space"].attrs["scale"]
    moved = mixseq.load(second).sample().points - golden_points("model-v2")
    np.testing.assert_allclose(moved, np.broadcast_to(shift * scale, moved.shape), atol=1e-9)


def test_old_free_models_turn_as_they_did(tmp_path: Path) -> None:
    """Rotation vectors become the quaternions of the same rotations, with signs that do not jump."""
    frames = np.arange(5.0)
    path = tmp_path / "old.h5"
    original = mixseq.fit(bar(sides=5, rings=13, frames=5), placement="free", parts=2, exact=True)
    mixseq.save(path, original)
    turns = np.stack([0 * frames, 1.5 * frames, 0 * frames], axis=1)[:, None]  # nearly a turn in all
    with h5py.File(path, "r+") as file:
        file.attrs["version"] = 2
        for name in ("times", "rotations", "translations"):
            values = file[f"signals/placement/{name}"][::2]
            del file[f"signals/placement/{name}"]
            file[f"signals/placement/{name}"] = turns if name == "rotations" else values
    loaded = mixseq.load(path)
    quaternions = loaded.placement.values[:, :4]
    expected = np.stack([np.cos(0.75 * frames), 0 * frames, np.sin(0.75 * frames), 0 * frames], axis=1)
    np.testing.assert_allclose(quaternions, expected, atol=1e-12)
    np.testing.assert_array_equal(loaded.shapes, original.shapes)
    np.testing.assert_array_equal(loaded.placement.values[:, 4:], original.placement.values[::2, 4:])


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("signals/placement/rotations", lambda values: values[:, :1], r"is float64 .*of shape \(6, 2, 3\)"),
        ("signals/placement/rotations", lambda values: values[:, [0, 1, 1]], r"is float64 .*\(6, 2, 3\)"),
        (
            "signals/placement/translations",
            lambda values: values[:, :1],
            r"is float64 .*of shape \(6, 2, 3\)",
        ),
        ("signals/placement/rotations", with_nan(2), "is not finite in row 2"),
        ("signals/placement/times", lambda values: values[::-1], "does not increase in row 1"),
        ("signals/shape/lengths", lambda values: values[:, 1:], r"is float64 .*floats of shape \(6, "),
        ("signals/shape/angles", lambda values: values[1:], r"is float64 .*floats of shape \(6, "),
        ("signals/shape/parts", lambda values: values[:, 1:], r"is float64 .*floats of shape \(6, "),
        ("signals/shape/offsets", lambda values: values[:, 1:], r"is float64 .*floats of shape \(6, 5, 3\)"),
        ("signals/time/values", lambda values: values[:, 1:], r"is float64 .*floats of shape \(6, 5\)"),
        ("space/shapes", lambda values: values[1:], r"is float64 .*floats of shape"),
        ("space/reference", lambda values: values[1:], r"is float64 .*floats of shape \(67, 3\)"),
        ("space/reference_lengths", lambda values: values[1:], r"is float64 .*floats of shape"),
        ("space/trust", lambda values: np.append(values, 1.0), r"is float64 .*floats of shape \(1\)"),
        ("space/reference_lengths", scaled(-1.0), "has lengths below zero"),
        ("space/trust", scaled(0.0), "has weights that are not positive"),
        ("space/trust", scaled(-1.0), "has weights that are not positive"),
    ],
)
def test_damaged_old_models_are_refused(
    second: Path, name: str, change: Callable[[Any], Any], message: str
) -> None:
    replace(second, name, change)
    with pytest.raises(FormatError, match=rf"old\.h5: {name} {message}"):
        mixseq.load(second)


OLD = [
    *(f"signals/shape/{name}" for name in ("lengths", "angles", "parts", "offsets")),
    *(f"signals/placement/{name}" for name in ("times", "rotations", "translations")),
    *("signals/pose/offset", "signals/pose/matrix", "signals/time/times", "signals/time/values"),
    *(f"space/{name}" for name in ("trust", "reference_lengths", "reference", "shapes")),
    *("segmentation/part_of_face", "segmentation/parts/vertices", "segmentation/joints/faces"),
]
"""What anchored models of versions 2 to 4 are read from, but for the frames and what is as in this version."""


@pytest.mark.parametrize("name", OLD)
@pytest.mark.parametrize("how", OTHER_SHAPES)
def test_old_datasets_of_another_size_or_type_are_refused(second: Path, name: str, how: str) -> None:
    replace(second, name, OTHER_SHAPES[how])
    with pytest.raises(FormatError, match=r"old\.h5"):
        mixseq.load(second)


@pytest.mark.parametrize("name", OLD)
def test_old_models_without_a_dataset_are_refused(second: Path, name: str) -> None:
    with h5py.File(second, "r+") as file:
        del file[name]
    with pytest.raises(FormatError, match=rf"old\.h5: {name} is missing"):
        mixseq.load(second)


@pytest.mark.parametrize("name", ["time", "placement"])
def test_old_models_with_frames_outside_a_curve_are_refused(second: Path, name: str) -> None:
    replace(second, f"signals/{name}/times", scaled(0.9))
    with pytest.raises(FormatError, match=rf"old\.h5: .*signals/{name}/times are only from 0 to 0\.45 s"):
        mixseq.load(second)


def test_old_models_without_settings_of_the_fit_are_refused(second: Path) -> None:
    for settings in ("{}", '{"shell": {"glue": 1}}', "["):
        with h5py.File(second, "r+") as file:
            file.attrs["settings"] = settings
        with pytest.raises(FormatError, match=r"old\.h5"):
            mixseq.load(second)


@pytest.mark.parametrize("seed", range(3))
def test_bytes_of_old_models_that_are_flipped_are_refused_or_do_no_harm(second: Path, seed: int) -> None:
    """Points are as they were, or an error tells of the damage."""
    whole, points = second.read_bytes(), golden_points("model-v2")
    rng = np.random.default_rng(seed)
    for place in rng.integers(2048, len(whole), 20):
        spoilt = bytearray(whole)
        spoilt[place] ^= int(rng.integers(1, 256))
        second.write_bytes(spoilt)
        try:
            loaded = mixseq.load(second)
        except FormatError as error:
            assert "old.h5" in str(error)
        else:
            np.testing.assert_allclose(loaded.sample().points, points, atol=1e-9)
