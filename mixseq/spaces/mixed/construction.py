"""Make the mixed shape space of a sequence: mean shapes, skinning weights, joint faces and settings of P_m.

Half-way between two frames, lengths and angles should be the means of both frames. Joint faces are faces with large
half-way errors, for any segmentation. The share of their lengths and angles is selected by `mixseq.signals.fitting`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import combinations, pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mixseq.choices import PLACEMENTS, PlacementName
from mixseq.errors import SettingsError
from mixseq.mesh.measures import degenerate_faces, dihedral_angles, edge_lengths, element_blocks, wrap_angles
from mixseq.mesh.rigid import mean_shape
from mixseq.mesh.topology import Topology
from mixseq.runtime.low_memory import LargeArray
from mixseq.runtime.progress import Progress, log_progress
from mixseq.segmentation.joints import Decomposition, sample_frame_ids
from mixseq.sequence.sequence import iterate_blocks, reference_diagonal
from mixseq.spaces.mixed.articulation import PartPoses
from mixseq.spaces.mixed.mixed_space import MixedSpace, Projection
from mixseq.spaces.mixed.skinning_weights import fit_skinning_weights
from mixseq.types import Float, FloatArray, Mask, evenly_spaced, index_mask

Purpose = Literal["sequence", "reduced", "blends"]
"""Use of a space: frames in time, models of a given rank or knots, or blends of poses that may be far apart."""

ERROR_LIMITS = {"sequence": (0.1, 25.0), "reduced": (0.1, 25.0), "blends": (0.015, 4.0), "free": (0.06, 15.0)}
"""Largest half-way errors outside joints, by purpose or placement: relative for edges, in degrees for hinges."""

TORN_STRETCH = 0.1  # relative half-way error of an edge above which its faces are torn
FAR_TORN_SHARE = 0.15  # fraction of torn faces above which frames are far apart
FAR_HOLD = 0.003  # `Projection.hold` where frames are far apart
REFERENCE_STEP = 2.0**-20  # rounding step of mean shapes and of the reference frame, in diagonals
SIZE_REDUCTION = 1.3  # least ratio of the number of all lengths and angles to the length of a vector
STILL_HOLD = 0.01  # `Projection.hold` of a single frame, whose joints have lengths and angles for poses by handles
FAR_RELATIONS = 3.0  # `Projection.relations` where frames are far apart, since relations vary less than poses
MIN_HEIGHT_RATIO = 1e-3  # least height to longest side of joint faces in all frames; angles of others are noise
MAX_NEIGHBOUR_PAIRS = 12  # largest number of pairs of neighbouring frames from which joint faces are found
SAMPLED_FACES = 100_000  # number of faces from which the fraction of torn faces is estimated
MAX_POSES_FOR_ALL_PAIRS = 12  # poses of which all pairs are compared; of more, only neighbours are
MIN_STEPS, MAX_STEPS = 6, 20  # relaxation steps between far poses if no or all faces are joint faces
FREE_STEPS = 10  # relaxation steps of the free placement
MAX_SHAPE_FRAMES = 64  # number of frames in mean shapes; frames are encoded exactly with any


def mixed_space(
    points: LargeArray,
    topology: Topology,
    decomposition: Decomposition,
    placement: PlacementName = "anchored",
    purpose: Purpose = "sequence",
    progress: Progress = log_progress,
) -> MixedSpace:
    """Make the mixed shape space of points ``(T, V, 3)`` in any unit.

    Purpose "reduced" ignores lengths and angles, which are inaccurate in models of few modes; "blends" uses the full
    share of lengths and angles.
    """
    if placement not in PLACEMENTS:
        raise SettingsError(f"placement is {placement!r}; {' or '.join(map(repr, PLACEMENTS))} is expected")
    first = points[:1][0]
    scale = reference_diagonal(iterate_blocks(points)).length or 1.0
    frames = points[sample_frame_ids(len(points), MAX_SHAPE_FRAMES)]
    shapes = np.concatenate([mean_shape(frames[:, part] / scale) for part in decomposition.parts])
    shapes = _round_positions(shapes)
    reference = _round_positions(first.astype(np.float64) / scale)
    progress(1, 2, "registering parts")
    base = MixedSpace(
        topology=topology,
        decomposition=decomposition,
        scale=scale,
        shapes=shapes,
        reference=reference,
        skinning_weights=fit_skinning_weights(topology, decomposition, shapes, frames, scale, reference),
        steadiness=None,
        joint_faces=np.zeros(len(topology.faces), dtype=bool),
        projection=Projection(),
    )
    if purpose == "blends":
        base = base.with_weights(projection=Projection(relations=FAR_RELATIONS))
    base = base.with_weights(steadiness=base.articulation.measure_steadiness(_encode_poses(base, frames)))
    progress(2, 2, "registering parts")
    if len(points) == 1 and placement == "anchored":
        faces = _blended_faces(base) & ~faces_without_area(topology, frames)
        return base.with_weights(joint_faces=faces, projection=Projection(share=1.0, hold=STILL_HOLD))
    pairs = _all_pairs(frames) if purpose == "blends" else _neighbour_pairs(points)
    errors = midpoint_errors(base, pairs, *ERROR_LIMITS["free" if placement == "free" else purpose])
    if placement == "free":
        return base.with_weights(
            joint_faces=_blended_faces(base) | (errors > 1.0),
            projection=Projection("free", 1.0, FAR_HOLD, FREE_STEPS, FAR_RELATIONS),
        )
    if (errors > 1.0).any():
        errors[faces_without_area(topology, frames)] = 0.0
        if purpose != "blends":  # models of few modes miss by half a turn where angles wind
            errors[faces_at_winding_hinges(topology, frames)] = 0.0
    joint_faces = errors > 1.0 if purpose == "blends" else _limit_joint_faces(base, errors)
    space = base.with_weights(joint_faces=joint_faces)
    if purpose == "reduced" or not joint_faces.any():
        return space
    if purpose == "blends" or are_far_apart(base, points):
        steps = MIN_STEPS + round((MAX_STEPS - MIN_STEPS) * float(joint_faces.mean()))
        return space.with_weights(projection=Projection("anchored", 1.0, FAR_HOLD, steps, FAR_RELATIONS))
    return space


def _blended_faces(space: MixedSpace) -> Mask:
    """Mark the faces ``(F,)`` that are not rigid with a single part."""
    corners = space.rigid_part_of_vertex[space.topology.faces]
    return np.asarray((corners < 0).any(axis=1) | (corners != corners[:, :1]).any(axis=1))


def _round_positions(x: Float) -> Float:
    """Round positions in diagonals to `REFERENCE_STEP`, in place, to save bytes."""
    x /= REFERENCE_STEP
    np.round(x, out=x)
    x *= REFERENCE_STEP
    return x


def _encode_poses(space: MixedSpace, frames: FloatArray) -> PartPoses:
    """Encode frames ``(S, V, 3)`` in blocks, and return their part poses and relations."""
    poses, previous = [], None
    for block in iterate_blocks(frames):
        vectors = space.encode(block, previous)
        poses.append([np.array(each) for each in space.split(vectors).part_poses])
        previous = vectors[-1]
    return PartPoses(*map(np.concatenate, zip(*poses, strict=True)))


def _limit_joint_faces(space: MixedSpace, errors: Float) -> Mask:
    """Mark faces ``(F,)`` with the largest errors above 1 as joint faces, limited by `SIZE_REDUCTION`."""
    topology = space.topology
    budget = (len(topology.edges) + len(topology.hinge_faces)) / SIZE_REDUCTION - space.dim
    descending = np.argsort(-errors, kind="stable")[: int(np.count_nonzero(errors > 1.0))]

    def mark(count: int) -> Mask:
        return index_mask(descending[:count], len(topology.faces))

    def fits(count: int) -> bool:
        faces = mark(count)
        edges = np.unique(topology.face_edges[faces])
        hinges = np.count_nonzero(faces[topology.hinge_faces].any(axis=1))
        return bool(len(edges) + hinges <= budget)

    low, high = 0, len(descending)
    while low < high:
        middle = (low + high + 1) // 2
        low, high = (middle, high) if fits(middle) else (low, middle - 1)
    return mark(low)


def faces_without_area(topology: Topology, frames: FloatArray) -> Mask:
    """Mark the faces ``(F,)`` that are degenerate in any of the frames ``(S, V, 3)``."""
    return np.asarray(degenerate_faces(frames, topology.faces, MIN_HEIGHT_RATIO).any(axis=0))


def faces_at_winding_hinges(topology: Topology, frames: FloatArray) -> Mask:
    """Mark the faces ``(F,)`` at hinges whose angles in frames ``(S, V, 3)`` differ by more than 180 degrees."""
    winding = np.zeros(len(topology.faces), dtype=bool)
    for block in element_blocks(len(topology.hinge_faces)):
        hinges = topology.hinges_at(block)
        corners = np.arange(hinges.size, dtype=np.int32).reshape(hinges.shape)
        angles = [dihedral_angles(frame[hinges.reshape(-1)], corners) for frame in frames]
        winding[topology.hinge_faces[block][np.ptp(angles, axis=0) > np.pi]] = True
    return winding


def are_far_apart(space: MixedSpace, frames: LargeArray) -> bool:
    """Whether more than `FAR_TORN_SHARE` of the faces are torn half-way between neighbouring frames ``(T, V, 3)``."""
    pairs = list(_neighbour_pairs(frames))
    return bool(pairs) and all(
        sum(_torn_share(space.topology, midpoint(space, pair), pair) for pair in pairs) > FAR_TORN_SHARE * len(pairs)
        for midpoint in (_linear_midpoint, _skinned_midpoint)  # the linear midpoint is quick, and often suffices
    )


def midpoint_errors(space: MixedSpace, pairs: Iterable[FloatArray], stretch: float, bend: float) -> Float:
    """Return the largest errors ``(F,)`` half-way between pairs ``(2, V, 3)``, relative to limits.

    The limit for edges, `stretch`, is relative to edge lengths; the limit for hinges, `bend`, is in degrees.
    """
    topology = space.topology
    errors = np.zeros(len(topology.faces))
    for pair in pairs:
        midpoint = _skinned_midpoint(space, pair)
        edge_errors = _length_errors(midpoint, pair, topology.edges) / stretch
        for side in topology.face_edges.T:
            np.maximum(errors, edge_errors[side], out=errors)
        for block in element_blocks(len(topology.hinge_faces)):
            hinge_errors = _angle_errors(midpoint, pair, topology.hinges_at(block)) / bend
            for side in topology.hinge_faces[block].T:
                np.maximum.at(errors, side, hinge_errors)
    return errors


def _all_pairs(frames: FloatArray) -> Iterator[FloatArray]:
    """Yield all pairs of few frames ``(S, V, 3)``, or only neighbouring pairs of many frames."""
    count = len(frames)
    pairs = combinations(range(count), 2) if count <= MAX_POSES_FOR_ALL_PAIRS else pairwise(range(count))
    return (frames[[first, second]] for first, second in pairs)


def _neighbour_pairs(frames: LargeArray) -> Iterator[FloatArray]:
    """Yield evenly spread pairs of neighbours among frames ``(T, V, 3)``."""
    return (frames[first : first + 2] for first in sample_frame_ids(len(frames) - 1, MAX_NEIGHBOUR_PAIRS))


def _torn_share(topology: Topology, midpoint: Float, pair: FloatArray) -> float:
    """Return the fraction of faces, or of a sample of them, that are torn half-way between two frames."""
    faces = topology.faces[evenly_spaced(len(topology.faces), SAMPLED_FACES)]
    sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    is_torn = _length_errors(midpoint, pair, sides) > TORN_STRETCH
    return float(is_torn.reshape(-1, 3).any(axis=1).mean())


def _skinned_midpoint(space: MixedSpace, pair: FloatArray) -> Float:
    """Return the skinned vertices half-way between two frames, in their unit."""
    return np.asarray(space.skin(space.encode(pair).mean(axis=0)[None])[0] * space.scale)


def _linear_midpoint(space: MixedSpace, pair: FloatArray) -> Float:
    """Return the mean of the vertices of two frames."""
    return np.asarray(pair.mean(axis=0, dtype=np.float64))


def _length_errors(midpoint: Float, pair: FloatArray, edges: NDArray[np.integer]) -> Float:
    """Return relative errors ``(E,)`` of lengths against the means of two frames."""
    expected = edge_lengths(pair, edges).mean(axis=0)
    errors = np.abs(edge_lengths(midpoint, edges) - expected)
    return np.asarray(np.divide(errors, expected, out=np.zeros_like(errors), where=expected > 0))


def _angle_errors(midpoint: Float, pair: FloatArray, hinges: NDArray[np.integer]) -> Float:
    """Return errors ``(H,)`` of angles, in degrees, against the means of two frames."""
    first, second = dihedral_angles(pair, hinges)
    expected = first + 0.5 * wrap_angles(second - first)
    return np.degrees(np.abs(wrap_angles(dihedral_angles(midpoint, hinges) - expected)))
