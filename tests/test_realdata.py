"""Animations made by others come back exactly, and what lies between their frames is found."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import mixseq
from mixseq.choices import PLACEMENTS, PlacementName
from mixseq.operations.interpolation import PoseInterpolator
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import FloatArray

pytestmark = [pytest.mark.realdata, pytest.mark.slow]


class Case(NamedTuple):
    """A file and how many of its frames are looked at."""

    name: str
    frames: int


CASES = (
    Case("fox_run", 4),
    Case("q_wolf_gallop", 4),
    Case("q_man_run", 4),
    Case("lion_poses", 3),
    Case("camel_poses", 2),
    Case("horse_gallop", 3),
    Case("robotexpressive_dance", 5),
)


def some_frames(folder: Path, case: Case) -> MeshSequence:
    """Frames spread over a sequence."""
    whole = mixseq.read(folder / "npz" / f"{case.name}.npz")
    chosen = np.linspace(0, whole.frame_count - 1, case.frames).round().astype(int)
    return MeshSequence.from_header(whole.header.with_times(whole.times[chosen]), whole.points[chosen])


@pytest.mark.parametrize(
    ("case", "placement"),
    [
        (case, placement)
        for number, case in enumerate(CASES)
        for which, placement in enumerate(PLACEMENTS)
        if case.frames == 4 or number % len(PLACEMENTS) == which  # both where that is quick
    ],
    ids=str,
)
def test_frames_come_back(data: Path, case: Case, placement: PlacementName) -> None:
    sequence = some_frames(data, case)
    model = mixseq.fit(sequence, exact=True, placement=placement)
    error = np.linalg.norm(model.sample().points - sequence.points, axis=2).max() / sequence.diagonal
    assert error < (1e-9 if placement == "anchored" else 1e-6)


def test_half_way_between_two_lions(data: Path) -> None:
    """The paper's Figure 9: the free placement finds a whole lion between two poses."""
    whole = mixseq.read(data / "npz" / "lion_poses.npz")
    points = PoseInterpolator.from_poses(whole, pose_ids=[2, 5]).blend([0.5, 0.5])
    assert np.isfinite(points).all()
    # Edges are nearly as long as on average; halves of vertices would be far shorter where the lion turns.
    edges = mixseq.Topology(whole.faces, whole.vertex_count).edges
    first, second = whole.points[2], whole.points[5]

    def lengths(x: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.norm(x[edges[:, 1]].astype(float) - x[edges[:, 0]], axis=1))

    wanted = (lengths(first) + lengths(second)) / 2
    strain = np.abs(lengths(points) / np.maximum(wanted, 1e-12) - 1)
    averaged = np.abs(lengths((first + second) / 2) / np.maximum(wanted, 1e-12) - 1)
    assert np.mean(strain) < 0.5 * np.mean(averaged)
    assert np.quantile(strain, 0.99) < 0.2 * np.quantile(averaged, 0.99)  # 0.031 against 0.31
    assert np.quantile(strain, 0.999) < 0.1
