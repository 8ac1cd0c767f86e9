r"""Apply the motion of one body to another: combine its time and pose signals with key shapes of another mesh.

.. math:: s(t) = \sum_j \varphi_j(c(t))\, P_j

The weights :math:`\varphi_j(c(t))` are independent of the mesh. With key shapes :math:`P_j` of a second body, encoded
in its own shape space, the same signals move the second body. Its key shapes are the poses of `key_poses`, transferred
or modelled by hand. The second body follows the path of the first, scaled to its size:

.. math:: Q'(t) = Q(t)\, A, \qquad C'(t) = C(t) + \bar d,

each in diagonals of its mesh, with the mean rotation A and the mean shift :math:`\bar d` between their key poses.
"""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np

from mixseq.errors import SettingsError
from mixseq.mesh.rigid import nearest_rotations
from mixseq.mesh.rotations import (
    align_quat_signs,
    matrix_to_quat,
    normalise_quat,
    quat_conjugate,
    quat_multiply,
    quat_to_matrix,
)
from mixseq.operations.sections import correction_norm
from mixseq.runtime.parallel import one_blas_thread
from mixseq.runtime.progress import log_progress
from mixseq.runtime.public import FileOr, public
from mixseq.segmentation.joints import sample_frame_ids
from mixseq.sequence.provenance import format_error, with_other_motion
from mixseq.sequence.sequence import Frames, MeshSequence, check_frames, load_frames, own_parts, warn_of_loss
from mixseq.signals.curve import Curve
from mixseq.signals.detail import VISUALLY_LOSSLESS_TOLERANCE, encode_sequence
from mixseq.signals.model import Model
from mixseq.spaces.making import MixedSettings, make_space
from mixseq.spaces.mixed.mixed_space import MixedSpace, as_mixed
from mixseq.spaces.temporal import Poses
from mixseq.types import Float

AXIS_ITERATIONS = 100
"""Number of iterations by which body axes and part axes of two bodies are matched."""


@public
def key_poses(model: Model) -> MeshSequence:
    """Return the key shapes of a model as a sequence of meshes, one frame each.

    A key shape that is a frame (``mixseq.fit(sequence, pose="keys")``) has the placement of that frame; any other has
    the placement of the first frame. Transferred to another body, the key poses are the input of `with_shapes`.

    Parameters
    ----------
    model : Model
        A model in any shape space.

    Returns
    -------
    MeshSequence
        K frames, one second apart.
    """
    times = np.arange(len(model.shapes), dtype=np.float64)
    corrections = np.zeros((len(times), model.space.correction_dim))
    vectors = np.concatenate([model.shapes, model.placement(_key_times(model)), corrections], axis=1)
    with one_blas_thread():
        return MeshSequence.from_header(model.header.with_times(times, 1.0), model.space.decode(vectors))


@public
def with_shapes(model: Model, keys: FileOr[Frames | Model]) -> Model:
    """Apply the motion of a model to another body, with the same time and pose signals and other key shapes.

    A body with the same triangles gets the same parts, and the correction in its axes; for others it is left out.

    Parameters
    ----------
    model : Model
        A model in the mixed shape space.
    keys : MeshSequence, SequenceReader or Model
        The poses of `key_poses` on the other body, in the same order: a sequence of any mesh, one frame per key shape.
        Alternatively, a model of the other body that `with_shapes` made with the same pose signal.

    Returns
    -------
    Model
        Model in a shape space of the other mesh, with the times of `model`.

    Raises
    ------
    SettingsError
        If there is not one frame per key shape, the other model has a different pose signal, or a space has no parts.
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
    >>> from mixseq.operations import key_poses, with_shapes
    >>> model = mixseq.fit(walk_cycle(frames=6), rank=5, pose="keys")
    >>> keys = key_poses(model)
    >>> tall = mixseq.MeshSequence.from_arrays(keys.points * [1.0, 1.5, 1.0], keys.faces, fps=1.0)
    >>> with_shapes(model, tall).sample().frame_count
    6
    """
    keys = cast("Frames | Model", keys)
    played = _exchange_shapes(model, keys)
    if not isinstance(keys, Model):
        own, times = _exchange_shapes(model, key_poses(model)), model.times[sample_frame_ids(len(model.times))]
        pairs = zip(own.blocks(times), model.blocks(times), strict=True)
        gap = max(float(np.linalg.norm(a - b, axis=2).max()) for a, b in pairs) / model.space.scale
        if gap > VISUALLY_LOSSLESS_TOLERANCE:
            text = f"its own key poses give the motion back within {format_error(gap)} diagonals"
            warn_of_loss(model.header, text, "fit it with pose='keys' and a larger rank")
    return played


