"""Make the mixed shape space of a sequence: register parts, find joints, and see whether meshes have to settle.

Half-way between two frames lengths and angles should be their means. Where frames turn far from each other, posed
vertices are not that good: there meshes settle, and the faces that are wrong half-way are joints as well.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, FloatArray, Mask, evenly
from mixseq.choices import PLACEMENTS, PlacementName
from mixseq.disk_array import LargeArray
from mixseq.errors import SettingsError
from mixseq.geometry.lengths_angles import dihedral_angles, edge_lengths, wrap
from mixseq.geometry.rigid import mean_shape
from mixseq.geometry.rotations import quaternions
from mixseq.mapping import Executor, serially
from mixseq.progress import Progress, silent
from mixseq.segmentation.joints import Decomposition
from mixseq.segmentation.observed import frames_to_look_at
from mixseq.sequence import bounding_diagonal
from mixseq.shells.shell import Relaxation
from mixseq.spaces.metric import mean_lengths
from mixseq.spaces.mixed.anchored import AnchoredSpace
from mixseq.spaces.mixed.free import FreeSpace
from mixseq.spaces.mixed.mixed_space import MixedSpace
from mixseq.spaces.mixed.shares import fitted_shares
from mixseq.topology import Topology

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

FACES = 100_000
"""So many faces tell what share of all is torn."""

ALL_PAIRS = 12
"""Among so many frames all pairs are tried, else neighbours."""

FEWEST, MOST = 6, 20
"""So many steps are taken if hardly any faces are joints, and if all are; in between in proportion. Ours."""

SHAPED_BY = 64
"""Mean shapes of parts are means of at most so many frames. Any shapes would do to encode all frames exactly."""


def mixed_space(
    points: LargeArray,
    topology: Topology,
    decomposition: Decomposition,
    placement: PlacementName = "anchored",
    settling_from: float = NEVER,
    workers: Executor = serially,
    progress: Progress = silent,
) -> MixedSpace:
    """Make the mixed shape space of a sequence.

    Parameters
    ----------
    points : (T, V, 3) float
        The sequence, in any unit.
    topology : Topology
        Its connectivity.
    decomposition : Decomposition
        Parts and joints.
    placement : {"anchored", "free"}
        How parts are placed.
    settling_from : float
        Anchored placement: lengths and angles are made to agree if, half-way between neighbouring frames, a larger
        share of faces is torn: 0 in blends of poses, `FAR` in animations, whose true frames do not have mean lengths
        and angles, and `NEVER` where few modes do not know them well enough to be told by them.
    workers : Executor, optional
        Who looks at the frames.
    progress : callable, optional
        Told about every block of frames.

    Raises
    ------
    SettingsError
        If the placement is neither.
    """
    if placement not in PLACEMENTS:
        raise SettingsError(f"placement is {placement!r}; {' or '.join(map(repr, PLACEMENTS))} is expected")
    first = points[:1][0]
    scale = bounding_diagonal(first) or 1.0
    some = points[frames_to_look_at(len(points), SHAPED_BY)]
    shapes = np.concatenate([mean_shape(some[:, part] / scale) for part in decomposition.parts])
    reference = first.astype(np.float64) / scale
    progress(1, 2, "registering parts")
    if placement == "anchored":
        shares = fitted_shares(topology, decomposition, shapes, some / scale, reference)
        stiff = AnchoredSpace(
            topology=topology,
            decomposition=decomposition,
            scale=scale,
            shapes=shapes,
            reference=reference,
            shares=shares,
            free=np.zeros(topology.vertex_count, dtype=bool),
            known=np.zeros(len(topology.faces), dtype=bool),
            relaxation=Relaxation(steps=0),
        )
        near = replace(stiff, free=_free(stiff, some))
        progress(2, 2, "registering parts")
        if settling_from >= NEVER or (settling_from > 0 and not are_far(near, points, settling_from)):
            return near
        known = wrong_half_way(near, some)
        steps = FEWEST + round((MOST - FEWEST) * float(known.mean())) if known.any() else 0
        return replace(near, known=known, relaxation=Relaxation(steps=steps))
    space = FreeSpace(topology, decomposition, scale, shapes, reference, np.zeros(0), Relaxation())
    edges = topology.edges[space.edge_ids]
    return replace(space, reference_lengths=mean_lengths(points, edges, scale, workers, progress))


def _free(space: AnchoredSpace, frames: FloatArray) -> Mask:
    """Mark the vertices ``(V,)`` of faces that bend in some of the frames ``(S, V, 3)``."""
    bent = np.zeros(len(space.topology.faces), dtype=bool)
    for frame in frames:
        _, rotations, centres = space.registered(frame.astype(np.float64) / space.scale)
        bent |= space.frames.bent(space.frames.motions(quaternions(rotations), centres))
    free = np.zeros(space.topology.vertex_count, dtype=bool)
    free[space.topology.faces[bent]] = True
    return free


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
    """Share of faces, or of `FACES` of them, that are torn in a mesh between two frames."""
    faces = space.topology.faces[evenly(len(space.topology.faces), FACES)]
    sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    torn = _stretched(between(space, pair), pair, sides) > TORN
    return float(torn.reshape(-1, 3).any(axis=1).mean())


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
