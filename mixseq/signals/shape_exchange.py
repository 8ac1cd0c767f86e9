r"""Apply the motion of one body to another: combine its time and pose signals with key shapes of another mesh.

The poses of `key_poses`, transferred or modelled by hand, are encoded in the shape space of the second body. Its key
shapes :math:`P'_j` (`mixseq.signals.bodies`) are blended to these vectors :math:`s'_i` by the weights of the model at
the times :math:`t_i` of the key poses:

.. math:: \sum_j \varphi_j(c(t_i))\, P'_j = s'_i

It stands as the first, up to the mean rotation A and the mean shift d between their key poses. What is left of both in
a key pose is a motion of the second body's parts in this frame,

.. math:: Q_i A, \qquad C_i + d, \qquad \text{instead of} \quad Q'_i, \quad C'_i,

and part of its shape: two bodies with other proportions bob and pitch otherwise in the same pose.
"""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from mixseq.errors import SettingsError
from mixseq.mesh.rigid import nearest_rotations
from mixseq.mesh.rotations import (
    align_quat_signs,
    matrix_to_quat,
    normalise_quat,
    quat_conjugate,
    quat_multiply,
    quat_to_matrix,
    rotate_vectors,
)
from mixseq.runtime.parallel import one_blas_thread
from mixseq.runtime.progress import log_progress
from mixseq.runtime.public import FileOr, public
from mixseq.segmentation.joints import sample_frame_ids
from mixseq.sequence.provenance import format_error, with_other_motion
from mixseq.sequence.sequence import Frames, MeshSequence, check_frames, load_frames, warn_of_loss
from mixseq.signals.bodies import Body
from mixseq.signals.detail import (
    VISUALLY_LOSSLESS_TOLERANCE,
    encode_sequence,
    find_rounding_step,
    max_norm,
    round_key_shapes,
)
from mixseq.signals.model import Model
from mixseq.spaces.making import MixedSettings, make_space
from mixseq.spaces.mixed.mixed_space import MixedSpace, as_mixed
from mixseq.spaces.temporal import Poses
from mixseq.types import Float

AXIS_ITERATIONS = 100  # number of iterations by which body axes and part axes of two bodies are matched
MIN_INDEPENDENCE = 1e-9  # least distance of a key pose from the span of the others, relative to the largest weights


@public
def key_poses(model: Model) -> MeshSequence:
    """Return the frames of a model from which all its poses are blended.

    A QR decomposition with pivoting chooses the least number of frames, as unlike as possible. Transferred to another
    body, the key poses are the input of `with_body`.

    Parameters
    ----------
    model : Model
        A model in any shape space.

    Returns
    -------
    MeshSequence
        At most one frame per key shape, at its time, without the correction of part poses.
    """
    times = key_times(model)
    vectors = np.array(model.curve(times))
    vectors[:, model.space.dim - model.space.correction_dim :] = 0.0
    with one_blas_thread():
        points = model.space.decode(vectors)
    return MeshSequence.from_header(model.header.with_times(times, model.header.fps), points)


