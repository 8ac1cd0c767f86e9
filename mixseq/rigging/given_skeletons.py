"""Fit a given skeleton: its joints and the bound mesh keep their rest positions.

A vertex starts with the nearest bone in the bind pose. Bone b is the segments from its joint to those of its children;
one without children extends the direction of the one above. Bones start with the best rigid motions of their vertices,
those without vertices follow the bone above; then joints connect them, and weights and motions are fitted in turn
(`mixseq.rigging.decomposition`). Of bones that move alike a vertex follows the nearest: a weight :math:`w_{vb}` costs
:math:`w_{vb} (10^{-3} d_{vb})^2` of a squared error, at the distance :math:`d_{vb}`. At first the cost is a hundred
times larger: else bones with unknown motions lose their vertices to others that happen to move like them, and never
get them back. Bones that move nothing keep their rest pose relative to the one above.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from mixseq.arrays import Float, Index
from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.progress import Progress
from mixseq.rigging.bones import motion_of
from mixseq.rigging.centred import Centred
from mixseq.rigging.decomposition import alternated
from mixseq.rigging.jointed_motions import Joints, attached, move
from mixseq.rigging.rigs import INFLUENCES, Skin
from mixseq.rigging.skeletons import Skeleton
from mixseq.rigging.weights import Binding
from mixseq.sequence import MeshSequence, bounding_diagonal
from mixseq.unit_conversion import UnitConversion

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
    conversion = UnitConversion.of(bind_pose.header, header.up_axis, header.metres_per_unit)
    shape = np.asarray(conversion.values(bind_pose.points[0].astype(np.float64)), dtype=np.float64)
    _check_size(shape, sequence)
    turn = Rotation.from_matrix(conversion.turn)
    axes = (turn * Rotation.from_quat(skeleton.axes)).as_quat()
    pivots = np.asarray(conversion.values(skeleton.pivots), dtype=np.float64)
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
