r"""Measure a transfer: coverage, strain, smoothness, flipped triangles, self-intersections, volume and contact.

In a frame, a side s of a target triangle at rest becomes the expected side :math:`s' = G J G^T s`. J is the gradient of
the source triangle, and G the rotation between the meshes (`mixseq.retargeting.gradient_transfer`). The expected
stretch is :math:`\lambda = |s'| / |s|`, and the expected normal is :math:`s'_1 \times s'_2`.

- The *strain* of an edge in a frame is :math:`|\,l / l_\mathrm{rest} - 1\,|`, for the target and the source.
- The *excess* of a target edge is :math:`|\,l / l_\mathrm{rest} - \lambda\,|`: its strain beyond the source's strain.
  The expected stretch is averaged over the triangles at the edge; without source triangles it is 1.
- A triangle is *turned over* if it faces away from its expected normal.
- The *acceleration* of a vertex is :math:`|x_{t+1} - 2 x_t + x_{t-1}| / d`, with the target's diagonal d at rest. For
  the source d / s replaces d, with the scale s between the meshes (`mixseq.retargeting.sources`). The source is
  measured at the source points of the target's vertices, independent of the mesh densities.

- The *volume change* is :math:`\log (V' / V'_\mathrm{rest}) - \log (V / V_\mathrm{rest})`, if both are positive.
- The *lift* of a frame is a height, above the lowest vertex of the target, over the ground on which the source stands:
  nine tenths of the vertices are lower whose source points are on that ground, within `GROUND_DIAGONALS`.

Self-intersections are counted in sampled frames; other measures use all frames. Frames are measured block by block, and
only the largest thousandth of the strains is kept in memory.
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
from mixseq.sequence.header import UP_AXES, SequenceHeader
from mixseq.sequence.sequence import bounding_diagonal, check_block
from mixseq.types import Float, FloatArray, Index, Mask, evenly_spaced, index_mask


@dataclass(frozen=True)
class Follower:
    """Vertices of a target component that have no source point and follow a leader."""

    name: str  # name of the component
    vertices: int  # number of following vertices
    leader: int  # vertex that is followed; the first of several
    leads: str  # name of the leader's component


@dataclass(frozen=True)
class Coverage:
    """Shares of both meshes with a counterpart."""

    vertices: float  # share of the target's vertices with a source point
    area: float  # share of the target's area with a source triangle
    source_area: float  # share of the source's area with a target triangle
    followers: tuple[Follower, ...]  # following vertices, grouped by component


def measure_coverage(transfer: Transfer) -> Coverage:
    """Measure the shares of both meshes with a counterpart."""
    source, header, correspondence = transfer.source, transfer.header, transfer.correspondence
    topology = Topology(header.faces, header.vertex_count)
    component_of_vertex = topology.component_of_vertex
    names = name_components(header, topology)
    followers = []
    for component in np.unique(component_of_vertex[~correspondence.matched]).tolist():
        follower_ids = np.flatnonzero((component_of_vertex == component) & ~correspondence.matched)
        leader = int(correspondence.leaders[follower_ids[0]])
        leader_component = names[int(component_of_vertex[leader])]
        followers.append(Follower(names[component], len(follower_ids), leader, leader_component))
    is_mapped = correspondence.faces >= 0
    is_used = index_mask(correspondence.faces[is_mapped], len(source.header.faces))
    return Coverage(
        vertices=float(correspondence.matched.mean()),
        area=_area_share(is_mapped, TriangleMesh(transfer.target, topology).face_areas),
        source_area=_area_share(is_used, TriangleMesh(source.rest, source.topology).face_areas),
        followers=tuple(followers),
    )


def name_components(header: SequenceHeader, topology: Topology) -> list[str]:
    """Name connected components after their object in the file, or number them from 1."""
    component_of_vertex = topology.component_of_vertex
    object_sizes = [mesh_object.vertex_count for mesh_object in header.objects]
    object_of_vertex = np.repeat(np.arange(len(object_sizes)), object_sizes)
    names = []
    for component in range(int(component_of_vertex.max()) + 1):
        object_ids, sizes = np.unique(object_of_vertex[component_of_vertex == component], return_counts=True)
        name = header.objects[int(object_ids[0])].name if len(object_sizes) > 1 else ""
        is_whole_object = len(object_ids) == 1 and int(sizes[0]) == object_sizes[int(object_ids[0])]
        numbered = f"component {component + 1}" + (f" of {name}" if name else "")
        names.append(name if name and is_whole_object else numbered)
    return names


def _area_share(face_mask: NDArray[np.bool_], areas: Float) -> float:
    total_area = float(areas.sum())
    return float(areas[face_mask].sum() / total_area) if total_area > 0 else float(face_mask.mean())


FLAT_TRIANGLE_RATIO = 1e-3  # largest ratio of height to longest side of a flat triangle


@dataclass(frozen=True, eq=False)
class ExpectedTriangles:
    """Expected stretches and normals of the target's triangles."""

    gradients: GradientTransfer  # the two meshes at rest, and their correspondence
    rest: Float  # (V', 3) target at rest, in the unit of its mesh
    source_rest: Float  # (V, 3) source at rest, in the unit of its mesh

    @classmethod
    def from_transfer(cls, transfer: Transfer) -> ExpectedTriangles:
        """Prepare the expected triangles of a transfer, for any transfer method."""
        topology = Topology(transfer.header.faces, transfer.header.vertex_count)
        source, target = transfer.source, transfer.target
        gradients = gradient_transfer(source.topology, source.rest, topology, target, transfer.correspondence)
        return cls(gradients, target, source.rest)

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
        return degenerate_faces(self.rest, self.topology.faces, FLAT_TRIANGLE_RATIO)

    @cached_property
    def _rest_sides(self) -> Float:
        """Rest sides 01, 12, 20 ``(n, 3, 3)`` of the matched triangles, one side per row."""
        return _edge_vectors(self.rest, self.topology.faces[self.matched])

    @cached_property
    def lengths(self) -> Float:
        """Rest lengths ``(E',)`` of the target's edges; NaN for edges of zero length."""
        return _mask_zero_lengths(edge_lengths(self.rest, self.topology.edges))

    @cached_property
    def source_lengths(self) -> Float:
        """Rest lengths ``(E,)`` of the source's edges; NaN for edges of zero length."""
        return _mask_zero_lengths(edge_lengths(self.source_rest, self.source.edges))

    def sides(self, x: Float) -> Float:
        """Return the expected sides ``(n, 3, 3)`` of matched triangles in a frame ``(V, 3)``."""
        faces = self.gradients.correspondence.faces[self.matched]
        gradients = self.gradients.alignment.rotate_matrices(self.gradients.source_gradients(x)[faces])
        return np.asarray(self._rest_sides @ np.swapaxes(gradients, 1, 2))

    def stretches(self, sides: Float) -> Float:
        """Return the expected stretches ``(E',)`` of the target's edges; 1 for edges without a source triangle."""
        with np.errstate(divide="ignore", invalid="ignore"):
            stretches = np.linalg.norm(sides, axis=2) / np.linalg.norm(self._rest_sides, axis=2)
        of_side = np.ones((len(self.topology.faces), 3))
        of_side[self.matched] = stretches
        edges = self.topology.face_edges.reshape(-1)
        sums = np.bincount(edges, of_side.reshape(-1), len(self.topology.edges))
        return np.asarray(sums / np.bincount(edges, minlength=len(self.topology.edges)))

    def turned_over(self, y: Float, sides: Float) -> Mask:
        """Mark matched triangles ``(n,)`` that face away from their expected normals in a frame ``(V', 3)``."""
        actual_sides = _edge_vectors(y, self.topology.faces[self.matched])
        normals = np.cross(actual_sides[:, 0], actual_sides[:, 1])
        expected_normals = np.cross(sides[:, 0], sides[:, 1])
        return np.asarray((normals * expected_normals).sum(axis=1) < 0)

    def newly_flat(self, y: Float) -> Mask:
        """Mark triangles ``(F',)`` that are flat in a frame ``(V', 3)``, but not at rest."""
        return np.asarray(degenerate_faces(y, self.topology.faces, FLAT_TRIANGLE_RATIO) & ~self.flat)


