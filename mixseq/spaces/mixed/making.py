"""The mixed shape space of a sequence: parts registered over its frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mixseq.arrays import FloatArray, Mask
from mixseq.disk_array import LargeArray
from mixseq.errors import SettingsError
from mixseq.geometry.quaternions import quaternions
from mixseq.geometry.rigid import mean_shape
from mixseq.mapping import Executor, serially
from mixseq.progress import Progress, silent
from mixseq.segmentation.joints import Decomposition
from mixseq.segmentation.observed import frames_to_look_at
from mixseq.sequence import bounding_diagonal
from mixseq.shells.shell import Relaxation
from mixseq.spaces.mean_lengths import mean_lengths
from mixseq.spaces.mixed.anchored import AnchoredSpace
from mixseq.spaces.mixed.free import FreeSpace
from mixseq.spaces.mixed.half_way import NEVER, are_far, wrong_half_way
from mixseq.spaces.mixed.shares import fitted_shares
from mixseq.spaces.mixed.space import PLACEMENTS, MixedSpace, PlacementName
from mixseq.topology import Topology

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
