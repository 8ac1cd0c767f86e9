"""Mixed shape spaces of small sequences."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from mixseq.choices import PLACEMENTS, PlacementName
from mixseq.mesh.topology import Topology
from mixseq.segmentation.joints import decompose
from mixseq.segmentation.methods import segment_by_labels
from mixseq.segmentation.motion import segment_by_motion
from mixseq.sequence.sequence import MeshSequence
from mixseq.spaces.mixed.construction import Purpose, mixed_space
from mixseq.spaces.mixed.mixed_space import MixedSpace, Projection
from mixseq.types import Float, Index
from tests.meshes import SEQUENCES, Mesh, flipped, grid, joined, pages, rotation, tetrahedron, topology_of, torus, tube

BONES = {"bar": 2, "rigid component": 3}
"""Their bends would be parts of their own."""

MESHES: list[Mesh] = [
    tube(6, 13),
    tube(5, 9, closed=False),
    torus(14, 7),
    grid(7, 7),
    pages(3, 8, 3),
    joined(tube(5, 7), torus(8, 5)),
    (tube(6, 13)[0], flipped(tube(6, 13)[1])),
    tetrahedron(),
]


@cache
def sequence_of(name: str) -> MeshSequence:
    return SEQUENCES[name]()


@cache
def labels_of(name: str) -> tuple[Topology, Any]:
    sequence = sequence_of(name)
    topology = Topology(sequence.faces, sequence.vertex_count)
    return topology, segment_by_motion(sequence.points, topology, BONES.get(name))


@cache
def space_of(
    name: str, placement: PlacementName = "anchored", purpose: Purpose = "sequence", width: int = 3
) -> MixedSpace:
    topology, labels = labels_of(name)
    points = sequence_of(name).points
    return mixed_space(points, topology, decompose(topology, labels, width, points), placement, purpose)


@cache
def steered(name: str, share: float = 1.0, steps: int = 0) -> MixedSpace:
    """A space in which lengths and angles of all faces count."""
    space = space_of(name)
    everywhere = np.ones(len(space.topology.faces), dtype=bool)
    return replace(space, joint_faces=everywhere, projection=Projection(share=share, steps=steps))


def in_all_ways(name: str) -> list[MixedSpace]:
    """Both placements; lengths and angles that count, with steps and without, and a space for blends."""
    both = [space_of(name, placement) for placement in PLACEMENTS]
    return [*both, steered(name), steered(name, 0.5, 8), space_of(name, purpose="blends")]


def error(space: MixedSpace, points: Any, decoded: Float) -> float:
    """Largest coordinate of the difference, in diagonals."""
    return float(np.abs(decoded - points).max() / space.scale)


def sliced(mesh: Mesh, *heights: float) -> Index:
    """Parts of the faces of a mesh along z that is cut at heights."""
    return segment_by_labels(np.searchsorted(heights, mesh[0][mesh[1]].mean(axis=1)[:, 2]), topology_of(mesh))


def of_slices(points: Float, mesh: Mesh, *heights: float, width: int = 3) -> MixedSpace:
    """The space of frames of a mesh that is cut at heights; joints have full width."""
    topology = topology_of(mesh)
    return mixed_space(points, topology, decompose(topology, sliced(mesh, *heights), width))


def chain(bends: Float, links: int = 4, sides: int = 6) -> tuple[Float, Mesh]:
    """Frames of a tube of equal links that bend about x, each by angles ``(T,)`` from the one before it.

    Vertices near joints follow both links, by linear blends.
    """
    mesh = tube(sides, 8 * links + 1, length=4.0 * links)
    frames = []
    for bend in bends:
        turn, pivot = np.eye(3), np.zeros(3)
        moved = mesh[0].copy()
        for link in range(1, links):
            pivot = pivot + turn @ [0, 0, 4.0]
            turn = turn @ rotation((float(bend), 0, 0))
            weight = np.clip((mesh[0][:, 2:] - 4.0 * link) / 1.5 + 0.5, 0, 1)
            moved = (1 - weight) * moved + weight * ((mesh[0] - [0, 0, 4.0 * link]) @ turn.T + pivot)
        frames.append(moved)
    return np.stack(frames), mesh