def _edge_vectors(points: Float, faces: NDArray[Any]) -> Float:
    """Return sides 01, 12, 20 ``(n, 3, 3)`` of triangles ``(n, 3)``, one side per row."""
    corners = points[faces]
    return np.asarray(np.roll(corners, -1, axis=1) - corners)


def _mask_zero_lengths(lengths: Float) -> Float:
    return np.where(lengths > 0, lengths, np.nan)


class Acceleration:
    """Statistics of the second differences of frames, which are added in blocks."""

    def __init__(self) -> None:
        self._last_frames: Float | None = None
        self._square_sum, self._sample_count, self._max_square, self._frame_count = 0.0, 0, 0.0, 0
        self.worst_frame = self.worst_vertex = 0

    def add(self, block: Float) -> None:
        """Add the next frames ``(B, V, 3)``."""
        frames = block if self._last_frames is None else np.concatenate([self._last_frames, block])
        for index in range(1, len(frames) - 1):
            previous, current, following = frames[index - 1 : index + 2]
            squares = np.square(following - 2.0 * current + previous).sum(axis=1)
            self._square_sum += float(squares.sum())
            self._sample_count += len(squares)
            self._frame_count += 1  # the first difference is centred at frame 1
            if squares.max() > self._max_square:
                self._max_square, self.worst_frame = float(squares.max()), self._frame_count
                self.worst_vertex = int(squares.argmax())
        self._last_frames = frames[-2:]

    @property
    def rms(self) -> float:
        """Root mean square over all vertices and frames."""
        return float(np.sqrt(self._square_sum / max(self._sample_count, 1)))

    @property
    def max(self) -> float:
        """Largest acceleration of a vertex."""
        return float(np.sqrt(self._max_square))


