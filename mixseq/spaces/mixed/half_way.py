"""How wrong posed meshes are half-way between frames: whether they have to settle, and which faces that is about.

Half-way between two frames lengths and angles should be their means. Where frames turn far from each other, posed
vertices are not that good.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, FloatArray, Mask
from mixseq.disk_array import LargeArray
from mixseq.geometry.lengths_angles import dihedral_angles, edge_lengths, wrap
from mixseq.segmentation.observed import frames_to_look_at
from mixseq.spaces.mixed.anchored import AnchoredSpace

STRETCH = 0.015
"""Where meshes settle, faces with edges that are wrong by more of their length half-way are joints; ours."""

BEND = 4.0
"""So are those with hinges that are wrong by more degrees."""

TORN = 0.1
"""A face is torn half-way between frames if an edge of it is wrong by more of its length there."""

FAR = 0.15
"""Frames are far apart if, half-way to the next, a larger share of faces is torn; ours."""

NEVER = 1.0
"""No share of faces is larger: meshes do not settle."""

NEIGHBOURS = 5
"""So many pairs of neighbouring frames tell how far apart they are."""

ALL_PAIRS = 12
"""Among so many frames all pairs are tried, else neighbours."""


def are_far(space: AnchoredSpace, frames: LargeArray, share: float) -> bool:
    """Whether more than a share of faces is torn half-way between neighbours among the frames ``(T, V, 3)``."""
    last = len(frames) - 1
    pairs = [frames[first : first + 2] for first in frames_to_look_at(last, NEIGHBOURS)] if last else []
    return all(  # plain means are quick, and show most animations to be near
        sum(_torn(space, pair, middle) for pair in pairs) > share * len(pairs)
        for middle in (_plain_mean, _middle)
    )


def wrong_half_way(space: AnchoredSpace, frames: FloatArray) -> Mask:
    """Mark the faces ``(F,)`` that are wrong half-way between some of the frames ``(S, V, 3)``."""
    count = len(frames)
    pairs = combinations(range(count), 2) if count <= ALL_PAIRS else pairwise(range(count))
    wrong = np.zeros(len(space.topology.faces), dtype=bool)
    for first, second in pairs:
        wrong |= _wrong_between(space, frames[[first, second]])
    return wrong


def _wrong_between(space: AnchoredSpace, pair: FloatArray) -> Mask:
    """Mark the faces ``(F,)`` whose lengths or angles are wrong half-way between two frames."""
    topology, middle = space.topology, _middle(space, pair)
    stretched = _stretched(middle, pair, topology.edges) > STRETCH
    wrong = np.asarray(stretched[topology.face_edges].any(axis=1))
    wrong[topology.hinge_faces[_bent(middle, pair, topology.hinges) > BEND]] = True
    return wrong


def _torn(
    space: AnchoredSpace, pair: FloatArray, between: Callable[[AnchoredSpace, FloatArray], Float]
) -> float:
    """Share of faces that are torn in a mesh between two frames."""
    torn = _stretched(between(space, pair), pair, space.topology.edges) > TORN
    return float(torn[space.topology.face_edges].any(axis=1).mean())


def _middle(space: AnchoredSpace, pair: FloatArray) -> Float:
    """Decode what is half-way between two frames."""
    half = np.array([0.5, 0.5])
    shapes, placements = np.split(space.encode(pair), [space.shape_dim], axis=1)
    vector = np.concatenate([half @ shapes, space.blended_placements(half, placements)])
    return np.asarray(space.decode(vector[None])[0])


def _plain_mean(space: AnchoredSpace, pair: FloatArray) -> Float:
    """Return the mean of the vertices of two frames; the space is not asked."""
    return np.asarray(pair.mean(axis=0, dtype=np.float64))


def _stretched(middle: Float, pair: FloatArray, edges: NDArray[np.integer]) -> Float:
    """By how much lengths ``(E,)`` of a mesh are not half-way between two frames; relative."""
    lengths = edge_lengths(pair.astype(np.float64), edges).mean(axis=0)
    off = np.abs(edge_lengths(middle, edges) - lengths)
    return np.asarray(np.divide(off, lengths, out=np.zeros_like(off), where=lengths > 0))


def _bent(middle: Float, pair: FloatArray, hinges: NDArray[np.integer]) -> Float:
    """By how many degrees angles ``(H,)`` of a mesh are not half-way between two frames."""
    first, second = dihedral_angles(pair.astype(np.float64), hinges)
    wanted = first + 0.5 * wrap(second - first)
    return np.degrees(np.abs(wrap(dihedral_angles(middle, hinges) - wanted)))
