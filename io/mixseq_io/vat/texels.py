"""Texels: places of vertices in a texture, and the mesh that refers to them.

A texel is a vertex with one normal; glTF vertices that differ only by texture coordinates or materials share it. A
*layer* is one value of all texels, a frame or four basis vectors, in some rows of the texture. Layers are stacked:
shaders find a vertex in layer `n` by an offset in rows from the first one, the second set of texture coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Index
from mixseq.errors import SettingsError
from mixseq.geometry.normals import shared_normals
from mixseq.sequence import SequenceHeader
from mixseq_io.gltf.buffers import VERTICES, Layout
from mixseq_io.gltf.morphs import MovingMesh
from mixseq_io.gltf.new_document import new_scene
from mixseq_io.vat.images import LARGEST

_USUAL_WIDTH = 4096
_CHANNELS = 4


@dataclass(frozen=True, eq=False)
class Texels:
    """Texels of a sequence, N vertices ``(N,)`` and normals ``(N,)`` (`normals_of`), in a glTF document without points.

    `of_primitive` are the texels ``(n,)`` of every primitive's glTF vertices.
    """

    header: SequenceHeader
    layout: Layout
    meshes: list[MovingMesh]
    vertices: Index
    normals: Index
    of_primitive: list[Index]

    @staticmethod
    def of(header: SequenceHeader) -> Texels:
        """Find the texels of a sequence."""
        layout, meshes = new_scene(header)
        keys, first = [], 0
        for mesh in meshes:
            hard_edges = mesh.scene_mesh.hard_edges
            groups = (
                mesh.scene_mesh.vertex_count if hard_edges is None else int(hard_edges.max(initial=-1)) + 1
            )
            for each in mesh.primitives:
                assert each.normals is not None  # new documents have some
                vertices = np.arange(header.vertex_count)[mesh.scene_mesh.vertices][each.vertices]
                keys.append(np.column_stack([vertices, each.normals + first]))
            first += groups
        distinct, numbers = np.unique(np.concatenate(keys), axis=0, return_inverse=True)
        ends = np.cumsum([len(each) for each in keys])[:-1]
        return Texels(
            header, layout, meshes, distinct[:, 0], distinct[:, 1], np.split(numbers.reshape(-1), ends)
        )

    @property
    def count(self) -> int:
        """Number N of texels."""
        return len(self.vertices)

    def normals_of(self, points: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the normals ``(n, N, 3)`` of texels for points ``(n, V, 3)``."""
        found = [
            shared_normals(
                points[:, mesh.scene_mesh.vertices].astype(np.float32),
                mesh.scene_mesh.polygons,
                mesh.scene_mesh.hard_edges,
            )
            for mesh in self.meshes
        ]
        return np.asarray(np.concatenate(found, axis=1)[:, self.normals])

    @cached_property
    def width(self) -> int:
        """Width of textures, no more than a layer's rows need."""
        return -(-self.count // self.rows)

    @cached_property
    def rows(self) -> int:
        """Rows of a layer in the texture."""
        return -(-self.count // _USUAL_WIDTH)

    def stacked(self, layers: NDArray[np.floating], what: str) -> NDArray[np.floating]:
        """Return layers ``(n, N, channels)`` as pixels ``(n * rows, width, channels)``, padded with zeros."""
        count, _, channels = layers.shape
        if count * self.rows > LARGEST:
            raise SettingsError(
                f"{count} {what} of {self.count} texels take {count * self.rows} rows of a texture, and graphics cards "
                f"take {LARGEST}; write fewer frames, or few basis vectors (--max-error)"
            )
        filled = np.zeros((count, self.rows * self.width, channels), layers.dtype)
        filled[:, : self.count] = layers
        return filled.reshape(count * self.rows, self.width, channels)

    def add_vertices(self, points: NDArray[np.floating], layers: int) -> None:
        """Give the document points ``(V, 3)``, their normals, and their places in a texture of `layers` layers."""
        normals = self.normals_of(points[None])[0]
        places = np.arange(self.count)
        lookup = np.column_stack(
            [(places % self.width + 0.5) / self.width, (places // self.width + 0.5) / (layers * self.rows)]
        ).astype(np.float32)
        here = points.astype(np.float32)[self.vertices]
        numbers = iter(self.of_primitive)
        for each in (primitive for mesh in self.meshes for primitive in mesh.primitives):
            texels, attributes = next(numbers), each.entry["attributes"]
            attributes["POSITION"] = self.layout.add_array(here[texels], target=VERTICES)
            bounds = here[texels].min(axis=0).tolist(), here[texels].max(axis=0).tolist()
            self.layout.bounded(attributes["POSITION"], bounds)
            attributes["NORMAL"] = self.layout.add_array(normals[texels], target=VERTICES)
            if "TEXCOORD_0" not in attributes:  # glTF counts sets of texture coordinates from 0 on
                none = np.zeros((len(texels), 2), np.float32)
                attributes["TEXCOORD_0"] = self.layout.add_array(none, target=VERTICES)
            attributes["TEXCOORD_1"] = self.layout.add_array(lookup[texels], target=VERTICES)


def in_fours(numbers: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return numbers ``(N, K)`` as layers ``(ceil(K / 4), N, 4)``, padded with zeros."""
    count, rank = numbers.shape
    layers = -(-rank // _CHANNELS)
    padded = np.zeros((count, layers * _CHANNELS), numbers.dtype)
    padded[:, :rank] = numbers
    return np.ascontiguousarray(padded.reshape(count, layers, _CHANNELS).swapaxes(0, 1))
