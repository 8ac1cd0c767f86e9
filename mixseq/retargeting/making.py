"""The two ways to transfer, made for two meshes at rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixseq.correspondence.dense import Correspondence
from mixseq.reconstruction.shells import ShellSettings
from mixseq.retargeting.alignment import align
from mixseq.retargeting.carried import CarriedParts, carry_parts
from mixseq.retargeting.gradients import GradientTransfer
from mixseq.retargeting.mixed import MixedTransfer
from mixseq.segmentation.joints import decompose
from mixseq.segmentation.observed import Watched, frames_to_look_at, observe
from mixseq.sequence import IntArray, bounding_diagonal
from mixseq.spaces.gradient import GradientSpace
from mixseq.table import Table
from mixseq.topology import Topology

Float = NDArray[np.float64]
Index = NDArray[np.int64]


def vertex_areas(x: Float, faces: IntArray) -> Float:
    """A third of the area of the triangles at every vertex ``(V,)``."""
    areas = np.linalg.norm(np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]]), axis=1)
    return np.asarray(np.bincount(faces.reshape(-1), np.repeat(areas / 6.0, 3), len(x)), dtype=np.float64)


def gradient_transfer(
    source: Topology, source_rest: Float, target: Topology, target_rest: Float, correspondence: Correspondence
) -> GradientTransfer:
    """Make a transfer between two meshes at rest."""
    spaces = []
    for topology, rest in ((source, source_rest), (target, target_rest)):
        scale = bounding_diagonal(rest) or 1.0
        spaces.append(GradientSpace(topology, scale, rest / scale))
    matched = correspondence.matched
    whole = align(
        correspondence.carry(source_rest)[matched],
        target_rest[matched],
        vertex_areas(target_rest, target.faces)[matched],
    )
    return GradientTransfer(spaces[0], spaces[1], correspondence, whole)


def mixed_transfer(
    gradients: GradientTransfer, points: Table, part_of_face: Index, joint_width: int, settings: ShellSettings
) -> MixedTransfer:
    """Make a transfer of the motion of parts."""
    source, target = gradients.source, gradients.target
    looked_at = points[frames_to_look_at(len(points))]
    watched = Watched.of(source.topology, part_of_face, source.reference[None])
    seen = observe(watched, np.concatenate([source.reference[None] * source.scale, looked_at]))
    decomposition = decompose(source.topology, part_of_face, joint_width, seen)
    if np.array_equal(source.topology.faces, target.topology.faces):
        carried = CarriedParts(decomposition, np.arange(len(decomposition.parts)))
    else:
        carried = carry_parts(
            decomposition,
            seen.rotations,
            gradients.correspondence,
            target.topology,
            target.reference,
            joint_width,
        )
    return MixedTransfer(gradients, decomposition, carried, settings)
