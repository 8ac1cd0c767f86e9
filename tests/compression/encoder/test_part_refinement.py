"""Vertices go to the part whose components tell their motion in the fewest bits."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.compression.bitstream.signal_graph import mesh_graph
from mixseq.compression.encoder.components import MIN_PART_VERTICES, refine_parts, trajectory_components
from mixseq.compression.encoder.trial import Candidate, try_step
from mixseq.sequence.sequence import FrameStore, MeshSequence, load_frames
from mixseq.types import Index
from tests.meshes import bar, rotation, tube


def two_limbs(frames: int = 20) -> FrameStore:
    """A tube whose two halves turn about its middle, each by itself."""
    points, faces = tube(16, 40)
    points = points - points.mean(axis=0)
    far = points[:, 2] > 0
    turns = np.random.default_rng(0).normal(size=(frames, 2, 3)).cumsum(axis=0) * 0.2
    moved = [
        np.where(far[:, None], points @ rotation(tuple(one)).T, points @ rotation(tuple(other)).T)
        for one, other in turns
    ]
    return load_frames(MeshSequence.from_arrays(np.stack(moved), faces))


def shifted(sequence: FrameStore) -> tuple[Index, Index]:
    """The labels of the halves, and those of a cut that is a quarter of the tube off."""
    points = np.asarray(tube(16, 40)[0])
    place = points[:, 2] - points[:, 2].mean()
    return (place > 0).astype(np.int64), (place > 0.25 * np.ptp(place)).astype(np.int64)


def test_a_cut_moves_to_where_the_motion_changes() -> None:
    sequence = two_limbs()
    right, wrong = shifted(sequence)
    found = refine_parts(trajectory_components(sequence, 1e-6), wrong, sequence.header.faces, 0.01)
    assert np.count_nonzero(found != right) < 0.2 * np.count_nonzero(wrong != right)


def test_better_parts_take_fewer_bytes() -> None:
    sequence = two_limbs()
    _, wrong = shifted(sequence)
    components, faces = trajectory_components(sequence, 1e-6), sequence.header.faces
    graph = mesh_graph(faces, len(wrong))
    sizes = [
        try_step(sequence, Candidate.from_labels(components, labels, faces, graph, 1e-6), 0.01).size
        for labels in (wrong, refine_parts(components, wrong, faces, 0.01))
    ]
    assert sizes[1] < 0.95 * sizes[0]


@pytest.mark.parametrize("step", [1e-6, 0.01, 1e3])
def test_no_part_is_lost(step: float) -> None:
    sequence = load_frames(bar(sides=6, rings=30, frames=5))
    labels = (np.arange(sequence.header.vertex_count) // 40).astype(np.int64)
    found = refine_parts(trajectory_components(sequence, 1e-9), labels, sequence.header.faces, step)
    assert len(np.unique(found)) == labels.max() + 1
    assert np.bincount(found).min() >= min(MIN_PART_VERTICES, np.bincount(labels).min())
