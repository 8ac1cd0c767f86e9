"""Models in HDF5: signals can be edited with h5py, and frames move as they should."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

import mixseq
from mixseq.mesh.rotations import normalise_quat, quat_multiply, quat_to_matrix
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from tests.formats.models.model_cases import INSIDE, points_at, replace, scale
from tests.meshes import bar

# Use ------------------------------------------------------------------------------------------------------


def test_a_model_reads_as_a_sequence(stored: Path, model: Model) -> None:
    sequence = mixseq.read(stored)
    np.testing.assert_array_equal(sequence.points, model.sample().points)
    np.testing.assert_array_equal(sequence.times, model.times)


def test_an_edited_key_shape_moves_frames_by_its_weight(vertices: Path, models: dict[str, Model]) -> None:
    model, bump = models["vertex"], np.array([0.1, -0.2, 0.3])
    with h5py.File(vertices, "r+") as file:
        file["signals/shape/positions"][1, 17] += bump
    moved = points_at(mixseq.load(vertices), INSIDE) - points_at(model, INSIDE)
    weight = model.pose.weights(model.time(INSIDE))[:, 1]
    assert np.abs(weight).max() > 0.5
    np.testing.assert_allclose(moved[:, 17], weight[:, None] * bump * scale(model), atol=1e-12)
    assert np.abs(np.delete(moved, 17, axis=1)).max() < 1e-12


def test_an_edited_value_moves_the_curve_there(vertices: Path, models: dict[str, Model]) -> None:
    model, knot, change = models["vertex"], 2, np.array([0.05, -0.02])
    with h5py.File(vertices, "r+") as file:
        file["signals/time/values"][knot] += change
    loaded = mixseq.load(vertices)
    moved = points_at(loaded, model.time.times) - points_at(model, model.time.times)
    expected = model.space.decode((change @ model.pose.matrix @ model.shapes)[None])[0]
    np.testing.assert_allclose(moved[knot], expected, atol=1e-12)
    assert np.abs(np.delete(moved, knot, axis=0)).max() < 1e-12


def test_knots_can_be_dropped(vertices: Path, models: dict[str, Model]) -> None:
    kept = [0, 1, 3, 4]
    for name in ("times", "values"):
        replace(vertices, f"signals/time/{name}", lambda array: array[kept])
    model = models["vertex"]
    cubic = Curve(model.time.times[kept], model.time.values[kept])
    np.testing.assert_array_equal(mixseq.load(vertices).time(INSIDE), cubic(INSIDE))


def test_a_knot_on_the_curve_changes_nothing(vertices: Path, models: dict[str, Model]) -> None:
    model, new = models["vertex"], 0.4
    place = int(np.searchsorted(model.time.times, new))
    value = model.time([new])[0]
    replace(vertices, "signals/time/times", lambda times: np.insert(times, place, new))
    replace(vertices, "signals/time/values", lambda values: np.insert(values, place, value, axis=0))
    loaded = mixseq.load(vertices)
    assert len(loaded.time.times) == len(model.time.times) + 1
    np.testing.assert_allclose(points_at(loaded, INSIDE), points_at(model, INSIDE), atol=1e-12)


def test_an_edited_offset_blends_key_shapes(vertices: Path, models: dict[str, Model]) -> None:
    model = models["vertex"]
    with h5py.File(vertices, "r+") as file:
        file["signals/pose/offset"][:2] += [0.25, -0.25]
    moved = points_at(mixseq.load(vertices), INSIDE) - points_at(model, INSIDE)
    expected = model.space.decode(0.25 * (model.shapes[:1] - model.shapes[1:2]))
    np.testing.assert_allclose(moved, np.repeat(expected, len(INSIDE), axis=0), atol=1e-12)


def test_an_edited_matrix_damps_a_coordinate(vertices: Path, models: dict[str, Model]) -> None:
    """Half the row is the same as half the coordinate."""
    model = models["vertex"]
    with h5py.File(vertices, "r+") as file:
        file["signals/pose/matrix"][1] *= 0.5
    damped = Curve(model.time.times, model.time.values * [1.0, 0.5])
    expected = Model(model.header, model.space, damped, model.pose, model.shapes, model.placement)
    np.testing.assert_allclose(points_at(mixseq.load(vertices), INSIDE), points_at(expected, INSIDE), atol=1e-12)


def test_key_shapes_can_be_added(vertices: Path, models: dict[str, Model]) -> None:
    """One that nothing uses yet, and as its offset is zero nothing changes."""
    replace(vertices, "signals/shape/positions", lambda keys: np.concatenate([keys, 2 * keys[:1]]))
    replace(vertices, "signals/pose/offset", lambda offset: np.append(offset, 0.0))
    replace(vertices, "signals/pose/matrix", lambda matrix: np.insert(matrix, 3, 0.0, axis=1))
    loaded = mixseq.load(vertices)
    assert len(loaded.shapes) == 4
    np.testing.assert_allclose(points_at(loaded, INSIDE), points_at(models["vertex"], INSIDE), atol=1e-12)


def test_an_edited_translation_moves_the_body_there(copy: Path, model: Model) -> None:
    """All parts alike, at one knot of the placement; at the others nothing moves."""
    knot, shift = 3, np.array([1.0, 0.0, -0.5])
    with h5py.File(copy, "r+") as file:
        file["signals/placement/translations"][knot] += shift
    times = model.placement.times
    moved = points_at(mixseq.load(copy), times) - points_at(model, times)
    np.testing.assert_allclose(moved[knot], np.broadcast_to(shift * scale(model), moved[knot].shape), atol=1e-9)
    assert np.abs(np.delete(moved, knot, axis=0)).max() < 1e-9


def test_an_edited_rotation_turns_the_body_there(copy: Path, model: Model) -> None:
    """By half a turn about z: as a whole, about its centre."""
    knot, space = 2, model.mixed
    with h5py.File(copy, "r+") as file:
        before, centre = (file[f"signals/placement/{name}"][knot, 0] for name in ("rotations", "translations"))
        file["signals/placement/rotations"][knot, 0] = quat_multiply(np.array([0.0, 0.0, 0.0, 1.0]), before)
    time, centre = model.placement.times[knot], centre * space.scale
    expected = (model(time) - centre) @ np.diag([-1, -1, 1]) + centre
    np.testing.assert_allclose(mixseq.load(copy)(time), expected, atol=1e-9)


def kept_by(model: Model, part: int) -> NDArray[np.integer]:
    """Return vertices that follow one part, and are no neighbours of joints."""
    space, faces = model.mixed, model.mixed.topology.faces
    near = np.isin(faces, faces[space.joint_faces]).any(axis=1)
    kept = np.setdiff1d(np.flatnonzero(space.rigid_part_of_vertex == part), faces[near])
    assert len(kept) > 3
    return kept.astype(np.int64)


def test_an_edited_correction_moves_a_part_there(copy: Path, model: Model) -> None:
    """As seen from the body; vertices that follow the other part alone stay."""
    knot, shift, space = 2, np.array([0.05, 0.0, -0.02]), model.mixed
    with h5py.File(copy, "r+") as file:
        file["signals/correction/translations"][knot, 0] += shift
    times = model.correction.times
    moved = points_at(mixseq.load(copy), times) - points_at(model, times)
    body = quat_to_matrix(normalise_quat(space.unpack_placements(model.placement(times[[knot]])).rotations))[0, 0]
    found = moved[knot][kept_by(model, 0)]
    np.testing.assert_allclose(found, np.broadcast_to(space.scale * body @ shift, found.shape), atol=1e-9)
    assert np.abs(moved[knot][kept_by(model, 1)]).max() < 1e-9
    assert np.abs(np.delete(moved, knot, axis=0)).max() < 1e-9


def test_quaternions_of_any_length_are_rotations(copy: Path, model: Model) -> None:
    """Where all are scaled alike, curves and shapes do not change."""
    with h5py.File(copy, "r+") as file:
        file["signals/placement/rotations"][...] *= 1.7
    np.testing.assert_allclose(points_at(mixseq.load(copy), INSIDE), points_at(model, INSIDE), atol=1e-12)


def test_an_edited_vertex_moves_with_its_frame(copy: Path, model: Model) -> None:
    """One that a part keeps, lifted in every key shape, is lifted as its frame is turned, whatever the pose."""
    space, bump = model.mixed, np.array([0.0, 0.02, 0.01])
    vertex = kept_by(model, 0)[0]
    with h5py.File(copy, "r+") as file:
        file["signals/shape/unposed"][:, vertex] += bump
    times = model.placement.times
    moved = points_at(mixseq.load(copy), times) - points_at(model, times)
    vectors = model.curve(times)
    blocks, poses = space.split(vectors), vectors[:, : space.shape_dim][:, -space.pose_dim :]
    turns = space.correct_poses(poses, blocks.corrections).rotations
    turns = quat_multiply(normalise_quat(blocks.body_rotations[:, 0]), turns[:, 0])
    np.testing.assert_allclose(moved[:, vertex], space.scale * quat_to_matrix(turns) @ bump, atol=1e-9)


def test_edited_lengths_move_joints_only(copy: Path, model: Model) -> None:
    with h5py.File(copy, "r+") as file:
        file["signals/shape/lengths"][...] *= 1.1
    moved = np.abs(points_at(mixseq.load(copy), INSIDE) - points_at(model, INSIDE)).max(axis=(0, 2))
    assert moved[model.mixed.topology.faces[model.mixed.joint_faces]].max() > 1e-2
    assert not moved[np.concatenate([kept_by(model, 0), kept_by(model, 1)])].any()


def test_frames_can_be_chosen_anew(copy: Path, model: Model) -> None:
    replace(copy, "signals/time/frames", lambda _: np.array([0.05, 0.5]))
    np.testing.assert_array_equal(mixseq.read(copy).points, model.sample([0.05, 0.5]).points)


def test_skinning_weights_that_are_edited_by_hand_move_vertices(copy: Path, model: Model) -> None:
    """Vertices follow one part each: key shapes mean something else between frames, but it is a model."""
    starts = model.mixed.skinning_weights.indptr[:-1]
    replace(copy, "space/skinning/parts", lambda values: values[starts])
    replace(copy, "space/skinning/weights", lambda _: np.ones(67))
    replace(copy, "space/skinning/sizes", lambda sizes: np.ones_like(sizes))
    space = mixseq.load(copy).mixed
    assert (space.rigid_part_of_vertex >= 0).all()
    points = bar(sides=5, rings=13, frames=7).points
    np.testing.assert_allclose(space.decode(space.encode(points)), points, atol=1e-12)
