r"""Principal components, spatially predicted: the peer to beat.

Basis vectors and coefficients are quantised with one step s, coefficients in units of singular values,
which is the optimum of rate and distortion (reverse water-filling). The decoder gives the coefficients their length, 1,
again. A component is kept if it is worth its bits, :math:`D_i > \lambda R_i` with the slope of uniform quantisation
:math:`\lambda = s^2 \ln 2 / 6`. Basis vectors are predicted over the connectivity (`prediction`), coefficients by their
differences in time, each by what makes it smallest; then lzma. Rates are those of real bytes, errors those of decoded
points.

A sequence about its mean point is a matrix of rank K, coefficients in time times basis vectors over the mesh, from the
singular vectors of what is left without the mean:

- *shape space* (Alexa and Mueller 2000): ``(T, 3V)``; a vector is a shape, the mean shape is one more of them
- *trajectory space* (as in CoDDyAC, Vasa and Skala 2007): ``(3T, V)``; a vector is one number a vertex, the mean is a
  number for each row
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from typing import Literal, NamedTuple

import numpy as np

import mixseq
from mixseq.types import Float, FloatArray, Index
from scripts.benchmarks.peers.coders import KG_SWEEP, spread
from scripts.benchmarks.peers.packing import from_lzma, numbers, planes, to_lzma, width
from scripts.benchmarks.peers.prediction import prediction

Space = Literal["shape", "trajectory"]


class Components(NamedTuple):
    """Mean of the rows ``(R,)``, coefficients ``(R, K)`` as long as their singular values, basis vectors ``(K, N)``."""

    mean: Float
    coefficients: Float
    vectors: Float


def components(points: FloatArray, space: Space) -> Components:
    """Return all components of points ``(T, V, 3)``, those with the largest singular values first."""
    matrix = to_matrix(points.astype(np.float64), space)
    if space == "shape":
        mean, shape = np.zeros(len(matrix)), matrix.mean(axis=0)
        rest = matrix - shape
    else:
        mean = matrix.mean(axis=1)
        rest = matrix - mean[:, None]
    _, eigenvectors = np.linalg.eigh(rest @ rest.T)
    eigenvectors = eigenvectors[:, ::-1]
    vectors = eigenvectors.T @ rest
    if space == "shape":
        constant = np.full((len(matrix), 1), len(matrix) ** -0.5)
        eigenvectors = np.concatenate([constant, eigenvectors], axis=1)
        vectors = np.concatenate([shape[None] * len(matrix) ** 0.5, vectors])
    return Components(mean, eigenvectors * np.linalg.norm(vectors, axis=1), vectors)


def to_matrix(points: Float, space: Space) -> Float:
    """Lay out points ``(T, V, 3)`` as a matrix of a space."""
    if space == "shape":
        return points.transpose(0, 2, 1).reshape(len(points), -1)
    return points.transpose(2, 0, 1).reshape(3 * len(points), -1)


def to_points(matrix: Float, space: Space, frames: int) -> Float:
    """Undo `to_matrix`."""
    if space == "shape":
        return matrix.reshape(frames, 3, -1).transpose(0, 2, 1)
    return matrix.reshape(3, frames, -1).transpose(1, 2, 0)


STEPS = 16
SLOPE = np.log(2) / 6

_HEAD = struct.Struct("<IId3f")  # frames, components, step, mean point
_ORDERS = 3  # differences in time of order 0, 1 and 2


class Pca:
    """PCA in one of the two spaces."""

    package = ""

    def __init__(self, space: Space) -> None:
        self.name: str = space
        self.title = f"PCA in {space} space"
        self._space = space

    def settings(self, sequence: mixseq.MeshSequence) -> Iterable[float]:
        """Return steps: from where few components have all of the error to where all of them share it."""
        found = components(sequence.points, self._space)
        size = spread(sequence.points) / 100
        coarse = size * max(KG_SWEEP) * np.sqrt(12 / found.vectors.shape[1]) / 2
        fine = size * min(KG_SWEEP) * np.sqrt(12 / (found.vectors.size + found.coefficients.size))
        return (float(step) for step in np.geomspace(coarse, fine, STEPS))

    def encode(self, sequence: mixseq.MeshSequence, setting: float) -> bytes:
        frames, vertices = len(sequence), sequence.vertex_count
        centre = sequence.points.mean(axis=(0, 1), dtype=np.float64).astype(np.float32)
        found = components(sequence.points - centre.astype(np.float64), self._space)
        over_mesh = prediction(mixseq.Topology(sequence.faces, vertices))

        # The mean of the rows moves all vertices: it is the coefficient of a constant vector of length 1.
        coefficients = [_differences(_whole(found.mean * np.sqrt(vertices), setting), frames)]
        vectors = []
        for coefficient, vector in zip(found.coefficients.T, found.vectors, strict=True):
            coefficients_q, vector_q = _whole(coefficient, setting), _whole(vector, setting)
            if not (coefficients_q.any() and vector_q.any()):
                continue
            values = vector_q.reshape(-1, vertices).T
            predicted = [over_mesh.residuals(values, k)[over_mesh.order].T for k in range(len(over_mesh.weights))]
            in_time, in_space = _differences(coefficients_q, frames), _smallest(predicted)
            gained = np.square(vector).sum()
            for values, whole in ((coefficient, coefficients_q), (vector, vector_q)):
                gained -= np.square(values - setting * whole).sum()
            if gained > SLOPE * setting**2 * (in_time.bits + in_space.bits):
                coefficients.append(in_time)
                vectors.append(in_space)
        return _HEAD.pack(frames, len(vectors), setting, *centre) + to_lzma(_written(coefficients + vectors))

    def signals(self, mesh: mixseq.Topology, data: bytes) -> int:
        return len(data)

    def decode(self, mesh: mixseq.Topology, data: bytes) -> Float:
        frames, count, step, *centre = _HEAD.unpack_from(data)
        rows, columns = (frames, 3 * mesh.vertex_count) if self._space == "shape" else (3 * frames, mesh.vertex_count)
        streams = _read(from_lzma(data[_HEAD.size :]), [rows] * (count + 1) + [columns] * count)

        mean, *coefficients = [_sums(values.reshape(-1, frames), order) for order, values in streams[: count + 1]]
        u = np.array(coefficients, np.float64).reshape(count, rows)
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        vectors = _vectors(mesh, streams[count + 1 :]).reshape(count, columns)
        matrix = u.T @ (step * vectors) + (mean * (step / np.sqrt(mesh.vertex_count)))[:, None]
        return np.asarray(to_points(matrix, self._space, frames) + np.array(centre))


class _Stream(NamedTuple):
    """A vector or its coefficients as written: by which prediction, what is left, and about how many bits it takes."""

    choice: int
    residuals: Index
    bits: float


def _whole(values: Float, step: float) -> Index:
    return np.rint(values / step).astype(np.int64)


def _smallest(candidates: Sequence[Index]) -> _Stream:
    bits = [_bits(each) for each in candidates]
    best = int(np.argmin(bits))
    return _Stream(best, candidates[best], bits[best])


def _bits(values: Index) -> float:
    r"""Estimate the bits of integers by the entropy of the two-sided geometric distribution of their mean size.

    :math:`P(k) = \frac{1-\theta}{1+\theta} \theta^{|k|}` has :math:`E|k| = m = 2\theta / (1 - \theta^2)`.
    """
    m = float(np.abs(values).mean())
    if m == 0:
        return 0.0
    theta = (np.sqrt(1 + m * m) - 1) / m
    return float(values.size * (np.log2((1 + theta) / (1 - theta)) - m * np.log2(theta)))


def _differences(coefficients: Index, frames: int) -> _Stream:
    """Take the differences of the order that makes coefficients, or three one after the other, smallest."""
    found = [coefficients.reshape(-1, frames)]
    for _ in range(_ORDERS - 1):
        found.append(np.diff(found[-1], axis=1, prepend=0))
    return _smallest(found)


def _sums(values: Index, order: int) -> Index:
    """Undo differences: ``(n, T)`` to all values in one row."""
    for _ in range(order):
        values = np.cumsum(values, axis=1)
    return values.reshape(-1)


def _vectors(mesh: mixseq.Topology, streams: Sequence[tuple[int, Index]]) -> Index:
    """Undo the prediction of vectors, those with the same predictor together: ``(K, c V)``."""
    over_mesh = prediction(mesh)
    vectors = np.empty((len(streams), 0 if not streams else streams[0][1].size), np.int64)
    choices = np.array([choice for choice, _ in streams], np.int64)
    for choice in np.unique(choices):
        chosen = np.flatnonzero(choices == choice).tolist()
        stacked = np.concatenate([streams[i][1].reshape(-1, mesh.vertex_count) for i in chosen])
        residuals = np.empty(stacked.shape[::-1], np.int64)
        residuals[over_mesh.order] = stacked.T
        vectors[chosen] = over_mesh.values(residuals, choice).T.reshape(len(chosen), -1)
    return vectors


def _written(streams: Sequence[_Stream]) -> bytes:
    """Write for each stream its choice and its width, then the planes of all."""
    widths = [width(each.residuals) for each in streams]
    table = bytes(number for each, size in zip(streams, widths, strict=True) for number in (each.choice, size))
    return table + b"".join(planes(each.residuals, size) for each, size in zip(streams, widths, strict=True))


def _read(body: bytes, lengths: Sequence[int]) -> list[tuple[int, Index]]:
    """Undo `_written`: the choice and the values of each stream."""
    at, streams = 2 * len(lengths), []
    for i, length in enumerate(lengths):
        choice, size = body[2 * i], body[2 * i + 1]
        streams.append((choice, numbers(body[at : at + size * length], size)))
        at += size * length
    return streams