@dataclass(frozen=True)
class Smoothness:
    """Root mean square and largest accelerations of vertices, in diagonals of the target per squared frame."""

    rms: float  # root mean square of the target
    max: float  # largest acceleration of a target vertex
    source_rms: float  # root mean square of the source, scaled to the target
    source_max: float  # largest acceleration of a source point, scaled to the target
    worst_frame: int  # frame of the target's largest acceleration
    worst_vertex: int  # vertex with that acceleration

    @property
    def ratio(self) -> float | None:
        """Ratio of root mean squares, target to source; None if the source does not accelerate."""
        return self.rms / self.source_rms if self.source_rms > 0 else None


MAX_INTERSECTION_FRAMES = 8  # largest number of frames in which self-intersections are counted


@dataclass(frozen=True)
class FrameCounts:
    """Counts of triangles or pairs at rest, and in the measured frames."""

    rest: int  # count at rest
    frames: tuple[int, ...]  # ids of the measured frames
    values: tuple[int, ...]  # counts in the measured frames
    vertices: tuple[int, ...] = ()  # a vertex to look at in each measured frame

    @property
    def mean(self) -> float:
        """Mean count over the measured frames."""
        return float(np.mean(self.values))

    @property
    def worst(self) -> int:
        """Largest count of a measured frame."""
        return max(self.values)

    @property
    def worst_frame(self) -> int:
        """First frame with the largest count."""
        return self.frames[self.values.index(self.worst)]

    @property
    def worst_vertex(self) -> int | None:
        """Vertex to look at in the first frame with the largest count, if it is known."""
        return self.vertices[self.values.index(self.worst)] if self.vertices else None

    def as_dict(self, per_frame: bool = False) -> dict[str, Any]:
        """Return plain values for JSON, optionally with counts per frame."""
        summary = {"rest": self.rest, "mean": self.mean, "worst": self.worst, "worst_frame": self.worst_frame}
        return summary | ({"frames": list(self.frames), "values": list(self.values)} if per_frame else {})


@dataclass(frozen=True)
class FrameExtreme:
    """Largest value of all frames."""

    value: float  # value of the worst frame
    frame: int  # worst frame
    vertex: int | None = None  # vertex with that value, if it is one of a vertex


