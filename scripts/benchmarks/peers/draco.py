"""Draco, a mesh for each frame, on one grid for all frames: positions only, at its best compression.

Every frame carries the connectivity. It is measured by a mesh whose vertices are all in one cell of the grid, and
taken from the size of every frame, so that what counts is the vertices alone. Draco changes their order; as that
follows from the connectivity, vertices at known places tell it.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from functools import cache

import numpy as np

import mixseq
from mixseq.errors import InvalidSequenceError
from mixseq.types import Float, Index

LEVEL = 10
LATTICE = 10  # bits a coordinate

_SIZE = struct.Struct("<I")


class Draco:
    name = "draco"
    title = "Draco, frame by frame"
    packages: tuple[str, ...] = ("DracoPy",)

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
