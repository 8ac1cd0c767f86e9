r"""Smooth skinning decomposition: fit weights, rest positions and motions of bones alternately.

.. math:: \min \sum_{t, v} \Bigl| \sum_b w_{vb} \bigl( R_{tb} r_v + T_{tb} \bigr) - x_t(v) \Bigr|^2

Le and Deng (2012) fit weights (`mixseq.rigging.bones`) and motions (`mixseq.rigging.bone_tree`) alternately. They take
rest positions from a frame, which are fitted here too. Initial bones are near-rigid parts instead of clusters of
vertices; further bones are seeded where the error is largest. Rounds are accelerated.

*Without a skeleton* bones are free at first. Then they are connected to a tree with few sliding joints, whose error is
at most a tenth larger than the error of free bones. Joints with the largest weighted separation slide.

*With a skeleton* joints and bound mesh keep their rest positions. A vertex starts with the nearest bone in the bind
pose. A bone is the union of segments from its joint to its children's joints; without children it extends the direction
of its parent. Bones start with the rigid motion of their vertices, or with the parent's motion. Then joints are
connected, and weights and motions are fitted alternately. Among bones of similar motion the nearest is preferred: the
cost :math:`w_{vb} (10^{-3} d_{vb})^2` of a weight :math:`w_{vb}` at the distance :math:`d_{vb}` is added to the squared
error. At first the cost is a hundred times larger, so that bones do not lose all vertices to bones of similar motion.
Bones that move no vertex keep their rest pose relative to the parent.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from mixseq.errors import InvalidSequenceError, SegmentationError, SettingsError
from mixseq.mesh.polygons import label_vertices
from mixseq.mesh.topology import Topology
from mixseq.rigging.bone_tree import Joints, attach_joints, build_bone_tree, fit_motions
from mixseq.rigging.bones import Binding, Centred, bind, fit_rigid_motion, merge_bones, project_to_rotations, seed_bones
from mixseq.rigging.rigs import BONES_PER_VERTEX, Skeleton, Skin
from mixseq.runtime.progress import Progress
from mixseq.segmentation.methods import segment
from mixseq.sequence.sequence import MeshSequence, UnitConversion, bounding_diagonal
from mixseq.types import Float, Index

MIN_RELATIVE_GAIN = 3e-3  # smallest mean relative decrease of the error by a round; chosen empirically, as all here
MAX_TREE_ERROR_RATIO = 1.1  # largest root mean square error of bones in a tree, relative to the error of free bones
_GAIN_ROUNDS = 3  # number of rounds over which the decrease of the error is averaged
_ROUNDING_ERROR = 1e-9  # root mean square error that counts as rounding, in diagonals
_NO_SLIDING_ERROR = 1e-6  # root mean square error that is always accepted without sliding joints, in diagonals
_ROUNDS_BETWEEN_SEEDS = 2  # number of rounds before more bones are seeded
_TRIAL_ROUND_DIVISOR = 3  # ratio of all rounds to the rounds of a trial of sliding joints


def decompose_tracks(
    tracks: Float, labels: Index, max_count: int, rounds: int, report: Callable[[int], None]
) -> tuple[Binding, Float]:
    """Fit a binding and free bones ``(B, 4, 3T)`` to tracks ``(V, 3T)``, starting from labels ``(V,)``."""
    labels = merge_bones(tracks, labels, max_count)
    rest = tracks[:, :3].copy()
    vertices = [np.flatnonzero(labels == bone) for bone in range(labels.max() + 1)]
    motions = np.stack([fit_rigid_motion(tracks, rest, vertex_ids) for vertex_ids in vertices])
    no_weights = np.zeros((len(rest), BONES_PER_VERTEX))
    binding = Binding(rest, no_weights.astype(np.int64), no_weights, no_weights[:, 0])
    rounding_error = _ROUNDING_ERROR**2 * tracks.size / 3
    binding = bind(tracks, motions, binding, free_rest=False)
    while len(motions) < max_count and binding.errors.sum() > rounding_error:
        # The number of bones grows by half, with seeds at the largest errors.
        new_count = min(max_count - len(motions), 1 + len(motions) // 2)
        new_motions = seed_bones(tracks, binding, new_count, max(4, len(tracks) // (6 * max_count)))
        motions = np.concatenate([motions, new_motions])
        for _ in range(_ROUNDS_BETWEEN_SEEDS):
            binding = bind(tracks, motions, binding, free_rest=False)
            motions, _ = fit_motions(tracks, binding, motions, Joints.free(len(motions)))
    joints = Joints.free(len(motions))
    motions, _ = fit_motions(tracks, binding, motions, joints)
    binding, motions, _ = alternate_fits(tracks, binding, motions, joints, rounding_error, rounds, report)
    used_bones = np.unique(binding.influences[binding.weights > 0])
    return _renumber_bones(binding, used_bones, len(motions)), motions[used_bones]


def alternate_fits(
    tracks: Float,
    binding: Binding,
    motions: Float,
    joints: Joints,
    target_error: float,
    rounds: int,
    report: Callable[[int], None] = lambda round_id: None,
    fixed_rest: bool = False,
) -> tuple[Binding, Float, Joints]:
    """Fit the binding and the motions alternately until the squared error is small or stops decreasing.

    Rest positions and motions are extrapolated by a fraction j / (j + 3) of their last step (Nesterov 1983). Rounds
    that increase the error are reverted; j is the number of rounds since the last such round.
    """
    previous_rest, previous_motions = binding.rest, motions
    errors, good_rounds = [np.inf], 0
    for round_id in range(rounds):
        report(round_id)
        momentum = good_rounds / (good_rounds + 3.0)
        extrapolated = replace(binding, rest=binding.rest + momentum * (binding.rest - previous_rest))
        extrapolated_motions = project_to_rotations(motions + momentum * (motions - previous_motions))
        extrapolated_motions = attach_joints(extrapolated_motions, joints)
        fitted = bind(tracks, extrapolated_motions, extrapolated, free_rest=not fixed_rest)
        if good_rounds and fitted.errors.sum() > errors[-1]:
            good_rounds = 0
            continue
        good_rounds += 1
        previous_rest, previous_motions = binding.rest, motions
        binding = fitted
        motions, joints = fit_motions(tracks, fitted, extrapolated_motions, joints, fit_pivots=not fixed_rest)
        errors.append(binding.errors.sum())
        if errors[-1] <= target_error:
            break
        decay = (1 - MIN_RELATIVE_GAIN) ** (2 * _GAIN_ROUNDS)
        if len(errors) > _GAIN_ROUNDS and errors[-1] > decay * errors[-1 - _GAIN_ROUNDS]:
            break
    return binding, motions, joints


def _renumber_bones(binding: Binding, order: Index, bone_count: int) -> Binding:
    """Renumber the bones of a binding by their positions in the array `order` ``(n,)``."""
    new_ids = np.zeros(bone_count, dtype=np.int64)
    new_ids[order] = np.arange(len(order))
    return replace(binding, influences=np.where(binding.weights > 0, new_ids[binding.influences], 0))


def connect_bones(
    sequence: Centred, free: FreeBones, rounds: int, report: Callable[[int], None]
) -> tuple[Binding, Float, Joints]:
    """Connect free bones to a tree, with the fewest sliding joints that keep the error within its bound."""
    tracks, binding, motions = sequence.tracks, free.binding, free.motions
    order, joints = build_bone_tree(sequence.header.faces.astype(np.int64), binding, motions)
    binding, motions = _renumber_bones(binding, order, len(order)), motions[order]
    max_error = max(MAX_TREE_ERROR_RATIO**2 * binding.errors.sum(), _NO_SLIDING_ERROR**2 * tracks.size / 3)
    by_separation = _order_by_separation(binding, motions, joints)
    min_count, max_count, trial = 0, len(by_separation), 0
    best = binding, motions, replace(joints, sliding=np.ones(len(order), dtype=bool))
    trial_rounds = rounds // _TRIAL_ROUND_DIVISOR
    while min_count < max_count:  # binary search; `max_count` sliding joints keep the error within its bound
        report(trial := trial + 1)
        count = (min_count + max_count) // 2
        sliding = joints.sliding.copy()
        sliding[by_separation[:count]] = True
        trial_joints = replace(joints, sliding=sliding)
        fit = alternate_fits(tracks, binding, motions, trial_joints, max_error, trial_rounds)
        if fit[0].errors.sum() <= max_error:
            best, max_count = fit, count
        else:
            min_count = count + 1
    return alternate_fits(tracks, *best, _ROUNDING_ERROR**2 * tracks.size / 3, trial_rounds)


def _order_by_separation(binding: Binding, motions: Float, joints: Joints) -> Index:
    """Return the bones that have parents, sorted by decreasing weighted separation of their joints."""
    bones = np.flatnonzero(joints.parents >= 0)
    differences = motions[joints.parents[bones]] - motions[bones]
    separations = np.einsum("bi,bij->bj", joints.pivots[bones], differences[:, :3]) + differences[:, 3]
    weights = np.zeros(len(motions))
    np.add.at(weights, binding.influences, np.square(binding.weights))
    costs = np.sum(np.square(separations), axis=1) * weights[bones]
    return np.asarray(bones[np.argsort(-costs, kind="stable")])


ROUGH_FIT_ROUNDS = 4  # number of rounds of a rough fit, which takes a twentieth of the time of a full fit


@dataclass(frozen=True, eq=False)
class FreeBones:
    """Fitted bones without joints."""

    binding: Binding  # skinning weights, and rest positions in diagonals
    motions: Float  # (B, 4, 3T) transposed motions
    errors: tuple[float, float]  # see `measure_errors`


def fit_free_bones(
    sequence: Centred, bones: int | ArrayLike | None, rounds: int, report: Callable[[int], None]
) -> FreeBones:
    """Fit free bones; `bones` is their largest number, labels ``(F,)`` of triangles, or None for segmented parts."""
    binding, motions = decompose_tracks(sequence.tracks, *_initial_labels(sequence, bones), rounds, report)
    return FreeBones(binding, motions, measure_errors(sequence.tracks, binding, motions))


def measure_errors(tracks: Float, binding: Binding, motions: Float) -> tuple[float, float]:
    """Return the largest distance from tracks ``(V, 3T)`` in diagonals, and the KG error in percent."""
    residuals = tracks - binding.matrix(len(motions)) @ motions.reshape(-1, motions.shape[2])
    squares = np.square(residuals).reshape(len(residuals), -1, 3).sum(axis=2)
    spread = float(np.square(tracks).sum()) or 1.0
    return float(np.sqrt(squares.max())), 100 * float(np.sqrt(squares.sum() / spread))


def fit_tree_skin(
    sequence: Centred, free: FreeBones, rounds: int, report: Callable[[int], None]
) -> tuple[Skin, tuple[float, float]]:
    """Connect free bones to a tree; return the skin of all bones that move vertices, and its errors."""
    binding, motions, joints = connect_bones(sequence, free, rounds, report)
    errors = measure_errors(sequence.tracks, binding, motions)
    is_kept = joints.moves_vertices(binding)
    new_ids = np.cumsum(is_kept) - 1
    parents = joints.parents[is_kept]
    origin = sequence.centres[0]
    pivots = sequence.diagonal * joints.pivots[is_kept] + origin
    skeleton = replace(Skeleton.from_pivots(pivots), parents=np.where(parents < 0, -1, new_ids[parents]))
    binding = replace(binding, influences=new_ids[binding.influences])
    return sequence.to_skin(binding, motions[is_kept], skeleton, origin), errors


def _initial_labels(sequence: Centred, bones: int | ArrayLike | None) -> tuple[Index, int]:
    """Return the initial bone ``(V,)`` of every vertex, and the largest number of bones."""
    faces, vertex_count = sequence.header.faces.astype(np.int64), sequence.header.vertex_count
    if bones is None or isinstance(bones, int | np.integer):
        if bones is not None and not 1 <= bones <= len(faces):
            raise SettingsError(
                f"bones is {bones}; a number from 1 to {len(faces)}, the number of triangles, is expected"
            )
        max_count = None if bones is None else int(bones)
        labels = segment(sequence.frames, Topology(faces, vertex_count), parts=max_count)
    else:
        labels, max_count = np.asarray(bones), None
        if labels.shape != (len(faces),) or not np.issubdtype(labels.dtype, np.integer):
            raise SegmentationError(
                f"labels of bones have shape {labels.shape} and type {labels.dtype}; "
                f"one whole number for each of the {len(faces)} triangles is expected"
            )
        labels = np.unique(labels, return_inverse=True)[1]
    return label_vertices(faces, labels, vertex_count), max_count or int(labels.max()) + 1


_MAX_EDGE_LENGTH_RATIO = 1.5  # largest median ratio of edge lengths, bind pose to first frame or its inverse
_MARGIN_RATIO = 0.5  # margin around the mesh, relative to its largest extent; fitted joints need up to 0.4
_MAX_OUTSIDE_SHARE = 0.25  # largest share of joints outside the margin; control joints may be anywhere
_MIN_SKELETON_SIZE_RATIO = 0.03  # smallest ratio of diagonals, skeleton to mesh; smaller skeletons have another unit
_MIN_RIGID_VERTICES = 4  # smallest number of vertices to which a rigid motion is fitted
_DISTANCE_COSTS = 1e-2, 1e-3  # costs of distances relative to errors, in the first and the second fit
_INITIAL_MOTION_ROUNDS = 10  # number of fits of motions before the first fit of weights


def fit_to_skeleton(
    sequence: Centred, skeleton: Skeleton, bind_pose: MeshSequence | None, rounds: int, progress: Progress
) -> Skin:
    """Fit skinning weights and motions of a skeleton to a sequence."""
    if bind_pose is None:
        bind_shape = sequence.points[0]
        expected = (
            "the mesh in the first frame; give the mesh as it is bound to the skeleton (bind_pose; on the command "
            "line in the skeleton's file), or a skeleton in the pose, place and unit of the first frame"
        )
    else:
        skeleton, bind_shape = _convert_bind_pose(sequence, skeleton, bind_pose)
        expected = "the bind pose; export both together, in the same place and unit"
    _check_placement(skeleton, bind_shape, expected)
    origin = bind_shape.mean(axis=0)
    rest = (bind_shape - origin) / sequence.diagonal
    pivots = (skeleton.pivots - origin) / sequence.diagonal
    parents = skeleton.parents.copy()  # numba would compile another version for read-only arrays
    joints = Joints(parents, pivots, parents < 0)
    tracks = sequence.tracks
    distances = bone_distances(rest, joints.pivots, joints.parents)
    binding, motions = _initial_fit(tracks, rest, joints, distances.argmin(axis=1))
    for stage, distance_cost in enumerate(_DISTANCE_COSTS):

        def report(round_id: int, first_round: int = stage * rounds) -> None:
            progress(first_round + round_id, len(_DISTANCE_COSTS) * rounds + 1, "fitting weights and bones")

        binding = replace(binding, costs=sequence.header.frame_count * (distance_cost * distances) ** 2)
        binding, motions, _ = alternate_fits(tracks, binding, motions, joints, 0.0, rounds, report, fixed_rest=True)
    return sequence.to_skin(binding, motions, skeleton, origin)


def bone_distances(points: Float, pivots: Float, parents: Index) -> Float:
    """Return the distances ``(V, B)`` of points ``(V, 3)`` from bones, which are segments between joints."""
    distances = cdist(points, pivots)
    for bone, parent in enumerate(parents.tolist()):
        if parent >= 0:
            segment = pivots[bone] - pivots[parent]
            to_segment = _segment_distances(points, pivots[parent], segment)
            distances[:, parent] = np.minimum(distances[:, parent], to_segment)
            if bone not in parents:
                distances[:, bone] = _segment_distances(points, pivots[bone], segment)
    return np.asarray(distances)


def _segment_distances(points: Float, start: Float, segment: Float) -> Float:
    positions = np.clip((points - start) @ segment / max(float(segment @ segment), 1e-300), 0, 1)
    return np.asarray(np.linalg.norm(points - start - positions[:, None] * segment, axis=1))


def _convert_bind_pose(sequence: Centred, skeleton: Skeleton, bind_pose: MeshSequence) -> tuple[Skeleton, Float]:
    """Convert a skeleton and its bind shape ``(V, 3)`` to the unit and the up axis of the sequence."""
    header = sequence.header
    if bind_pose.vertex_count != header.vertex_count:
        raise InvalidSequenceError(
            f"the bind pose has {bind_pose.vertex_count} vertices, the sequence has {header.vertex_count}; give the "
            "same mesh, or no bind pose if the skeleton is in the pose of the first frame"
        )
    conversion = UnitConversion.from_header(bind_pose.header, header.up_axis, header.metres_per_unit)
    shape = np.asarray(conversion.convert(bind_pose.points[0].astype(np.float64)), dtype=np.float64)
    _check_size(shape, sequence)
    rotation = Rotation.from_matrix(conversion.rotation)
    axes = (rotation * Rotation.from_quat(skeleton.axes)).as_quat()
    pivots = np.asarray(conversion.convert(skeleton.pivots), dtype=np.float64)
    return replace(skeleton, pivots=pivots, axes=axes), shape


def _check_size(shape: Float, sequence: Centred) -> None:
    """Raise if edge lengths of a bind pose differ too much from edge lengths of the first frame."""
    i, j = np.roll(sequence.header.faces, 1, axis=1).reshape(-1), sequence.header.faces.reshape(-1)
    lengths = [np.linalg.norm(points[i] - points[j], axis=1) for points in (shape, sequence.points[0])]
    has_length = (lengths[0] > 0) & (lengths[1] > 0)
    ratios = np.log(lengths[0][has_length] / lengths[1][has_length])
    if has_length.any() and np.median(np.abs(ratios)) > np.log(_MAX_EDGE_LENGTH_RATIO):
        raise SettingsError(
            f"edges of the bind pose are {np.exp(np.median(ratios)):.3g} times as long as those of the first frame; "
            "give the same mesh with its vertices in the same order, and set the unit of both (metres_per_unit)"
        )


def _check_placement(skeleton: Skeleton, shape: Float, expected: str) -> None:
    """Raise if a skeleton is outside of the bounding box of its mesh, or far smaller than the mesh."""
    margin = _MARGIN_RATIO * np.ptp(shape, axis=0).max()
    lower, upper = shape.min(axis=0) - margin, shape.max(axis=0) + margin
    outside_count = int(((skeleton.pivots < lower) | (skeleton.pivots > upper)).any(axis=1).sum())
    if outside_count > _MAX_OUTSIDE_SHARE * skeleton.bone_count:
        raise SettingsError(f"{outside_count} of {skeleton.bone_count} joints are outside of {expected}")
    size = bounding_diagonal(skeleton.pivots) / (bounding_diagonal(shape) or 1.0)
    if skeleton.bone_count > 1 and size < _MIN_SKELETON_SIZE_RATIO:
        raise SettingsError(f"the skeleton is {size:.2g} times as large as {expected}")


def _initial_fit(tracks: Float, rest: Float, joints: Joints, nearest: Index) -> tuple[Binding, Float]:
    """Bind every vertex to the nearest bone, and fit motions with connected joints."""
    influences, weights = np.zeros((2, len(rest), BONES_PER_VERTEX))
    influences[:, 0], weights[:, 0] = nearest, 1.0
    binding = Binding(rest, influences.astype(np.int64), weights, np.zeros(len(rest)))
    body_motion = fit_rigid_motion(tracks, rest, np.arange(len(rest)))
    motions: list[Float] = []
    for bone, parent in enumerate(joints.parents.tolist()):
        vertices = np.flatnonzero(nearest == bone)
        parent_motion = motions[parent] if parent >= 0 else body_motion
        is_rigid = len(vertices) >= _MIN_RIGID_VERTICES
        motions.append(fit_rigid_motion(tracks, rest, vertices) if is_rigid else parent_motion)
    attached = attach_joints(np.stack(motions), joints)
    for _ in range(_INITIAL_MOTION_ROUNDS):
        attached, _ = fit_motions(tracks, binding, attached, joints, fit_pivots=False)
    return binding, attached
