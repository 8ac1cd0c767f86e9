"""Decomposition of a mesh into parts and joints between the parts.

A joint of width w covers w strips of triangles on both sides of a boundary. Parts lose w - 1 strips, so that joint and
part overlap by one strip (paper, Section 2.1 and Figure 4, with w = 3). In terms of the *depth* of a vertex,
``max_b (w_b - number of edges to the boundary vertex b)``:

- vertices of depth <= 1 remain in their part,
- faces with a vertex of depth >= 1 belong to a joint,
- vertices of depth >= 2 in all their parts are *free*: they belong only to the joint.

The width depends on the motion: every strip except the first takes at most 30 degrees of the largest relative rotation
of the two parts between two frames. The width is at most `joint_width`. On coarse meshes the width is also limited so
that a part keeps a core of a third of its vertices. A joint of width 1 takes no vertices from a part.

Three kinds of elements cannot be reconstructed from lengths and angles and are returned to the parts: faces without
area, vertices that alone connect two pieces of a joint, and joint patches without a face inside a part.

The rotations of parts, and the faces without area in some frame, are measured block by block, so that a sequence may be
larger than memory.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import SegmentationError, SettingsError
from mixseq.mesh.measures import degenerate_faces
from mixseq.mesh.rigid import aligning_rotations, largest_rotation, mean_shape
from mixseq.mesh.topology import (
    Topology,
    connected_components,
    face_patches,
    interior_hinges,
    mark_face_vertices,
    propagate_depth,
)
from mixseq.segmentation.elements import Boundaries
from mixseq.types import Float, FloatArray, Index, Mask, evenly_spaced, index_mask

MIN_MOTION_HEIGHT_RATIO = 1e-5  # ratio of height to longest side up to which a face has no motion of its own


def sample_frame_ids(frame_count: int, max_count: int = 24) -> Index:
    """Return indices of evenly spaced frames, from which parts and their shapes are computed."""
    return evenly_spaced(frame_count, max_count)


@dataclass(frozen=True, eq=False)
class PartShapes:
    """Mean shapes of parts; rotations of parts are relative to these shapes."""

    faces: NDArray[np.integer]  # (F, 3) triangles of the mesh
    parts: tuple[Index, ...]  # vertices of every part, ascending
    shapes: tuple[Float, ...]  # centred positions of these vertices

    @classmethod
    def from_labels(cls, topology: Topology, part_of_face: Index, frames: FloatArray) -> PartShapes:
        """Compute the mean shapes of parts ``(F,)`` in frames ``(S, V, 3)``, S >= 1."""
        count = int(part_of_face.max(initial=-1)) + 1
        masks = (mark_face_vertices(topology, part_of_face == part) for part in range(count))
        parts = tuple(map(np.flatnonzero, masks))
        shapes = tuple(mean_shape(frames[:, part].astype(np.float64), sweeps=3) for part in parts)
        return cls(topology.faces, parts, shapes)


@dataclass(frozen=True, eq=False)
class PartMotion:
    """Rotations of parts and faces without area in a range of frames."""

    rotations: Float  # (T, p, 3, 3) rotation of every part in every frame, relative to its shape
    degenerate_mask: Mask  # (F,) faces without area in some frame


def measure_part_motion(shapes: PartShapes, points: FloatArray) -> PartMotion:
    """Measure part motion in a block of frames ``(B, V, 3)``; the result of a frame does not depend on its block."""
    degenerate_mask = np.zeros(len(shapes.faces), dtype=bool)
    covariances = np.empty((len(points), len(shapes.parts), 3, 3))
    for frame, frame_covariances in zip(points, covariances, strict=True):
        x = frame.astype(np.float64)
        degenerate_mask |= degenerate_faces(x, shapes.faces, MIN_MOTION_HEIGHT_RATIO)
        for part, (vertices, shape) in enumerate(zip(shapes.parts, shapes.shapes, strict=True)):
            posed = x[vertices]
            frame_covariances[part] = (posed - posed.mean(axis=0)).T @ shape
    return PartMotion(aligning_rotations(covariances), degenerate_mask)


def join_part_motion(blocks: Iterable[PartMotion]) -> PartMotion:
    """Join the motion of one or more consecutive blocks of frames."""
    rotations, degenerate_mask = [], np.zeros(1, dtype=bool)
    for block in blocks:
        rotations.append(block.rotations)
        degenerate_mask = degenerate_mask | block.degenerate_mask
    return PartMotion(np.concatenate(rotations), degenerate_mask)


MIN_CORE_FRACTION = 1.0 / 3.0  # least fraction of its vertices that a part keeps
DEGREES_PER_STRIP = 30.0  # relative rotation of two parts per strip of their joint, except the first


@dataclass(frozen=True, eq=False)
class Joint:
    """A hinge-connected patch of faces between parts; local indices refer to the joint's `vertices`."""

    vertices: Index  # (n,) global vertices, ascending
    faces: Index  # (m, 3) local triangles
    face_ids: Index  # (m,) global faces
    edge_ids: Index  # (e,) global edges of these faces, ascending
    hinge_ids: Index  # (h,) global hinges between two of these faces, ascending
    free: Mask  # (n,) vertices that belong to no part


