"""From a compressed sequence to a model."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from mixseq.arrays import Float, Index
from mixseq.coding.basis import Basis
from mixseq.coding.coded import Chunk, Coded
from mixseq.coding.corrections import RUN, Correction, read_corrections
from mixseq.coding.graph import SignalGraph, mesh_graph
from mixseq.coding.streams import basis_of, read_fields, read_tracks
from mixseq.errors import FormatError
from mixseq.pickling import PickledWithoutCaches
from mixseq.prediction.operator import chosen, with_middles
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.signals.pose import NEGLIGIBLE, straight_modes
from mixseq.spaces import ShapeSpace, VertexSpace
from mixseq.spaces.basis import BasisSpace
from mixseq.threads import one_blas_thread

_KEPT = 8
"""Runs of corrections that are kept."""


def to_model(coded: Coded) -> Model:
    """Decode a compressed sequence.

    Parameters
    ----------
    coded : Coded
        The sequence. If groups of fields are missing at the end, what is there is decoded.

    Returns
    -------
    Model
        In the basis space (trajectories) or the vertex space (shapes), with the corrections of the file.

    Raises
    ------
    FormatError
        If the streams are damaged or contradict each other.
    """
    parameters, header = coded.parameters, coded.header
    graph = mesh_graph(header.faces, header.vertex_count)
    with one_blas_thread(), np.errstate(over="ignore", invalid="ignore"):  # what is not finite is damaged
        basis = decode_basis(coded, graph)
        tracks = np.concatenate([decode_tracks(coded, chunk, basis) for chunk in coded.chunks])
        if not (np.isfinite(basis.norms).all() and np.isfinite(tracks).all()):
            raise FormatError("coded signals are not finite; the file is damaged")
        space, scores, mean, directions = _affine(basis, tracks, parameters.diagonal)
        pose, shapes = straight_modes(scores, mean, directions)
    corrections = None
    if any(chunk.corrections for chunk in coded.chunks):
        corrections = CodedCorrections(
            header.times, coded.chunks, header.faces, header.vertex_count, parameters.correction
        )
    times = with_middles(header.times)
    time = Curve(times, chosen(header.times, scores).at(times).of(scores))
    placement = Curve(times, np.zeros((len(times), 0)))
    return Model(header, space, time, pose, shapes, placement, corrections)


def decode_basis(coded: Coded, graph: SignalGraph) -> Basis:
    """Return the fields of a compressed sequence: all of them, or those of the groups that are there."""
    parameters = coded.parameters
    coordinates = 1 if parameters.factors == "trajectories" else 3
    ranks = parameters.ranks or (parameters.rank,)
    most = 3 * min(len(ranks) * parameters.frame_count, graph.size) + len(ranks)
    if parameters.rank > most:
        raise FormatError(
            f"{parameters.rank} fields are more than the {most} that such a sequence can have; the file is damaged"
        )
    fields, parts = read_fields(coded.fields, ranks, coordinates, parameters.step, coded.header.faces, graph)
    if parameters.factors == "shapes" and not len(fields[0]):
        raise FormatError(
            "the first fields are missing, without which there is no shape; the file is damaged"
        )
    return basis_of(parameters.factors, fields, parts, parameters.frame_count)


def decode_tracks(coded: Coded, chunk: Chunk, basis: Basis) -> Float:
    """Return the tracks ``(n, K, d)`` of a chunk's frames, as many as the basis has free fields."""
    return read_tracks(basis, chunk.tracks, chunk.count, coded.parameters.step)


