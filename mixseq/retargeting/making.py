"""The two ways to transfer, made for two meshes at rest."""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.correspondence.dense import Correspondence
from mixseq.correspondence.triangle_mesh import TriangleMesh
from mixseq.disk_array import LargeArray
from mixseq.retargeting.alignment import Alignment, align
from mixseq.retargeting.carried import CarriedParts, carry_parts
from mixseq.retargeting.gradients import GradientTransfer
from mixseq.retargeting.mixed import MixedTransfer
from mixseq.segmentation.joints import decompose
from mixseq.segmentation.observed import Watched, frames_to_look_at, observe
from mixseq.sequence import bounding_diagonal
from mixseq.shells.fitting import ShellSettings
from mixseq.spaces.gradient import GradientSpace
from mixseq.topology import Topology


def gradient_transfer(
    source: Topology, source_rest: Float, target: Topology, target_rest: Float, correspondence: Correspondence
) -> GradientTransfer:
    """Make a transfer between two meshes at rest, ``(V, 3)`` and ``(V', 3)``; it raises what `align` does."""
    own, other = _space(source, source_rest), _space(target, target_rest)
    matched = correspondence.matched
    whole = align(
        correspondence.carry(own.reference)[matched],
        other.reference[matched],
        TriangleMesh(other.reference, target).vertex_areas[matched],
    )
    in_units = Alignment(whole.rotation, whole.scale * other.scale / own.scale)
    return GradientTransfer(own, other, correspondence, in_units)


def _space(topology: Topology, rest: Float) -> GradientSpace:
    scale = bounding_diagonal(rest) or 1.0
    return GradientSpace(topology, scale, rest / scale)


def mixed_transfer(
    gradients: GradientTransfer,
    points: LargeArray,
    part_of_face: Index,
    joint_width: int,
    settings: ShellSettings,
) -> MixedTransfer:
    """Make a transfer of the motion of parts.

    Parameters
    ----------
    gradients : GradientTransfer
        The two meshes at rest, and how they correspond.
    points : (T, V, 3) array, perhaps on disk
        The frames of the source, in its units.
    part_of_face : (F,) int64
        Its parts.
    joint_width : int
        Largest width of joints in strips of triangles.
    settings : ShellSettings
        Settings of the joint solves.

    Raises
    ------
    SettingsError
        If the width is below 1.
    """
    source, target = gradients.source, gradients.target
    looked_at = points[frames_to_look_at(len(points))]
    watched = Watched.of(source.topology, part_of_face, source.reference[None])
    seen = observe(watched, np.concatenate([source.reference[None] * source.scale, looked_at]))
    decomposition = decompose(source.topology, part_of_face, joint_width, seen)
    if _same_mesh(gradients):
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


def _same_mesh(gradients: GradientTransfer) -> bool:
    """Whether both meshes have the same triangles, and every vertex and triangle corresponds to itself."""
    source, target, given = gradients.source.topology, gradients.target.topology, gradients.correspondence
    if not np.array_equal(source.faces, target.faces):
        return False
    own = np.where(given.corners == np.arange(len(given.corners))[:, None], given.weights, 0.0).sum(axis=1)
    return bool(np.allclose(own, 1.0) and np.array_equal(given.faces, np.arange(len(target.faces))))
