r"""Room for edits: a compressed sequence has only the shapes of its basis, until an edit adds fields to it.

A displacement :math:`\Delta(v)` that is not in the span of the fields is made of three more, its coordinates:
:math:`\Delta(v) = \Delta_x(v)\, e_x + \Delta_y(v)\, e_y + \Delta_z(v)\, e_z`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from mixseq.operations.edited import checked_points
from mixseq.sequence import MeshSequence
from mixseq.signals.model import Model
from mixseq.spaces.basis import BasisSpace
from mixseq.threads import one_blas_thread

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


def joined(first: Model, second: Model) -> tuple[Model, Model]:
    """Return two motions of one mesh, both in basis spaces, in one space that has the shapes of both.

    Its fields are an orthonormal basis of the fields of both.
    """
    a, b = first.space, second.space
    assert isinstance(a, BasisSpace)
    assert isinstance(b, BasisSpace)
    fields = np.concatenate([a.fields / np.linalg.norm(a.fields, axis=1, keepdims=True), b.fields])
    fields[len(a.fields) :] /= np.linalg.norm(b.fields, axis=1, keepdims=True)
    with one_blas_thread():
        orthonormal, triangle, _ = linalg.qr(fields.T, mode="economic", pivoting=True)
        rank = int(np.count_nonzero(np.abs(np.diagonal(triangle)) > NEGLIGIBLE))
        space = BasisSpace(orthonormal.T[:rank], a.scale)
        return _moved(first, a, space), _moved(second, b, space)


def _moved(model: Model, old: BasisSpace, new: BasisSpace) -> Model:
    """Put a model into a space whose fields are orthonormal, and span those of its own."""
    change = (new.fields @ old.fields.T) * (old.scale / new.scale)
    cubes = model.shapes.reshape(len(model.shapes), -1, 3)
    shapes = np.einsum("nk,jki->jni", change, cubes).reshape(len(cubes), -1)
    return replace(model, space=new, shapes=shapes)
