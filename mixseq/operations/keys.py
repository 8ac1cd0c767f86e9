"""Exchange a key shape: everything that is blended from it follows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.signals.model import Model


def swap_key(model: Model, key: int, points: ArrayLike) -> Model:
    """Put another mesh in the place of a key shape.

    Meant for models whose key shapes are frames, ``mixseq.fit(sequence, pose="keys")``: an artist takes one of them,
    reworks it, and the whole sequence follows, as much as the key is part of every frame.

    Parameters
    ----------
    model : Model
        The motion.
    key : int
        Number of the key shape, from 0 on.
    points : (V, 3) array_like
        The new key shape, in the units of the sequence. Where it stands does not matter: placement is no part of a
        key shape.

    Raises
    ------
    SettingsError
        If there is no such key shape.
    InvalidSequenceError
        If the points are not those of the mesh, or not finite.
    """
    if not 0 <= key < len(model.shapes):
        raise SettingsError(f"key is {key}; the model has key shapes 0 to {len(model.shapes) - 1}")
    x = np.asarray(points, dtype=np.float64)
    if x.shape != (model.header.vertex_count, 3):
        raise InvalidSequenceError(
            f"the new key shape has points of shape {x.shape}; ({model.header.vertex_count}, 3) is expected"
        )
    if not np.isfinite(x).all():
        vertex = int(np.argmin(np.isfinite(x).all(axis=1)))
        raise InvalidSequenceError(f"vertex {vertex} of the new key shape is not finite")
    space, size = model.space, model.shape_dim
    placement = model.curve([model.start])[0, size:]
    before = np.concatenate([model.shapes[key, :size], placement])  # angles go on from those of the old key
    vector = space.encode(x[None], before)
    offsets = space.offsets(x[None], vector)
    shapes = np.array(model.shapes)
    shapes[key] = np.concatenate([vector[0, :size], offsets[0]])
    return replace(model, shapes=shapes)
