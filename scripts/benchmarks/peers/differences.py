"""The plain coder: one quantisation step, second differences in time, zstd."""

from __future__ import annotations

import struct
from collections.abc import Iterable

import numpy as np

import mixseq
from mixseq.types import Float
from scripts.benchmarks.peers.coder import KG_SWEEP, step_of
from scripts.benchmarks.peers.packing import from_zstd, numbers, planes, to_zstd, width

_HEAD = struct.Struct("<IB4d")  # frames, bytes a number, origin, step


class Differences:
    name = "differences"
    title = "quantisation, 2nd differences, zstd"
    packages = ("zstandard",)

    def settings(self, sequence: mixseq.MeshSequence) -> Iterable[float]:
        return (step_of(sequence, kg) for kg in KG_SWEEP)

    def encode(self, sequence: mixseq.MeshSequence, setting: float) -> bytes:
        """Code q_t - 2 q_(t-1) + q_(t-2), with zeros before the first frame, vertex by vertex in time."""
        points = sequence.points.astype(np.float64)
        origin = points.min(axis=(0, 1))
        q = np.rint((points - origin) / setting).astype(np.int64)
        first = np.diff(q, axis=0, prepend=0)
        second = np.concatenate([first[:1], np.diff(first, axis=0)])
        second[1:2] = first[1:2]  # the second frame by its difference: nothing is known of its speed
        size = width(second)
        head = _HEAD.pack(len(q), size, *origin, setting)
        return head + to_zstd(planes(second.transpose(2, 1, 0), size))

    def signals(self, mesh: mixseq.Topology, data: bytes) -> int:
        return len(data)

    def decode(self, mesh: mixseq.Topology, data: bytes) -> Float:
        frames, size, *origin, step = _HEAD.unpack_from(data)
        second = numbers(from_zstd(data[_HEAD.size :]), size)
        first = second.reshape(3, mesh.vertex_count, frames).transpose(2, 1, 0).copy()
        first[1:] = np.cumsum(first[1:], axis=0)
        return np.asarray(np.cumsum(first, axis=0) * step + np.array(origin))
