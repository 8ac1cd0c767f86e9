"""S_m of a mesh that is one rigid part is S_v, registered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixseq.choices import PLACEMENTS, PlacementName
from mixseq.mesh.rigid import kabsch, transform_points
from mixseq.segmentation.joints import decompose
from mixseq.spaces.base import VertexSpace
from mixseq.spaces.mixed.construction import mixed_space
from mixseq.spaces.mixed.mixed_space import Projection
from mixseq.types import Float
from tests.meshes import rotation, topology_of, tube


def frames() -> Float:
    """A tube that bulges here and there, and moves about."""
    points, _ = tube(8, 12)
    rng = np.random.default_rng(5)
    moved = []
    for number in range(4):
        bulged = points * (1.0 + 0.1 * rng.normal(size=(len(points), 1)))
        moved.append(bulged @ rotation(rng.normal(size=3)).T + number * np.array([1.0, -2.0, 0.5]))
    return np.stack(moved)


@pytest.mark.parametrize("placement", PLACEMENTS)
@pytest.mark.parametrize("weights", [[0.5, 0.5, 0, 0], [0.25, 0.25, 0.25, 0.25], [1.5, -0.5, 0, 0]])
def test_one_part_is_blended_by_its_registered_vertices(placement: PlacementName, weights: list[float]) -> None:
    points, mesh = frames(), tube(8, 12)
    topology = topology_of(mesh)
    decomposition = decompose(topology, np.zeros(len(mesh[1]), dtype=np.int64), 3, points)
    mixed = replace(
        mixed_space(points, topology, decomposition, placement),
        joint_faces=np.zeros(len(mesh[1]), dtype=bool),
        projection=Projection(placement),
    )
    assert not decomposition.joints
    assert mixed.dim == 3 * len(mesh[0]) + 7 + 7 + 6  # the part in its body, the body, and a correction
    blended = mixed.decode(np.array(weights)[None] @ mixed.encode(points))[0]

    shape = mixed.shapes * mixed.scale
    registered = np.stack([transform_points(x, *kabsch(x, shape)) for x in points])
    vertices = VertexSpace(len(mesh[0]), mixed.scale)
    expected = vertices.decode(np.array(weights)[None] @ vertices.encode(registered))[0]
    np.testing.assert_allclose(transform_points(expected, *kabsch(expected, blended)), blended, atol=1e-9)
