"""What is chosen by leaving frames out: how poses are predicted, and how much lengths and angles count."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.detail import Encoded, encode
from mixseq.signals.fitting import MIN_TRIAL_FRAMES, SHARES, Trial, tuned
from mixseq.spaces.making import MixedSettings, make_space
from mixseq.spaces.mixed.mixed_space import MixedSpace, Projection
from tests.meshes import bar, rotation, tube


@cache
def curling(frames: int = 9) -> MeshSequence:
    """A tube that curls up evenly: angles between frames are means, and vertices are not."""
    points, faces = tube(8, 41, length=10.0)
    x, y, z = points.T
    made = []
    for share in np.linspace(0.0, 1.6, frames):
        angle = np.maximum(share * np.pi * z / 10.0, 1e-9)
        radius = z / angle
        spot = np.stack([x, radius * (np.cos(angle) - 1), radius * np.sin(angle)], axis=1)
        made.append(spot + np.stack([0 * x, y * np.cos(angle), y * np.sin(angle)], axis=1))
    return MeshSequence.from_arrays(np.stack(made), faces)


def encoded_of(sequence: MeshSequence, parts: int, everywhere: bool = True) -> Encoded:
    """With lengths and angles of all faces, or of none."""
    space = make_space(sequence, "mixed", MixedSettings(parts=parts))
    assert isinstance(space, MixedSpace)
    faces = np.full(len(sequence.faces), everywhere)
    return encode(sequence, replace(space, joint_faces=faces, projection=Projection()))


def share_of(encoded: Encoded) -> float:
    assert isinstance(encoded.space, MixedSpace)
    return encoded.space.projection.share


def test_lengths_and_angles_count_where_they_are_right_between_frames() -> None:
    sequence = curling()
    assert share_of(tuned(encoded_of(sequence, 1), sequence.points)) >= 0.75


@pytest.mark.parametrize("block", ["lengths", "angles"])
def test_lengths_and_angles_do_not_count_where_they_are_noise(block: str) -> None:
    sequence = curling()
    encoded = encoded_of(sequence, 1)
    space, rng = encoded.space, np.random.default_rng(0)
    assert isinstance(space, MixedSpace)
    shapes = np.array(encoded.shapes[:])
    edges, hinges = space.sizes[:2]
    columns = slice(0, edges) if block == "lengths" else slice(edges, edges + hinges)
    size = shapes[:, columns].mean() if block == "lengths" else 1.0
    shapes[:, columns] += 0.5 * size * rng.normal(size=shapes[:, columns].shape)
    assert share_of(tuned(replace(encoded, shapes=shapes), sequence.points)) == 0.0


def test_nothing_else_of_the_space_changes() -> None:
    sequence = curling()
    encoded = encoded_of(sequence, 1)
    found = tuned(encoded, sequence.points)
    assert share_of(found) in SHARES
    assert isinstance(found.space, MixedSpace) and isinstance(encoded.space, MixedSpace)
    assert replace(found.space.projection, share=0.0) == encoded.space.projection
    assert found.shapes is encoded.shapes and found.placement is encoded.placement
    assert found.space.dim == encoded.space.dim


def spinning() -> MeshSequence:
    """A bar that bends a little, and spins by 70 degrees a frame."""
    still = bar(frames=9)
    turns = np.radians(70.0) * np.arange(9)
    centred = still.points - still.points.mean(axis=1, keepdims=True)
    points = np.stack([x @ rotation((0.0, turn, 0.0)).T for x, turn in zip(centred, turns, strict=True)])
    return MeshSequence.from_arrays(points, still.faces)


def test_parts_of_bodies_that_spin_are_predicted_in_them() -> None:
    sequence = spinning()
    assert tuned(encoded_of(sequence, 2, everywhere=False), sequence.points).in_body


def test_a_single_part_is_its_body() -> None:
    sequence = spinning()
    assert not tuned(encoded_of(sequence, 1, everywhere=False), sequence.points).in_body


def test_where_there_are_no_joints_no_share_is_chosen() -> None:
    sequence = bar(frames=9)
    encoded = encoded_of(sequence, 2, everywhere=False)
    assert tuned(encoded, sequence.points).space is encoded.space


def test_where_steps_are_taken_no_share_is_chosen() -> None:
    sequence = curling()
    space = encoded_of(sequence, 2).space
    assert isinstance(space, MixedSpace)
    stepping = replace(space, projection=Projection(share=1.0, steps=6))
    assert tuned(encode(sequence, stepping), sequence.points).space is stepping


def test_other_spaces_placements_and_short_sequences_stay_as_they_are() -> None:
    sequence = bar(sides=4, rings=9, frames=9)
    short = MeshSequence.from_arrays(sequence.points[:3], sequence.faces)
    for frames, name, settings in (
        (sequence, "vertex", None),
        (sequence, "mixed", MixedSettings(placement="free")),
        (short, "mixed", None),
    ):
        encoded = encode(frames, make_space(frames, name, settings))  # type: ignore[arg-type]
        assert tuned(encoded, frames.points) is encoded


def test_few_frames_of_large_meshes_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    sequence = curling(25)
    encoded = encoded_of(sequence, 1)
    assert isinstance(encoded.space, MixedSpace)
    many = Trial.of(encoded, encoded.space, sequence.points)
    assert len(many.frames) == len(many.points) == len(many.rows.frames) == 16
    assert 0 not in many.frames and 24 not in many.frames
    np.testing.assert_array_equal(many.points, sequence.points[many.frames] / encoded.space.scale)
    monkeypatch.setattr("mixseq.signals.fitting.MAX_TRIAL_VERTICES", 100)
    assert len(Trial.of(encoded, encoded.space, sequence.points).frames) == MIN_TRIAL_FRAMES


def test_frames_that_are_left_out_are_made_of_the_others() -> None:
    """Weights of the frame itself are none, and add up to one."""
    sequence = curling()
    encoded = encoded_of(sequence, 1)
    assert isinstance(encoded.space, MixedSpace)
    trial = Trial.of(encoded, encoded.space, sequence.points)
    for frame, used, weights in zip(trial.frames, trial.rows.frames, trial.rows.weights, strict=True):
        assert not weights[used == frame].any()
        assert weights.sum() == pytest.approx(1.0)
