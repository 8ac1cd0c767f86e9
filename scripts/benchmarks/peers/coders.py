"""Coders of `scripts/bench compress` and `speed`: `mixseq.compress`, Draco and meshopt.

For PCA see `pca.py`. Connectivity is not part of the measured size: a decoder is given the mesh.
"""

from __future__ import annotations

import struct
import tempfile
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

import mixseq
from mixseq.errors import InvalidSequenceError
from mixseq.types import Float, Index
from mixseq_io.model_files import compressed_sizes
from scripts.benchmarks.peers.packing import from_zstd, to_zstd

KG_TARGETS = (1.0, 0.5, 0.1, 0.05, 0.02)
"""KG errors in percent that rates are given at."""

KG_SWEEP = (2.2, 1.4, 1.0, 0.7, 0.5, 0.3, 0.2, 0.14, 0.1, 0.07, 0.05, 0.03, 0.02, 0.014, 0.005, 0.002)
"""KG errors in percent that coders with a quantisation step aim at."""

ERROR_TARGETS = (1e-2, 1e-3, 1e-4)
"""Largest errors in diagonals that rates are given at."""


class Coder(Protocol):
    """A way to make a sequence small."""

    @property
    def name(self) -> str:
        """In one word, for the command line."""

    @property
    def title(self) -> str:
        """For tables and plots."""

    @property
    def package(self) -> str:
        """What has to be installed, by the name that pip knows, if anything."""

    def settings(self, sequence: mixseq.MeshSequence) -> Iterable[Any]:
        """Return the settings to measure, one operating point each; this is not timed."""

    def encode(self, sequence: mixseq.MeshSequence, setting: Any) -> bytes:
        """Encode; timed."""

    def signals(self, mesh: mixseq.Topology, data: bytes) -> int:
        """Return how many of the bytes count: those of connectivity do not."""

    def decode(self, mesh: mixseq.Topology, data: bytes) -> Float:
        """Return points ``(T, V, 3)``; timed."""


def step_of(sequence: mixseq.MeshSequence, kg_percent: float) -> float:
    """Return the step of a uniform quantisation of all coordinates with this KG error: step²/12 a number."""
    return float(np.sqrt(12.0 / sequence.points.size) * spread(sequence.points) * kg_percent / 100)


def spread(points: NDArray[Any]) -> float:
    """Return the denominator of the KG error: the norm of all points, each frame about its centroid."""
    x = points.astype(np.float64)
    return float(np.linalg.norm(x - x.mean(axis=1, keepdims=True)))


# mixseq -----------------------------------------------------------------------------------------------------

Setting = tuple[str, float]


class Ours:
    """`mixseq.compress`, by KG error and by largest error."""

    name = "ours"
    title = "mixseq"
    package = ""

    def settings(self, sequence: mixseq.MeshSequence) -> Iterable[Setting]:
        """Return bounds: the argument of `mixseq.compress` and its value."""
        return (*(("kg", kg) for kg in KG_TARGETS), *(("max_error", error) for error in ERROR_TARGETS))

    def encode(self, sequence: mixseq.MeshSequence, setting: Setting) -> bytes:
        bound: dict[str, Any] = dict([setting])
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "coded.h5")
            mixseq.save(path, mixseq.compress(sequence, **bound, inbetweens=False))
            return path.read_bytes()

    def signals(self, mesh: mixseq.Topology, data: bytes) -> int:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "coded.h5")
            path.write_bytes(data)
            return int(compressed_sizes(path)["signals"])

    def decode(self, mesh: mixseq.Topology, data: bytes) -> Float:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "coded.h5")
            path.write_bytes(data)
            model = mixseq.load(path)
            return np.concatenate(list(model.blocks(model.times))).astype(np.float64)


# meshopt ---

_HEAD = struct.Struct("<I4d")  # frames, origin, step


class Meshopt:
    """Differences in time of coordinates on one grid, by meshoptimizer's codec of vertices and zstd."""

    name = "meshopt"
    title = "meshopt and zstd"
    package = "meshopt"

    def settings(self, sequence: mixseq.MeshSequence) -> Iterable[int]:
        """Return bits a coordinate; rows have two bytes a coordinate."""
        return range(8, 16)

    def encode(self, sequence: mixseq.MeshSequence, setting: int) -> bytes:
        import meshopt

        points = sequence.points.astype(np.float64)
        origin = points.min(axis=(0, 1))
        step = float((points.max(axis=(0, 1)) - origin).max()) / (2**setting - 1)
        q = np.rint((points - origin) / step).astype(np.int16)
        rows = np.pad(np.diff(q, axis=0, prepend=np.int16(0)), ((0, 0), (0, 0), (0, 1)))
        frames = [meshopt.encode_vertex_buffer(np.ascontiguousarray(frame)) for frame in rows]
        sizes = np.array([len(frame) for frame in frames], dtype="<u4")
        head = _HEAD.pack(len(q), *origin, step)
        return head + to_zstd(sizes.tobytes() + b"".join(frames))

    def signals(self, mesh: mixseq.Topology, data: bytes) -> int:
        return len(data)

    def decode(self, mesh: mixseq.Topology, data: bytes) -> Float:
        import meshopt

        count, *origin, step = _HEAD.unpack_from(data)
        unpacked = from_zstd(data[_HEAD.size :])
        ends = 4 * count + np.cumsum(np.frombuffer(unpacked, "<u4", count))
        buffers = (unpacked[start:end] for start, end in zip([4 * count, *ends[:-1]], ends, strict=True))
        rows = [meshopt.decode_vertex_buffer(each, mesh.vertex_count, 8).view(np.int16) for each in buffers]
        q = np.cumsum(np.stack(rows).reshape(count, mesh.vertex_count, 4)[..., :3], axis=0, dtype=np.int16)
        return np.asarray(q * step + np.array(origin))


