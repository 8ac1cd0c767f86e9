"""The mixed shape space of a sequence: what its frames teach about parts, links, and joints.

The mean shapes of the parts come from some frames, evenly spread. Then all frames are looked at once, block by block:
poses of the parts tell of the links, lengths and offsets of the joints how well neighbouring frames predict each.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import SettingsError
from mixseq.geometry.lengths_angles import edge_lengths
from mixseq.geometry.rigid import mean_shape
from mixseq.geometry.rotations import vectors, without_jumps
from mixseq.mapping import OrderedMap, serially
from mixseq.progress import Progress, silent
from mixseq.reconstruction.anchored import AnchoredPlacement
from mixseq.reconstruction.links import Boundaries, Links, make_links
from mixseq.reconstruction.placement import JointRows
from mixseq.reconstruction.prediction import SquaredErrors
from mixseq.reconstruction.shells import ShellSettings
from mixseq.segmentation.joints import Decomposition
from mixseq.segmentation.observed import frames_to_look_at
from mixseq.sequence import FloatArray, bounding_diagonal
from mixseq.spaces.mixed import PLACEMENTS, MixedSpace, PlacementName
from mixseq.spaces.registered import radii_of_gyration, registered
from mixseq.stored import blocks_of
from mixseq.table import Table
from mixseq.topology import Topology

Float = NDArray[np.float64]

TRUST = 3.0
"""Weight of an offset against a length that is predicted as well, both relative to the length of edges ..."""

TRUSTED = (0.1, 10.0)
"""... and its bounds."""

SMALL = 1e-6
"""Errors below this, relative to the length of edges, are all the same."""

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
        Settings of the joint solves.
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
    space = _untaught(points, topology, decomposition, placement, settings or ShellSettings())
    boundaries = Boundaries.of(topology, decomposition.part_of_face)
    count = len(points)
    total = np.zeros(len(space.projection.edge_ids))
    rows = space.projection.rows if isinstance(space.projection, AnchoredPlacement) else None
    stretch, away = SquaredErrors(count), SquaredErrors(count)
    rotations, centres, middles = [], [], []
    for number, seen in enumerate(_all_seen(workers, space, boundaries, points)):
        total += seen.lengths
        rotations.append(seen.rotations)
        centres.append(seen.centres)
        middles.append(seen.middles)
        if rows is not None and rows.joints:
            stretch.add(seen.lengths[:, None])
            away.add(rows.across_edges(seen.offsets[None])[0])
        progress(number + 1, count, "registering parts")

    lengths = total / count
    taught = replace(space, reference_lengths=lengths)
    if rows is not None:
        turned = without_jumps(np.stack(rotations))
        radii = radii_of_gyration(space.shapes, decomposition.parts)
        links = make_links(boundaries.parts, np.stack(middles), turned, np.stack(centres), radii)
        trust = _trust(rows, lengths, stretch.mean(), away.mean()) if rows.joints else np.zeros(0)
        taught = replace(taught, links=links, trust=trust)
    vars(taught)["projection"] = space.projection  # it depends on neither of these, and is work to make
    return taught


def _untaught(
    points: Table,
    topology: Topology,
    decomposition: Decomposition,
    placement: PlacementName,
    settings: ShellSettings,
) -> MixedSpace:
    """The space before it has seen all frames: its mean shapes are there, links, trust, mean lengths are not."""
    first = points[:1][0]
    scale = bounding_diagonal(first) or 1.0
    some = points[frames_to_look_at(len(points), SHAPED_BY)]
    space = MixedSpace(
        topology=topology,
        decomposition=decomposition,
        placement=placement,
        scale=scale,
        shapes=np.concatenate([mean_shape(some[:, part] / scale) for part in decomposition.parts]),
        reference_lengths=np.zeros(0),
        reference=first.astype(np.float64) / scale,
        links=Links.none(len(decomposition.parts)),
        trust=np.zeros(0),
        settings=settings,
    )
    return replace(space, links=Links.none(len(space.projection.posed)))


class _Seen(NamedTuple):
    """What a frame tells, in diagonals: lengths ``(E',)``, poses, and what the placement wants to know beside them."""

    lengths: Float
    rotations: Float
    centres: Float
    middles: Float
    offsets: Float


def _all_seen(
    workers: OrderedMap, space: MixedSpace, boundaries: Boundaries, points: Table
) -> Iterator[_Seen]:
    for block in workers(_look, (space, boundaries), blocks_of(points)):
        yield from block


def _look(shared: tuple[MixedSpace, Boundaries], points: FloatArray) -> list[_Seen]:
    space, boundaries = shared
    projection = space.projection
    edges = space.topology.edges[projection.edge_ids]
    block = []
    for frame in points:
        x = frame.astype(np.float64) / space.scale
        _, turned, centres = registered(space.shapes, space.decomposition.parts, x)
        offsets = np.zeros((0, 3))
        if isinstance(projection, AnchoredPlacement):
            offsets = projection.offsets(turned, centres, x)
        block.append(_Seen(edge_lengths(x, edges), vectors(turned), centres, boundaries.middles(x), offsets))
    return block


def _trust(rows: JointRows, lengths: Float, stretch: Float, away: Float) -> Float:
    """How much better than lengths ``(q,)`` offsets are predicted by neighbouring frames: the errors' ratio.

    Root mean squares over a joint of how far edges are off, relative to their lengths: by predicted lengths, and by
    predicted offsets of their ends. So the two weigh as their errors say.

    Parameters
    ----------
    rows : JointRows
        The joints that are solved.
    lengths : (E',)
        Mean edge lengths.
    stretch, away : (E',)
        Mean squared errors of lengths, and of differences of offsets along edges, in diagonals.
    """
    squares = np.square(np.maximum(lengths, np.finfo(np.float64).tiny))
    ratios = [
        ((stretch / squares)[edges].mean() + SMALL**2) / ((away / squares)[edges].mean() / 3.0 + SMALL**2)
        for edges in rows.edge_slices
    ]
    return np.clip(TRUST * np.sqrt(ratios), *TRUSTED)