def _exchange_shapes(model: Model, keys: Frames | Model) -> Model:
    """Do what `with_shapes` does, without a warning of inaccurate motion."""
    first = as_mixed(model.space)
    if isinstance(keys, Model):
        if keys.pose.identity != model.pose.identity:
            raise SettingsError(
                f"{keys.header.name!r} has key shapes of another pose signal than {model.header.name!r}; give one that "
                "with_shapes or mixseq transfer --as-model made of this model, or of one edited from it"
            )
        second, shapes, placements = as_mixed(keys.space), keys.shapes, keys.placement(_key_times(keys))
        header = keys.header
    else:
        check_frames(keys)
        count = keys.header.frame_count
        if count != len(model.shapes):
            raise SettingsError(
                f"{keys.header.name!r} has {count} frames; {len(model.shapes)} are expected, one per key shape of "
                f"{model.header.name!r}: transfer the poses that key_poses makes"
            )
        frames = load_frames(keys, log_progress)
        parts = model.parts if np.array_equal(keys.header.faces, model.header.faces) else own_parts(keys)
        second = as_mixed(make_space(frames, settings=MixedSettings(parts=parts)))
        if _has_same_parts(first, second):
            second = replace(
                second,
                steadiness=first.steadiness,
                skinning_weights=first.skinning_weights,
                joint_faces=first.joint_faces,
            )
        encoded = encode_sequence(frames, second)
        shapes, placements, header = np.asarray(encoded.shapes[:]), encoded.placement, keys.header
        if _has_same_parts(first, second):
            shapes, placements = _match_body_axes(model, second, shapes, placements)
    if first.rotation_count != second.rotation_count:
        raise SettingsError(
            f"{model.header.name!r} has {first.rotation_count} bodies, {header.name!r} has {second.rotation_count}; "
            "both need the same number"
        )
    before = first.unpack_placements(model.placement(_key_times(model)))
    rotation, shift = _mean_motion(before, second.unpack_placements(placements))
    poses = first.unpack_placements(model.placement.values)
    rotations = quat_multiply(normalise_quat(poses.rotations), rotation)
    moved_poses = Poses(align_quat_signs(rotations), poses.centres + shift)
    provenance = with_other_motion(header.provenance)
    played = Model(
        replace(header, times=model.header.times, fps=model.header.fps, provenance=provenance, keys=None),
        second,
        model.time,
        model.pose,
        shapes,
        Curve(model.placement.times, second.pack_placements(moved_poses)),
    )
    correction = _turn_correction(model, second, shapes, rotation)
    return played if correction is None else replace(played, correction=correction)


def _has_same_parts(first: MixedSpace, second: MixedSpace) -> bool:
    """Return whether two spaces have the same triangles and parts."""
    return np.array_equal(first.topology.faces, second.topology.faces) and np.array_equal(
        first.segmentation.part_of_face, second.segmentation.part_of_face
    )


def _part_rotations(space: MixedSpace, shapes: Float) -> Float:
    """Return rotations ``(K, p, 3, 3)`` of parts in body axes in key shapes ``(K, S)``."""
    poses = space.split_poses(shapes[:, space.shape_dim - space.pose_dim :])
    return quat_to_matrix(normalise_quat(poses.rotations))


def _match_body_axes(model: Model, space: MixedSpace, shapes: Float, placements: Float) -> tuple[Float, Float]:
    """Turn the body axes of key shapes ``(K, S)`` and their placements ``(K, P)`` to those of a model's key shapes.

    Blends depend on body axes, which follow from the reference. Turns D of bodies, and C of the axes of parts, minimise
    the distances of D R' and R C, for part rotations R of the model and R' of the key shapes.
    """
    articulation = space.articulation
    before, after = _part_rotations(as_mixed(model.space), model.shapes), _part_rotations(space, shapes)
    turned = after
    for _ in range(AXIS_ITERATIONS):
        part_turns = nearest_rotations((before.swapaxes(-1, -2) @ turned).sum(axis=0))
        body_turns = nearest_rotations(articulation.body_sums(before @ part_turns @ after.swapaxes(-1, -2)))
        turned = body_turns[:, articulation.body_of_part] @ after
    back = quat_conjugate(matrix_to_quat(body_turns))
    poses = space.split_poses(shapes[:, space.shape_dim - space.pose_dim :])
    axes = Poses(back, np.zeros((*back.shape[:2], 3)))
    rotations, centres = articulation.to_body_axes(Poses(poses.rotations, poses.centres), axes)
    blocks = poses._replace(rotations=rotations, centres=centres)
    columns = [shapes[:, : space.shape_dim - space.pose_dim], *(block.reshape(len(shapes), -1) for block in blocks)]
    bodies = space.unpack_placements(placements)
    return np.concatenate(columns, axis=1), space.pack_placements(
        Poses(quat_multiply(bodies.rotations, back), bodies.centres)
    )


def _turn_correction(model: Model, space: MixedSpace, shapes: Float, rotation: Float) -> Curve | None:
    """Return the correction of a model for the same parts of another body, in its axes; None for other parts.

    The second body has key shapes ``(K, S)``; its bodies are turned by rotations ``(B, 4)`` relative to the first.
    """
    first = as_mixed(model.space)
    if not _has_same_parts(first, space):
        loss = float(correction_norm(model)(model.correction.values).max(initial=0.0))
        if loss > VISUALLY_LOSSLESS_TOLERANCE:
            text = f"corrections of part poses, up to {format_error(loss)} diagonals, are left out"
            warn_of_loss(model.header, text, "a body with the same triangles has the same parts and keeps them")
        return None
    before, after = _part_rotations(first, model.shapes), _part_rotations(space, shapes)
    turns = nearest_rotations((before.swapaxes(-1, -2) @ after).sum(axis=0))
    bodies = quat_to_matrix(rotation)[first.articulation.body_of_part]
    vectors = model.correction.values.reshape(-1, 2, len(turns), 3)
    turned = np.einsum("rpij,mrpi->mrpj", np.stack([turns, bodies]), vectors)
    return Curve(model.correction.times, turned.reshape(len(vectors), -1))


def _key_times(model: Model) -> Float:
    """Return the times ``(K,)`` of key shapes; a key shape that is not a frame gets the time of the first frame."""
    frames = model.key_frames
    return np.where(frames >= 0, model.times[frames], model.times[0])


def _mean_motion(before: Poses, after: Poses) -> tuple[Float, Float]:
    """Return the mean rotations ``(B, 4)`` and shifts ``(B, 3)`` between two sets of body poses ``(K, B)``."""
    a, b = (normalise_quat(poses.rotations) for poses in (before, after))
    turns = quat_to_matrix(quat_multiply(quat_conjugate(a), b))
    return matrix_to_quat(nearest_rotations(turns.sum(axis=0))), (after.centres - before.centres).mean(axis=0)
