"""Frames edited by hand: spaces grow by what the edit needs, and key shapes are exchanged."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

import mixseq
from mixseq.compression.bitstream.compressed_sequence import to_model
from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.operations import concatenate, cut, reverse, shift, swap_key
from mixseq.operations.sculpt import encode_edit, sculpt
from mixseq.operations.transitions import match_spaces
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.spaces.vertex import BasisSpace
from tests.meshes import bar, coarse_walk

pytestmark = pytest.mark.slow


def compressed(sequence: MeshSequence) -> Model:
    """A compressed model in the basis space, whichever kind of basis takes fewer bytes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mixseq.compression.encoder.search.BASIS_KINDS", ("trajectories",))
        found = to_model(mixseq.compress(sequence, max_error=1e-2))
    assert isinstance(found.space, BasisSpace)
    return found


@pytest.fixture(scope="module")
def model() -> Model:
    return compressed(coarse_walk(frames=8))


def test_room_changes_nothing_but_the_space(model: Model) -> None:
    time = float(model.times[3])
    edited = model(time)
    edited[5] += (0.3, -0.2, 0.1)
    roomy, _ = encode_edit(model, time, edited)
    assert roomy.space.dim == model.space.dim + 9
    for t in (model.times[0], 0.5 * (model.times[2] + model.times[3])):
        np.testing.assert_allclose(roomy(t), model(t), atol=1e-12 * model.space.scale)


def test_displacement_along_one_axis_takes_one_field(model: Model) -> None:
    edited = model(model.times[3])
    edited[5, 1] += 0.3
    assert encode_edit(model, model.times[3], edited)[0].space.dim == model.space.dim + 3


def test_sculpted_vertex_is_where_it_was_put(model: Model) -> None:
    time = float(model.times[3])
    edited = model(time)
    edited[5] += (0.3, -0.2, 0.1)
    sculpted = sculpt(model, time, edited)
    np.testing.assert_allclose(sculpted(time), edited, atol=1e-9)
    moved = sculpted(model.times[6]) - model(model.times[6])
    np.testing.assert_allclose(moved[5], (0.3, -0.2, 0.1), atol=1e-9)
    np.testing.assert_allclose(np.delete(moved, 5, axis=0), 0, atol=1e-9)


def test_other_spaces_have_room() -> None:
    fitted = mixseq.fit(coarse_walk(frames=4), space="vertex")
    assert encode_edit(fitted, 0.0, fitted(0.0))[0].space is fitted.space


def test_points_of_another_mesh_are_refused(model: Model) -> None:
    with pytest.raises(InvalidSequenceError, match="shape"):
        encode_edit(model, 0.0, np.zeros((3, 3)))


def test_residual_layers_stay_with_their_times(model: Model) -> None:
    """Where an edit changes times, residual layers are left out: at other times they would do harm."""
    times, signals = model.times, replace(model, residual_layer=None)
    for edited, original in (
        (reverse(model), times[::-1]),
        (shift(model, 0.25), times),
        (cut(model, times[2], times[-1]), times[2:]),
    ):
        for mine, other in zip(edited.times, original, strict=True):
            np.testing.assert_allclose(edited(mine), signals(other), atol=1e-9)
    assert model.residual_layer is not None


def warped() -> MeshSequence:
    walk = coarse_walk(frames=8)
    return walk.with_points(walk.points + 0.1 * np.sin(7 * walk.points[..., [1, 2, 0]]))


def test_motions_of_two_files_keep_their_shapes(model: Model) -> None:
    """A basis has the shapes of its own motion; together they have those of both."""
    other = compressed(warped())
    both = match_spaces(replace(model, residual_layer=None), replace(other, residual_layer=None))
    for mine, original in zip(both, (model, other), strict=True):
        signals = replace(original, residual_layer=None)
        for time in (model.times[2], 0.5 * (model.times[4] + model.times[5])):
            np.testing.assert_allclose(mine(time), signals(time), atol=1e-9)
    longer = concatenate(model, other)
    np.testing.assert_allclose(
        longer(longer.end), replace(other, residual_layer=None)(other.end), atol=1e-6 * model.space.scale
    )


