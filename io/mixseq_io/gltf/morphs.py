"""Moving points as glTF morph targets: the first frame is the mesh, every further frame a target.

Frame ``k`` is ``x_k = x_0 + sum_j w_j(t_k) d_j`` with ``d_j = x_j - x_0`` and weights ``w_j(t_k)`` one where ``j = k``,
else zero. Viewers interpolate weights linearly between keys, hence points and normals too. ``x_0`` and ``d_j`` are
rounded to float32: a point is off by at most 2**-24 of its displacement since the first frame, plus its own rounding.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html#morph-targets
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import FloatArray, IntArray
from mixseq.errors import InvalidSequenceError
from mixseq.geometry.normals import shared_normals
from mixseq.sequence import SequenceHeader
from mixseq_io.blocks import as_float32
from mixseq_io.gltf.buffers import VERTICES, BufferWriter, Json, Layout, append
from mixseq_io.gltf.other_motion import NOTHING, OtherMotion
from mixseq_io.scene_meshes import SceneMesh

_BYTES_PER_VECTOR = 12


@dataclass(frozen=True, eq=False)
class MovingPrimitive:
    """Primitive of the document with moving vertices."""

    entry: Json
    vertices: IntArray
    normals: IntArray | None


@dataclass(frozen=True, eq=False)
class MovingMesh:
    """Mesh of the document with moving vertices: its node, its mesh of the sequence, its primitives."""

    node: int
    scene_mesh: SceneMesh
    primitives: Sequence[MovingPrimitive]


class Morphs:
    """Frames in the buffer: laid out on construction, then written one after the other."""

    def __init__(
        self,
        layout: Layout,
        meshes: Sequence[MovingMesh],
        header: SequenceHeader,
        keep_start: bool = False,
        others: OtherMotion = NOTHING,
    ) -> None:
        self._meshes = meshes
        self._animate(layout, header, keep_start, others)
        self._frames = [self._lay_out(layout, frame) for frame in range(header.frame_count)]
        self._first: tuple[FloatArray, list[NDArray[np.float32]]] | None = None

    def _animate(self, layout: Layout, header: SequenceHeader, keep_start: bool, others: OtherMotion) -> None:
        """Add the animation that steps through the targets."""
        if header.frame_count == 1:
            return
        keys, extras = key_times(header, keep_start)
        times = layout.add_array(keys)
        layout.bounded(times, ([float(keys[0])], [float(keys[-1])]))
        count = len(keys) * (len(keys) - 1)
        weights = layout.accessor(layout.add(_one_hot(len(keys)), 4 * count), count, "SCALAR")
        animation = {
            "name": header.name or "animation",
            "samplers": [{"input": times, "output": weights, "interpolation": "LINEAR"}],
            "channels": [
                {"sampler": 0, "target": {"node": mesh.node, "path": "weights"}} for mesh in self._meshes
            ],
            "extras": extras,
        }
        others.animate(layout, animation, header)
        append(layout.document, "animations", animation)

    def _lay_out(self, layout: Layout, frame: int) -> tuple[int, list[Json]]:
        """Return the offset of a frame's view, and the accessors of points without bounds."""
        vectors = sum(
            len(each.vertices) * (1 if each.normals is None else 2)
            for mesh in self._meshes
            for each in mesh.primitives
        )
        view = layout.reserve(vectors * _BYTES_PER_VECTOR, byteStride=_BYTES_PER_VECTOR, target=VERTICES)
        offset, unbounded = 0, []
        for mesh in self._meshes:
            for each in mesh.primitives:
                count = len(each.vertices)
                attributes = each.entry["attributes"] if frame == 0 else {}
                points = layout.accessor(view, count, "VEC3", offset)
                attributes["POSITION"] = points
                unbounded.append(layout.bounded(points))
                offset += count * _BYTES_PER_VECTOR
                if each.normals is not None:
                    attributes["NORMAL"] = layout.accessor(view, count, "VEC3", offset)
                    offset += count * _BYTES_PER_VECTOR
                if frame > 0:
                    append(each.entry, "targets", attributes)
        return layout.document["bufferViews"][view]["byteOffset"], unbounded

    def write(self, frame: int, points: NDArray[np.float32], writer: BufferWriter) -> None:
        """Write a frame's points ``(V, 3)``; `InvalidSequenceError` if too far from the first frame for float32."""
        normals = [
            shared_normals(
                points[None, mesh.scene_mesh.vertices], mesh.scene_mesh.polygons, mesh.scene_mesh.hard_edges
            )[0]
            for mesh in self._meshes
        ]
        if self._first is None:
            self._first = points.astype(np.float64), normals
        else:
            base, base_normals = self._first
            points = as_float32((points - base)[None], frame, "glTF")[0]
            normals = [here - there for here, there in zip(normals, base_normals, strict=True)]
        start, unbounded = self._frames[frame]
        chunks: list[NDArray[np.float32]] = []
        awaiting = iter(unbounded)
        for mesh, of_mesh in zip(self._meshes, normals, strict=True):
            for each in mesh.primitives:
                here = points[mesh.scene_mesh.vertices][each.vertices]
                accessor = next(awaiting)
                accessor["min"], accessor["max"] = here.min(axis=0).tolist(), here.max(axis=0).tolist()
                chunks.append(here)
                if each.normals is not None:
                    chunks.append(of_mesh[each.normals])
        writer.put(start, chunks)


def key_times(header: SequenceHeader, keep_start: bool = False) -> tuple[NDArray[np.float32], Json]:
    """Return float32 key times ``(T,)``, and extras: ``fps``, and ``start``, the time in s at key 0, unless it is 0."""
    start = time_shift(header, keep_start)
    keys = (header.times - start).astype(np.float32)
    close = np.diff(keys) <= 0
    if close.any() or not np.isfinite(keys).all():
        frame = int(np.argmax(close))
        raise InvalidSequenceError(
            f"frames {frame} and {frame + 1} are at {header.times[frame]:.9g} s and {header.times[frame + 1]:.9g} s, "
            "too close, or too late, for glTF's float32; let the times begin at 0, or write USD, .npz or .h5"
        )
    return keys, {"fps": header.fps, **({"start": start} if start else {})}


def time_shift(header: SequenceHeader, keep_start: bool = False) -> float:
    """Return the time in seconds that becomes 0: the first one.

    Players would otherwise show the first frame until then: 40 s for a shot that begins at frame 1001. `keep_start`
    moves only times that glTF cannot hold: those before 0, and that of a single frame.
    """
    first = float(header.times[0])
    return 0.0 if keep_start and first >= 0 and header.frame_count > 1 else first


def _one_hot(keys: int) -> Iterator[NDArray[np.float32]]:
    """Yield the weights of the targets ``(T - 1,)`` key by key."""
    for key in range(keys):
        yield (np.arange(1, keys) == key).astype(np.float32)
