"""The poses that tables and figures blend, and the lengths and angles that blends should have."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

import mixseq
from mixseq.mesh.measures import dihedral_angles, edge_lengths, unwrap_angles
from mixseq.mesh.rigid import kabsch, transform_points
from mixseq.mesh.topology import Topology
from mixseq.segmentation.motion import MotionSettings, segment_by_motion
from mixseq.sequence.sequence import bounding_diagonal
from mixseq.types import Float, Index
from scripts.benchmarks.common.harness import animation, subdivided


class Source(NamedTuple):
    """Animation of a mesh, the pair and the six frames that are blended, and the number of steps of the weight.

    `printed` is what the paper calls the mesh, or one with as many vertices. If `fine`, triangles are split into four.
    """

    animation: str
    pair: tuple[int, int]
    six: tuple[int, ...]
    steps: int
    printed: str
    fine: bool = False


MESHES = {
    "lion": Source("lion_poses", (2, 5), (1, 2, 3, 4, 5, 6), 20, "lion"),
    "cat": Source("cat_poses", (1, 3), (1, 2, 4, 5, 6, 7), 20, "cat"),
    "horse": Source("horse_poses", (6, 10), (1, 2, 3, 4, 5, 6), 20, "horse"),
    "elephant_gallop": Source("elephant_gallop", (0, 5), (0, 4, 8, 12, 16, 20), 8, "galloping elephant"),
    "horse_gallop": Source("horse_gallop", (5, 11), (0, 4, 8, 12, 16, 20), 20, "horse"),
}
"""The four meshes of the paper that there are data of, and a second pair of its horse. Which frames the paper blends
is not told. Those of the gallops and of the horse are the farthest; `Poses.rank` has all."""

ALL = MESHES | {"elephant_fine": MESHES["elephant_gallop"]._replace(printed="armadillo", fine=True)}
"""With one as large as the paper's largest mesh, for times."""

PAPER = tuple(mesh for mesh in MESHES if mesh != "horse_gallop")
"""The meshes of the paper."""

RANK_STRIDE = 3  # stride of the vertices by whose distances pairs of frames are ranked
MAX_FRAMES = 24  # largest number of frames of an animation that parts are found from
LIMB_VERTICES = 200  # largest number of vertices that distances along limbs are taken of
APART, PATH = 0.2, 1.5
"""Two vertices of a limb are farther apart than this, in diagonals, by a path at most that many times as long."""


@dataclass(frozen=True, eq=False)
class Poses:
    """Some poses of a mesh of `ALL`: frames of its animation, and their vertices ``(n, V, 3)`` in units of the file."""

    mesh: str
    frames: tuple[int, ...]
    points: Float
    sequence: mixseq.MeshSequence
    topology: Topology

    @classmethod
    def of(cls, mesh: str) -> Poses:
        """Take the pair of a mesh out of its animation."""
        source = ALL[mesh]
        sequence = animation(source.animation)
        if source.fine:
            sequence = mixseq.MeshSequence.from_arrays(*subdivided(sequence))
        points = sequence.points[list(source.pair)].astype(np.float64)
        return cls(mesh, source.pair, points, sequence, Topology(sequence.faces, sequence.vertex_count))

    @property
    def rank(self) -> tuple[int, int]:
        """Number of pairs of frames of the animation that are as far apart as these or farther, and of all pairs."""
        frames = self.sequence.points[:, ::RANK_STRIDE].astype(np.float64)
        pairs: list[tuple[int, ...]] = list(combinations(range(len(frames)), 2))
        away = np.array([np.square(apart(frames[i], frames[j])).sum() for i, j in pairs])
        return int((away >= away[pairs.index(self.frames)]).sum()), len(pairs)

    def moved(self, points: Float) -> Poses:
        """Return the same with other vertices."""
        return replace(self, points=points)

    def only(self, *frames: int) -> Poses:
        """Return other frames of the same animation."""
        return replace(self, frames=frames, points=self.sequence.points[list(frames)].astype(np.float64))

    @property
    def title(self) -> str:
        """Name of the animation and frames."""
        return f"{ALL[self.mesh].animation} {'-'.join(map(str, self.frames))}"

    @property
    def diagonal(self) -> float:
        """Diagonal of the first pose."""
        return bounding_diagonal(self.points[0]) or 1.0

    @property
    def sampled_frames(self) -> Float:
        """Frames ``(T, V, 3)`` of the whole animation that parts are found from."""
        step = max(1, -(-len(self.sequence) // MAX_FRAMES))
        return self.sequence.points[::step].astype(np.float64)

    def segmented(self, parts: int | None = None) -> Index:
        """Return the parts ``(F,)`` by motion, over the whole animation."""
        return segment_by_motion(self.sampled_frames, self.topology, parts, MotionSettings())

    @cached_property
    def lengths(self) -> Float:
        """Edge lengths ``(n, E)``."""
        return edge_lengths(self.points, self.topology.edges)

    @cached_property
    def angles(self) -> Float:
        """Dihedral angles ``(n, H)``, from pose to pose by the shorter way round."""
        return unwrap_angles(dihedral_angles(self.points, self.topology.hinges))

    def distances(self, starts: list[int]) -> Float:
        """Return the lengths ``(n, V)`` of the shortest paths of edges from vertices, in diagonals."""
        lengths, count = self.lengths.mean(axis=0) / self.diagonal, self.topology.vertex_count
        graph = sparse.coo_array((lengths, tuple(self.topology.edges.T)), shape=(count, count)).tocsr()
        return np.asarray(dijkstra(graph, directed=False, indices=starts))

    @cached_property
    def along_limbs(self) -> tuple[Index, Float]:
        """Pairs ``(n, 2)`` of vertices along limbs, and their smallest distances ``(n,)`` in all poses."""
        count = self.topology.vertex_count
        chosen = np.arange(0, count, -(-count // LIMB_VERTICES))
        first, second = np.triu_indices(len(chosen), 1)
        sides = self.points[:, chosen[second]] - self.points[:, chosen[first]]
        shortest = np.linalg.norm(sides, axis=2).min(axis=0)
        paths = self.distances(chosen.tolist())[first, chosen[second]] * self.diagonal
        kept = (shortest > APART * self.diagonal) & (paths < PATH * shortest)
        return np.stack([chosen[first], chosen[second]], axis=1)[kept], shortest[kept]

    def target(self, weights: Float) -> tuple[Float, Float]:
        """Return the blended lengths ``(E,)`` and angles ``(H,)``."""
        return weights @ self.lengths, weights @ self.angles


def apart(first: Float, second: Float, fitted: Index | slice = slice(None)) -> Float:
    """Return how far vertices ``(V,)`` of two meshes are apart when they are moved onto each other, by some of them."""
    rotation, translation = kabsch(first[fitted], second[fitted])
    return np.asarray(np.linalg.norm(transform_points(first, rotation, translation) - second, axis=1))


def between(weight: float) -> Float:
    """Return the weights of two poses, the second of which has this one."""
    return np.array([1.0 - weight, weight])