@dataclass(frozen=True, eq=False)
class Decomposition:
    """A mesh cut into parts and joints."""

    part_of_face: Index  # (F,) the segmentation
    parts: tuple[Index, ...]  # (V_i,) vertices of every part, ascending; parts may share vertices
    joints: tuple[Joint, ...]  # joints share no faces
    widths: Index  # (p,) largest width of joints inside every part, in strips

    @property
    def joint_of_face(self) -> Index:
        """Joint ``(F,)`` of every face, -1 for faces in no joint."""
        result = np.full(len(self.part_of_face), -1, dtype=np.int64)
        for number, joint in enumerate(self.joints):
            result[joint.face_ids] = number
        return result

    @property
    def paper_dimension(self) -> int:
        """Dimension of the free S_m as the paper counts it: ``2 sum E_k + 3 sum V_i + 6`` (Section 2.2)."""
        edges = sum(len(joint.edge_ids) for joint in self.joints)
        return 2 * edges + 3 * sum(len(part) for part in self.parts) + 6


def decompose(
    topology: Topology,
    part_of_face: Index,
    joint_width: int = 3,
    points: FloatArray | PartMotion | None = None,
    core: float = MIN_CORE_FRACTION,
) -> Decomposition:
    """Grow joints around the boundaries of parts ``(F,)``; their width follows the bending of points ``(T, V, 3)``."""
    if joint_width < 1:
        raise SettingsError(f"joint_width is {joint_width}; at least 1 strip is needed")
    if part_of_face.shape != (len(topology.faces),):
        raise SegmentationError(
            f"part_of_face has shape {part_of_face.shape}, the mesh has {len(topology.faces)} faces"
        )
    if isinstance(points, PartMotion) or points is None:
        motion = points
    else:
        samples = points[sample_frame_ids(len(points))]
        motion = measure_part_motion(PartShapes.from_labels(topology, part_of_face, samples), points)
    part_count = int(part_of_face.max()) + 1
    part_masks = [mark_face_vertices(topology, part_of_face == part) for part in range(part_count)]
    boundary_widths = _boundary_widths(topology, part_of_face, joint_width, motion)
    depths = [propagate_depth(topology, np.minimum(boundary_widths, width)) for width in range(joint_width + 1)]
    widths = np.array([_largest_width(depths, mask, core) for mask in part_masks], dtype=np.int64)

    kept = [mask & (depths[width] <= 1) for mask, width in zip(part_masks, widths, strict=True)]
    near_boundary = np.stack([(depth >= 1).take(topology.faces.T).any(axis=0) for depth in depths])
    in_joint = near_boundary[widths[part_of_face], np.arange(len(topology.faces))]
    if motion is not None:
        in_joint &= ~motion.degenerate_mask

    patches = _return_to_parts(topology, part_of_face, kept, in_joint)
    if topology.unused_vertices.size:
        kept.append(index_mask(topology.unused_vertices, topology.vertex_count))
        widths = np.append(widths, 1)
    in_parts = np.any(kept, axis=0)
    return Decomposition(
        part_of_face=np.asarray(part_of_face, dtype=np.int64),
        parts=tuple(np.flatnonzero(mask) for mask in kept),
        joints=tuple(make_joint(topology, patches == number, in_parts) for number in np.unique(patches[patches >= 0])),
        widths=widths,
    )