@public
def with_body(
    model: Model, keys: FileOr[Frames], name: str, parts: ArrayLike | None = None, turn: ArrayLike | None = None
) -> Model:
    """Give a model another body, which moves by the same time and pose signals with its own key shapes.

    Operations and files keep all bodies of a model: an edit is made once and plays on all. `Model.body` puts one in
    front.

    Parameters
    ----------
    model : Model
        A model in the mixed shape space.
    keys : MeshSequence or SequenceReader
        The poses of `key_poses` on the other body, in the same order: a sequence of any mesh.
    name : str
        Name of the body, unlike `Model.body_names`.
    parts : (F',) int, optional
        Part of the model that every triangle of the keys belongs to, all parts being used. Edits of parts then play on
        the other body, too. By default, a body with the same triangles has the same parts; for others, parts are found,
        and corrections of part poses are left out.
    turn : (3, 3) array_like, optional
        Rotation from the direction that the model looks in to that of the keys; by default they look in the same one.

    Returns
    -------
    Model
        The model with the body at the end of its `bodies`.

    Raises
    ------
    SettingsError
        If there is not one frame per key pose, a body has this name, the meshes consist of another number of touching
        components, the turn is no rotation, or the space of the model has no parts.
    InvalidSequenceError
        If the keys are not a sequence.

    Warns
    -----
    MixseqWarning
        If the model's own key poses give its motion back with visible errors, or a visible correction is left out.

    Examples
    --------
    >>> import mixseq
    >>> from mixseq.creature import walk_cycle
    >>> from mixseq.operations import key_poses, with_body
    >>> model = mixseq.fit(walk_cycle(frames=6), exact=True)
    >>> keys = key_poses(model)
    >>> tall = mixseq.MeshSequence.from_arrays(keys.points * [1.0, 1.5, 1.0], keys.faces, fps=1.0)
    >>> herd = with_body(model, tall, "tall fox")
    >>> herd.body("tall fox").sample().frame_count
    6
    """
    body = make_body(model, cast("Frames", keys), name, parts, np.eye(3) if turn is None else turn)
    own = make_body(model, key_poses(model), name, None, np.eye(3))
    times = model.times[sample_frame_ids(len(model.times))]
    pairs = zip(model.alone_as(own).blocks(times), model.blocks(times), strict=True)
    gap = max(float(np.linalg.norm(a - b, axis=2).max()) for a, b in pairs) / model.space.scale
    if gap > VISUALLY_LOSSLESS_TOLERANCE:
        text = f"its own key poses give the motion back within {format_error(gap)} diagonals"
        warn_of_loss(model.header, text, "fit it more accurately")
    return replace(model, bodies=(*model.bodies, body))


def make_body(model: Model, keys: Frames, name: str, parts: ArrayLike | None, turn: ArrayLike) -> Body:
    """Return the body of `with_body` without a warning of inaccurate motion, as its keys may be all frames."""
    first, turn = as_mixed(model.space), np.asarray(turn, dtype=np.float64)
    if turn.shape != (3, 3) or not np.allclose(turn @ turn.T, np.eye(3)) or np.linalg.det(turn) < 0:
        raise SettingsError("the turn is no rotation; a matrix (3, 3) with orthogonal columns of length 1 is expected")
    check_frames(keys)
    count = keys.header.frame_count
    times = key_times(model)
    if count != len(times):
        raise SettingsError(
            f"{keys.header.name!r} has {count} frames; {len(times)} are expected, one per key pose of "
            f"{model.header.name!r}: transfer the poses that key_poses makes"
        )
    frames = load_frames(keys, log_progress)
    has_same_faces = np.array_equal(keys.header.faces, model.header.faces)
    labels = model.parts if parts is None and has_same_faces else parts
    space = as_mixed(make_space(frames, settings=MixedSettings(parts=labels)))
    cut, part_count = space.decomposition, len(first.decomposition.parts)
    corresponds = labels is not None and len(cut.parts) == part_count and np.array_equal(cut.part_of_face, labels)
    if corresponds and has_same_faces:
        shared = {name: getattr(first, name) for name in ("steadiness", "skinning_weights", "joint_faces")}
        space = replace(space, **shared)
    if first.rotation_count != space.rotation_count:
        raise SettingsError(
            f"{model.header.name!r} has {first.rotation_count} bodies, {name!r} has {space.rotation_count}; "
            "both need the same number"
        )
    encoded = encode_sequence(frames, space)
    shapes, placed = np.asarray(encoded.shapes[:]), space.unpack_placements(encoded.placement)
    weights = model.pose.weights(model.time(times))
    part_rotations = _part_rotations(first, weights @ model.shapes)
    if corresponds:
        shapes, placed = _match_body_axes(part_rotations, space, shapes, placed)
    before = first.unpack_placements(model.placement(times))
    before = Poses(normalise_quat(before.rotations), before.centres)
    body = Body(keys.header, space, shapes, matrix_to_quat(turn), *_mean_motion(turn, before, placed))
    shapes = _change_body_axes(space, shapes, _relative_poses(placed, body.place(before)))
    turns = _part_turns(part_rotations, space, shapes) if corresponds else None
    shapes = np.asarray(np.linalg.lstsq(weights, shapes)[0], dtype=np.float64)
    round_key_shapes(shapes, space, find_rounding_step(model.shapes, first))
    if turns is None:
        correction_weights = first.weights[first.shape_dim + first.placement_dim :]
        loss = float(max_norm(correction_weights)(model.correction.values).max(initial=0.0))
        if loss > VISUALLY_LOSSLESS_TOLERANCE:
            text = f"corrections of part poses, up to {format_error(loss)} diagonals, are left out"
            warn_of_loss(model.header, text, "a body with the same triangles, or parts, keeps them")
    header = replace(keys.header, name=name, provenance=with_other_motion(keys.header.provenance), keys=None)
    return replace(body, header=header, shapes=shapes, part_turns=turns)


