"""What files of skins and morphs have in common: weights of bones, scaled targets, names, and what stands still."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, Index
from mixseq.rigging.rigs import Morph, Skin

_ROUNDING = 4 * float(np.finfo(np.float32).eps)
"""Of the largest number: what moves less is rounding; ours."""


def four_influences(skin: Skin) -> tuple[Index, NDArray[np.float32]]:
    """Return bones and weights ``(V, 4)`` as engines want them.

    Every bone of a vertex occurs once, the largest weight comes first, bones without weight are number 0, and the
    weights add to one in float32.
    """
    bones = skin.influences.copy()
    weights = skin.weights.copy()
    for column in range(1, bones.shape[1]):
        for earlier in range(column):
            again = bones[:, column] == bones[:, earlier]
            weights[again, earlier] += weights[again, column]
            weights[again, column] = 0.0
    order = np.argsort(-weights, axis=1, kind="stable")
    bones = np.take_along_axis(bones, order, axis=1)
    rounded = np.take_along_axis(weights, order, axis=1).astype(np.float32)
    rounded[:, 0] = 1 - rounded[:, 1:].astype(np.float64).sum(axis=1)
    return np.where(rounded > 0, bones, 0), rounded


def shape_of(rig: Skin | Morph) -> Morph:
    r"""Return what a rig has before bones move it, with weights from 0 to 1.

    That is where programs have sliders; Blender and Unity take what is less for 0. With the least and the largest
    weight of every target, over the frames, it is the same shape:

    .. math:: x + \sum_m w_{tm} d_m = \Bigl( x + \sum_m w^-_m d_m \Bigr)
              + \sum_m \frac{w_{tm} - w^-_m}{w^+_m - w^-_m} (w^+_m - w^-_m) d_m .

    Targets whose weight never changes are in the base then.
    """
    shape = rig if isinstance(rig, Morph) else Morph(rig.header, rig.rest, rig.targets, rig.target_weights)
    if not len(shape.targets):
        return shape
    least = shape.weights.min(axis=0)
    spread = shape.weights.max(axis=0) - least
    used = spread > 0
    return replace(
        shape,
        base=shape.base + np.einsum("m,mvi->vi", least, shape.targets),
        targets=shape.targets[used] * spread[used, None, None],
        weights=(shape.weights[:, used] - least[used]) / spread[used],
    )


def numbered_names(word: str, count: int) -> list[str]:
    """Return names that sort as their numbers do.

    Examples
    --------
    >>> numbered_names("bone", 2), numbered_names("mode", 101)[-1]
    (['bone_00', 'bone_01'], 'mode_100')
    """
    width = max(2, len(str(count - 1)))
    return [f"{word}_{number:0{width}d}" for number in range(count)]


def steadied(values: Float, unit: float) -> Float:
    """Return values ``(T, n, k)`` of which those of a bone that only move by rounding are those of the first frame.

    Examples
    --------
    >>> moved = np.array([[[1.0], [2.0]], [[1.0 + 1e-12], [3.0]]])
    >>> steadied(moved, 1.0)[1].tolist()
    [[1.0], [3.0]]
    """
    largest = max(unit, float(np.abs(values).max(initial=0.0)))
    moved = np.abs(values - values[:1]).max(axis=(0, 2), keepdims=True)
    return np.where(moved <= _ROUNDING * largest, values[:1], values)
