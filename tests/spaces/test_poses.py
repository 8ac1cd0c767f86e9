"""Poses between frames: closed forms for even turns, and frames that are passed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.mesh.rotations import product, quaternions, rotations_of
from mixseq.spaces.temporal import LENGTHS, Operator, Poses, chained, predicted_alone, with_middles
from mixseq.types import Float
from tests.meshes import rigid_motions, rotation, seeds
from tests.spaces.moving import AXIS, turns_of, wandering


@pytest.mark.parametrize("step", [0.0, 20.0, 90.0, 179.0, -120.0])
@pytest.mark.parametrize("length", LENGTHS)
def test_even_turns_go_on_evenly_however_many(step: float, length: float) -> None:
    frames = np.arange(20.0)
    operator = Operator(frames, length)
    times = np.linspace(0, 19, 77)
    found = chained(operator.at(times), turns_of(np.radians(step) * frames))
    expected = np.stack([rotation(AXIS * np.radians(step) * time) for time in times])
    np.testing.assert_allclose(rotations_of(found[:, 0]), expected, atol=1e-11)
    np.testing.assert_allclose(np.linalg.norm(found, axis=2), 1.0, atol=1e-14)
    assert (np.einsum("tpi,tpi->tp", found[1:], found[:-1]) > 0).all()


def test_turns_about_one_axis_are_angles_that_are_predicted() -> None:
    times, angles = np.arange(9) / 24, np.cumsum(np.random.default_rng(0).uniform(-1.5, 1.5, 9))
    operator = Operator(times, 2.8)
    middles = (times[1:] + times[:-1]) / 2
    found = chained(operator.at(middles), turns_of(angles))
    expected = turns_of(operator.at(middles).of(angles))
    np.testing.assert_allclose(rotations_of(found), rotations_of(expected), atol=1e-13)


@settings(max_examples=15, deadline=None)
@given(seed=seeds, length=st.sampled_from(LENGTHS), frames=st.sampled_from([2, 3, 12, 60]))
def test_frames_are_passed(seed: int, length: float, frames: int) -> None:
    poses = wandering(seed, 3, frames)
    times = np.cumsum(np.random.default_rng(seed).uniform(0.5, 1.5, frames))
    found = predicted_alone(Operator(times, length).at(with_middles(times)), poses)
    np.testing.assert_allclose(found.rotations[::2], poses.rotations, atol=1e-15)
    np.testing.assert_array_equal(found.centres[::2], poses.centres)
    np.testing.assert_allclose(np.linalg.norm(found.rotations, axis=2), 1.0, atol=1e-14)
    assert (np.einsum("tpi,tpi->tp", found.rotations[1:], found.rotations[:-1]) > 0).all()


@settings(max_examples=15, deadline=None)
@given(seed=seeds, motion=rigid_motions)
def test_rigid_motions_of_everything_go_through(seed: int, motion: tuple[Float, Float]) -> None:
    turn, shift = motion
    poses, times = wandering(seed, 3), np.arange(12.0)
    moved = Poses(product(quaternions(turn), poses.rotations), poses.centres @ turn.T + shift)
    rows = Operator(times, 4.0).at(with_middles(times))
    here, there = (predicted_alone(rows, each) for each in (poses, moved))
    np.testing.assert_allclose(rotations_of(there.rotations), turn @ rotations_of(here.rotations), atol=1e-9)
    np.testing.assert_allclose(there.centres, here.centres @ turn.T + shift, atol=1e-9)


def test_one_frame_is_everywhere() -> None:
    poses = wandering(11, 3, 1)
    found = predicted_alone(Operator(np.array([0.5])).at(np.array([0.0, 0.5, 2.0])), poses)
    for block, own in zip(found, poses, strict=True):
        np.testing.assert_allclose(block, np.repeat(own, 3, axis=0), atol=1e-15)
