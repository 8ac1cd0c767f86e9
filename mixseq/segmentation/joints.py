"""Joints between parts, and the parts that remain.

A joint of width w grows w strips of triangles from every boundary to both sides; the parts lose w - 1 strips, so
that joint and part overlap by one strip (paper, Section 2.1 and Figure 4, with w = 3). In terms of the *depth* of
a vertex, ``max_b (w_b - number of edges to the boundary vertex b)``:

- a part keeps its vertices of depth <= 1,
- the faces with a vertex of depth >= 1 are a joint's,
- vertices of depth >= 2 on all sides are *free*: they belong to the joint alone.

The width follows the motion: each strip but the first takes up a bend of at most 30 degrees between the two parts
(their largest relative rotation between any two frames), up to `joint_width`. On coarse meshes a part limits the width
further, to keep a core of a third of its vertices. Width 1 takes nothing from a part.

Three things cannot be solved for from lengths and angles and are given back to the parts: faces without area,
vertices where a joint is connected by a point only, and patches of a joint without a face that one part holds.

The rotations of parts, and the faces without area in some frame, are observed block by block: both are small and
additive over blocks of frames, so that a sequence need not be in memory as a whole.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import SegmentationError, SettingsError
from mixseq.mesh.polygons import read_only
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
from mixseq.types import Float, FloatArray, Index, Mask, evenly_spaced

DEGENERATE_HEIGHT_RATIO = 1e-5
"""Ratio of height to longest side below which a face has no area."""


def sample_frame_ids(frame_count: int, at_most: int = 24) -> Index:
    """Choose evenly spread frames that represent a sequence, for finding its parts and their shapes."""
    return evenly_spaced(frame_count, at_most)


@dataclass(frozen=True, eq=False)
class PartShapes:
    """Quantities observed in every frame."""

    faces: NDArray[np.integer]  # (F, 3) triangles of the mesh
    parts: tuple[Index, ...]  # vertices of every part, ascending
    shapes: tuple[Float, ...]  # their shapes, centred, against which turns are measured

    @classmethod
    def from_labels(cls, topology: Topology, part_of_face: Index, frames: FloatArray) -> PartShapes:
        """Make it for the parts ``(F,)`` of a mesh; their shapes are means of frames ``(S, V, 3)``, S >= 1."""
        count = int(part_of_face.max(initial=-1)) + 1
        parts = tuple(
            np.flatnonzero(mark_face_vertices(topology, part_of_face == part)) for part in range(count)
        )
        shapes = tuple(mean_shape(frames[:, part].astype(np.float64), sweeps=3) for part in parts)
        return cls(topology.faces, parts, shapes)


@dataclass(frozen=True, eq=False)
class PartMotion:
    """Observations of frames."""

    rotations: Float  # (T, p, 3, 3) rotation of every part in every frame, relative to its shape
    flat: Mask  # (F,) faces without area in some frame


def measure_part_motion(watched: PartShapes, points: FloatArray) -> PartMotion:
    """Observe a block of frames ``(B, V, 3)``; each frame is independent of its block."""
    from mixseq.segmentation.segmentation_kernels import mark_flat

    flat = np.zeros(len(watched.faces), dtype=bool)
    covariances = np.empty((len(points), len(watched.parts), 3, 3))
    for frame, into in zip(points, covariances, strict=True):
        x = read_only(np.ascontiguousarray(frame, dtype=np.float64))  # as frames are: one type to numba
        mark_flat(x, watched.faces, DEGENERATE_HEIGHT_RATIO, flat)
        for number, (part, shape) in enumerate(zip(watched.parts, watched.shapes, strict=True)):
            moved = x[part]
            into[number] = (moved - moved.mean(axis=0)).T @ shape
    return PartMotion(aligning_rotations(covariances), flat)


def join_part_motion(blocks: Iterable[PartMotion]) -> PartMotion:
    """Concatenate the observations of one or more blocks, in order."""
    rotations, flat = [], None
    for block in blocks:
        rotations.append(block.rotations)
        flat = block.flat if flat is None else flat | block.flat
    return PartMotion(np.concatenate(rotations), np.zeros(0, dtype=bool) if flat is None else flat)


MIN_CORE_FRACTION = 1.0 / 3.0
"""Least share of its vertices that a part keeps, whatever the width of its joints."""

DEGREES_PER_STRIP = 30.0
"""Bend per strip of a joint, except the first, in degrees."""


@dataclass(frozen=True, eq=False)
class Joint:
    """A hinge-connected patch of faces between parts; local indices are into its vertices."""

    vertices: Index  # (n,) global vertices, ascending
    faces: Index  # (m, 3) local triangles
    face_ids: Index  # (m,) their global numbers
    edge_ids: Index  # (e,) global numbers of the joint's edges, ascending
    hinge_ids: Index  # (h,) global numbers of hinges between two of its faces, ascending
    free: Mask  # (n,) vertices of no part


@dataclass(frozen=True, eq=False)
class Decomposition:
    """A mesh cut into parts and joints."""

    part_of_face: Index  # (F,) the segmentation
    parts: tuple[Index, ...]  # (V_i,) vertices of every part, ascending; parts may share vertices
    joints: tuple[Joint, ...]  # their faces are disjoint
    widths: Index  # (p,) largest width of joints on the side of every part, in strips

    @property
    def joint_of_face(self) -> Index:
        """Joint ``(F,)`` of every face, -1 for none."""
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
    """Grow joints around the boundaries of a segmentation ``(F,)``; points ``(T, V, 3)`` limit their width."""
    if joint_width < 1:
        raise SettingsError(f"joint_width is {joint_width}; at least 1 strip is needed")
    if part_of_face.shape != (len(topology.faces),):
        raise SegmentationError(
            f"part_of_face has shape {part_of_face.shape}, the mesh has {len(topology.faces)} faces"
        )
    if isinstance(points, PartMotion) or points is None:
        observed = points
    else:
        looked_at = points[sample_frame_ids(len(points))]
        observed = measure_part_motion(PartShapes.from_labels(topology, part_of_face, looked_at), points)
    part_count = int(part_of_face.max()) + 1
    members = [mark_face_vertices(topology, part_of_face == part) for part in range(part_count)]
    wanted = _boundary_widths(topology, part_of_face, joint_width, observed)
    depths = [propagate_depth(topology, np.minimum(wanted, width)) for width in range(joint_width + 1)]
    widths = np.array([_width(depths, inside, core) for inside in members], dtype=np.int64)

    kept = [inside & (depths[width] <= 1) for inside, width in zip(members, widths, strict=True)]
    touching = np.stack([np.logical_or.reduce(_at_corners(topology, depth >= 1)) for depth in depths])
    in_joint = touching[widths[part_of_face], np.arange(len(topology.faces))]
    if observed is not None:
        in_joint &= ~observed.flat

    patches = _give_back(topology, part_of_face, kept, in_joint)
    if topology.unused_vertices.size:
        loose = np.zeros(topology.vertex_count, dtype=bool)
        loose[topology.unused_vertices] = True
        kept.append(loose)
        widths = np.append(widths, 1)
    held = np.any(kept, axis=0)
    return Decomposition(
        part_of_face=np.asarray(part_of_face, dtype=np.int64),
        parts=tuple(np.flatnonzero(inside) for inside in kept),
        joints=tuple(
            make_joint(topology, patches == number, held) for number in np.unique(patches[patches >= 0])
        ),
        widths=widths,
    )


def _boundary_widths(
    topology: Topology, part_of_face: Index, joint_width: int, observed: PartMotion | None
) -> Index:
    """Width ``(V,)`` of the joint at every boundary vertex, 0 elsewhere."""
    boundaries = Boundaries.from_labels(topology, part_of_face)
    width_of_pair = np.full(len(boundaries.parts), joint_width)
    if observed is not None:
        for number, (i, j) in enumerate(boundaries.parts):
            strips = int(
                np.ceil(
                    largest_rotation(observed.rotations[:, i], observed.rotations[:, j]) / DEGREES_PER_STRIP
                )
            )
            width_of_pair[number] = min(joint_width, max(2, 1 + strips))
    widths = np.zeros(topology.vertex_count, dtype=np.int64)
    np.maximum.at(widths, boundaries.edges, width_of_pair[boundaries.pair][:, None])
    return widths


def _width(depths: list[Index], inside: Mask, core: float) -> int:
    """Return the largest width that leaves a part its core."""
    size = np.count_nonzero(inside)
    for width in range(len(depths) - 1, 1, -1):
        kept = np.count_nonzero(depths[width][inside] <= 1)
        if kept >= 3 and kept >= core * size:
            return width
    return 1


def _give_back(topology: Topology, part_of_face: Index, kept: list[Mask], in_joint: Mask) -> Index:
    """Number the remaining patches of joints; add the rest to `kept`, in place."""

    def keep(faces: Mask, vertices: Mask | None = None) -> None:
        for part, inside in enumerate(kept):
            corners = mark_face_vertices(topology, faces & (part_of_face == part))
            inside |= corners if vertices is None else corners & vertices

    keep(~in_joint & ~_firm(topology, kept))
    patches = face_patches(topology, in_joint)
    keep(in_joint, _points_of_contact(topology, patches))
    firm = _firm(topology, kept)
    for number in range(int(patches.max(initial=-1)) + 1):
        faces = patches == number
        if not firm[faces].any():
            keep(faces)
            patches[faces] = -1
    return patches


def _firm(topology: Topology, kept: list[Mask]) -> Mask:
    """Mark the faces whose corners all belong to one part."""
    firm = np.zeros(len(topology.faces), dtype=bool)
    for inside in kept:
        firm |= np.logical_and.reduce(_at_corners(topology, inside))
    return firm


def _at_corners(topology: Topology, marked: Mask) -> list[Mask]:
    """Return the marks of the first, second and third corner of every face."""
    return [marked[corner] for corner in topology.faces.T]


def _points_of_contact(topology: Topology, patches: Index) -> Mask:
    """Mark the vertices whose joint faces are several fans across hinges."""
    marked = patches >= 0
    joined = interior_hinges(topology, marked)
    sides = topology.hinge_faces[joined]
    links = []
    for end in topology.edges[topology.hinge_edges[joined]].T:
        at_end = topology.faces[sides] == end[:, None, None]
        links.append(3 * sides + at_end.argmax(axis=2))  # the corners of both faces at this end of the hinge
    inside = np.flatnonzero(np.repeat(marked, 3))
    fan = connected_components(len(inside), np.searchsorted(inside, np.concatenate(links)))
    corners = np.stack([topology.faces.reshape(-1)[inside], fan], axis=1)
    vertex_of_fan = np.unique(corners, axis=0)[:, 0]
    return np.asarray(np.bincount(vertex_of_fan, minlength=topology.vertex_count) > 1)


def make_joint(topology: Topology, faces: Mask, held: Mask) -> Joint:
    """Make a joint of the marked faces ``(F,)``; its vertices outside `held` ``(V,)`` are free."""
    face_ids = np.flatnonzero(faces)
    vertices = np.unique(topology.faces[face_ids]).astype(np.int64)
    return Joint(
        vertices=vertices,
        faces=np.searchsorted(vertices, topology.faces[face_ids]),
        face_ids=face_ids,
        edge_ids=np.unique(topology.face_edges[face_ids]),
        hinge_ids=interior_hinges(topology, faces),
        free=~held[vertices],
    )
