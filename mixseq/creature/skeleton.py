"""The fox as a table: bones, and the tapered flesh around them.

In its rest pose the fox stands on the plane ``y = 0``, faces ``+x``, and has its right side at ``+z``, in metres. A
row with a ``z`` of its own is the right one of a pair; the left one is its mirror.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from mixseq.arrays import Float

Vec3 = tuple[float, float, float]


@dataclass(frozen=True)
class Bone:
    """A bone and its flesh, the hull of a ball at its head and a ball at its tail; lengths in metres.

    Parents (empty for the root) come first in the table. `head` and `tail` (3,) are joint and far end at rest. `fillet`
    is the width of the blend with earlier bones, which thickens the body by up to a quarter of that.
    """

    name: str
    parent: str
    head: Vec3
    tail: Vec3
    head_radius: float
    tail_radius: float
    fillet: float


def _pairs(rows: Iterable[Bone]) -> tuple[Bone, ...]:
    """Mirror every right bone; name the pair ``name.r`` and ``name.l``."""
    bones: list[Bone] = []
    paired: set[str] = set()
    for row in rows:
        if row.head[2] == row.tail[2] == 0:
            bones.append(row)
            continue
        paired.add(row.name)
        for suffix, side in ((".r", 1.0), (".l", -1.0)):
            bones.append(
                replace(
                    row,
                    name=row.name + suffix,
                    parent=row.parent + suffix if row.parent in paired else row.parent,
                    head=(row.head[0], row.head[1], side * row.head[2]),
                    tail=(row.tail[0], row.tail[1], side * row.tail[2]),
                )
            )
    return tuple(bones)


# fmt: off
BONES = _pairs((
    #    name            parent         head                    tail                    radii         fillet
    Bone("pelvis",       "",            (-0.25, 0.575, 0.000),  (-0.12, 0.580, 0.000),  0.112, 0.110, 0.00),
    Bone("belly",        "pelvis",      (-0.12, 0.580, 0.000),  ( 0.05, 0.580, 0.000),  0.110, 0.118, 0.01),
    Bone("chest",        "belly",       ( 0.05, 0.580, 0.000),  ( 0.20, 0.580, 0.000),  0.118, 0.138, 0.01),
    Bone("neck",         "chest",       ( 0.21, 0.650, 0.000),  ( 0.31, 0.770, 0.000),  0.118, 0.096, 0.06),
    Bone("head",         "neck",        ( 0.33, 0.815, 0.000),  ( 0.37, 0.820, 0.000),  0.112, 0.106, 0.04),
    Bone("muzzle",       "head",        ( 0.42, 0.790, 0.000),  ( 0.575, 0.768, 0.000), 0.077, 0.034, 0.05),
    Bone("nose",         "muzzle",      ( 0.580, 0.784, 0.00),  ( 0.597, 0.785, 0.00),  0.025, 0.025, 0.01),
    Bone("cheek",        "head",        ( 0.35, 0.800, 0.050),  ( 0.315, 0.755, 0.135), 0.078, 0.020, 0.03),
    Bone("ear",          "head",        ( 0.315, 0.885, 0.068), ( 0.285, 1.030, 0.108), 0.056, 0.019, 0.02),
    Bone("arm",          "chest",       ( 0.205, 0.550, 0.085), ( 0.130, 0.360, 0.090), 0.082, 0.052, 0.04),
    Bone("forearm",      "arm",         ( 0.130, 0.360, 0.090), ( 0.165, 0.130, 0.088), 0.052, 0.038, 0.01),
    Bone("forepastern",  "forearm",     ( 0.165, 0.130, 0.088), ( 0.180, 0.052, 0.088), 0.038, 0.040, 0.01),
    Bone("forepaw",      "forepastern", ( 0.180, 0.048, 0.088), ( 0.240, 0.039, 0.088), 0.044, 0.039, 0.01),
    Bone("thigh",        "pelvis",      (-0.250, 0.540, 0.080), (-0.180, 0.355, 0.094), 0.106, 0.062, 0.04),
    Bone("shank",        "thigh",       (-0.180, 0.355, 0.094), (-0.300, 0.190, 0.092), 0.062, 0.038, 0.01),
    Bone("hindpastern",  "shank",       (-0.300, 0.190, 0.092), (-0.280, 0.052, 0.092), 0.038, 0.039, 0.01),
    Bone("hindpaw",      "hindpastern", (-0.280, 0.048, 0.092), (-0.220, 0.039, 0.092), 0.044, 0.039, 0.01),
    Bone("tail1",        "pelvis",      (-0.33, 0.615, 0.000),  (-0.46, 0.585, 0.000),  0.046, 0.068, 0.05),
    Bone("tail2",        "tail1",       (-0.46, 0.585, 0.000),  (-0.61, 0.530, 0.000),  0.068, 0.092, 0.01),
    Bone("tail3",        "tail2",       (-0.61, 0.530, 0.000),  (-0.75, 0.490, 0.000),  0.092, 0.080, 0.01),
    Bone("tail4",        "tail3",       (-0.75, 0.490, 0.000),  (-0.93, 0.475, 0.000),  0.080, 0.024, 0.01),
))
# fmt: on

NAMES = tuple(bone.name for bone in BONES)
PARENTS = tuple(NAMES.index(bone.parent) if bone.parent else -1 for bone in BONES)
HEADS: Float = np.array([bone.head for bone in BONES])
TAILS: Float = np.array([bone.tail for bone in BONES])
LENGTHS: Float = np.linalg.norm(TAILS - HEADS, axis=1)
AXES: Float = (TAILS - HEADS) / LENGTHS[:, None]


def bone_distances(points: Float) -> Float:
    """Return the signed distance ``(..., B)`` from points ``(..., 3)`` to the flesh of every bone.

    The hull of two balls is a cone with round ends. Of the balls along its axis, the nearest to a point lies off the
    foot of the perpendicular by the slope of the cone, towards the thicker end.
    """
    radius = np.array([bone.head_radius for bone in BONES])
    sine = (radius - np.array([bone.tail_radius for bone in BONES])) / LENGTHS
    along = points @ AXES.T - np.sum(HEADS * AXES, axis=1)
    squared = np.sum(points**2, axis=-1, keepdims=True) - 2 * points @ HEADS.T + np.sum(HEADS**2, axis=1)
    across = np.sqrt(np.maximum(squared - along**2, 0))
    ball = np.clip(along - across * (sine / np.sqrt(1 - sine**2)), 0, LENGTHS)
    distances: Float = np.hypot(along - ball, across) - (radius - sine * ball)
    return distances


def body_distance(points: Float) -> Float:
    """Return the implicit function ``(...)`` of the fox at points ``(..., 3)``: the bones' flesh, blended."""
    first, *others = np.moveaxis(bone_distances(points), -1, 0)
    body: Float = first
    for bone, other in zip(BONES[1:], others, strict=True):
        # the quadratic smooth minimum of Quilez: exact where the two differ by more than the fillet's width
        overlap = np.maximum(bone.fillet - np.abs(body - other), 0)
        body = np.minimum(body, other) - overlap**2 / (4 * bone.fillet)
    return body
