"""Make the mixed shape space of a sequence: mean shapes, skinning weights, joint faces and settings of P_m.

Half-way between two frames lengths and angles should be their means. Joint faces are those with errors there, however
parts were found. The share of their lengths and angles is chosen by `mixseq.signals.fitting`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import combinations, pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mixseq.choices import PLACEMENTS, PlacementName
from mixseq.errors import SettingsError
from mixseq.mesh.measures import degenerate_faces, dihedral_angles, edge_lengths, wrap_angles
from mixseq.mesh.rigid import mean_shape
from mixseq.mesh.topology import Topology
from mixseq.runtime.low_memory import LargeArray
from mixseq.runtime.progress import Progress, no_progress
from mixseq.segmentation.joints import Decomposition, sample_frame_ids
from mixseq.sequence.sequence import bounding_diagonal
from mixseq.spaces.mixed.mixed_space import MixedSpace, Projection
from mixseq.spaces.mixed.skinning_weights import fit_skinning_weights
from mixseq.types import Float, FloatArray, Mask, evenly_spaced

Purpose = Literal["sequence", "reduced", "blends"]
"""Use of a space: frames in time; models of a given rank or knots; blends of poses that may be far apart."""

MAX_STRETCH, MAX_BEND_DEGREES = 0.10, 25.0
"""Largest half-way errors of faces that are no joints of a sequence: of edges, relative, and of hinges, in degrees."""

MAX_BLEND_STRETCH, MAX_BLEND_BEND_DEGREES = 0.015, 4.0
"""The same for blends of poses."""

MAX_FREE_STRETCH, MAX_FREE_BEND_DEGREES = 0.06, 15.0
"""The same for the free placement."""

TORN_STRETCH = 0.1
"""Half-way error of an edge, relative to its length, above which its faces are torn."""

FAR_TORN_SHARE = 0.15
"""Share of torn faces above which frames are far apart."""

FAR_HOLD = 0.003
"""`Projection.hold` where frames are far apart."""

REFERENCE_STEP = 2.0**-20
"""Rounding step of mean shapes and of the reference frame, in diagonals."""

SIZE_REDUCTION = 1.3
"""Least ratio of the number of all lengths and angles to the length of vectors of a sequence."""

FAR_RELATIONS = 3.0
"""`Projection.relations` where frames are far apart: they change less than poses."""

MIN_HEIGHT_RATIO = 1e-3
"""Least height over longest side of joint faces, in all frames; angles of lower ones are noise."""

MAX_NEIGHBOUR_PAIRS = 12
"""Number of pairs of neighbouring frames from which joint faces of a sequence are found."""

SAMPLED_FACES = 100_000
"""Number of faces from which the share of torn faces is estimated."""

MAX_POSES_FOR_ALL_PAIRS = 12
"""Number of poses up to which all pairs are compared, not only neighbours."""

MIN_RELAXATION_STEPS, MAX_RELAXATION_STEPS = 6, 20
"""Relaxation steps between far poses with no joint faces and with joint faces only; linear in between."""

FREE_STEPS = 10
"""Relaxation steps of the free placement."""

MAX_SHAPE_FRAMES = 64
"""Number of frames from which mean shapes are taken. Any shapes encode all frames exactly."""


def mixed_space(
    points: LargeArray,
    topology: Topology,
    decomposition: Decomposition,
    placement: PlacementName = "anchored",
    purpose: Purpose = "sequence",
    progress: Progress = no_progress,
) -> MixedSpace:
    """Make the mixed shape space of points ``(T, V, 3)`` in any unit.

    Purpose "reduced" ignores lengths and angles, which reduced models do not have accurately enough; "blends" follows
    them fully.
    """
    if placement not in PLACEMENTS:
        raise SettingsError(f"placement is {placement!r}; {' or '.join(map(repr, PLACEMENTS))} is expected")
    first = points[:1][0]
    scale = bounding_diagonal(first) or 1.0
    frames = points[sample_frame_ids(len(points), MAX_SHAPE_FRAMES)]
    shapes = _round_positions(
        np.concatenate([mean_shape(frames[:, part] / scale) for part in decomposition.parts])
    )
    reference = _round_positions(first.astype(np.float64) / scale)
    progress(1, 2, "registering parts")
    posed = MixedSpace(
        topology=topology,
        decomposition=decomposition,
        scale=scale,
        shapes=shapes,
        reference=reference,
        skinning_weights=fit_skinning_weights(topology, decomposition, shapes, frames / scale, reference),
        steadiness=None,
        joint_faces=np.zeros(len(topology.faces), dtype=bool),
        projection=Projection(),
    )
    if purpose == "blends":
        posed = replace(posed, projection=Projection(relations=FAR_RELATIONS))
    posed = replace(
        posed, steadiness=posed.articulation.measure_steadiness(posed.split(posed.encode(frames)).part_poses)
    )
    progress(2, 2, "registering parts")
    limits = MAX_STRETCH, MAX_BEND_DEGREES
    if placement == "free":
        limits = MAX_FREE_STRETCH, MAX_FREE_BEND_DEGREES
    elif purpose == "blends":
        limits = MAX_BLEND_STRETCH, MAX_BLEND_BEND_DEGREES
    pairs = _all_pairs(frames) if purpose == "blends" else _neighbour_pairs(points)
    wrong = midpoint_errors(posed, pairs, *limits)
    if placement == "free":
        corners = posed.rigid_part_of_vertex[topology.faces]
        mixed = (corners < 0).any(axis=1) | (corners != corners[:, :1]).any(axis=1)
        return replace(
            posed,
            joint_faces=mixed | (wrong > 1.0),
            projection=Projection("free", 1.0, FAR_HOLD, FREE_STEPS, FAR_RELATIONS),
        )
    wrong[faces_without_area(topology, frames) | faces_at_winding_hinges(topology, frames)] = 0.0
    joint_faces = wrong > 1.0
    if purpose != "blends":
        joint_faces = _limit_joint_faces(posed, wrong)
    space = replace(posed, joint_faces=joint_faces)
    if purpose == "reduced" or not joint_faces.any():
        return space
    if purpose == "blends" or are_far_apart(posed, points):
        steps = MIN_RELAXATION_STEPS + round(
            (MAX_RELAXATION_STEPS - MIN_RELAXATION_STEPS) * float(joint_faces.mean())
        )
        return replace(space, projection=Projection("anchored", 1.0, FAR_HOLD, steps, FAR_RELATIONS))
    return space


def _round_positions(x: Float) -> Float:
    """Round positions in diagonals to `REFERENCE_STEP`, to save bytes."""
    return np.asarray(np.round(x / REFERENCE_STEP) * REFERENCE_STEP)


def _limit_joint_faces(posed: MixedSpace, wrong: Float) -> Mask:
    """Mark the faces with the largest errors above 1 as joint faces, up to the limit of `SIZE_REDUCTION`."""
    topology = posed.topology
    budget = (len(topology.edges) + len(topology.hinge_faces)) / SIZE_REDUCTION - posed.dim
    worst = np.argsort(-wrong, kind="stable")[: int(np.count_nonzero(wrong > 1.0))]

    def marked(count: int) -> Mask:
        faces = np.zeros(len(topology.faces), dtype=bool)
        faces[worst[:count]] = True
        return faces

    def fits(count: int) -> bool:
        faces = marked(count)
        edges = np.unique(topology.face_edges[faces])
        hinges = np.count_nonzero(faces[topology.hinge_faces].any(axis=1))
        return bool(len(edges) + hinges <= budget)

    low, high = 0, len(worst)
    while low < high:
        middle = (low + high + 1) // 2
        low, high = (middle, high) if fits(middle) else (low, middle - 1)
    return marked(low)


def faces_without_area(topology: Topology, frames: FloatArray) -> Mask:
    """Mark the faces ``(F,)`` that have no area in some of the frames ``(S, V, 3)``."""
    flat = [degenerate_faces(frame.astype(np.float64), topology.faces, MIN_HEIGHT_RATIO) for frame in frames]
    return np.asarray(np.any(flat, axis=0))


def faces_at_winding_hinges(topology: Topology, frames: FloatArray) -> Mask:
    """Mark the faces ``(F,)`` at hinges whose angles in frames ``(S, V, 3)`` are more than half a turn apart."""
    lowest = highest = dihedral_angles(frames[0].astype(np.float64), topology.hinges)
    for frame in frames[1:]:
        angles = dihedral_angles(frame.astype(np.float64), topology.hinges)
        lowest, highest = np.minimum(lowest, angles), np.maximum(highest, angles)
    winding = np.zeros(len(topology.faces), dtype=bool)
    winding[topology.hinge_faces[highest - lowest > np.pi]] = True
    return winding


def are_far_apart(space: MixedSpace, frames: LargeArray) -> bool:
    """Whether more than `FAR_TORN_SHARE` of faces are torn half-way between neighbours of frames ``(T, V, 3)``."""
    pairs = list(_neighbour_pairs(frames))
    for middle in (
        _linear_midpoint,
        _skinned_midpoint,
    ):  # plain means are quick, and show most animations to be near
        if not sum(_torn_share(space, pair, middle) for pair in pairs) > FAR_TORN_SHARE * len(pairs):
            return False
    return bool(pairs)


def midpoint_errors(space: MixedSpace, pairs: Iterable[FloatArray], stretch: float, bend: float) -> Float:
    """Return the largest errors ``(F,)`` half-way between pairs ``(2, V, 3)``, over limits of edges and hinges.

    `stretch` limits relative errors of edges, `bend` errors of hinges in degrees.
    """
    topology = space.topology
    wrong = np.zeros(len(topology.faces))
    for pair in pairs:
        middle = _skinned_midpoint(space, pair)
        edges = _length_errors(middle, pair, topology.edges) / stretch
        hinges = _angle_errors(middle, pair, topology.hinges) / bend
        np.maximum(wrong, edges[topology.face_edges].max(axis=1), out=wrong)
        for side in (0, 1):
            np.maximum.at(wrong, topology.hinge_faces[:, side], hinges)
    return wrong


def _all_pairs(frames: FloatArray) -> Iterator[FloatArray]:
    """Yield all pairs of a few frames ``(S, V, 3)``, or neighbours of many."""
    count = len(frames)
    pairs = combinations(range(count), 2) if count <= MAX_POSES_FOR_ALL_PAIRS else pairwise(range(count))
    return (frames[[first, second]] for first, second in pairs)


def _neighbour_pairs(frames: LargeArray) -> Iterator[FloatArray]:
    """Yield evenly spread pairs of neighbours among frames ``(T, V, 3)``."""
    return (frames[first : first + 2] for first in sample_frame_ids(len(frames) - 1, MAX_NEIGHBOUR_PAIRS))


def _torn_share(
    space: MixedSpace, pair: FloatArray, between: Callable[[MixedSpace, FloatArray], Float]
) -> float:
    """Share of faces, or of `SAMPLED_FACES` of them, that are torn in a mesh between two frames."""
    faces = space.topology.faces[evenly_spaced(len(space.topology.faces), SAMPLED_FACES)]
    sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    torn = _length_errors(between(space, pair), pair, sides) > TORN_STRETCH
    return float(torn.reshape(-1, 3).any(axis=1).mean())


def _skinned_midpoint(space: MixedSpace, pair: FloatArray) -> Float:
    """Return the posed mesh half-way between two frames, in their unit."""
    return np.asarray(space.skin(space.encode(pair).mean(axis=0)[None])[0] * space.scale)


def _linear_midpoint(space: MixedSpace, pair: FloatArray) -> Float:
    """Return the mean vertices of two frames."""
    return np.asarray(pair.mean(axis=0, dtype=np.float64))


def _length_errors(middle: Float, pair: FloatArray, edges: NDArray[np.integer]) -> Float:
    """Return relative errors of lengths ``(E,)`` against those half-way between two frames."""
    lengths = edge_lengths(pair.astype(np.float64), edges).mean(axis=0)
    off = np.abs(edge_lengths(middle, edges) - lengths)
    return np.asarray(np.divide(off, lengths, out=np.zeros_like(off), where=lengths > 0))


def _angle_errors(middle: Float, pair: FloatArray, hinges: NDArray[np.integer]) -> Float:
    """Return errors of angles ``(H,)``, in degrees, against those half-way between two frames."""
    first, second = dihedral_angles(pair.astype(np.float64), hinges)
    wanted = first + 0.5 * wrap_angles(second - first)
    return np.degrees(np.abs(wrap_angles(dihedral_angles(middle, hinges) - wanted)))