@dataclass(frozen=True)
class TransferReport:
    """Measures of a transfer, with the formulas at the head of this module."""

    coverage: Coverage  # shares of both meshes with a counterpart
    strain: Statistics  # strain of the target's edges
    source_strain: Statistics  # strain of the source's edges
    excess: Statistics  # excess of the target's edges
    smoothness: Smoothness | None  # accelerations; None for fewer than three frames
    intersections: FrameCounts  # intersecting pairs of triangles of the target
    source_intersections: FrameCounts  # intersecting pairs of triangles of the source
    turned_over: FrameCounts  # turned-over triangles of the target, in all frames
    flat: FrameCounts  # triangles of the target that become flat, in all frames
    volume: FrameExtreme  # volume change
    lift: FrameExtreme  # height of the target over the ground where the source stands on it, in diagonals

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        smooth = self.smoothness
        return {
            "coverage": asdict(self.coverage),
            "strain": asdict(self.strain),
            "source_strain": asdict(self.source_strain),
            "excess_strain": asdict(self.excess),
            "acceleration": None if smooth is None else asdict(smooth) | {"ratio": smooth.ratio},
            "self_intersections": self.intersections.as_dict(per_frame=True),
            "source_self_intersections": self.source_intersections.as_dict(per_frame=True),
            "turned_over": self.turned_over.as_dict(),
            "flat": self.flat.as_dict(),
            "volume_change": asdict(self.volume),
            "lift": asdict(self.lift),
        }


def measure_transfer(transfer: Transfer, blocks: Iterable[FloatArray] | None = None) -> TransferReport:
    """Measure a transfer; `blocks` are its result in blocks ``(B, V', 3)``, computed if not given."""
    meter = TransferMeter(transfer)
    for block in transfer.blocks() if blocks is None else blocks:
        meter.add(block)
    return meter.report()


MIN_VOLUME_RATIO = 1e-3  # smallest ratio of volumes in logarithms
GROUND_DIAGONALS = 0.02  # largest height of source points on the ground, in diagonals of the source