def _part_rotations(space: MixedSpace, shapes: Float) -> Float:
    """Return rotations ``(K, p, 3, 3)`` of parts in body axes in key shapes ``(K, S)``."""
    poses = space.split_poses(shapes[:, space.shape_dim - space.pose_dim :])
    return quat_to_matrix(normalise_quat(poses.rotations))


def _match_body_axes(before: Float, space: MixedSpace, shapes: Float, placed: Poses) -> tuple[Float, Poses]:
    """Turn the body axes of shapes ``(K, S)`` and their body poses ``(K, B)`` to those of another body.

    Blends depend on body axes, which follow from the reference. Turns D of bodies, and C of the axes of parts, minimise
    the distances of D R' and R C, for part rotations R ``(K, p, 3, 3)`` of the other body and R' of the shapes.
    """
    articulation = space.articulation
    turned = after = _part_rotations(space, shapes)
    for _ in range(AXIS_ITERATIONS):
        part_turns = nearest_rotations((before.swapaxes(-1, -2) @ turned).sum(axis=0))
        body_turns = nearest_rotations(articulation.body_sums(before @ part_turns @ after.swapaxes(-1, -2)))
        turned = body_turns[:, articulation.body_of_part] @ after
    back = quat_conjugate(matrix_to_quat(body_turns))
    axes = Poses(back, np.zeros((*back.shape[:2], 3)))
    return _change_body_axes(space, shapes, axes), Poses(quat_multiply(placed.rotations, back), placed.centres)


def _relative_poses(bodies: Poses, others: Poses) -> Poses:
    """Return other poses ``(K, B)`` in the axes of bodies ``(K, B)``."""
    back = quat_conjugate(normalise_quat(bodies.rotations))
    offsets = others.centres - bodies.centres
    return Poses(quat_multiply(back, others.rotations), rotate_vectors(quat_to_matrix(back), offsets))


def _change_body_axes(space: MixedSpace, shapes: Float, axes: Poses) -> Float:
    """Return key shapes ``(K, S)`` with part poses in other axes ``(K, B)`` of their bodies; only numbers change."""
    start = space.shape_dim - space.pose_dim
    poses = space.split_poses(shapes[:, start:])
    rotations, centres = space.articulation.to_body_axes(Poses(poses.rotations, poses.centres), axes)
    blocks = poses._replace(rotations=align_quat_signs(rotations), centres=centres)
    return np.concatenate([shapes[:, :start], *(block.reshape(len(shapes), -1) for block in blocks)], axis=1)


def _part_turns(before: Float, space: MixedSpace, shapes: Float) -> Float:
    """Return the mean rotations ``(p, 3, 3)`` from axes of parts turned by ``(K, p, 3, 3)`` to those of shapes."""
    return nearest_rotations((before.swapaxes(-1, -2) @ _part_rotations(space, shapes)).sum(axis=0))


def key_times(model: Model) -> Float:
    """Return the times of the key poses: frames, or knots of the time signal if frames lack some of its poses."""
    chosen = []
    for times in (model.times, model.time.times):
        triangle, pivots = linalg.qr(model.pose.weights(model.time(times)).T, mode="r", pivoting=True)
        lengths = np.abs(triangle.diagonal())
        chosen.append(np.sort(times[pivots[: np.count_nonzero(lengths > MIN_INDEPENDENCE * lengths[0])]]))
    return max(chosen, key=len)


def _mean_motion(turn: Float, before: Poses, after: Poses) -> tuple[Float, Float]:
    """Return the mean rotations ``(B, 4)`` and shifts ``(B, 3)`` from body poses ``(K, B)``, once turned, to others."""
    first, second = turn @ quat_to_matrix(before.rotations), quat_to_matrix(normalise_quat(after.rotations))
    rotations = matrix_to_quat(nearest_rotations((first.swapaxes(-1, -2) @ second).sum(axis=0)))
    return rotations, (after.centres - before.centres @ turn.T).mean(axis=0)
