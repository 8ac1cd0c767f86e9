"""Skinning by py-dem-bones, packed: a rest shape, four bones and weights a vertex, rotations and places of the bones.

16 bits a coordinate of the rest shape, predicted over the connectivity; 8 bits a weight, in the order of the traversal;
16 bits a number of the bones' unit quaternions and of the places of their centres, by differences in time where this is
smaller; each through lzma. The centre of a bone is the mean of the rest shape by its weights.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from itertools import pairwise

import numpy as np

import mixseq
from mixseq.types import Float, Index
from scripts.benchmarks.common.dembones import INFLUENCES, skinned, skinning
from scripts.benchmarks.peers.packing import from_lzma, numbers, planes, to_lzma
from scripts.benchmarks.peers.prediction import prediction

FINE = 2**16 - 1
WEIGHT = 2**8 - 1
TURN = 2**15 - 1

_HEAD = struct.Struct("<II4d6f6f3I")  # frames, bones, centre, diagonal, boxes of rest shape and places, sizes of parts
_PREDICTOR = 2  # parallelograms


class Bones:
    name = "bones"
    title = "skinning, py-dem-bones"
    packages: tuple[str, ...] = ("py-dem-bones",)

    def settings(self, sequence: mixseq.MeshSequence) -> Iterable[int]:
        """Return numbers of bones."""
        return (10, 20, 40)

    def encode(self, sequence: mixseq.MeshSequence, setting: int) -> bytes:
        from scipy.spatial.transform import Rotation

        points = sequence.points.astype(np.float64)
        centre, diagonal = points[0].mean(axis=0), sequence.diagonal
        points = (points - centre) / diagonal
        found = skinning(points, sequence.faces, setting, runs=1)
        bones = len(found.weights)
        mesh = prediction(mixseq.Topology(sequence.faces, sequence.vertex_count))

        box = np.stack([points[0].min(axis=0), points[0].max(axis=0)]).astype(np.float32)
        rest = _onto(points[0], box)
        chosen = np.argsort(-found.weights, axis=0, kind="stable")[:INFLUENCES]
        weights = np.take_along_axis(found.weights, chosen, axis=0)
        weights = np.rint(WEIGHT * weights / weights.sum(axis=0)).astype(np.int64)

        rotations = found.transforms[:, :, :3, :3]
        middles = _centres(_spread(chosen, weights[1:], bones), _from(rest, box))
        places = np.einsum("tbij,bj->tbi", rotations, middles) + found.transforms[:, :, :3, 3]
        range_ = np.stack([places.min(axis=(0, 1)), places.max(axis=(0, 1))]).astype(np.float32)
        turns = Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_quat(canonical=True)
        motion = np.concatenate(
            [np.rint(TURN * turns[:, :3]).astype(np.int64).reshape(places.shape), _onto(places, range_)],
            axis=2,
        ).reshape(len(points), -1)
        parts = (
            to_lzma(planes(mesh.residuals(rest, _PREDICTOR)[mesh.order].T, 3)),
            to_lzma(np.concatenate([chosen, weights[1:]])[:, mesh.order].astype(np.uint8).tobytes()),
            _timed(motion),
        )
        head = _HEAD.pack(
            len(points), bones, *centre, diagonal, *box.reshape(-1), *range_.reshape(-1), *map(len, parts)
        )
        return head + b"".join(parts)

    def signals(self, mesh: mixseq.Topology, data: bytes) -> int:
        return len(data)

    def decode(self, mesh: mixseq.Topology, data: bytes) -> Float:
        from scipy.spatial.transform import Rotation

        head = _HEAD.unpack_from(data)
        frames, bones, centre, diagonal = head[0], head[1], np.array(head[2:5]), head[5]
        box, range_ = np.array(head[6:12]).reshape(2, 3), np.array(head[12:18]).reshape(2, 3)
        ends = _HEAD.size + np.cumsum([0, *head[18:]])
        parts = [data[start:end] for start, end in pairwise(ends.tolist())]
        over_mesh = prediction(mesh)

        residuals = np.empty((mesh.vertex_count, 3), np.int64)
        residuals[over_mesh.order] = numbers(from_lzma(parts[0]), 3).reshape(3, -1).T
        rest = _from(over_mesh.values(residuals, _PREDICTOR), box)
        table = np.empty((2 * INFLUENCES - 1, mesh.vertex_count), np.int64)
        table[:, over_mesh.order] = np.frombuffer(from_lzma(parts[1]), np.uint8).reshape(len(table), -1)
        weights = _spread(table[:INFLUENCES], table[INFLUENCES:], bones)

        motion = _untimed(parts[2], frames).reshape(frames, bones, 6)
        turns = motion[:, :, :3].reshape(-1, 3) / TURN
        last = np.sqrt(np.maximum(1 - np.square(turns).sum(axis=1), 0))
        transforms = np.zeros((frames, bones, 3, 4))
        transforms[..., :3] = (
            Rotation.from_quat(np.column_stack([turns, last])).as_matrix().reshape(frames, bones, 3, 3)
        )
        centres = _centres(weights, rest)
        transforms[..., 3] = _from(motion[:, :, 3:], range_) - np.einsum("tbij,bj->tbi", transforms[..., :3], centres)
        return np.asarray(skinned(rest, weights, transforms) * diagonal + centre)


def _onto(values: Float, box: Float | np.ndarray[tuple[int, ...], np.dtype[np.float32]]) -> Index:
    low, high = np.asarray(box, np.float64)
    return np.asarray(np.rint(FINE * (values - low) / np.maximum(high - low, 1e-30)), np.int64)


def _from(whole: Index, box: Float | np.ndarray[tuple[int, ...], np.dtype[np.float32]]) -> Float:
    low, high = np.asarray(box, np.float64)
    return np.asarray(low + whole / FINE * (high - low))


def _spread(chosen: Index, others: Index, bones: int) -> Float:
    """Return weights ``(B, V)``: the first of each vertex is what the others leave."""
    weights = np.zeros((bones, chosen.shape[1]))
    np.add.at(weights, (chosen[1:], np.arange(chosen.shape[1])), others / WEIGHT)
    np.add.at(weights, (chosen[0], np.arange(chosen.shape[1])), 1 - others.sum(axis=0) / WEIGHT)
    return weights


def _centres(weights: Float, rest: Float) -> Float:
    return np.asarray((weights @ rest) / np.maximum(weights.sum(axis=1), 1e-9)[:, None])


def _timed(motion: Index) -> bytes:
    """Code rows of frames as they are or by differences, whatever is smaller; the first byte tells."""
    found = [
        bytes([order]) + to_lzma(planes(np.diff(motion, order, axis=0, prepend=_zeros(order, motion)).T, 3))
        for order in (0, 1)
    ]
    return min(found, key=len)


def _zeros(rows: int, like: Index) -> Index:
    return np.zeros((rows, like.shape[1]), np.int64)


def _untimed(data: bytes, frames: int) -> Index:
    rows = numbers(from_lzma(data[1:]), 3).reshape(-1, frames).T
    return np.cumsum(rows, axis=0) if data[0] else rows