# Draco ---

LEVEL = 10
LATTICE = 10  # bits a coordinate

_SIZE = struct.Struct("<I")


class Draco:
    """A mesh for each frame, on one grid for all frames: positions only, at the best compression.

    Every frame carries the connectivity. It is measured by a mesh whose vertices are all in one cell of the grid, and
    taken from the size of every frame, so that what counts is the vertices alone. Draco changes their order; as that
    follows from the connectivity, it is read off vertices at known places.
    """

    name = "draco"
    title = "Draco, frame by frame"
    package = "DracoPy"

    def settings(self, sequence: mixseq.MeshSequence) -> Iterable[int]:
        """Return bits a coordinate."""
        return range(8, 19)

    def encode(self, sequence: mixseq.MeshSequence, setting: int) -> bytes:
        import DracoPy

        points, faces = sequence.points, sequence.faces.astype(np.uint32)
        low = points.min(axis=(0, 1)).astype(np.float64)
        size = float((points.max(axis=(0, 1)) - low).max())
        grid = {"quantization_range": size, "quantization_origin": low.tolist()}
        frames = [
            DracoPy.encode(frame, faces, quantization_bits=setting, compression_level=LEVEL, **grid) for frame in points
        ]
        return b"".join(_SIZE.pack(len(frame)) + frame for frame in frames)

    def signals(self, mesh: mixseq.Topology, data: bytes) -> int:
        connectivity = _connectivity(mesh.faces.astype(np.uint32).tobytes(), mesh.vertex_count)
        return sum(len(frame) - connectivity for frame in _frames(data))

    def decode(self, mesh: mixseq.Topology, data: bytes) -> Float:
        import DracoPy

        order = _order(mesh.faces.astype(np.uint32).tobytes(), mesh.vertex_count)
        frames = list(_frames(data))
        points = np.empty((len(frames), mesh.vertex_count, 3))
        for frame, coded in zip(points, frames, strict=True):
            frame[order] = DracoPy.decode(coded).points
        return points


def _frames(data: bytes) -> Iterator[bytes]:
    at = 0
    while at < len(data):
        (size,) = _SIZE.unpack_from(data, at)
        at += _SIZE.size
        yield data[at : at + size]
        at += size


@cache
def _connectivity(faces: bytes, vertices: int) -> int:
    """Bytes of a mesh whose vertices are all in one cell."""
    import DracoPy

    triangles = np.frombuffer(faces, np.uint32).reshape(-1, 3)
    far: dict[str, object] = {"quantization_range": 1e6, "quantization_origin": [-1.0] * 3}
    places = _lattice(vertices) / 2**LATTICE
    return len(DracoPy.encode(places, triangles, quantization_bits=8, compression_level=LEVEL, **far))


@cache
def _order(faces: bytes, vertices: int) -> Index:
    """Return which vertex each of those that Draco decodes is; kept, as it is the same for all frames."""
    import DracoPy

    triangles = np.frombuffer(faces, np.uint32).reshape(-1, 3)
    exact: dict[str, object] = {"quantization_range": float(2**LATTICE - 1), "quantization_origin": [0.0] * 3}
    mesh = DracoPy.encode(_lattice(vertices), triangles, quantization_bits=LATTICE, compression_level=LEVEL, **exact)
    found = np.rint(DracoPy.decode(mesh).points).astype(np.int64)
    order = found @ (1 << (LATTICE * np.arange(3)))
    if not np.array_equal(np.sort(order), np.arange(vertices)):
        raise InvalidSequenceError(f"Draco returns {len(order)} of {vertices} vertices; the others are in no face")
    return np.asarray(order)


def _lattice(vertices: int) -> Float:
    """Points ``(V, 3)`` whose whole coordinates are the digits of the vertex number."""
    digits = np.arange(vertices)[:, None] >> (LATTICE * np.arange(3))
    return np.asarray(digits & (2**LATTICE - 1), np.float64)