def _affine(basis: Basis, tracks: Float, unit: float) -> tuple[ShapeSpace, Float, Float, Float]:
    """Return a space, and frames in it as mean plus scores ``(T, r)`` times directions ``(r, D)``."""
    if basis.name == "shapes":
        fields = basis.fields.transpose(0, 2, 1).reshape(len(basis.fields), -1) / unit
        mean = fields[0] / np.sqrt(basis.frame_count)
        return VertexSpace(basis.fields.shape[2], unit), tracks[..., 0], mean, fields[1:]
    space = BasisSpace(basis.fields[:, 0], unit)
    vectors = tracks.reshape(len(tracks), -1) / unit
    mean = vectors.mean(axis=0)
    # Principal components: pose space shall have the coordinates in which most of the motion is.
    left, sizes, right = linalg.svd((vectors - mean) * space.weights, full_matrices=False)
    kept = sizes > NEGLIGIBLE * sizes.max(initial=0.0)
    return space, left[:, kept] * sizes[kept], mean, right[kept] / space.weights


@dataclass(frozen=True, eq=False)
class CodedCorrections(PickledWithoutCaches):
    """Corrections of a compressed sequence, decoded where they are asked for.

    Attributes
    ----------
    times : (T,) float64
        Times of the frames; between them corrections are interpolated.
    chunks : tuple of Chunk
        The streams.
    faces : (F, 3) int32
        Triangles of the mesh.
    vertex_count : int
        Number V of vertices.
    unit : float
        Length of the unit of the numbers, in the units of the sequence.
    """

    times: Float
    chunks: tuple[Chunk, ...]
    faces: NDArray[np.int32]
    vertex_count: int
    unit: float

    def __post_init__(self) -> None:
        _ = self._lock, self._cache  # there before threads ask for them, who might make two

    def at(self, times: Float) -> Float:
        """Return displacements ``(N, V, 3)`` at times ``(N,)`` in seconds."""
        moved = np.zeros((len(times), self.vertex_count, 3))
        for row, (frame, share) in enumerate(zip(*self._places(times), strict=True)):
            for which, weight in ((frame, 1.0 - share), (frame + 1, share)):
                if weight > 0:
                    nodes, numbers = self._frame(int(which))
                    moved[row, nodes] += weight * self.unit * numbers
        return moved

    def rates(self, times: Float) -> Float:
        """Return the derivatives ``(N, V, 3)`` of the displacements by time, per second."""
        moved = np.zeros((len(times), self.vertex_count, 3))
        if len(self.times) == 1:
            return moved
        frames, _ = self._places(times)
        for row, frame in enumerate(np.minimum(frames, len(self.times) - 2)):
            for which, sign in ((frame, -1.0), (frame + 1, 1.0)):
                nodes, numbers = self._frame(int(which))
                moved[row, nodes] += sign * self.unit * numbers / (self.times[frame + 1] - self.times[frame])
        return moved

    def _places(self, times: Float) -> tuple[Index, Float]:
        """Frames before or at times, and how far times are on the way to the next."""
        places = np.interp(times, self.times, np.arange(len(self.times)))
        nearest = np.rint(places)
        places = np.where(
            np.abs(places - nearest) < 1e-9, nearest, places
        )  # a frame is a frame, after rounding
        frames = np.floor(places).astype(np.int64)
        return frames, places - frames

    def _frame(self, frame: int) -> Correction:
        chunk = int(np.searchsorted(self._starts, frame, side="right")) - 1
        run, place = divmod(frame - int(self._starts[chunk]), RUN)
        return self._run(chunk, run)[place]

    def _run(self, chunk: int, run: int) -> list[Correction]:
        # Threads go through the frames in order, so that the last few runs are all they need.
        with self._lock:
            decoded = self._cache.get((chunk, run))
            if decoded is None:
                stream = self.chunks[chunk]
                decoded = read_corrections(stream.corrections, stream.count, run, self._graph)
                self._cache[chunk, run] = decoded
                while len(self._cache) > _KEPT:
                    self._cache.pop(next(iter(self._cache)))
            return decoded

    @cached_property
    def _starts(self) -> Index:
        return np.cumsum([0, *(chunk.count for chunk in self.chunks)])[:-1]

    @cached_property
    def _graph(self) -> SignalGraph:
        return mesh_graph(self.faces, self.vertex_count)

    @cached_property
    def _cache(self) -> dict[tuple[int, int], list[Correction]]:
        return {}

    @cached_property
    def _lock(self) -> threading.Lock:
        return threading.Lock()
