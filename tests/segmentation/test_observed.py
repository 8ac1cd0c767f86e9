"""What is seen of frames: rotations of parts and faces without area, block by block."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from mixseq.mesh.measures import flat_faces
from mixseq.mesh.topology import Topology
from mixseq.segmentation.joints import FLAT, Watched, decompose, frames_to_look_at, gather, observe
from mixseq.segmentation.motion import segment_by_motion
from tests.meshes import SEQUENCES, bar, rotation, topology_of, tube


def test_frames_are_evenly_spread_with_both_ends() -> None:
    assert frames_to_look_at(5).tolist() == [0, 1, 2, 3, 4]
    assert frames_to_look_at(100, 4).tolist() == [0, 33, 66, 99]
    assert frames_to_look_at(1).tolist() == [0]


@pytest.mark.parametrize(("count", "at_most"), [(240, 24), (25, 24), (7, 3)])
def test_frames_looked_at_are_looked_at_again(count: int, at_most: int) -> None:
    """So that a sequence can be cut by these frames alone."""
    chosen = frames_to_look_at(count, at_most)
    assert len(chosen) == at_most
    assert frames_to_look_at(len(chosen), at_most).tolist() == list(range(at_most))


def test_rotations_are_those_of_rigid_parts() -> None:
    mesh = tube(6, 9)
    labels = (mesh[0][mesh[1]].mean(axis=1)[:, 2] > 2.0).astype(np.int64)
    turns = [rotation((0.4 * t, -0.2 * t, 0.1 * t)) for t in range(5)]
    frames = np.stack([mesh[0] @ turn.T + [t, 0, 0] for t, turn in enumerate(turns)])
    seen = observe(Watched.of(topology_of(mesh), labels, frames[:1]), frames)
    assert seen.rotations.shape == (5, 2, 3, 3)
    for part in range(2):
        np.testing.assert_allclose(seen.rotations[:, part], np.stack(turns), atol=1e-12)
    assert not seen.flat.any()


def test_flat_faces_are_those_of_any_frame() -> None:
    sequence = SEQUENCES["zero area"]()
    topology = Topology(sequence.faces, sequence.vertex_count)
    seen = observe(Watched.of(topology, np.zeros(len(topology.faces), int), sequence.points), sequence.points)
    expected = flat_faces(sequence.points.astype(np.float64), topology.faces, FLAT).any(axis=0)
    assert expected.any()
    np.testing.assert_array_equal(seen.flat, expected)


@pytest.mark.parametrize("size", [1, 2, 5])
def test_blocks_do_not_matter(size: int) -> None:
    sequence = bar(frames=7)
    topology = Topology(sequence.faces, sequence.vertex_count)
    chosen = sequence.points[frames_to_look_at(len(sequence))]
    labels = segment_by_motion(chosen, topology)
    np.testing.assert_array_equal(labels, segment_by_motion(sequence.points, topology))
    watched = pickle.loads(pickle.dumps(Watched.of(topology, labels, chosen)))
    whole = observe(watched, sequence.points)
    seen = gather(observe(watched, sequence.points[start : start + size]) for start in range(0, 7, size))
    np.testing.assert_array_equal(seen.rotations, whole.rotations)
    np.testing.assert_array_equal(seen.flat, whole.flat)
    at_once, streamed = (decompose(topology, labels, 3, x) for x in (sequence.points, seen))
    np.testing.assert_array_equal(at_once.joint_of_face, streamed.joint_of_face)
    np.testing.assert_array_equal(at_once.widths, streamed.widths)