def _boundary_widths(topology: Topology, part_of_face: Index, joint_width: int, motion: PartMotion | None) -> Index:
    """Return the width ``(V,)`` of joints at boundary vertices, 0 elsewhere."""
    boundaries = Boundaries.from_labels(topology, part_of_face)
    width_of_pair = np.full(len(boundaries.parts), joint_width)
    if motion is not None:
        for pair, (i, j) in enumerate(boundaries.parts):
            rotation = largest_rotation(motion.rotations[:, i], motion.rotations[:, j])
            strips = int(np.ceil(rotation / DEGREES_PER_STRIP))
            width_of_pair[pair] = min(joint_width, max(2, 1 + strips))
    widths = np.zeros(topology.vertex_count, dtype=np.int64)
    np.maximum.at(widths, boundaries.edges, width_of_pair[boundaries.pair][:, None])
    return widths


def _largest_width(depths: list[Index], part_mask: Mask, core: float) -> int:
    """Return the largest width of joints with which a part keeps its core."""
    count = np.count_nonzero(part_mask)
    for width in range(len(depths) - 1, 1, -1):
        kept_count = np.count_nonzero(depths[width][part_mask] <= 1)
        if kept_count >= 3 and kept_count >= core * count:
            return width
    return 1


def _return_to_parts(topology: Topology, part_of_face: Index, kept: list[Mask], in_joint: Mask) -> Index:
    """Return the joint ``(F,)`` of every face, -1 for none; mark vertices returned to parts in `kept`, in place."""

    def keep(faces: Mask, vertices: Mask | None = None) -> None:
        for part, mask in enumerate(kept):
            corners = mark_face_vertices(topology, faces & (part_of_face == part))
            mask |= corners if vertices is None else corners & vertices

    keep(~in_joint & ~_mark_rigid_faces(topology, kept))
    patches = face_patches(topology, in_joint)
    keep(in_joint, _mark_contact_vertices(topology, patches))
    is_rigid = _mark_rigid_faces(topology, kept)
    for number in range(int(patches.max(initial=-1)) + 1):
        faces = patches == number
        if not is_rigid[faces].any():
            keep(faces)
            patches[faces] = -1
    return patches


def _mark_rigid_faces(topology: Topology, kept: list[Mask]) -> Mask:
    """Mark the faces whose corners all belong to one part."""
    corners = topology.faces.T
    return np.asarray(np.logical_or.reduce([mask.take(corners).all(axis=0) for mask in kept]))


def _mark_contact_vertices(topology: Topology, patches: Index) -> Mask:
    """Mark the vertices where the faces of joints form several fans that no hinge connects."""
    in_joint = patches >= 0
    hinge_ids = interior_hinges(topology, in_joint)
    sides = topology.hinge_faces[hinge_ids]
    links = []
    for end in topology.edges[topology.hinge_edges[hinge_ids]].T:
        at_end = topology.faces[sides] == end[:, None, None]
        links.append(3 * sides + at_end.argmax(axis=2))  # corners of both faces at this end of the hinge
    corners = np.flatnonzero(np.repeat(in_joint, 3))
    fan = connected_components(len(corners), np.searchsorted(corners, np.concatenate(links)))
    fan_count = int(fan.max(initial=0)) + 1
    vertex_of_fan = np.unique(topology.faces.reshape(-1)[corners].astype(np.int64) * fan_count + fan) // fan_count
    return np.asarray(np.bincount(vertex_of_fan, minlength=topology.vertex_count) > 1)


def make_joint(topology: Topology, faces: Mask, in_parts: Mask) -> Joint:
    """Make a joint of the marked faces ``(F,)``; its vertices not in parts ``(V,)`` are free."""
    face_ids = np.flatnonzero(faces)
    vertices = np.unique(topology.faces[face_ids]).astype(np.int64)
    return Joint(
        vertices=vertices,
        faces=np.searchsorted(vertices, topology.faces[face_ids]),
        face_ids=face_ids,
        edge_ids=np.unique(topology.face_edges[face_ids]),
        hinge_ids=interior_hinges(topology, faces),
        free=~in_parts[vertices],
    )
