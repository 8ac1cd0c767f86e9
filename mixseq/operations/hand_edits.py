"""Frames edited by hand: validation, the difference to the model, and replaced key shapes."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.arrays import Float
from mixseq.errors import InvalidSequenceError, MixseqWarning, SettingsError
from mixseq.polygon_matching import difference
from mixseq.polygons import Polygons
from mixseq.public import public
from mixseq.sequence import MeshSequence, SequenceHeader, bounding_diagonal
from mixseq.signals.model import Model

MOVED, MOST = 1e-3, 0.9
"""Displacement of moved vertices, in diagonals, and their largest share in an edit without a warning."""


def edited_difference(model: Model, time: float, points: ArrayLike | MeshSequence) -> tuple[Model, Float]:
    """Return the model in a space that can represent the edit ``(V, 3)``, and its key shape difference ``(S,)``."""
    edited, before = checked_points(points, model.header), model(time)
    space, carry = model.space.with_shape(edited - before)
    model = replace(model, space=space, shapes=carry(model.shapes))
    _doubt(before, edited, time)
    return model, space.shape_difference(model.curve([time])[0], before, edited)


@public
def swap_key(model: Model, key: int, points: ArrayLike | MeshSequence) -> Model:
    """Put an edited mesh in the place of a key shape.

    For models whose key shapes are frames, ``mixseq.fit(sequence, pose="keys")``: the whole sequence follows the edit,
    in proportion to the weight of the key in every frame. The residual layer is kept.

    Parameters
    ----------
    model : Model
        The motion.
    key : int
        Number of the key shape, from 0 on, see `Model.key_frames`.
    points : (V, 3) array_like or MeshSequence of one frame
        That frame with vertices moved, in the units of the sequence.

    Raises
    ------
    SettingsError
        If there is no such key shape, or it is no frame of the model.
    InvalidSequenceError
        If the points are not those of the mesh, or not finite.
    """
    if not 0 <= key < len(model.shapes):
        raise SettingsError(f"key is {key}; the model has key shapes 0 to {len(model.shapes) - 1}")
    frame = int(model.key_frames[key])
    if frame < 0:
        raise SettingsError(
            f"key shape {key} is no frame of the model; fit one with pose='keys', or sculpt a frame instead"
        )
    time = float(model.times[frame])
    model, difference = edited_difference(model, time, points)
    shapes = np.array(model.shapes)
    shapes[key] += difference
    return replace(model, shapes=shapes)


def checked_points(points: ArrayLike | MeshSequence, header: SequenceHeader) -> Float:
    """Validate an edited frame of the mesh and return its points ``(V, 3)``."""
    if isinstance(points, MeshSequence):
        if points.frame_count != 1:
            raise SettingsError(f"the edited mesh has {points.frame_count} frames; one is expected")
        if points.vertex_count == header.vertex_count and not _same_surface(points.polygons, header.polygons):
            what = difference(points.polygons, header.polygons, ("the edited mesh", "the model"))
            raise InvalidSequenceError(
                f"the edited mesh has other edges than the model, {what}: vertices must keep their order; look for "
                "such a setting in the program that wrote it"
            )
        points = points.points[0]
    edited = np.asarray(points, dtype=np.float64)
    if edited.shape != (header.vertex_count, 3):
        raise InvalidSequenceError(
            f"the edited points have shape {edited.shape}; ({header.vertex_count}, 3) is expected: move the vertices "
            "of the decoded frame, but add none, take none away and keep their order"
        )
    if not np.isfinite(edited).all():
        vertex = int(np.flatnonzero(~np.isfinite(edited).all(axis=1))[0])
        raise InvalidSequenceError(f"vertex {vertex} of the edited points is not finite")
    return edited


def _doubt(before: Float, edited: Float, time: float) -> None:
    """Warn if most vertices were moved."""
    apart = np.linalg.norm(edited - before, axis=1) / (bounding_diagonal(before) or 1.0)
    moved = int(np.count_nonzero(apart > MOVED))
    if moved > MOST * len(edited):
        warnings.warn(
            f"{moved:,} of {len(edited):,} vertices moved, by up to {apart.max():.2g} diagonals; is the mesh the frame "
            f"at {time:g} s, in the axes and units of the model?",
            MixseqWarning,
            stacklevel=5,
        )


def _same_surface(one: Polygons, other: Polygons) -> bool:
    """Whether polygons have the same edges, except for diagonals where one of them is triangulated."""
    whole, cut = ({tuple(side) for side in _sides(polygons).tolist()} for polygons in (one, other))
    return whole <= cut or cut <= whole


def _sides(polygons: Polygons) -> NDArray[np.int64]:
    """Return the sides of polygons ``(E, 2)``, smaller vertex first."""
    ends = np.cumsum(polygons.counts)
    following = np.arange(1, len(polygons.indices) + 1)
    following[ends - 1] = ends - polygons.counts
    pairs = np.stack([polygons.indices, polygons.indices[following]], axis=1)
    return np.unique(np.sort(pairs, axis=1), axis=0).astype(np.int64)