def test_the_same_file_twice_is_one_space(model: Model) -> None:
    space = model.space
    assert isinstance(space, BasisSpace)
    again = replace(model, space=BasisSpace(np.array(space.basis), space.scale))
    first, second = match_spaces(model, again)
    assert first.space is second.space is model.space
    np.testing.assert_array_equal(first.shapes, model.shapes)


def test_a_motion_in_another_space_takes_the_first_along(model: Model) -> None:
    fitted = mixseq.fit(warped(), space="vertex", exact=True)
    first, second = match_spaces(replace(model, residual_layer=None), fitted)
    assert first.space is second.space is fitted.space
    signals = replace(model, residual_layer=None)
    np.testing.assert_allclose(first(model.times[3]), signals(model.times[3]), atol=1e-9)
    np.testing.assert_allclose(second(model.times[3]), fitted(model.times[3]), atol=1e-9)


SEQUENCE: MeshSequence = bar(sides=5, rings=15, frames=6)


@cache
def keyed(space: str) -> Model:
    return fit(SEQUENCE, exact=True, pose="keys", space=space)  # type: ignore[arg-type]


@pytest.mark.parametrize("space", ["mixed", "vertex"])
def test_the_same_key_changes_nothing(space: str) -> None:
    model = keyed(space)
    for key in (0, 3, 5):  # all frames are keys
        swapped = swap_key(model, key, SEQUENCE.points[key])
        np.testing.assert_allclose(swapped.sample().points, SEQUENCE.points, atol=1e-9)


def test_vertices_that_were_not_moved_stay() -> None:
    """In a model of few keys too, in the frame of the key; the others follow by their weight."""
    model = fit(SEQUENCE, rank=3, pose="keys")
    assert len(model.key_frames) == 4
    frame = int(model.key_frames[1])
    x = model(float(model.times[frame]))
    bump = 0.2 * np.exp(-20 * np.square(x - x[10]).sum(axis=1))[:, None] * [1.0, 0, 0]
    swapped = swap_key(model, 1, x + bump)
    np.testing.assert_allclose(swapped(float(model.times[frame])), x + bump, atol=1e-6)
    other = int(model.key_frames[3])
    np.testing.assert_allclose(swapped.sample().points[other], model.sample().points[other], atol=1e-9)


def test_keys_that_are_no_frames_are_refused() -> None:
    model = fit(SEQUENCE, rank=2)
    assert (model.key_frames == -1).all()
    with pytest.raises(SettingsError, match="key shape 1 is no frame of the model; fit one with pose='keys'"):
        swap_key(model, 1, SEQUENCE.points[0])


def test_a_new_key_shows_in_its_frame_and_no_other() -> None:
    x = np.array(SEQUENCE.points[4])
    x[3] += [0.1, 0.0, 0.0]
    swapped = swap_key(keyed("vertex"), 4, x).sample().points
    np.testing.assert_allclose(swapped[4], x, atol=1e-12)
    np.testing.assert_allclose(np.delete(swapped, 4, axis=0), np.delete(SEQUENCE.points, 4, axis=0), atol=1e-12)


@pytest.mark.parametrize("key", [-1, 6])
def test_unknown_keys_are_refused(key: int) -> None:
    with pytest.raises(SettingsError, match=f"key is {key}; the model has key shapes 0 to 5"):
        swap_key(keyed("vertex"), key, SEQUENCE.points[0])


@pytest.mark.parametrize("points", [np.zeros((4, 3)), np.full((67, 3), np.nan)])
def test_other_meshes_are_refused(points: NDArray[np.float64]) -> None:
    with pytest.raises(InvalidSequenceError, match="edited points"):
        swap_key(keyed("vertex"), 0, points)
