"""Exchange a key shape: everything that is blended from it follows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import SettingsError
from mixseq.operations.edited import edited_difference
from mixseq.sequence import MeshSequence
from mixseq.signals.model import Model


def swap_key(model: Model, key: int, points: ArrayLike | MeshSequence) -> Model:
    """Put an edited mesh in the place of a key shape.

    For models whose key shapes are frames, ``mixseq.fit(sequence, pose="keys")``: an artist takes the frame of a key,
    reworks it, and the whole sequence follows, as much as the key is part of every frame. The residual layer is kept.

    Parameters
    ----------
    model : Model
        The motion.
    key : int
        Number of the key shape, from 0 on. `Model.key_frames` tells its frame.
    points : (V, 3) array_like or MeshSequence of one frame
        That frame with vertices moved, in the units of the sequence. Vertices that were not moved stay where they are.

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
