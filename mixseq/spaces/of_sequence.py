"""The mixed shape space of a sequence: what its frames teach about parts, links, and joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import SettingsError
from mixseq.geometry.lengths_angles import edge_lengths
from mixseq.geometry.rigid import mean_shape
from mixseq.reconstruction.anchored import AnchoredPlacement
from mixseq.reconstruction.links import Links
from mixseq.reconstruction.prediction import mean_squared_errors
from mixseq.reconstruction.shells import ShellSettings
from mixseq.segmentation.joints import Decomposition
from mixseq.sequence import FloatArray, bounding_diagonal
from mixseq.spaces.mixed import PLACEMENTS, MixedSpace, PlacementName, projection_of
from mixseq.spaces.registered import links_between
from mixseq.topology import Topology

Float = NDArray[np.float64]

TRUST = 3.0
"""Weight of an offset against a length that is predicted as well, both relative to the length of edges ..."""

TRUSTED = (0.1, 10.0)
"""... and its bounds."""

SMALL = 1e-6
"""Errors below this, relative to the length of edges, are all the same."""


def mixed_space(
    points: FloatArray,
    topology: Topology,
    decomposition: Decomposition,
    placement: PlacementName = "anchored",
    settings: ShellSettings | None = None,
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
        Settings of the joint solves.

    Raises
    ------
    SettingsError
        If the placement is neither.
    """
    if placement not in PLACEMENTS:
        raise SettingsError(f"placement is {placement!r}; {' or '.join(map(repr, PLACEMENTS))} is expected")
    scale = bounding_diagonal(points[0]) or 1.0
    shapes = np.concatenate([mean_shape(points[:, part] / scale) for part in decomposition.parts])
    reference = points[0].astype(np.float64) / scale
    projection = projection_of(topology, decomposition, placement, shapes, reference)
    edges = topology.edges[projection.edge_ids]
    lengths = np.mean([edge_lengths(frame.astype(np.float64), edges) for frame in points], axis=0)
    if placement == "anchored":
        links = links_between(points.astype(np.float64) / scale, topology, decomposition, shapes)
    else:
        links = Links.none(len(projection.posed))
    space = MixedSpace(
        topology=topology,
        decomposition=decomposition,
        placement=placement,
        scale=scale,
        shapes=shapes,
        reference_lengths=lengths / scale,
        reference=reference,
        links=links,
        trust=np.ones(len(projection.rows.joints) if isinstance(projection, AnchoredPlacement) else 0),
        settings=settings or ShellSettings(),
    )
    return replace(space, trust=_trust(space, points)) if len(space.trust) else space


def _trust(space: MixedSpace, points: FloatArray) -> Float:
    """How much better than lengths ``(q,)`` offsets are predicted by neighbouring frames: the errors' ratio.

    Root mean squares over a joint of how far edges are off, relative to their lengths: by predicted lengths, and by
    predicted offsets of their ends. So the two weigh as their errors say.
    """
    projection = space.projection
    if not isinstance(projection, AnchoredPlacement):
        return np.zeros(0)
    vectors = space.encode(points)
    lengths = np.maximum(space.reference_lengths, np.finfo(np.float64).tiny)
    stretch = mean_squared_errors(space.split(vectors).lengths[:, :, None]) / np.square(lengths)
    offsets = space.offsets(points, vectors).reshape(len(points), -1, 3)
    away = mean_squared_errors(projection.rows.across_edges(offsets)) / np.square(lengths) / 3.0
    ratios = [
        (stretch[edges].mean() + SMALL**2) / (away[edges].mean() + SMALL**2)
        for edges in projection.rows.edge_slices
    ]
    return np.clip(TRUST * np.sqrt(ratios), *TRUSTED)
