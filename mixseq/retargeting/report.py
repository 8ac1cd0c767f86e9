r"""Measure a transfer: coverage, strain, smoothness, flipped triangles and self-intersections.

With the gradients J of the source's triangles and the rotation G between the two meshes a side s of a target triangle
should become :math:`s' = G J G^T s`, as in `mixseq.retargeting.gradient_transfer`. So its length should be
:math:`\lambda = |s'| / |s|` times that at rest, and the triangle should face along :math:`s'_1 \times s'_2`.

- *strain* of an edge in a frame: :math:`|\,l / l_\mathrm{rest} - 1\,|`, of the target and of the source,
- *excess* of a target edge: :math:`|\,l / l_\mathrm{rest} - \lambda\,|`, averaged over the triangles at the edge: the
  strain of one mesh alone. Edges without a counterpart should have no strain.
- a triangle is *turned over* if it faces away from the direction expected from the source,
- *acceleration* of a vertex: :math:`|x_{t+1} - 2 x_t + x_{t-1}| / d`, per frame squared, with the target's diagonal d
  at rest, and for the source d / s with the scale s between the two (`mixseq.retargeting.sources`). That of the source
  is taken at the points of the target's vertices, independent of the density of meshes.

All frames are measured, but self-intersections are counted in some only. Frames come block by block, and only the
largest thousandth of the strains is kept.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import InvalidSequenceError
from mixseq.mesh.measures import degenerate_faces, edge_lengths
from mixseq.mesh.topology import Topology
from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.retargeting.gradient_transfer import GradientTransfer, gradient_transfer
from mixseq.retargeting.transfer import Transfer
from mixseq.runtime.low_memory import RunningStatistics, Statistics
from mixseq.runtime.parallel import Executor
from mixseq.runtime.progress import Progress, no_progress
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import bounding_diagonal, check_block
from mixseq.types import Float, FloatArray, Index, Mask, evenly_spaced


@dataclass(frozen=True)
class Follower:
    """A component of the target, or some vertices of it, without a counterpart, and the vertex it follows."""

    name: str  # the component
    vertices: int  # number of following vertices
    leader: int  # the vertex they follow; the first of several
    leads: str  # the component of that vertex


@dataclass(frozen=True)
class Coverage:
    """Share of a target with a counterpart."""

    vertices: float  # share of its vertices on the source
    area: float  # share of its area whose triangles are moved by a triangle of the source
    source_area: float  # share of the source's area whose triangles move one of the target's
    followers: tuple[Follower, ...]  # following components


def coverage(transfer: Transfer) -> Coverage:
    """Measure the share of the target with a counterpart on the source."""
    mapping, header = transfer.correspondence, transfer.header
    topology = Topology(header.faces, header.vertex_count)
    component = topology.component_of_vertex
    names = component_names(header, topology)
    followers = []
    for number in np.unique(component[~mapping.matched]).tolist():
        led = np.flatnonzero((component == number) & ~mapping.matched)
        leader = int(mapping.leaders[led[0]])
        followers.append(Follower(names[number], len(led), leader, names[int(component[leader])]))
    known = mapping.faces >= 0
    moving = np.zeros(len(transfer.source.header.faces), dtype=np.bool_)
    moving[mapping.faces[known]] = True
    return Coverage(
        vertices=float(mapping.matched.mean()),
        area=_share(known, TriangleMesh(transfer.target, topology).face_areas),
        source_area=_share(moving, TriangleMesh(transfer.source.rest, transfer.source.topology).face_areas),
        followers=tuple(followers),
    )


def component_names(header: SequenceHeader, topology: Topology) -> list[str]:
    """Name connected components by their object in the file, or by numbers from 1."""
    component = topology.component_of_vertex
    counts = [each.vertex_count for each in header.objects]
    owner = np.repeat(np.arange(len(counts)), counts)
    names = []
    for number in range(int(component.max()) + 1):
        own = np.unique(owner[component == number])
        name = header.objects[int(own[0])].name if len(counts) > 1 else ""
        whole = len(own) == 1 and int((component == number).sum()) == counts[int(own[0])]
        names.append(name if name and whole else f"component {number + 1}" + (f" of {name}" if name else ""))
    return names


def _share(chosen: NDArray[np.bool_], areas: Float) -> float:
    total = float(areas.sum())
    return float(areas[chosen].sum() / total) if total > 0 else float(chosen.mean())


FLAT = 1e-3
"""Ratio of height to longest side below which a triangle is flat."""


@dataclass(frozen=True, eq=False)
class ExpectedTriangles:
    """Expected stretches and normals of the target's triangles."""

    gradients: GradientTransfer  # the two meshes at rest, and their correspondence
    rest: Float  # (V', 3) target at rest, in its own units
    source_rest: Float  # (V, 3) source at rest, in its own units

    @classmethod
    def from_transfer(cls, transfer: Transfer) -> ExpectedTriangles:
        """Make it for the two meshes of a transfer by any method."""
        topology = Topology(transfer.header.faces, transfer.header.vertex_count)
        source = transfer.source
        made = gradient_transfer(
            source.topology, source.rest, topology, transfer.target, transfer.correspondence
        )
        return cls(made, transfer.target, source.rest)

    @property
    def topology(self) -> Topology:
        """Connectivity of the target."""
        return self.gradients.target.topology

    @property
    def source(self) -> Topology:
        """Connectivity of the source."""
        return self.gradients.source.topology

    @cached_property
    def matched(self) -> Index:
        """Target triangles ``(n,)`` with a source triangle."""
        return np.flatnonzero(self.gradients.correspondence.faces >= 0)

    @cached_property
    def flat(self) -> Mask:
        """Target triangles ``(F',)`` that are flat at rest."""
        return degenerate_faces(self.rest, self.topology.faces, FLAT)

    @cached_property
    def _sides(self) -> Float:
        """Sides 01, 12, 20 ``(n, 3, 3)`` of the matched triangles at rest, in rows."""
        return _sides_of(self.rest, self.topology.faces[self.matched])

    @cached_property
    def lengths(self) -> Float:
        """Lengths ``(E',)`` of the target's edges at rest, NaN for none."""
        return _or_nan(edge_lengths(self.rest, self.topology.edges))

    @cached_property
    def source_lengths(self) -> Float:
        """Lengths ``(E,)`` of the source's edges at rest, NaN for none."""
        return _or_nan(edge_lengths(self.source_rest, self.source.edges))

    def sides(self, x: Float) -> Float:
        """Return the expected sides ``(n, 3, 3)`` of matched triangles in a frame ``(V, 3)``."""
        faces = self.gradients.correspondence.faces[self.matched]
        moving = self.gradients.alignment.turned(self.gradients.gradients(x)[faces])
        return np.asarray(self._sides @ np.swapaxes(moving, 1, 2))

    def stretches(self, sides: Float) -> Float:
        """Return the expected stretches ``(E',)`` of the target's edges; 1 without a counterpart."""
        with np.errstate(divide="ignore", invalid="ignore"):
            stretches = np.linalg.norm(sides, axis=2) / np.linalg.norm(self._sides, axis=2)
        of_side = np.ones((len(self.topology.faces), 3))
        of_side[self.matched] = stretches
        edges = self.topology.face_edges.reshape(-1)
        count = len(self.topology.edges)
        return np.asarray(
            np.bincount(edges, of_side.reshape(-1), count) / np.bincount(edges, minlength=count)
        )

    def turned_over(self, y: Float, sides: Float) -> Mask:
        """Mark matched triangles ``(n,)`` whose normals oppose the expected ones in a frame ``(V', 3)``."""
        own = _sides_of(y, self.topology.faces[self.matched])
        normals, expected = (np.cross(each[:, 0], each[:, 1]) for each in (own, sides))
        return np.asarray((normals * expected).sum(axis=1) < 0)

    def newly_flat(self, y: Float) -> Mask:
        """Mark triangles ``(F',)`` that are flat in a frame ``(V', 3)``, but not at rest."""
        return np.asarray(degenerate_faces(y, self.topology.faces, FLAT) & ~self.flat)


