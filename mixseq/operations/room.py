r"""Room for edits: a compressed sequence has only the shapes of its basis, until an edit adds fields to it.

A displacement :math:`\Delta(v)` that is not in the span of the fields is made of three more, its coordinates:
:math:`\Delta(v) = \Delta_x(v)\, e_x + \Delta_y(v)\, e_y + \Delta_z(v)\, e_z`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.operations.edited import checked_points
from mixseq.sequence import MeshSequence
from mixseq.signals.model import Model
from mixseq.spaces.basis import BasisSpace

Float = NDArray[np.float64]

NEGLIGIBLE = 1e-9
"""Fields are added unless they are below this share of the displacement: rounding errors."""


def with_room(model: Model, time: float, points: ArrayLike | MeshSequence) -> Model:
    """Return the same motion in a space that has the edit of a frame.

    Parameters
    ----------
    model : Model
        The motion; all spaces but the basis space have room for everything.
    time : float
        Time of the frame in seconds.
    points : (V, 3) array_like or MeshSequence of one frame
        The edited mesh.

    Raises
    ------
    InvalidSequenceError
        If the points are not those of the mesh, or not finite.
    """
    space = model.space
    if not isinstance(space, BasisSpace):
        return model
    moved = checked_points(points, model.header) - model(time)
    rest = moved - space.decode(space.encode(moved[None]))[0]
    norms = np.linalg.norm(rest, axis=0)
    new = (rest / np.where(norms > 0, norms, 1.0)).T[norms > NEGLIGIBLE * np.linalg.norm(moved)]
    wider = BasisSpace(np.concatenate([space.fields, new]), space.scale)
    shapes = np.pad(model.shapes, [(0, 0), (0, 3 * len(new))])
    return replace(model, space=wider, shapes=shapes)
