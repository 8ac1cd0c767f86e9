"""Hold the streams and parameters of a compressed sequence, and decode them as players do.

Frozen: the JSON text in files has the same parameter names and meanings; changing them breaks old files
(golden: ``tests/formats/golden/compressed-v1.h5``).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import inf
from typing import Any, get_args

import numpy as np
from numpy.typing import ArrayLike

from mixseq.choices import OrderName
from mixseq.compression.bitstream.arithmetic import DAMAGE_CURE
from mixseq.compression.bitstream.corner_values import MAX_COORDINATE
from mixseq.compression.bitstream.residual_layer import CodedResidualLayer
from mixseq.compression.bitstream.signal_graph import SignalGraph, mesh_graph
from mixseq.compression.bitstream.spatial_basis import (
    MAX_NORM,
    MAX_PARTS,
    BasisKind,
    FaceLabels,
    SpatialBasis,
    affine_basis,
    assemble_basis,
    decode_face_labels,
    part_groups,
    read_basis,
    read_coefficients,
)
from mixseq.errors import FormatError, SettingsError
from mixseq.mesh.polygons import label_vertices
from mixseq.runtime.lazy import PickledWithoutCaches, connected
from mixseq.runtime.parallel import one_blas_thread
from mixseq.runtime.progress import Progress
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.bodies import SAME_BODY, Relation
from mixseq.signals.curve import Curve
from mixseq.signals.decoding import Decodable
from mixseq.spaces.temporal import TemporalOperator, insert_midpoints, select_operator
from mixseq.types import Float, Index

MIN_COVARIANCE_LENGTH, MAX_COVARIANCE_LENGTH = 0.5, 64.0  # range of lengths, in mean steps between frames; frozen
MAX_CHUNK_FRAMES = 8192  # largest number of frames of a chunk; frozen
MAX_INBETWEEN_LEVELS = 3  # largest number of levels of in-betweens, each with twice the knots of the one before; frozen


@dataclass(frozen=True)
class Chunk:
    """Consecutive frames that can be decoded without other chunks."""

    first: int  # first frame
    count: int  # number of frames
    coefficients: bytes  # the coefficients of the spatial basis at these frames
    # The residual layer, which brings vertices within the bound; empty if none is needed.
    residuals: bytes = b""
    # In-betweens of the intervals that begin at these frames; empty if there are none, or all are zero.
    inbetweens: bytes = b""


@dataclass(frozen=True)
class CodingParameters:
    """Parameters needed for decoding: numbers and strings, named as in files."""

    factors: BasisKind  # kind of the spatial basis: see mixseq.compression.bitstream.spatial_basis
    rank: int  # number K of coded basis vectors of all parts together
    frame_count: int  # number T of frames
    step: float  # quantisation step, in the units of the sequence
    diagonal: float  # unit of errors, see `reference_diagonal`, in the units of the sequence
    # Guaranteed largest distance of a vertex from the original at the frames, in diagonals, measured by decoding.
    max_error: float
    kg_percent: float  # measured KG error of all frames, in percent
    # Whether max_error is a bound requested by the user, which the residual layer keeps.
    promised: bool
    correction: float = 0.0  # unit of the residual layer, in the units of the sequence; zero if there is none
    ranks: tuple[int, ...] = ()  # number of basis vectors of every part, if the mesh has several
    # Origin (x, y, z) of the decoded positions, in the units of the sequence. Empty if it is zero.
    origin: tuple[float, ...] = ()
    # Steps per unit of texture coordinates. None without rounded texture coordinates.
    uv_steps: int | None = None
    # Guaranteed largest difference of u and of v from the original. None if uv_steps is None.
    uv_error: float | None = None
    # Levels of in-betweens: 1 for the middles between frames, 2 for the quarters as well, and so on. None without.
    inbetween_levels: int | None = None
    # Quantisation step of in-betweens, in the units of the sequence. None if there are none.
    inbetween_step: float | None = None
    # Largest measured distance between frames from the fitted model, in diagonals. None if it was not fitted.
    inbetween_error: float | None = None
    # True if in-betweens move in the affine basis of the labelled parts, None if in the spatial basis.
    inbetween_parts: bool | None = None

    def __post_init__(self) -> None:
        kinds = get_args(BasisKind)
        if self.factors not in kinds:
            raise SettingsError(f"factors is {self.factors!r}; {' or '.join(kinds)} is expected")
        for name in ("rank", "frame_count"):
            value = getattr(self, name)
            if not (type(value) is int and value > 0):
                raise SettingsError(f"{name} is {value!r}; a whole number above zero is expected")
        for name in ("step", "diagonal", "max_error", "kg_percent", "correction"):
            value, positive = getattr(self, name), name in ("step", "diagonal")
            if not (_is_number(value) and 0 <= value < inf and (value or not positive)):
                raise SettingsError(
                    f"{name} is {value!r}; a {'positive' if positive else 'non-negative'} number is expected"
                )
        object.__setattr__(self, "ranks", tuple(self.ranks))
        if self.ranks and not (len(self.ranks) <= MAX_PARTS and sum(self.ranks) == self.rank):
            raise SettingsError(f"the parts have {self.ranks} basis vectors, which are not {self.rank} in all")
        if self.ranks and self.factors == "shapes":
            raise SettingsError("shapes are of the whole mesh, not of parts")
        if any(not (type(rank) is int and rank > 0) for rank in self.ranks):
            raise SettingsError(f"ranks are {self.ranks}; whole numbers above zero are expected")
        object.__setattr__(self, "origin", tuple(self.origin))
        if self.origin and not (len(self.origin) == 3 and all(_is_number(x) and abs(x) < inf for x in self.origin)):
            raise SettingsError(f"origin is {self.origin!r}; three numbers are expected")
        steps, error, most = self.uv_steps, self.uv_error, MAX_COORDINATE
        if (steps is None) != (error is None):
            raise SettingsError("uv_steps and uv_error come together")
        if steps is not None and not (type(steps) is int and 0 < steps <= most):
            raise SettingsError(f"uv_steps is {steps!r}; a whole number from 1 to {most} is expected")
        if error is not None and not (_is_number(error) and 0 <= error < inf):
            raise SettingsError(f"uv_error is {error!r}; a non-negative number is expected")
        levels, step, error = self.inbetween_levels, self.inbetween_step, self.inbetween_error
        if (levels is None) != (step is None):
            raise SettingsError("inbetween_levels and inbetween_step come together")
        if levels is not None and not (type(levels) is int and 0 < levels <= MAX_INBETWEEN_LEVELS):
            raise SettingsError(
                f"inbetween_levels is {levels!r}; a whole number from 1 to {MAX_INBETWEEN_LEVELS} is expected"
            )
        if step is not None and not (_is_number(step) and 0 < step < inf):
            raise SettingsError(f"inbetween_step is {step!r}; a positive number is expected")
        if error is not None and not (_is_number(error) and 0 <= error < inf):
            raise SettingsError(f"inbetween_error is {error!r}; a non-negative number is expected")
        if self.inbetween_parts is not None and (self.inbetween_parts is not True or levels is None):
            raise SettingsError(
                f"inbetween_parts is {self.inbetween_parts!r}; true is expected, beside inbetween_levels"
            )
        if not isinstance(self.promised, bool):
            raise SettingsError(f"promised is {self.promised!r}; true or false is expected")


@dataclass(frozen=True)
class TemporalInterpolation:
    """Interpolation of coefficients between frames, as chosen by `mixseq.spaces.temporal.select_operator`."""

    length: float  # length of the covariance, in mean steps between frames: from 0.5 to 64, or infinite
    # Weights of the usual cubic spline in the first and the last interval between frames, from 0 to 1.
    cubic: tuple[float, float]
    # First frames after cuts, increasing. The frames between two cuts are interpolated by themselves.
    cuts: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        length, cubic, least, most = self.length, self.cubic, MIN_COVARIANCE_LENGTH, MAX_COVARIANCE_LENGTH
        if not (_is_number(length) and (least <= length <= most or length == inf)):
            raise SettingsError(f"length is {length!r}; a number from {least:g} to {most:g} is expected, or infinity")
        is_pair = isinstance(cubic, tuple) and len(cubic) == 2
        if not (is_pair and all(_is_number(value) and 0 <= value <= 1 for value in cubic)):
            raise SettingsError(f"cubic is {cubic!r}; two numbers from 0 to 1 are expected")
        are_frames = isinstance(self.cuts, tuple) and all(type(frame) is int for frame in self.cuts)
        if not (are_frames and all(a < b for a, b in pairwise((0, *self.cuts)))):
            raise SettingsError(f"cuts is {self.cuts!r}; increasing numbers of frames from 1 on are expected")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


@dataclass(frozen=True, repr=False)
class CompressedSequence(PickledWithoutCaches):
    """A compressed sequence as stored in a file. `mixseq.compress` makes one, and `mixseq.save` stores it.

    ``max_error`` and ``kg_percent`` are in `parameters`; ``sample(times=, fps=)`` is that of `model`.

    Examples
    --------
    >>> import mixseq
    >>> corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    >>> growing = np.linspace(1, 2, 5)[:, None, None] * corners
    >>> sequence = mixseq.MeshSequence.from_arrays(growing, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    >>> coded = mixseq.compress(sequence, max_error=1e-3)
    >>> coded.parameters.max_error, len(coded.sample(fps=48)), coded([0.0, 0.05]).shape
    (0.001, 9, (2, 4, 3))
    """

    header: SequenceHeader  # mesh and times
    parameters: CodingParameters  # parameters of the streams
    # Groups of the spatial basis; each group needs the groups before it, and makes frames more accurate.
    basis: tuple[bytes, ...]
    chunks: tuple[Chunk, ...]  # signals over time: all frames, in order
    # Numbering kept from the original: of vertices and polygons, of vertices only, or none. Decoders ignore it.
    order: OrderName = "keep"
    # Interpolation of coefficients between frames. None if the decoder chooses it.
    between: TemporalInterpolation | None = None
    # Parts of triangles, used by `CompressedModel` between frames. None if found from the decoded frames.
    labels: FaceLabels | None = None
    # Further bodies, other meshes at the same times, each with its own streams and none of these.
    bodies: tuple[CompressedSequence, ...] = ()
    relation: Relation = SAME_BODY  # of a further body to the first

    def __post_init__(self) -> None:
        if len({each.header.name for each in self.all_bodies}) <= len(self.bodies):
            raise SettingsError(f"two bodies have the same name, {self.header.name!r}")
        for body in self.bodies:
            if body.bodies or not np.array_equal(body.header.times, self.header.times):
                raise SettingsError(f"the body {body.header.name!r} has other times than {self.header.name!r}")

    def __repr__(self) -> str:
        bound = f"{'within' if self.parameters.promised else 'error'} {self.parameters.max_error:.3g} diagonals"
        return f"CompressedSequence({self.header!r}, {self.nbytes} bytes of signals, {bound})"

    @property
    def all_bodies(self) -> tuple[CompressedSequence, ...]:
        """The sequence itself, and its further bodies."""
        return self, *self.bodies

    @property
    def nbytes(self) -> int:
        """Number of bytes of the signals of all bodies; a file also holds their meshes."""
        chunks = (part for each in self.chunks for part in (each.coefficients, each.residuals, each.inbetweens))
        return sum(map(len, (*self.basis, *chunks))) + sum(each.nbytes for each in self.bodies)

    @cached_property
    def parts(self) -> Index | None:
        """Part ``(F,)`` of every triangle; None if the file has none."""
        return decode_face_labels(self.labels, self.header.faces)

    @cached_property
    def model(self) -> Decodable:
        """The decoded model, which `mixseq.load` returns for a file of this sequence."""
        find_name, _ = connected()  # the model knows spaces and fitting, which decoders at frames do without
        model: Decodable = find_name("CompressedModel").from_sequence(self)
        return model

    def __call__(self, times: ArrayLike) -> Float:
        """Return the vertex positions ``(V, 3)`` at a time in seconds, or ``(N, V, 3)`` at times ``(N,)``."""
        return self.model(times)

    def sample(self, times: ArrayLike | None = None, fps: float | None = None, **options: Any) -> MeshSequence:
        """Decode frames of the motion to a mesh sequence; see `Model.sample`."""
        return self.model.sample(times, fps, **options)


@dataclass(frozen=True, eq=False)
class Playback(Decodable, PickledWithoutCaches):
    """A compressed sequence as players in browsers show it: cubic splines of vertex positions through in-betweens.

    Frames between two cuts have a spline of their own, which goes on straight until half-way to the next frame.
    """

    header: SequenceHeader  # mesh and times
    basis: SpatialBasis  # spatial basis of K varying vectors
    coefficients: Float  # (T, K, d) coefficients of all frames
    between: TemporalInterpolation  # interpolation of coefficients between frames
    residual_layer: CodedResidualLayer | None  # displacements added to bring vertices within the bound
    # Level by level ((T - 1) 2^l, K, d), the in-betweens: offsets of coefficients from the spline at the middles
    # between its knots.
    inbetweens: tuple[Float, ...] = ()
    origin: tuple[float, ...] = ()  # origin (x, y, z) of positions; empty if it is zero
    parts_basis: SpatialBasis | None = None  # affine basis of in-betweens; None if it is the spatial basis
    labels: FaceLabels | None = None  # parts of triangles
    relation: Relation = SAME_BODY  # of a further body to the first

    @cached_property
    def parts(self) -> Index | None:
        """Part ``(F,)`` of every triangle, decoded when first needed, which takes a tenth of opening a file."""
        try:
            return decode_face_labels(self.labels, self.header.faces)
        except FormatError as error:
            raise FormatError(f"{self.header.file_name}: {error}") from error

    @property
    def inbetween_basis(self) -> SpatialBasis:
        """The basis of in-betweens."""
        return self.parts_basis or self.basis

    @cached_property
    def sections(self) -> tuple[Curve, ...]:
        """The coefficients over time between two cuts, K d coordinates, and those of `parts_basis`."""
        bounds = (0, *self.between.cuts, len(self.coefficients))
        return tuple(self._section(first, end) for first, end in pairwise(bounds))

    def _section(self, first: int, end: int) -> Curve:
        times = insert_midpoints(self.header.times[first:end])
        operator = TemporalOperator(times[::2], self.between.length, self.between.cubic)
        values = operator.weights_at(times).interpolate(self._rows(first, end))
        for level, offsets in enumerate(self.inbetweens):
            if level:
                finer = insert_midpoints(times)
                times, values = finer, Curve(times, values)(finer)
            own = offsets[first << level : (end - 1) << level]
            values[1::2, -offsets[0].size :] += own.reshape(len(own), offsets[0].size)
        return Curve(times, values)

    def _rows(self, first: int, end: int) -> Float:
        """Return the coordinates of frames from `first` to before `end`."""
        rows = self.coefficients[first:end].reshape(end - first, -1)
        return rows if self.parts_basis is None else np.pad(rows, ((0, 0), (0, 3 * len(self.parts_basis.part_ids))))

    @cached_property
    def _edges(self) -> Float:
        """Times half-way between the frames beside cuts, at which the next section begins."""
        times, after = self.header.times, np.array(self.between.cuts, dtype=np.int64)
        return np.asarray(times[after - 1] + 0.5 * (times[after] - times[after - 1]))

    def _coordinates(self, times: Float, order: int) -> Float:
        """Return the coordinates, or their derivatives, at times ``(N,)``."""
        section_ids = np.searchsorted(self._edges, times, side="right")
        result = np.empty((len(times), self.sections[0].dim))
        for number in np.unique(section_ids):
            mask, curve = section_ids == number, self.sections[number]
            own = np.clip(times[mask], curve.start, curve.end)
            values = curve.derivative(own) if order else curve(own)
            beyond = times[mask] - own
            first, end = (0, *self.between.cuts, len(self.coefficients))[number : number + 2]
            for outside, at in ((beyond < 0, first), (beyond > 0, max(end - 2, first))):
                if outside.any():
                    ends = slice(at, min(at + 2, end))
                    change = np.diff(self._rows(ends.start, ends.stop), axis=0).sum(axis=0)
                    slope = change / (np.diff(self.header.times[ends]).sum() or 1.0)
                    values[outside] = slope if order else values[outside] + beyond[outside, None] * slope
            result[mask] = values
        return result

    def prepare(self, times: Float, velocities: bool, progress: Progress) -> None:
        """Make the curves, before threads use them."""
        _ = self.sections

    def decode_points(self, times: Float) -> Float:
        """Implement `Decodable.decode_points`."""
        points = self._decode_coefficients(self._coordinates(times, 0))
        if self.residual_layer is not None:
            points += self.residual_layer.at(times)
        return points + self.origin if self.origin else points

    def decode_moving(self, times: Float) -> tuple[Float, Float]:
        """Implement `Decodable.decode_moving`."""
        rates = self._coordinates(times, 1)
        velocities = self._decode_coefficients(rates) - self._decode_coefficients(0 * rates)  # without the mean shape
        if self.residual_layer is not None:
            velocities += self.residual_layer.rates(times)
        return self.decode_points(times), velocities

    def _decode_coefficients(self, values: Float) -> Float:
        """Return the points ``(N, V, 3)`` of coefficients ``(N, K d)``."""
        points = np.empty((len(values), self.header.vertex_count, 3))
        shape, size = self.coefficients.shape[1:], self.coefficients[0].size
        with one_blas_thread():
            for row, value in zip(points, values, strict=True):  # row by row, so that each is independent of the others
                row[:] = self.basis.frames(value[:size].reshape(1, *shape))[0]
                if self.parts_basis is not None:
                    row += self.parts_basis.frames(value[size:].reshape(1, -1, 3))[0]
        return points


def decode(coded: CompressedSequence, cuts: tuple[int, ...] = ()) -> Playback:
    """Decode the streams of a compressed sequence, and choose its interpolation between `cuts` if it has none."""
    header = coded.header
    graph = mesh_graph(header.faces, header.vertex_count)
    # Damaged files may have numbers that are not finite.
    with one_blas_thread(), np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        basis = decode_basis(coded, graph)
        coefficients = np.concatenate([decode_coefficients(coded, chunk, basis) for chunk in coded.chunks])
        parts_basis = parts_basis_of(coded, basis, coefficients) if coded.parameters.inbetween_parts else None
        inbetweens = _decode_inbetweens(coded, parts_basis or basis)
        if not all(np.isfinite(values).all() for values in (basis.norms, coefficients, *inbetweens)):
            raise FormatError(f"the coded signals are damaged, they are not finite; {DAMAGE_CURE}")
    residual_layer = None
    if any(chunk.residuals for chunk in coded.chunks):
        chunks = tuple((chunk.count, chunk.residuals) for chunk in coded.chunks)
        residual_layer = CodedResidualLayer(
            header.times, chunks, header.faces, header.vertex_count, coded.parameters.correction, graph
        )
    between = coded.between
    if between is None:
        displacements = coefficients * basis.norms[basis.varying, None]
        first, end = max(pairwise((0, *cuts, len(displacements))), key=lambda bounds: bounds[1] - bounds[0])
        longest = displacements[first:end]
        operator = select_operator(header.times[first:end], longest.reshape(len(longest), -1))
        between = TemporalInterpolation(operator.length_scale, operator.cubic_shares, cuts)
    origin = coded.parameters.origin
    optional = inbetweens, origin, parts_basis, coded.labels, coded.relation
    return Playback(header, basis, coefficients, between, residual_layer, *optional)


def parts_basis_of(coded: CompressedSequence, basis: SpatialBasis, coefficients: Float) -> SpatialBasis:
    """Return the affine basis of the labelled parts, for the first frame of coefficients ``(T, K, d)``."""
    header = coded.header
    if coded.parts is None:
        raise FormatError(f"in-betweens are of parts, and no triangle has a label; {DAMAGE_CURE}")
    labels = label_vertices(header.faces, coded.parts, header.vertex_count)
    return affine_basis(basis.frames(coefficients[:1])[0], labels, coded.parameters.diagonal)


def decode_basis(coded: CompressedSequence, graph: SignalGraph) -> SpatialBasis:
    """Decode the spatial basis of a compressed sequence."""
    parameters = coded.parameters
    ranks = parameters.ranks or (parameters.rank,)
    max_rank = 3 * min(len(ranks) * parameters.frame_count, graph.size) + len(ranks)
    if parameters.rank > max_rank:
        raise FormatError(
            f"the parameters are damaged: {parameters.rank} basis vectors, and such a sequence has {max_rank} at most; "
            f"{DAMAGE_CURE}"
        )
    count, expected = len(coded.basis), len(part_groups(ranks))
    if count != expected:
        raise FormatError(f"the spatial basis is damaged, it has {count} groups of {expected}; {DAMAGE_CURE}")
    coordinates, step = 1 if parameters.factors == "trajectories" else 3, parameters.step
    vectors, vertices = read_basis(coded.basis, ranks, coordinates, step, coded.header.faces, graph)
    basis = assemble_basis(parameters.factors, vectors, vertices, parameters.frame_count)
    if not basis.norms.max(initial=0.0) < MAX_NORM:
        raise FormatError(f"the parameters are damaged, basis vectors are beyond single precision; {DAMAGE_CURE}")
    return basis


def decode_coefficients(coded: CompressedSequence, chunk: Chunk, basis: SpatialBasis) -> Float:
    """Decode the coefficients ``(n, K, d)`` of a chunk of n frames, for the K varying vectors of the basis."""
    return read_coefficients(basis, chunk.coefficients, [chunk.count], coded.parameters.step)[0]


def _decode_inbetweens(coded: CompressedSequence, basis: SpatialBasis) -> tuple[Float, ...]:
    """Decode the in-betweens ``((T - 1) 2^l, K, d)`` of every level l."""
    levels, step = range(coded.parameters.inbetween_levels or 0), coded.parameters.inbetween_step or 0.0
    chunks = []
    for chunk in coded.chunks if levels else ():
        intervals = inbetween_intervals(chunk.first, chunk.count, coded.parameters.frame_count)
        counts = [len(intervals) << level for level in levels]
        if chunk.inbetweens:
            chunks.append(read_coefficients(basis, chunk.inbetweens, counts, step))
        else:
            chunks.append([np.zeros((count, *basis.coefficient_shape)) for count in counts])
    return tuple(map(np.concatenate, zip(*chunks, strict=True)))


def inbetween_intervals(first: int, count: int, frame_count: int) -> range:
    """Return the intervals between frames that begin in a chunk; n is the interval from frame n to n + 1."""
    return range(first, min(first + count, frame_count - 1))