def _sides_of(points: Float, faces: NDArray[Any]) -> Float:
    """Return sides 01, 12, 20 ``(n, 3, 3)`` of triangles ``(n, 3)``, in rows."""
    corners = points[faces]
    return np.asarray(np.roll(corners, -1, axis=1) - corners)


def _or_nan(lengths: Float) -> Float:
    return np.where(lengths > 0, lengths, np.nan)


class Acceleration:
    """Second differences of frames in blocks."""

    def __init__(self) -> None:
        self._before: Float | None = None
        self._squares, self._seen, self._largest, self._done = 0.0, 0, 0.0, 0
        self.worst_frame = 0

    def add(self, block: Float) -> None:
        """Add the next frames ``(B, V, 3)``."""
        whole = block if self._before is None else np.concatenate([self._before, block])
        for number in range(1, len(whole) - 1):
            before, here, after = whole[number - 1 : number + 2]
            squares = np.square(after - 2.0 * here + before).sum(axis=1)
            self._squares += float(squares.sum())
            self._seen += len(squares)
            self._done += 1  # the first difference is about frame 1
            if squares.max() > self._largest:
                self._largest, self.worst_frame = float(squares.max()), self._done
        self._before = whole[-2:]

    @property
    def rms(self) -> float:
        """Root mean square over all vertices and frames."""
        return float(np.sqrt(self._squares / max(self._seen, 1)))

    @property
    def max(self) -> float:
        """Largest acceleration of a vertex."""
        return float(np.sqrt(self._largest))


