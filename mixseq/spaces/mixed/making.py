"""The mixed shape space of a sequence: parts registered over its frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import SettingsError
from mixseq.geometry.quaternions import quaternions
from mixseq.geometry.rigid import mean_shape
from mixseq.mapping import OrderedMap, serially
from mixseq.progress import Progress, silent
from mixseq.reconstruction.shells import ShellSettings
from mixseq.segmentation.joints import Decomposition
from mixseq.segmentation.observed import frames_to_look_at
from mixseq.sequence import FloatArray, bounding_diagonal
from mixseq.spaces.mean_lengths import mean_lengths
from mixseq.spaces.mixed.anchored import AnchoredSpace
from mixseq.spaces.mixed.free import FreeSpace
from mixseq.spaces.mixed.shares import fitted_shares
from mixseq.spaces.mixed.space import PLACEMENTS, MixedSpace, PlacementName
from mixseq.table import Table
from mixseq.topology import Topology

Float = NDArray[np.float64]

SHAPED_BY = 64
"""Mean shapes of parts are means of at most so many frames. Any shapes would do to encode all frames exactly."""


def mixed_space(
    points: Table,
    topology: Topology,
    decomposition: Decomposition,
    placement: PlacementName = "anchored",
    settings: ShellSettings | None = None,
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
    settings : ShellSettings, optional
        Settings of the fits of the free placement.
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
        nothing = np.zeros(len(reference), dtype=bool)
        stiff = AnchoredSpace(topology, decomposition, scale, shapes, reference, shares, nothing)
        free = _free(stiff, some)
        progress(2, 2, "registering parts")
        return replace(stiff, free=free)
    space = FreeSpace(
        topology, decomposition, scale, shapes, reference, np.zeros(0), settings or ShellSettings()
    )
    edges = topology.edges[space.edge_ids]
    made = replace(space, reference_lengths=mean_lengths(points, edges, scale, workers, progress))
    vars(made)["projection"] = space.projection  # it does not depend on lengths, and is work to make
    return made


def _free(space: AnchoredSpace, frames: FloatArray) -> NDArray[np.bool_]:
    """Mark the vertices ``(V,)`` of faces that bend in some of the frames ``(S, V, 3)``."""
    bent = np.zeros(len(space.topology.faces), dtype=bool)
    for frame in frames:
        _, rotations, centres = space.registered(frame.astype(np.float64) / space.scale)
        bent |= space.frames.bent(space.frames.motions(quaternions(rotations), centres))
    free = np.zeros(space.topology.vertex_count, dtype=bool)
    free[space.topology.faces[bent]] = True
    return free
