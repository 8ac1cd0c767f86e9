"""The mixed shape space of a sequence: parts registered over its frames."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import SettingsError
from mixseq.geometry.lengths_angles import dihedral_angles, edge_lengths, wrap
from mixseq.geometry.quaternions import quaternions
from mixseq.geometry.rigid import mean_shape
from mixseq.mapping import OrderedMap, serially
from mixseq.progress import Progress, silent
from mixseq.segmentation.joints import Decomposition
from mixseq.segmentation.observed import frames_to_look_at
from mixseq.sequence import FloatArray, bounding_diagonal
from mixseq.shells.shell import Relaxation
from mixseq.spaces.mean_lengths import mean_lengths
from mixseq.spaces.mixed.anchored import AnchoredSpace
from mixseq.spaces.mixed.free import FreeSpace
from mixseq.spaces.mixed.shares import fitted_shares
from mixseq.spaces.mixed.space import PLACEMENTS, MixedSpace, PlacementName
from mixseq.table import Table
from mixseq.topology import Topology

Float = NDArray[np.float64]

STRETCH = 0.015
"""Where meshes settle, faces with edges that are wrong by more of their length half-way are joints; ours."""

BEND = 4.0
"""So are those with hinges that are wrong by more degrees."""

FEWEST, MOST = 6, 20
"""So many steps are taken if hardly any faces are joints, and if all are; in between in proportion. Ours."""

ALL_PAIRS = 12
"""Among so many frames all pairs are tried, else neighbours."""

SHAPED_BY = 64
"""Mean shapes of parts are means of at most so many frames. Any shapes would do to encode all frames exactly."""


def mixed_space(
    points: Table,
    topology: Topology,
    decomposition: Decomposition,
    placement: PlacementName = "anchored",
    settling: bool = False,
    workers: OrderedMap = serially,
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
    settling : bool
        Anchored placement: lengths and angles are made to agree between frames that are far apart. That is for blends
        of poses: true frames of an animation do not have mean lengths and angles, and models of few modes do not know
        them well enough to be told by them.
    workers : OrderedMap, optional
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
        if not settling:
            return near
        known = _wrong_half_way(near, some)
        steps = FEWEST + round((MOST - FEWEST) * float(known.mean())) if known.any() else 0
        return replace(near, known=known, relaxation=Relaxation(steps=steps))
    space = FreeSpace(topology, decomposition, scale, shapes, reference, np.zeros(0), Relaxation())
    edges = topology.edges[space.edge_ids]
    return replace(space, reference_lengths=mean_lengths(points, edges, scale, workers, progress))


def _half_way(space: AnchoredSpace, pair: FloatArray) -> tuple[Float, Float]:
    """By how much lengths ``(E,)``, relative, and angles ``(H,)``, in degrees, are wrong between two frames."""
    pair, half = pair.astype(np.float64), np.array([0.5, 0.5])
    edges, hinges = space.topology.edges, space.topology.hinges
    shapes, placements = np.split(space.encode(pair), [space.shape_dim], axis=1)
    vector = np.concatenate([half @ shapes, space.blended_placements(half, placements)])
    middle = space.decode(vector[None])[0]
    lengths, angles = edge_lengths(pair, edges).mean(axis=0), dihedral_angles(pair, hinges)
    off = np.abs(edge_lengths(middle, edges) - lengths)
    stretch = np.divide(off, lengths, out=np.zeros_like(off), where=lengths > 0)
    wanted = angles[0] + 0.5 * wrap(angles[1] - angles[0])
    return stretch, np.degrees(np.abs(wrap(dihedral_angles(middle, hinges) - wanted)))


def _free(space: AnchoredSpace, frames: FloatArray) -> NDArray[np.bool_]:
    """Mark the vertices ``(V,)`` of faces that bend in some of the frames ``(S, V, 3)``."""
    bent = np.zeros(len(space.topology.faces), dtype=bool)
    for frame in frames:
        _, rotations, centres = space.registered(frame.astype(np.float64) / space.scale)
        bent |= space.frames.bent(space.frames.motions(quaternions(rotations), centres))
    free = np.zeros(space.topology.vertex_count, dtype=bool)
    free[space.topology.faces[bent]] = True
    return free


def _wrong_half_way(space: AnchoredSpace, frames: FloatArray) -> NDArray[np.bool_]:
    """Mark the faces ``(F,)`` whose lengths or angles are wrong half-way between some of the frames ``(S, V, 3)``."""
    topology, count = space.topology, len(frames)
    pairs = combinations(range(count), 2) if count <= ALL_PAIRS else pairwise(range(count))
    wrong = np.zeros(len(topology.faces), dtype=bool)
    for first, second in pairs:
        stretch, bend = _half_way(space, frames[[first, second]])
        wrong |= (stretch > STRETCH)[topology.face_edges].any(axis=1)
        wrong[topology.hinge_faces[bend > BEND]] = True
    return wrong
