r"""Measures of a transfer: strain, smoothness, flipped triangles, and self-intersections.

- *strain* of an edge in a frame: :math:`|\,l / l_\mathrm{rest} - 1\,|`, of the target and of the source,
- *excess* of a target edge: :math:`|\,l / l_\mathrm{rest} - \lambda\,|` with the stretch :math:`\lambda` expected from
  the source (`mixseq.retargeting.transfer_measures`), averaged over the triangles at the edge: the strain of one mesh
  alone. Edges without a counterpart should have no strain.
- a triangle is *turned over* if it faces away from the direction expected from the source,
- *acceleration* of a vertex: :math:`|x_{t+1} - 2 x_t + x_{t-1}| / d`, per frame squared, with the target's diagonal d
  at rest, and for the source d / s with the scale s between the two (`mixseq.retargeting.alignment`).
  That of the source is taken at the points of the target's vertices, independent of the density of meshes.

All frames are measured, but self-intersections are counted in some only. Frames come block by block, and only the
largest thousandth of the strains is kept.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mixseq.arrays import Float, FloatArray, evenly
from mixseq.errors import InvalidSequenceError
from mixseq.mapping import Executor
from mixseq.progress import Progress, silent
from mixseq.retargeting.coverage import Coverage, coverage
from mixseq.retargeting.transfer import Transfer
from mixseq.retargeting.transfer_measures import Acceleration, Expected, Smoothness
from mixseq.sequence import bounding_diagonal, check_block
from mixseq.statistics import RunningStatistics, Statistics
from mixseq.topology import Topology

FRAMES = 8
"""Largest number of frames in which self-intersections are counted."""


@dataclass(frozen=True)
class Counts:
    """Counts at rest, and in some frames."""

    rest: int  # at rest
    frames: tuple[int, ...]  # the frames
    values: tuple[int, ...]  # ... and the numbers in them

    @property
    def mean(self) -> float:
        """Mean over the frames."""
        return float(np.mean(self.values))

    @property
    def worst(self) -> int:
        """Largest count."""
        return max(self.values)

    @property
    def worst_frame(self) -> int:
        """First frame with the largest count."""
        return self.frames[self.values.index(self.worst)]

    def as_dict(self, per_frame: bool = False) -> dict[str, Any]:
        """Return plain values for JSON, optionally with counts per frame."""
        summary = {"rest": self.rest, "mean": self.mean, "worst": self.worst, "worst_frame": self.worst_frame}
        return summary | ({"frames": list(self.frames), "values": list(self.values)} if per_frame else {})


@dataclass(frozen=True)
class TransferReport:
    """Measures of a transfer; their formulas are at the head of this module."""

    coverage: Coverage  # shares with a counterpart, and followers
    strain: Statistics  # strain of the target's edges
    source_strain: Statistics  # strain of the source's edges
    excess: Statistics  # excess of the target's edges
    smoothness: Smoothness | None  # if there are at least three frames
    intersections: Counts  # intersecting pairs of triangles of the target
    source_intersections: Counts  # intersecting pairs of triangles of the source
    turned_over: Counts  # turned-over triangles of the target, in all frames
    flat: Counts  # triangles of the target that are flat in a frame but not at rest, in all frames

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        smooth = self.smoothness
        return {
            "coverage": self.coverage.as_dict(),
            "strain": asdict(self.strain),
            "source_strain": asdict(self.source_strain),
            "excess_strain": asdict(self.excess),
            "acceleration": None if smooth is None else asdict(smooth) | {"ratio": smooth.ratio},
            "self_intersections": self.intersections.as_dict(per_frame=True),
            "source_self_intersections": self.source_intersections.as_dict(per_frame=True),
            "turned_over": self.turned_over.as_dict(),
            "flat": self.flat.as_dict(),
        }


def measure(
    transfer: Transfer,
    blocks: Iterable[FloatArray] | None = None,
    progress: Progress = silent,
    workers: Executor | None = None,
) -> TransferReport:
    """Measure a transfer; frames are made unless blocks of them are given."""
    meter = Meter(transfer)
    for block in transfer.blocks(progress, workers) if blocks is None else blocks:
        meter.add(block)
    return meter.report()


class Meter:
    """Measures a transfer as its frames stream."""

    def __init__(self, transfer: Transfer) -> None:
        self._transfer = transfer
        self._expected = Expected.of(transfer)
        self._count = len(transfer.source.points)
        self._done = 0
        edges, source_edges = len(self._expected.topology.edges), len(transfer.source.topology.edges)
        self._strain, self._excess = (
            RunningStatistics(self._count * edges),
            RunningStatistics(self._count * edges),
        )
        self._source_strain = RunningStatistics(self._count * source_edges)
        self._acceleration = Acceleration(), Acceleration()
        self._looked_at = tuple(evenly(self._count, FRAMES).tolist())
        self._crossings: list[tuple[int, int]] = []
        self._turned_over: list[int] = []
        self._flat: list[int] = []

    def passing(self, blocks: Iterable[FloatArray]) -> Iterator[FloatArray]:
        """Yield blocks of the target's points, and measure them."""
        for block in blocks:
            self.add(block)
            yield block

    def add(self, block: FloatArray) -> None:
        """Measure the next frames ``(B, V', 3)`` of the target."""
        check_block(self._transfer.header, block, self._done)
        if self._done + len(block) > self._count:
            raise InvalidSequenceError(
                f"there are more than the {self._count} frames of the source; give one frame for each of its frames"
            )
        source = self._transfer.source.points[self._done : self._done + len(block)].astype(np.float64)
        points = block.astype(np.float64)
        expected = self._expected
        for number, (x, y) in enumerate(zip(source, points, strict=True), start=self._done):
            sides = expected.sides(x)
            lengths = expected.own_stretches(y)
            self._strain.add(np.abs(lengths - 1.0))
            self._excess.add(np.abs(lengths - expected.stretches(sides)))
            self._source_strain.add(np.abs(expected.source_stretches(x) - 1.0))
            self._turned_over.append(int(expected.turned_over(y, sides).sum()))
            self._flat.append(int(expected.newly_flat(y).sum()))
            if number in self._looked_at:
                self._crossings.append((_crossings(y, expected.topology), _crossings(x, expected.source)))
        for acceleration, frames in zip(
            self._acceleration, (points, self._transfer.correspondence.carry(source)), strict=True
        ):
            acceleration.add(frames)
        self._done += len(block)

    def report(self) -> TransferReport:
        """Return the report after all frames."""
        if self._done < self._count:
            raise InvalidSequenceError(
                f"{self._done} frames were measured, the source has {self._count}; give one frame for each of them"
            )
        transfer, expected = self._transfer, self._expected
        target, source = zip(*self._crossings, strict=True)
        at_rest = [
            _crossings(*mesh)
            for mesh in ((transfer.target, expected.topology), (transfer.source.rest, expected.source))
        ]
        every = tuple(range(self._count))
        diagonal = bounding_diagonal(transfer.target) or 1.0
        source_diagonal = diagonal / expected.gradients.alignment.scale
        moved, own = self._acceleration
        return TransferReport(
            coverage=coverage(transfer),
            strain=self._strain.result(),
            source_strain=self._source_strain.result(),
            excess=self._excess.result(),
            smoothness=Smoothness.of(moved, diagonal, own, source_diagonal) if self._count > 2 else None,
            intersections=Counts(at_rest[0], self._looked_at, target),
            source_intersections=Counts(at_rest[1], self._looked_at, source),
            turned_over=Counts(0, every, tuple(self._turned_over)),
            flat=Counts(int(expected.flat.sum()), every, tuple(self._flat)),
        )


def _crossings(points: Float, topology: Topology) -> int:
    from mixseq.geometry.intersections import self_intersections

    return len(self_intersections(points, topology.faces))
