"""Arrays of skins and morphs for files: four bone weights, scaled targets, names, and steadied values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, Index
from mixseq.rigging.rigs import Morph, Skin

_ROUNDING = 4 * float(np.finfo(np.float32).eps)
"""Motion below this fraction of the largest number counts as rounding."""


def four_influences(skin: Skin) -> tuple[Index, NDArray[np.float32]]:
    """Return four bones and float32 weights ``(V, 4)`` per vertex, for engines.

    Bones of a vertex are distinct, the largest weight first, bones without weight are 0, and weights sum to 1.
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
    r"""Return a rig's shape before bones, with weights scaled to 0 to 1, the range of sliders.

    Blender and Unity clip smaller weights to 0. With the least and the largest weight of every target over the frames,

    .. math:: x + \sum_m w_{tm} d_m = \Bigl( x + \sum_m w^-_m d_m \Bigr)
              + \sum_m \frac{w_{tm} - w^-_m}{w^+_m - w^-_m} (w^+_m - w^-_m) d_m .

    Targets of constant weight move into the base.
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
    """Return numbered names that sort by number: "bone_00", "bone_01"."""
    width = max(2, len(str(count - 1)))
    return [f"{word}_{number:0{width}d}" for number in range(count)]


def steadied(values: Float, unit: float) -> Float:
    """Return values ``(T, n, k)`` with those of bones that only move by rounding set to the first frame's."""
    largest = max(unit, float(np.abs(values).max(initial=0.0)))
    moved = np.abs(values - values[:1]).max(axis=(0, 2), keepdims=True)
    return np.where(moved <= _ROUNDING * largest, values[:1], values)
