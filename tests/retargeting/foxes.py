"""The fox in two proportions, with other triangles, and of every vertex the bone that it is on."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from mixseq.creature import part_of_vertex, walk_cycle
from mixseq.mesh.decimation import decimate
from mixseq.mesh.topology import Topology
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float, Index
from tests.meshes import rotation


@dataclass(frozen=True, eq=False)
class Fox:
    """A fox, the name of the bone that every vertex is on, the direction of its left, and its vertices in the walk."""

    mesh: MeshSequence
    bones: tuple[str, ...]
    left: Float
    vertices: Index

    @property
    def points(self) -> Float:
        return np.asarray(self.mesh.points[0], np.float64)

    @property
    def topology(self) -> Topology:
        return Topology(self.mesh.faces, self.mesh.vertex_count)


def long_legs(points: Float) -> Float:
    """Longer legs, wider apart."""
    x, y, z = points.T
    return np.stack([x, y + 0.5 * np.minimum(y, 0.45), 1.3 * z], axis=1)


@cache
def short() -> Fox:
    """The fox in the first frame of its walk, of 1500 vertices."""
    return _thinned(walk_cycle(4).points[0], 1500, np.array([0.0, 0.0, -1.0]))


@cache
def tall() -> Fox:
    """The same on longer legs, of 1000 vertices, elsewhere, turned, and in another unit."""
    legs = long_legs(walk_cycle(4).points[0])
    turned = rotation((0.1, 0.6, 0.0))
    return _thinned(100.0 * legs @ turned.T + [300.0, 0.0, -50.0], 1000, turned @ [0.0, 0.0, -1.0])


def _thinned(points: Float, count: int, left: Float) -> Fox:
    faces = walk_cycle(4).faces.astype(np.int64)
    kept, coarse = decimate(np.asarray(points, np.float64), faces, count)
    bone, names = part_of_vertex()
    return Fox(
        MeshSequence.from_arrays(points[None, kept], coarse, fps=24), tuple(names[bone[v]] for v in kept), left, kept
    )


def on_bones(fox: Fox, *bones: str) -> Index:
    """The vertex of each of some bones that is farthest from the body's middle."""
    away = np.linalg.norm(fox.points - fox.points.mean(axis=0), axis=1)
    names = np.array(fox.bones)
    return np.array([np.where(names == bone, away, -1).argmax() for bone in bones])


def seen_from_left(fox: Fox, bone: str) -> int:
    """The vertex of a bone that is farthest to the left."""
    return int(np.where(np.array(fox.bones) == bone, fox.points @ fox.left, -np.inf).argmax())
