"""Where parts meet."""

from __future__ import annotations

import numpy as np

from mixseq.retargeting.meetings import Meetings
from mixseq.segmentation.joints import decompose
from tests.meshes import joined, tetrahedron, topology_of, tube
from tests.retargeting.pairs import gradients


def test_two_bones_and_an_eye() -> None:
    """The bones meet in an octagon, the eye is held by a vertex."""
    mesh = joined(tube(8, 33, radius=0.3), (0.1 * tetrahedron()[0] + [0.0, 0.45, 3.5], tetrahedron()[1]))
    points, faces = mesh
    labels = (points[faces].mean(axis=1)[:, 2] > 2).astype(np.int64)
    labels[-4:] = 2
    meetings = Meetings.of(gradients(mesh, mesh), decompose(topology_of(mesh), labels, 3))
    assert meetings.parts.tolist() == [[0, 1], [2, 1]]
    middle, held = meetings.points(points)
    np.testing.assert_allclose(middle, [0.0, 0.0, 2.0], atol=1e-12)
    assert (points[-4:] == held).all(axis=1).any()
    lengths, radii = meetings.sizes(points)
    np.testing.assert_allclose(lengths, [8 * 0.6 * np.sin(np.pi / 8), 0.0])
    np.testing.assert_allclose(radii, [0.3 * np.cos(np.pi / 8), 0.0])