class TransferMeter:
    """Meter that measures a transfer block by block."""

    def __init__(self, transfer: Transfer) -> None:
        self._transfer = transfer
        self._expected = ExpectedTriangles.from_transfer(transfer)
        self._frame_count, self._measured_count = len(transfer.source.points), 0
        edges, source_edges = len(self._expected.topology.edges), len(transfer.source.topology.edges)
        self._strain, self._excess = (RunningStatistics(self._frame_count * edges) for _ in range(2))
        self._source_strain = RunningStatistics(self._frame_count * source_edges)
        self._accelerations = Acceleration(), Acceleration()
        self._intersection_frames = tuple(evenly_spaced(self._frame_count, MAX_INTERSECTION_FRAMES).tolist())
        self._intersections: list[tuple[int, int, int]] = []
        self._turned_over: list[tuple[int, int]] = []
        self._flat: list[tuple[int, int]] = []
        self._rest_volumes = self._volumes(transfer.source.rest, transfer.target)
        self._volume, self._lift = FrameExtreme(0.0, 0), FrameExtreme(0.0, 0)

    def measure_blocks(self, blocks: Iterable[FloatArray]) -> Iterator[FloatArray]:
        """Yield given blocks of the target's points, and measure each."""
        for block in blocks:
            self.add(block)
            yield block

    def add(self, block: FloatArray) -> None:
        """Measure the next frames ``(B, V', 3)`` of the target."""
        check_block(self._transfer.header, block, self._measured_count)
        start, stop = self._measured_count, self._measured_count + len(block)
        if stop > self._frame_count:
            raise InvalidSequenceError(
                f"there are more frames than the {self._frame_count} of the source; give one frame for each of them"
            )
        source_block = self._transfer.source.points[start:stop].astype(np.float64)
        target_block, expected = block.astype(np.float64), self._expected
        for frame, source, target in zip(range(start, stop), source_block, target_block, strict=True):
            sides = expected.sides(source)
            stretches = edge_lengths(target, expected.topology.edges) / expected.lengths
            source_stretches = edge_lengths(source, expected.source.edges) / expected.source_lengths
            self._strain.add(np.abs(stretches - 1.0))
            self._excess.add(np.abs(stretches - expected.stretches(sides)))
            self._source_strain.add(np.abs(source_stretches - 1.0))
            is_turned = np.zeros(len(expected.topology.faces), dtype=bool)
            is_turned[expected.matched] = expected.turned_over(target, sides)
            for counts, mask in ((self._turned_over, is_turned), (self._flat, expected.newly_flat(target))):
                counts.append((int(mask.sum()), int(expected.topology.faces[mask.argmax(), 0])))
            if frame in self._intersection_frames:
                crossing = _find_intersections(target, expected.topology)
                face = int(np.bincount(crossing.reshape(-1), minlength=1).argmax())
                source_count = len(_find_intersections(source, expected.source))
                self._intersections.append((len(crossing), source_count, int(expected.topology.faces[face, 0])))
            if self._rest_volumes.min() > 0:
                change = np.log(np.maximum(self._volumes(source, target) / self._rest_volumes, MIN_VOLUME_RATIO))
                difference = FrameExtreme(float(change[1] - change[0]), frame)
                self._volume = max(self._volume, difference, key=lambda each: abs(each.value))
        carried = self._transfer.correspondence.interpolate(source_block)
        target_acceleration, source_acceleration = self._accelerations
        target_acceleration.add(target_block)
        source_acceleration.add(carried)
        self._measure_lift(carried, target_block)
        self._measured_count = stop

    def _volumes(self, source: Float, target: Float) -> Float:
        """Return the volumes ``(2,)`` of source and target; those of open components depend on where they are."""
        meshes = (source, self._expected.source.faces), (target, self._expected.topology.faces)
        corners = [(points - points.mean(axis=0))[faces] for points, faces in meshes]
        return np.array([np.linalg.det(each).sum() / 6 for each in corners])

    def _measure_lift(self, carried: Float, target_block: Float) -> None:
        """Measure the lift in frames ``(B, V', 3)``, with the source points of all vertices."""
        up = UP_AXES.index(self._transfer.header.up_axis)
        toward = np.eye(3)[up]
        source_up = self._expected.gradients.alignment.rotation.T @ toward
        size, source_size = (bounding_diagonal(x) for x in (self._transfer.target, self._transfer.source.rest))
        is_matched = self._transfer.correspondence.matched
        for frame, x, y in zip(range(self._measured_count, self._frame_count), carried, target_block, strict=False):
            heights, source_heights = y @ toward, x @ source_up
            is_low = is_matched & (source_heights <= source_heights[is_matched].min() + GROUND_DIAGONALS * source_size)
            vertex_ids = np.flatnonzero(is_low)[np.argsort(heights[is_low], kind="stable")]
            vertex = int(vertex_ids[int(0.9 * (len(vertex_ids) - 1))])
            lift = float(heights[vertex] - heights.min()) / (size or 1.0)
            if lift > self._lift.value:
                self._lift = FrameExtreme(lift, frame, vertex)

    def report(self) -> TransferReport:
        """Return the report; all frames must have been added."""
        if self._measured_count < self._frame_count:
            raise InvalidSequenceError(
                f"{self._measured_count} frames were measured, the source has {self._frame_count}; give one frame for "
                "each of them"
            )
        transfer, expected = self._transfer, self._expected
        target, source, crossing_vertices = zip(*self._intersections, strict=True)
        rest_count = len(_find_intersections(transfer.target, expected.topology))
        source_rest_count = len(_find_intersections(transfer.source.rest, expected.source))
        all_frames = tuple(range(self._frame_count))
        diagonal = bounding_diagonal(transfer.target) or 1.0
        source_diagonal = diagonal / expected.gradients.alignment.scale
        smoothness = None
        if self._frame_count > 2:
            target_acceleration, source_acceleration = self._accelerations
            smoothness = Smoothness(
                target_acceleration.rms / diagonal,
                target_acceleration.max / diagonal,
                source_acceleration.rms / source_diagonal,
                source_acceleration.max / source_diagonal,
                target_acceleration.worst_frame,
                target_acceleration.worst_vertex,
            )
        return TransferReport(
            coverage=measure_coverage(transfer),
            strain=self._strain.result(),
            source_strain=self._source_strain.result(),
            excess=self._excess.result(),
            smoothness=smoothness,
            intersections=FrameCounts(rest_count, self._intersection_frames, target, crossing_vertices),
            source_intersections=FrameCounts(source_rest_count, self._intersection_frames, source),
            turned_over=FrameCounts(0, all_frames, *zip(*self._turned_over, strict=True)),
            flat=FrameCounts(int(expected.flat.sum()), all_frames, *zip(*self._flat, strict=True)),
            volume=self._volume,
            lift=self._lift,
        )


def _find_intersections(points: Float, topology: Topology) -> Index:
    from mixseq.mesh.nearest import self_intersections

    return self_intersections(points, topology.faces)
