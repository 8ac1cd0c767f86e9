r"""Smooth skinning decomposition: weights, rest positions and motions of bones, fitted in turn.

.. math:: \min \sum_{t, v} \Bigl| \sum_b w_{vb} \bigl( R_{tb} r_v + T_{tb} \bigr) - x_t(v) \Bigr|^2

Le and Deng (2012) alternate weights (`mixseq.rigging.bones`) and motions (`mixseq.rigging.bone_tree`); rest
positions, which they take from a frame, are fitted here too. Bones start as near-rigid parts instead of clusters of
vertices; further bones are seeded where the error is largest. Rounds are accelerated.

*Found bones* are free at first. Then they form a tree, with the fewest sliding joints that keep the error within a
tenth of that of free bones: those of largest separation, weighted by their bones.

*A given skeleton* keeps the rest positions of its joints and of the bound mesh. A vertex starts with the nearest bone
in the bind pose. Bone b is the segments from its joint to those of its children; one without children extends the
direction of the one above. Bones start with the best rigid motions of their vertices, those without vertices follow the
bone above; then joints connect them, and weights and motions are fitted in turn. Of bones that move alike a vertex
follows the nearest: a weight :math:`w_{vb}` costs :math:`w_{vb} (10^{-3} d_{vb})^2` of a squared error, at the distance
:math:`d_{vb}`. At first the cost is a hundred times larger: else bones with unknown motions lose their vertices to
others that happen to move like them, and never get them back. Bones that move nothing keep their rest pose relative to
the one above.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from mixseq.errors import InvalidSequenceError, SegmentationError, SettingsError
from mixseq.mesh.topology import Topology
from mixseq.rigging.bone_tree import Joints, attached, bone_tree, move
from mixseq.rigging.bones import (
    Binding,
    Centred,
    bind,
    label_vertices,
    merged,
    motion_of,
    on_rotations,
    seeded,
)
from mixseq.rigging.rigs import INFLUENCES, Skeleton, Skin
from mixseq.runtime.progress import Progress
from mixseq.segmentation.methods import segment
from mixseq.sequence.sequence import MeshSequence, UnitConversion, bounding_diagonal
from mixseq.types import Float, Index

GAIN = 3e-3
"""Relative decrease of the error below which rounds end; constants here were chosen empirically."""

WORSE = 1.1
"""Largest root mean square error of bones in a tree, relative to free ones."""

_FEW = 3  # rounds over which this is averaged
_EXACT = 1e-9  # root mean square error of rounding, in diagonals
_NEARLY = 1e-6  # root mean square error below which no joint slides, in diagonals
_BETWEEN = 2  # rounds before more bones are seeded
_TRIED = 3  # a number of sliding joints gets this fraction of all rounds: 1 / _TRIED


def decompose_tracks(
    tracks: Float, labels: Index, most: int, rounds: int, told: Callable[[int], None]
) -> tuple[Binding, Float]:
    """Fit weights, rest positions, motions ``(B, 4, 3T)`` of free bones: tracks ``(V, 3T)``; labels ``(V,)``."""
    labels = merged(tracks, labels, most)
    rest = tracks[:, :3].copy()
    motions = np.stack(
        [motion_of(tracks, rest, np.flatnonzero(labels == b)) for b in range(labels.max() + 1)]
    )
    nothing = np.zeros((len(rest), INFLUENCES))
    binding = Binding(rest, nothing.astype(np.int64), nothing, nothing[:, 0])
    exact = _EXACT**2 * tracks.size / 3
    binding = bind(tracks, motions, binding, free_rest=False)
    while len(motions) < most and binding.errors.sum() > exact:
        # Half as many again at a time, each seeded at errors of those before.
        more = min(most - len(motions), 1 + len(motions) // 2)
        new = seeded(tracks, binding, more, max(4, len(tracks) // (6 * most)))
        motions = np.concatenate([motions, new])
        for _ in range(_BETWEEN):
            binding = bind(tracks, motions, binding, free_rest=False)
            motions, _ = move(tracks, binding, motions, Joints.loose(len(motions)))
    loose = Joints.loose(len(motions))
    motions, _ = move(tracks, binding, motions, loose)
    binding, motions, _ = alternated(tracks, binding, motions, loose, exact, rounds, told)
    used = np.unique(binding.influences[binding.weights > 0])
    return _renumbered(binding, used, len(motions)), motions[used]


def alternated(
    tracks: Float,
    binding: Binding,
    motions: Float,
    joints: Joints,
    enough: float,
    rounds: int,
    told: Callable[[int], None] = lambda done: None,
    held: bool = False,
) -> tuple[Binding, Float, Joints]:
    """Fit weights with rest positions, and motions, in turn, until the squared error is small enough or stops falling.

    Every round extrapolates the last ones: rest positions and motions go on by a fraction j / (j + 3) of their last
    step (Nesterov 1983), j counting the rounds since the error grew; such a round is reverted. With `held`, rest
    positions and joints are fixed.
    """
    rest, before = binding.rest, motions
    past, good = [np.inf], 0
    for done in range(rounds):
        told(done)
        on = good / (good + 3.0)
        ahead = replace(binding, rest=binding.rest + on * (binding.rest - rest))
        going = attached(on_rotations(motions + on * (motions - before)), joints)
        bound = bind(tracks, going, ahead, free_rest=not held)
        if good and bound.errors.sum() > past[-1]:
            good = 0
            continue
        good += 1
        rest, before = binding.rest, motions
        binding = bound
        motions, joints = move(tracks, bound, going, joints, fit_pivots=not held)
        past.append(binding.errors.sum())
        if past[-1] <= enough or (len(past) > _FEW and past[-1] > (1 - GAIN) ** (2 * _FEW) * past[-1 - _FEW]):
            break
    return binding, motions, joints


def _renumbered(binding: Binding, order: Index, bones: int) -> Binding:
    """Renumber the bones of a binding by their places in an order."""
    places = np.zeros(bones, dtype=np.int64)
    places[order] = np.arange(len(order))
    return replace(binding, influences=np.where(binding.weights > 0, places[binding.influences], 0))


def hung_bones(
    tracks: Float, faces: Index, binding: Binding, motions: Float, rounds: int, told: Callable[[int], None]
) -> tuple[Binding, Float, Joints]:
    """Build a tree of free bones with the fewest sliding joints that the error allows; see `free_bones`."""
    order, joints = bone_tree(faces, binding, motions)
    binding, motions = _renumbered(binding, order, len(order)), motions[order]
    most = max(WORSE**2 * binding.errors.sum(), _NEARLY**2 * tracks.size / 3)
    apart = _coming_apart(binding, motions, joints)
    fewest, enough, tries = 0, len(apart), 0
    found = binding, motions, replace(joints, sliding=np.ones(len(order), dtype=bool))
    while fewest < enough:  # binary search: `enough` sliding joints keep the error
        told(tries := tries + 1)
        count = (fewest + enough) // 2
        sliding = joints.sliding.copy()
        sliding[apart[:count]] = True
        tried = alternated(tracks, binding, motions, replace(joints, sliding=sliding), most, rounds // _TRIED)
        if tried[0].errors.sum() <= most:
            found, enough = tried, count
        else:
            fewest = count + 1
    return alternated(tracks, *found, _EXACT**2 * tracks.size / 3, rounds // _TRIED)


def _coming_apart(binding: Binding, motions: Float, joints: Joints) -> Index:
    """Return the bones with parents, by decreasing weighted separation of their joints."""
    bones = np.flatnonzero(joints.parents >= 0)
    apart = motions[joints.parents[bones]] - motions[bones]
    gaps = np.einsum("bi,bij->bj", joints.pivots[bones], apart[:, :3]) + apart[:, 3]
    weights = np.zeros(len(motions))
    np.add.at(weights, binding.influences, np.square(binding.weights))
    costs = np.sum(np.square(gaps), axis=1) * weights[bones]
    return np.asarray(bones[np.argsort(-costs, kind="stable")])


ROUGH = 4
"""Rounds of a rough fit, a twentieth of the time of a skin; chosen empirically."""


@dataclass(frozen=True, eq=False)
class FreeBones:
    """Bones without joints."""

    binding: Binding  # weights and rest positions of vertices, in diagonals
    motions: Float  # (B, 4, 3T) their transposed motions
    # (float, float) largest distance from the sequence in diagonals, and KG error in percent.
    errors: tuple[float, float]


def fit_free_bones(
    sequence: Centred, bones: int | ArrayLike | None, rounds: int, told: Callable[[int], None]
) -> FreeBones:
    """Fit free bones: at most a number, or from the labels ``(F,)`` of triangles, or from parts by motion."""
    tracks = sequence.tracks
    binding, motions = decompose_tracks(tracks, *_initial_labels(sequence, bones), rounds, told)
    off = tracks - binding.matrix(len(motions)) @ motions.reshape(-1, motions.shape[2])
    squares = np.square(off).reshape(len(off), -1, 3).sum(axis=2)
    spread = float(np.square(tracks).sum()) or 1.0
    errors = float(np.sqrt(squares.max())), 100 * float(np.sqrt(squares.sum() / spread))
    return FreeBones(binding, motions, errors)


def skin_of_tree(sequence: Centred, free: FreeBones, rounds: int, told: Callable[[int], None]) -> Skin:
    """Build a tree of free bones, without those that move nothing."""
    faces = sequence.header.faces.astype(np.int64)
    binding, motions, joints = hung_bones(sequence.tracks, faces, free.binding, free.motions, rounds, told)
    used = np.isin(np.arange(len(motions)), binding.influences[binding.weights > 0])
    kept = (joints.below() & used).any(axis=1)
    place = np.cumsum(kept) - 1
    parents = joints.parents[kept]
    origin = sequence.centres[0]
    skeleton = replace(
        Skeleton.from_pivots(sequence.diagonal * joints.pivots[kept] + origin),
        parents=np.where(parents < 0, -1, place[parents]),
    )
    binding = replace(binding, influences=place[binding.influences])
    return sequence.skin(binding, motions[kept], skeleton, origin)


def _initial_labels(sequence: Centred, bones: int | ArrayLike | None) -> tuple[Index, int]:
    """Return the initial bone ``(V,)`` of every vertex, and the largest number of bones."""
    faces, vertices = sequence.header.faces.astype(np.int64), sequence.header.vertex_count
    if bones is None or isinstance(bones, int | np.integer):
        if bones is not None and not 1 <= bones <= len(faces):
            raise SettingsError(
                f"{bones} bones are asked for; a number from 1 to {len(faces)}, that of the triangles, is expected"
            )
        count = None if bones is None else int(bones)
        labels = segment(sequence.frames, Topology(faces, vertices), parts=count)
    else:
        labels, count = np.asarray(bones), None
        if labels.shape != (len(faces),) or not np.issubdtype(labels.dtype, np.integer):
            raise SegmentationError(
                f"labels of bones have shape {labels.shape} and type {labels.dtype}; "
                f"one whole number for each of the {len(faces)} triangles is expected"
            )
        labels = np.unique(labels, return_inverse=True)[1]
    return label_vertices(faces, labels, vertices), count or int(labels.max()) + 1


_OTHER_LENGTH = 1.5  # ratio of median edge lengths: another unit, or another mesh; chosen empirically
_AROUND = 0.5  # of the mesh's largest extent: found joints of few bones are up to 0.4 out of its box
_OUTSIDE = 0.25  # share of the joints: controls, which move nothing, may be anywhere
_TINY = 0.03  # share of the mesh's diagonal: smaller joints are in a larger unit
_RIGID = 4  # vertices that determine a motion
_NEARER = 1e-2, 1e-3  # cost of a distance relative to an error, at first and then
_BEFORE = 10  # rounds of motions before the first weights


def fit_to_skeleton(
    sequence: Centred,
    skeleton: Skeleton,
    bind_pose: MeshSequence | None,
    rounds: int,
    progress: Progress,
) -> Skin:
    """Fit weights and motions of a skeleton to a sequence."""
    if bind_pose is None:
        shape = sequence.points[0]
        _check_place(
            skeleton,
            shape,
            "the mesh in the first frame; give the mesh as it is bound to the skeleton (bind_pose; on the command "
            "line in the skeleton's file), or a skeleton in the pose, place and unit of the first frame",
        )
    else:
        skeleton, shape = _converted(sequence, skeleton, bind_pose)
        _check_place(
            skeleton,
            shape,
            "the bind pose; both in the same place and unit are expected, so export them together",
        )
    origin = shape.mean(axis=0)
    rest = (shape - origin) / sequence.diagonal
    pivots = (skeleton.pivots - origin) / sequence.diagonal
    joints = Joints(skeleton.parents, pivots, skeleton.parents < 0)
    tracks = sequence.tracks
    distances = bone_distances(rest, joints.pivots, joints.parents)
    binding, motions = _start(tracks, rest, joints, distances.argmin(axis=1))
    for stage, nearer in enumerate(_NEARER):

        def told(done: int, before: int = stage * rounds) -> None:
            progress(before + done, len(_NEARER) * rounds + 1, "fitting weights and bones")

        binding = replace(binding, costs=sequence.header.frame_count * (nearer * distances) ** 2)
        binding, motions, _ = alternated(tracks, binding, motions, joints, 0.0, rounds, told, held=True)
    return sequence.skin(binding, motions, skeleton, origin)


def bone_distances(points: Float, pivots: Float, parents: Index) -> Float:
    """Return the distances ``(V, B)`` of points ``(V, 3)`` from bones."""
    found = cdist(points, pivots)
    for bone, parent in enumerate(parents.tolist()):
        if parent >= 0:
            along = pivots[bone] - pivots[parent]
            found[:, parent] = np.minimum(found[:, parent], _segment_distances(points, pivots[parent], along))
            if bone not in parents:
                found[:, bone] = _segment_distances(points, pivots[bone], along)
    return np.asarray(found)


def _segment_distances(points: Float, start: Float, along: Float) -> Float:
    share = np.clip((points - start) @ along / max(float(along @ along), 1e-300), 0, 1)
    return np.asarray(np.linalg.norm(points - start - share[:, None] * along, axis=1))


def _converted(sequence: Centred, skeleton: Skeleton, bind_pose: MeshSequence) -> tuple[Skeleton, Float]:
    """Return a skeleton and its bind mesh ``(V, 3)`` in the unit and with the up axis of the sequence."""
    header = sequence.header
    if bind_pose.vertex_count != header.vertex_count:
        raise InvalidSequenceError(
            f"the bind pose has {bind_pose.vertex_count} vertices, the sequence has {header.vertex_count}; the same "
            "mesh is expected, or none, if the skeleton stands in the first frame"
        )
    conversion = UnitConversion.from_header(bind_pose.header, header.up_axis, header.metres_per_unit)
    shape = np.asarray(conversion.convert(bind_pose.points[0].astype(np.float64)), dtype=np.float64)
    _check_size(shape, sequence)
    turn = Rotation.from_matrix(conversion.rotation)
    axes = (turn * Rotation.from_quat(skeleton.axes)).as_quat()
    pivots = np.asarray(conversion.convert(skeleton.pivots), dtype=np.float64)
    return replace(skeleton, pivots=pivots, axes=axes), shape


def _check_size(shape: Float, sequence: Centred) -> None:
    """Raise an error for a bind pose whose edge lengths differ too much from those of the first frame."""
    ends = np.roll(sequence.header.faces, 1, axis=1).reshape(-1), sequence.header.faces.reshape(-1)
    lengths = [
        np.linalg.norm(points[ends[0]] - points[ends[1]], axis=1) for points in (shape, sequence.points[0])
    ]
    known = (lengths[0] > 0) & (lengths[1] > 0)
    ratios = np.log(lengths[0][known] / lengths[1][known])
    if known.any() and np.median(np.abs(ratios)) > np.log(_OTHER_LENGTH):
        raise SettingsError(
            f"edges of the bind pose are {np.exp(np.median(ratios)):.3g} times as long as those of the first frame; "
            "the same mesh with its vertices in the same order is expected, and that both tell their unit of length "
            "(metres_per_unit)"
        )


def _check_place(skeleton: Skeleton, shape: Float, expected: str) -> None:
    """Raise an error for a skeleton outside the box of its mesh, or with all joints in one spot of it."""
    margin = _AROUND * np.ptp(shape, axis=0).max()
    low, high = shape.min(axis=0) - margin, shape.max(axis=0) + margin
    outside = int(((skeleton.pivots < low) | (skeleton.pivots > high)).any(axis=1).sum())
    if outside > _OUTSIDE * skeleton.bone_count:
        raise SettingsError(f"{outside} of {skeleton.bone_count} joints are outside of {expected}")
    size = bounding_diagonal(skeleton.pivots) / (bounding_diagonal(shape) or 1.0)
    if skeleton.bone_count > 1 and size < _TINY:
        raise SettingsError(f"all joints together are {size:.2g} times as large as {expected}")


def _start(tracks: Float, rest: Float, joints: Joints, nearest: Index) -> tuple[Binding, Float]:
    """Bind every vertex to the nearest bone, and return motions with connected joints."""
    influences, weights = np.zeros((2, len(rest), INFLUENCES))
    influences[:, 0], weights[:, 0] = nearest, 1.0
    binding = Binding(rest, influences.astype(np.int64), weights, np.zeros(len(rest)))
    whole = motion_of(tracks, rest, np.arange(len(rest)))
    motions: list[Float] = []
    for bone, parent in enumerate(joints.parents.tolist()):
        own = np.flatnonzero(nearest == bone)
        above = motions[parent] if parent >= 0 else whole
        motions.append(motion_of(tracks, rest, own) if len(own) >= _RIGID else above)
    held = attached(np.stack(motions), joints)
    for _ in range(_BEFORE):
        held, _ = move(tracks, binding, held, joints, fit_pivots=False)
    return binding, held
