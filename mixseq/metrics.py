r"""Distances between two mesh sequences: positions, lengths, angles, volume.

:math:`A, B` are the points ``(T, V, 3)`` of the reference and of the other sequence, and d is the unit of errors, by
default the diagonal of the bounding box of A's first frame (`mixseq.sequence.sequence.reference_diagonal`):

- *KG error* (Karni and Gotsman 2004): :math:`100\,\|A - B\|_F / \|A - \bar A\|_F` percent, where
  :math:`\bar A` holds the centroid of every frame of A
- *rms error* :math:`\|A - B\|_F / (d \sqrt{TV})` and *max error* :math:`\max_{tv} |A_{tv} - B_{tv}| / d`
- *strain* of an edge: :math:`|\,l_B / l_A - 1\,|`
- *dihedral error* of a hinge: the absolute difference of its angles, at most 180 degrees
- *volume error* of a frame: :math:`|\mathrm{vol}_B / \mathrm{vol}_A - 1|`

Frames are compared in blocks, in float64, at any scale (`mixseq.mesh.measures`). Percentiles are exact, because the
largest thousandth of all values is stored.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import chain, islice
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from mixseq.compression.numbering import Renumbering, match_meshes, mesh_of, with_mesh_of
from mixseq.errors import InvalidSequenceError
from mixseq.mesh.measures import Diagonal, degenerate_faces, dihedral_angles, edge_lengths, element_blocks, wrap_angles
from mixseq.mesh.polygons import describe_difference
from mixseq.mesh.topology import Topology
from mixseq.runtime.low_memory import RunningStatistics, Statistics
from mixseq.runtime.progress import Progress, log_progress
from mixseq.runtime.public import FileOr, HasFrames, public
from mixseq.sequence.frame_rates import FRAME_TOLERANCE
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import Frames, reference_diagonal
from mixseq.signals.decoding import largest_distance, played_blocks, quarter_times
from mixseq.signals.model import Model
from mixseq.types import Float

MIN_NORMAL_HEIGHT_RATIO = 1e-6  # ratio of height to longest side up to which the normal of a face is undefined

_MAX_BLOCK_VERTICES = 50_000  # vertices in all frames of a block: about 40 MB of temporary arrays


@dataclass(frozen=True)
class VolumeError:
    """Relative error of the enclosed volume: mean and largest over the frames."""

    mean: float
    max: float


@dataclass(frozen=True, eq=False)
class Comparison:
    """Result of `compare`; formulas are in the docstring of `mixseq.metrics`.

    Errors relative to zero, such as the KG error of a mesh whose vertices coincide, are 0 if nothing differs, otherwise
    infinite.

    Attributes
    ----------
    frames, vertices : int
        Number of frames and vertices of each sequence.
    diagonal : float
        Unit of `rms_error`, `max_error` and `per_frame_max`, in the units of the reference.
    kg_percent : float
        Karni-Gotsman error.
    rms_error, max_error : float
        Distance of vertices, in diagonals.
    worst_frame, worst_time : int, float
        Frame of the largest distance, and its time in seconds.
    edge_strain : Statistics
        Strain of the edges; edges of length zero in the reference are skipped.
    dihedral_degrees : Statistics
        Dihedral error; hinges where a face has no area, in either sequence, are skipped.
    volume : VolumeError or None
        Volume error; None unless the mesh is closed, consistently oriented and has a volume.
    max_time_difference : float
        Largest difference of the times of two frames that are compared, in seconds.
    per_frame_max : (T,) float64
        Largest distance of a vertex in every frame, in diagonals.
    """

    frames: int
    vertices: int
    diagonal: float
    kg_percent: float
    rms_error: float
    max_error: float
    worst_frame: int
    worst_time: float
    edge_strain: Statistics
    dihedral_degrees: Statistics
    volume: VolumeError | None
    max_time_difference: float
    per_frame_max: Float

    def as_dict(self, per_frame: bool = False) -> dict[str, Any]:
        """Return plain numbers for JSON, with None for infinite values; include `per_frame_max` if `per_frame`."""
        plain = asdict(self)
        plain["per_frame_max"] = self.per_frame_max.tolist()
        if not per_frame:
            del plain["per_frame_max"]
        finite: dict[str, Any] = _finite(plain)
        return finite


@public
def compare(a: FileOr[Frames | HasFrames], b: FileOr[Frames | HasFrames]) -> Comparison:
    """Measure how far a sequence is from a reference.

    Both sequences may be larger than memory, see `mixseq.open_sequence`.

    Parameters
    ----------
    a : MeshSequence or SequenceReader
        The reference.
    b : MeshSequence or SequenceReader
        The compared sequence, with the same mesh and times; a compressed file (``order="free"``) may renumber vertices.

    Raises
    ------
    InvalidSequenceError
        If vertices, faces, or times differ; the message states the difference.
    FormatError
        If a file that is read is damaged.

    Examples
    --------
    >>> from mixseq import MeshSequence
    >>> points = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]])
    >>> a = MeshSequence.from_arrays(points, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    >>> error = compare(a, a.with_points(1.1 * points))
    >>> round(error.edge_strain.max, 9), round(error.volume.max, 9), round(error.dihedral_degrees.max, 9)
    (0.1, 0.331, 0.0)
    """
    a = cast("Frames", a)
    b = cast("Frames", b)
    a, _ = match_reference(a, b.header)
    header = a.header
    topology = Topology(header.faces, header.vertex_count)
    strains = RunningStatistics(header.frame_count * len(topology.edges))
    angles = RunningStatistics(header.frame_count * len(topology.hinge_faces))
    defects = topology.boundary_edges, topology.non_manifold_edges, topology.inconsistent_edges
    is_closed = not any(len(edges) for edges in defects)
    error_squares = variation_squares = 0.0
    unit = Diagonal(0.0, 0)
    largest: list[Float] = []
    volumes: list[Float] = []
    for x, y in paired_blocks(a, b, max(1, _MAX_BLOCK_VERTICES // header.vertex_count)):
        if not largest:
            unit = reference_diagonal(chain([x], a.blocks()))
        difference, x, y = (unit.rescale(lengths) for lengths in (x - y, x, y))
        squares = np.einsum("tvi,tvi->tv", difference, difference)
        error_squares += float(squares.sum())
        variation_squares += float(np.square(x - x.mean(axis=1, keepdims=True)).sum())
        largest.append(np.sqrt(squares.max(axis=1)))
        _add_strains(strains, topology, x, y)
        _add_angles(angles, topology, x, y)
        if is_closed:
            volumes.append(np.stack([_signed_volumes(x, header.faces), _signed_volumes(y, header.faces)]))

    per_frame = np.concatenate(largest)
    worst = int(per_frame.argmax())
    count = header.frame_count * header.vertex_count
    return Comparison(
        frames=header.frame_count,
        vertices=header.vertex_count,
        diagonal=unit.length,
        kg_percent=100 * error_ratio(np.sqrt(error_squares), np.sqrt(variation_squares)),
        rms_error=error_ratio(np.sqrt(error_squares / count), unit.fraction),
        max_error=error_ratio(per_frame[worst], unit.fraction),
        worst_frame=worst,
        worst_time=float(header.times[worst]),
        edge_strain=strains.result(),
        dihedral_degrees=angles.result(),
        volume=_volume_error(np.concatenate(volumes, axis=1), unit.fraction) if is_closed else None,
        max_time_difference=float(np.abs(header.times - b.header.times).max()),
        per_frame_max=np.array([error_ratio(value, unit.fraction) for value in per_frame]),
    )


@public
def measure_between(
    source: FileOr[Frames | Model], delivery: FileOr[Model | Frames], progress: Progress = log_progress
) -> float:
    """Measure how far a file is from its source between frames, as it is played.

    Players interpolate a rig as its file says, other points along straight lines. Compressed models are played by the
    splines of `CompressedModel.playback`. Points are compared at the quarters of the intervals between frames.

    Parameters
    ----------
    source : Model, MeshSequence or SequenceReader
        The reference: a model, an open rig, or a sequence, of which the exact model is fitted.
    delivery : Model, MeshSequence or SequenceReader
        The same mesh at times of the source, at any frame rate.
    progress : callable, optional
        Called while a model is fitted.

    Returns
    -------
    float
        Largest distance of a vertex, in diagonals of the source's first frame.

    Raises
    ------
    InvalidSequenceError
        If the meshes differ.
    SettingsError
        If the delivery has frames before or after the source.

    Examples
    --------
    >>> import mixseq
    >>> mixseq.measure_between("arm.h5", "arm.h5")
    0.0
    """
    from mixseq.signals.fitting import as_motion

    source = cast("Frames | Model", source)
    delivery = cast("Frames | Model", delivery)
    motion = as_motion(source, progress)
    times = quarter_times(delivery.header.times)
    vertices = _match_mesh(motion.header, delivery.header).vertices
    expected = (block[:, vertices] for block in motion.blocks(times))
    played = played_blocks(getattr(delivery, "playback", delivery), times)
    unit = reference_diagonal(motion.blocks(motion.times)).length
    return error_ratio(largest_distance(expected, played), unit)


def match_frames(a: SequenceHeader, b: SequenceHeader) -> NDArray[np.int64] | None:
    """Return the frame indices ``(T,)`` of b at the times of a, or with its numbers; None if b lacks one of them.

    Times in single precision are off by up to 1e-4 of a frame after a minute, so they count as equal within
    `FRAME_TOLERANCE`. Sequences of as many frames at other rates, such as 24 and 23.976, are paired by number.
    """
    frames = _match_nearest(a.times, b.times, FRAME_TOLERANCE / a.fps)
    if frames is None and a.frame_count == b.frame_count:
        return _match_nearest(a.times * a.fps, b.times * b.fps, FRAME_TOLERANCE)
    return frames


def _match_nearest(a: Float, b: Float, tolerance: float) -> NDArray[np.int64] | None:
    """Return the index in b of each of the times in a ``(T,)``; None if one differs by more than the tolerance.

    The tolerance is at most a quarter of the smallest step.
    """
    after = np.clip(np.searchsorted(b, a), 1, max(b.size - 1, 1))
    before = after - 1
    after = np.minimum(after, b.size - 1)
    frames = np.where(np.abs(b[before] - a) <= np.abs(b[after] - a), before, after)
    tolerance = min(tolerance, np.concatenate([np.diff(a), np.diff(b)]).min(initial=np.inf) / 4)
    return frames if (np.abs(b[frames] - a) <= tolerance).all() else None


def match_reference(a: Frames, b: SequenceHeader) -> tuple[Frames, Renumbering]:
    """Return the reference `a` with vertices in the order of `b`, and their renumbering.

    Polygons may be in any order. Vertices may be renumbered by a compressed file. Raises InvalidSequenceError if meshes
    or times differ.
    """
    header = a.header
    renumbering = _match_mesh(header, b)
    _check_count("frames", header.frame_count, b.frame_count)
    if match_frames(header, b) is None:
        frame = int(np.argmax(np.abs(header.times - b.times) > FRAME_TOLERANCE / header.fps))
        raise InvalidSequenceError(
            f"{header.frame_name(frame)} is at {header.times[frame]:.9g} s in the reference, at "
            f"{b.times[frame]:.9g} s in the other sequence; give sequences with the same times"
        )
    return (a if renumbering.order != "free" else with_mesh_of(a, b, renumbering.vertices)), renumbering


def _match_mesh(a: SequenceHeader, b: SequenceHeader) -> Renumbering:
    """Return the renumbering of vertices from a to b; raise InvalidSequenceError if meshes differ."""
    _check_count("vertices", a.vertex_count, b.vertex_count)
    renumbering = match_meshes(mesh_of(a), mesh_of(b))
    if renumbering is None:
        difference = describe_difference(a.polygons, b.polygons, ("the reference", "the other sequence"))
        raise InvalidSequenceError(f"{difference}; vertices must be in the same order")
    return renumbering


def _check_count(what: str, count: int, other_count: int) -> None:
    if count != other_count:
        raise InvalidSequenceError(f"the reference has {count} {what}, the other sequence {other_count}")


def paired_blocks(a: Frames, b: Frames, size: int) -> Iterator[tuple[Float, Float]]:
    """Yield the points of both sequences in blocks ``(B, V, 3)`` of `size` frames, as float64."""
    x, y = (chain.from_iterable(sequence.blocks(size)) for sequence in (a, b))
    while x_block := list(islice(x, size)):
        y_block = list(islice(y, size))
        if len(y_block) != len(x_block):
            raise InvalidSequenceError("the other sequence ends before the reference; its file is incomplete")
        yield np.stack(x_block).astype(np.float64), np.stack(y_block).astype(np.float64)
    if next(y, None) is not None:
        raise InvalidSequenceError("the other sequence has more frames than the reference; its header is wrong")


def _add_strains(strains: RunningStatistics, topology: Topology, x: Float, y: Float) -> None:
    for block in element_blocks(len(topology.edges), len(x)):
        edges = topology.edges[block]
        lengths = edge_lengths(x, edges)
        defined = lengths > 0
        strains.add(np.abs(edge_lengths(y, edges)[defined] / lengths[defined] - 1))


def _add_angles(angles: RunningStatistics, topology: Topology, x: Float, y: Float) -> None:
    degenerate = np.logical_or(*(degenerate_faces(z, topology.faces, MIN_NORMAL_HEIGHT_RATIO) for z in (x, y)))
    hinge_faces = topology.hinge_faces
    for block in element_blocks(len(hinge_faces), len(x)):
        hinges, defined = topology.hinges_at(block), ~degenerate[:, hinge_faces[block]].any(axis=2)
        x_angles, y_angles = (dihedral_angles(z, hinges)[defined] for z in (x, y))
        angles.add(np.degrees(np.abs(wrap_angles(y_angles - x_angles))))


def _signed_volumes(points: Float, faces: NDArray[np.int32]) -> Float:
    """Return signed volumes ``(B,)``, summed over tetrahedra between each face and the centroid."""
    centred = points - points.mean(axis=1, keepdims=True)
    volumes = np.zeros(len(points))
    for block in element_blocks(len(faces), len(points)):
        p, q, r = (centred[:, faces[block, corner]] for corner in range(3))
        volumes += np.einsum("tfi,tfi->t", p, np.cross(q, r)) / 6
    return volumes


def _volume_error(volumes: Float, diagonal: float) -> VolumeError | None:
    reference, other = volumes
    if (np.abs(reference) <= 1e-12 * diagonal**3).any():
        return None
    errors = np.abs(other / reference - 1)
    return VolumeError(mean=float(errors.mean()), max=float(errors.max()))


def error_ratio(value: float, unit: float) -> float:
    """Return an error in a unit; zero errors are zero in any unit, others infinite if the unit is zero."""
    if value == 0:
        return 0.0
    return float(value / unit) if unit > 0 else float("inf")


def _finite(value: Any) -> Any:
    """Replace infinite and nan values by None, as JSON cannot hold them."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
