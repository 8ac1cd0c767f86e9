"""Transfer of real animations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.choices import TRANSFERS, TransferName
from mixseq.retargeting.sources import prepare_source
from mixseq.retargeting.transfer import TransferSettings, plan_transfer
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import FloatArray
from mixseq_io.text.markers import read_markers
from tests.meshes import rotation
from tests.retargeting.pairs import furthest

pytestmark = [pytest.mark.realdata, pytest.mark.slow]

both = pytest.mark.parametrize("method", TRANSFERS)


def some_frames(folder: Path, name: str, count: int) -> MeshSequence:
    """Frames spread over a sequence, the first among them."""
    whole = mixseq.read(folder / "npz" / f"{name}.npz")
    chosen = np.unique(np.linspace(0, whole.frame_count - 1, count).round().astype(int))
    return MeshSequence.from_header(whole.header.with_times(whole.times[chosen]), whole.points[chosen])


def still(points: FloatArray, like: MeshSequence) -> MeshSequence:
    return MeshSequence.from_header(like.header.with_times([0.0]), points[None])


@both
@pytest.mark.parametrize(("name", "frames"), [("q_wolf_gallop", 4), ("camel_poses", 2)])
def test_transfer_to_the_same_mesh_is_identity(data: Path, name: str, frames: int, method: TransferName) -> None:
    sequence = some_frames(data, name, frames)
    moved = mixseq.transfer(sequence, still(sequence.points[0], sequence), method=method)
    error = furthest(moved.points, sequence.points.astype(np.float64))
    assert error <= 1e-6 * sequence.diagonal


@both
def test_a_wolf_on_a_copy_of_another_size(data: Path, method: TransferName) -> None:
    wolf = some_frames(data, "q_wolf_gallop", 6)
    turn, size, shift = rotation((0.7, -2.0, 0.4)), 3.7, np.array([10.0, 20.0, -5.0])
    copies = size * wolf.points.astype(np.float64) @ turn.T + shift
    moved = mixseq.transfer(wolf, still(copies[0], wolf), method=method)
    assert furthest(moved.points, copies) <= 1e-6 * size * wolf.diagonal


@pytest.mark.parametrize("seed", range(2))
def test_noise_of_the_source_is_hardly_amplified(data: Path, seed: int) -> None:
    """Noise as of a compressed file on a wolf whose hind legs nearly fold, and on its rest."""
    wolf = some_frames(data, "q_wolf_gallop", 27)
    noise = np.random.default_rng(seed).normal(size=wolf.points.shape)
    noise *= 1e-4 * wolf.diagonal / np.linalg.norm(noise, axis=2).max()
    parts = prepare_source(wolf).part_of_face()
    target = still(wolf.points[0] * np.array([1, 1.5, 1], dtype=np.float32), wolf)
    exact, noisy = (
        planned.method.transfer_frames(source.points[8:13])
        for source in (wolf, wolf.with_points(wolf.points + noise))
        for planned in [plan_transfer(source, target, TransferSettings(parts=parts))]
    )
    assert furthest(noisy, exact) <= 1e-3 * target.diagonal  # 4.6e-3 and 1.8e-3 if bends are not limited


@pytest.mark.exhaustive
def test_a_horse_on_a_camel_is_the_camel_of_sumner_and_popovic(data: Path) -> None:
    """Poses 1 and 2 by 107 markers, as they were published; beside places, which gradients do not tell."""
    horses, camels = (mixseq.read(data / "npz" / f"{name}_poses.npz") for name in ("horse", "camel"))
    some = MeshSequence.from_header(horses.header.with_times(horses.times[:3]), horses.points[:3])
    markers = read_markers(data / "markers" / "golevka_horse_camel.cons")
    planned = plan_transfer(some, still(camels.points[0], camels), TransferSettings(markers))
    assert planned.quality is not None
    moved = np.concatenate(list(planned.blocks()))
    away = moved - camels.points[:3]
    away -= away.mean(axis=1, keepdims=True)
    errors = np.sqrt(np.square(away).sum(axis=2).mean(axis=1)) / camels.diagonal
    assert errors[0] < 1e-6
    assert errors.max() < 0.03  # 0.012 and 0.017