@dataclass(frozen=True)
class Smoothness:
    """Accelerations in diagonals of the target per squared frame: root mean square, and the largest of a vertex."""

    rms: float  # root mean square of the target
    max: float  # largest of a vertex of the target
    source_rms: float  # root mean square of the source, scaled to the target
    source_max: float  # largest of the source, scaled to the target
    worst_frame: int  # frame of the target's largest

    @property
    def ratio(self) -> float | None:
        """Root mean square of the target relative to the source's; None if the source does not accelerate."""
        return self.rms / self.source_rms if self.source_rms > 0 else None


FRAMES = 8
"""Largest number of frames in which self-intersections are counted."""


@dataclass(frozen=True)
class FrameCounts:
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
    intersections: FrameCounts  # intersecting pairs of triangles of the target
    source_intersections: FrameCounts  # intersecting pairs of triangles of the source
    turned_over: FrameCounts  # turned-over triangles of the target, in all frames
    flat: FrameCounts  # triangles of the target that are flat in a frame but not at rest, in all frames

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        smooth = self.smoothness
        return {
            "coverage": asdict(self.coverage)
            | {"followers": [asdict(each) for each in self.coverage.followers]},
            "strain": asdict(self.strain),
            "source_strain": asdict(self.source_strain),
            "excess_strain": asdict(self.excess),
            "acceleration": None if smooth is None else asdict(smooth) | {"ratio": smooth.ratio},
            "self_intersections": self.intersections.as_dict(per_frame=True),
            "source_self_intersections": self.source_intersections.as_dict(per_frame=True),
            "turned_over": self.turned_over.as_dict(),
            "flat": self.flat.as_dict(),
        }


def measure_transfer(
    transfer: Transfer,
    blocks: Iterable[FloatArray] | None = None,
    progress: Progress = no_progress,
    workers: Executor | None = None,
) -> TransferReport:
    """Measure a transfer; frames are made unless blocks of them are given."""
    meter = TransferMeter(transfer)
    for block in transfer.blocks(progress, workers) if blocks is None else blocks:
        meter.add(block)
    return meter.report()


class TransferMeter:
    """Measures a transfer as its frames stream."""

    def __init__(self, transfer: Transfer) -> None:
        self._transfer = transfer
        self._expected = ExpectedTriangles.from_transfer(transfer)
        self._count = len(transfer.source.points)
        self._done = 0
        edges, source_edges = len(self._expected.topology.edges), len(transfer.source.topology.edges)
        self._strain, self._excess = (RunningStatistics(self._count * edges) for _ in range(2))
        self._source_strain = RunningStatistics(self._count * source_edges)
        self._acceleration = Acceleration(), Acceleration()
        self._looked_at = tuple(evenly_spaced(self._count, FRAMES).tolist())
        self._crossings: list[tuple[int, int]] = []
        self._turned_over: list[int] = []
        self._flat: list[int] = []

    def measure_blocks(self, blocks: Iterable[FloatArray]) -> Iterator[FloatArray]:
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
            stretches = edge_lengths(y, expected.topology.edges) / expected.lengths
            source_stretches = edge_lengths(x, expected.source.edges) / expected.source_lengths
            self._strain.add(np.abs(stretches - 1.0))
            self._excess.add(np.abs(stretches - expected.stretches(sides)))
            self._source_strain.add(np.abs(source_stretches - 1.0))
            self._turned_over.append(int(expected.turned_over(y, sides).sum()))
            self._flat.append(int(expected.newly_flat(y).sum()))
            if number in self._looked_at:
                self._crossings.append((_crossings(y, expected.topology), _crossings(x, expected.source)))
        for acceleration, frames in zip(
            self._acceleration, (points, self._transfer.correspondence.interpolate(source)), strict=True
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
        every = tuple(range(self._count))
        diagonal = bounding_diagonal(transfer.target) or 1.0
        source_diagonal = diagonal / expected.gradients.alignment.scale
        smoothness = None
        if self._count > 2:
            moved, own = self._acceleration
            smoothness = Smoothness(
                moved.rms / diagonal,
                moved.max / diagonal,
                own.rms / source_diagonal,
                own.max / source_diagonal,
                moved.worst_frame,
            )
        return TransferReport(
            coverage=coverage(transfer),
            strain=self._strain.result(),
            source_strain=self._source_strain.result(),
            excess=self._excess.result(),
            smoothness=smoothness,
            intersections=FrameCounts(
                _crossings(transfer.target, expected.topology), self._looked_at, target
            ),
            source_intersections=FrameCounts(
                _crossings(transfer.source.rest, expected.source), self._looked_at, source
            ),
            turned_over=FrameCounts(0, every, tuple(self._turned_over)),
            flat=FrameCounts(int(expected.flat.sum()), every, tuple(self._flat)),
        )


def _crossings(points: Float, topology: Topology) -> int:
    from mixseq.mesh.nearest import self_intersections

    return len(self_intersections(points, topology.faces))
