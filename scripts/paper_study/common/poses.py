"""The poses that tables and figures blend, and the lengths and angles that blends should have."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import NamedTuple

import numpy as np

import mixseq
from mixseq.mesh.measures import dihedral_angles, edge_lengths, unwrap_angles
from mixseq.mesh.rigid import kabsch, transform_points
from mixseq.mesh.topology import Topology
from mixseq.segmentation.motion import MotionSettings, segment_by_motion
from mixseq.sequence.sequence import bounding_diagonal
from mixseq.types import Float, Index
from scripts.benchmarks.common.harness import animation, subdivided


class Source(NamedTuple):
    """Which animation a mesh is from, the pair and the six frames that are blended, how many weights are tried.

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
is not told. Those of the gallops and of the horse are the farthest; `Poses.rank` tells of all."""

FINE = {"elephant_fine": Source("elephant_gallop", (0, 5), (0, 4, 8, 12, 16, 20), 8, "armadillo", fine=True)}
"""As large as the paper's largest mesh, for times."""

ALL = MESHES | FINE

RANKED = 3
"""One in so many vertices tells which pairs of frames are far apart."""

FRAMES = 24
"""So many frames of an animation, at most, tell of its parts."""


@dataclass(frozen=True, eq=False)
class Poses:
    """Some poses of a mesh of `ALL`: frames of its animation, and their vertices ``(n, V, 3)`` in units of the file."""

    mesh: str
    frames: tuple[int, ...]
    points: Float
    sequence: mixseq.MeshSequence
    topology: Topology

    @classmethod
    def of(cls, mesh: str, frames: tuple[int, ...] | None = None) -> Poses:
        """Take poses out of an animation, by default the pair of `MESHES`."""
        source = ALL[mesh]
        sequence = animation(source.animation)
        if source.fine:
            sequence = mixseq.MeshSequence.from_arrays(*subdivided(sequence))
        frames = source.pair if frames is None else frames
        points = sequence.points[list(frames)].astype(np.float64)
        return cls(mesh, frames, points, sequence, Topology(sequence.faces, sequence.vertex_count))

    @property
    def rank(self) -> tuple[int, int]:
        """How many pairs of frames of the animation are as far apart as this one or farther, and of how many."""
        frames = self.sequence.points[:, ::RANKED].astype(np.float64)
        own = _apart(*(frames[number] for number in self.frames[:2]))
        others = [_apart(first, second) for first, second in combinations(frames, 2)]
        return sum(other >= own for other in others), len(others)

    def moved(self, points: Float) -> Poses:
        """Return the same with other vertices."""
        return Poses(self.mesh, self.frames, points, self.sequence, self.topology)

    def only(self, *frames: int) -> Poses:
        """Return other frames of the same animation."""
        points = self.sequence.points[list(frames)].astype(np.float64)
        return Poses(self.mesh, frames, points, self.sequence, self.topology)

    @property
    def title(self) -> str:
        """Name of the animation and frames."""
        return f"{ALL[self.mesh].animation} {'-'.join(map(str, self.frames))}"

    @property
    def diagonal(self) -> float:
        """Diagonal of the first pose."""
        return bounding_diagonal(self.points[0]) or 1.0

    @property
    def telling(self) -> Float:
        """Frames of the whole animation that tell of the parts, (T, V, 3)."""
        step = max(1, -(-len(self.sequence) // FRAMES))
        return self.sequence.points[::step].astype(np.float64)

    def segmented(self, parts: int | None = None) -> Index:
        """Return the parts ``(F,)`` by motion, over the whole animation."""
        return segment_by_motion(self.telling, self.topology, parts, MotionSettings())

    @cached_property
    def lengths(self) -> Float:
        """Edge lengths ``(n, E)``."""
        return np.stack([edge_lengths(x, self.topology.edges) for x in self.points])

    @cached_property
    def angles(self) -> Float:
        """Dihedral angles ``(n, H)``, from pose to pose by the shorter way round."""
        return unwrap_angles(np.stack([dihedral_angles(x, self.topology.hinges) for x in self.points]))

    def target(self, weights: Float) -> tuple[Float, Float]:
        """Return the blended lengths ``(E,)`` and angles ``(H,)``."""
        return weights @ self.lengths, weights @ self.angles


def _apart(first: Float, second: Float) -> float:
    """Sum of squared distances of vertices ``(V, 3)``, up to a rigid motion."""
    return float(np.square(transform_points(first, *kabsch(first, second)) - second).sum())


def between(weight: float) -> Float:
    """Return the weights of two poses, the second of which has this one."""
    return np.array([1.0 - weight, weight])
