"""Segmentation by rigid motion: faces that turn together form a part.

1. *Cluster.* Every cluster carries one rigid motion per frame; faces go to the cluster that predicts them best
   (Lloyd's iteration), the costs being diffused over the surface first so that boundaries come out smooth. The
   worst predicted patch seeds the next cluster, until there are enough.
2. *Connect.* Clusters are split into connected patches; crumbs join the neighbour that predicts them best.
3. *Merge.* Neighbours are merged, those that turn least against each other first, until every boundary bends
   enough (or the number of parts asked for is reached). Bending is the measure because it is what a part cannot
   do: vertices of a part are combined linearly, which is fine for slides and small deformations, but shortens
   what turns.

The result depends on nothing but the input: there are no random numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mixseq.errors import SettingsError
from mixseq.geometry.rigid import bend
from mixseq.segmentation.rigid_error import Moments, moments
from mixseq.sequence import FloatArray
from mixseq.topology import Topology, split_labels, spread

Float = NDArray[np.float64]
Labels = NDArray[np.int64]


@dataclass(frozen=True)
class MotionSettings:
    """Settings of `segment_by_motion`.

    Attributes
    ----------
    clusters : int
        Clusters to start from; parts are merged from these.
    frames : int
        Frames looked at, evenly spread over the sequence.
    smoothing : float
        Rounds of averaging costs over neighbouring faces, per square root of the number of faces, so that
        boundaries are equally smooth on coarse and on dense meshes.
    bend : float
        A boundary stays where its sides turn against each other by more degrees than this, between any two
        frames ...
    narrow : float
        ... and by up to this fraction more where a side is so narrow that its joints would take all of it:
        such patches are where skin bends, not parts.
    soft, stiff : float
        A patch softer than `soft` is no part: it joins a neighbour with which it is stiffer than `stiff`, if
        there is one. Softness is the largest rigid error of a frame, root mean square, relative to the radius
        of gyration.
    crumb : float
        Patches below this fraction of the faces join a neighbour.
    """

    clusters: int = 23
    frames: int = 24
    smoothing: float = 0.1
    bend: float = 20.0
    narrow: float = 1.0
    soft: float = 0.5
    stiff: float = 0.35
    crumb: float = 0.003


def segment_by_motion(
    points: FloatArray,
    topology: Topology,
    parts: int | None = None,
    settings: MotionSettings | None = None,
) -> Labels:
    """Find the near-rigid parts of a moving mesh.

    Parameters
    ----------
    points : (T, V, 3) float
        The sequence; any unit.
    topology : Topology
        Its connectivity.
    parts : int, optional
        Number of parts. Every connected component has at least one, whatever is asked for. Found automatically
        if not given.
    settings : MotionSettings, optional
        Details.

    Returns
    -------
    (F,) int64
        Part of every face, numbered 0, 1, ... by decreasing area. Parts are connected across edges.

    Raises
    ------
    SettingsError
        If `parts` is below one or above the number of faces.
    """
    settings = settings or MotionSettings()
    face_count = len(topology.faces)
    if parts is not None and not 1 <= parts <= face_count:
        raise SettingsError(f"parts is {parts}; a number from 1 to {face_count} (the faces) is expected")
    motion = _Motion.of(points, topology, settings.frames)
    clusters = max(settings.clusters, round(1.5 * (parts or 1)))
    labels = _cluster(motion, min(clusters, face_count), settings)
    patches = _absorb_crumbs(motion, split_labels(topology, labels), settings)
    return _by_area(_merge(motion, patches, parts, settings), motion.area)


@dataclass(frozen=True, eq=False)
class _Motion:
    """The data every step looks at: centred rest positions, vertex trajectories, face areas."""

    topology: Topology
    rest: Float
    moved: Float
    area: Float

    @classmethod
    def of(cls, points: FloatArray, topology: Topology, frames: int) -> _Motion:
        chosen = np.unique(np.linspace(0, len(points) - 1, min(len(points), frames)).round().astype(int))
        x = points[chosen].astype(np.float64)
        x -= x.mean(axis=1, keepdims=True)
        x /= max(float(np.linalg.norm(x[0].max(axis=0) - x[0].min(axis=0))), np.finfo(np.float64).tiny)
        corners = x[0][topology.faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.maximum(0.5 * np.linalg.norm(normal, axis=1), 1e-12)
        return cls(topology, x[0], np.ascontiguousarray(x.transpose(1, 0, 2)), area)

    def moments(self, faces: NDArray[np.intp]) -> Moments:
        """Moments of a set of faces, a third of each area on every corner."""
        corners = self.topology.faces[faces].reshape(-1)
        thirds = np.repeat(self.area[faces] / 3.0, 3)
        weights = np.bincount(corners, thirds, self.topology.vertex_count).astype(np.float64)
        used = np.flatnonzero(weights)
        return moments(self.rest[used], self.moved[used], weights[used])

    def costs(self, clusters: list[Moments]) -> Float:
        """Mean squared distance ``(F, K)`` of every face's corners from where each cluster puts them.

        ``|x - A h|^2``, with h in homogeneous coordinates and A the motions of all frames below each other, is
        expanded so that all clusters and frames are one matrix product.
        """
        count, frames = len(self.rest), self.moved.shape[1]
        flat = self.moved.reshape(count, -1)
        h = np.concatenate([self.rest, np.ones((count, 1))], axis=1)
        motions = [
            np.concatenate([r, t[:, :, None]], axis=2).reshape(-1, 4)
            for r, t in (c.motion() for c in clusters)
        ]
        mixed = (flat @ np.concatenate(motions, axis=1)).reshape(count, -1, 4)
        squares = np.stack([a.T @ a for a in motions])
        predicted = np.einsum("vi,kij,vj->vk", h, squares, h, optimize=True)
        distance = self.square[:, None] - 2.0 * np.einsum("vki,vi->vk", mixed, h) + predicted
        per_vertex = np.maximum(distance, 0.0) / frames
        return np.asarray(per_vertex[self.topology.faces].mean(axis=1))

    @cached_property
    def averaging(self) -> sparse.csr_array:
        """Matrix ``(F, F)`` that averages over each face and its neighbours."""
        weights = self.topology.face_adjacency + sparse.eye_array(len(self.area))
        mean = sparse.diags_array(1.0 / np.asarray(weights.sum(axis=1)).reshape(-1)) @ weights
        return sparse.csr_array(mean.astype(np.float32))

    @cached_property
    def square(self) -> Float:
        """Sum of squares ``(V,)`` of every trajectory."""
        return np.asarray(np.einsum("vti,vti->v", self.moved, self.moved))


def _cluster(motion: _Motion, count: int, settings: MotionSettings) -> Labels:
    """Lloyd's iteration with one more cluster at a time; only its end looks at fully diffused costs."""
    face_count = len(motion.area)
    seed_size = max(4, face_count // (6 * count))
    rounds = max(1, round(settings.smoothing * face_count**0.5))
    labels = np.zeros(face_count, dtype=np.int64)
    for _ in range(1, count):
        labels, own = _assign(motion, labels, 1 + rounds // 4)
        labels[_ball(motion.topology, int(np.argmax(own)), seed_size)] = labels.max() + 1
        labels, _ = _assign(motion, labels, 1 + rounds // 4)
    for _ in range(4):
        labels, _ = _assign(motion, labels, rounds)
    return labels


def _assign(motion: _Motion, labels: Labels, rounds: int) -> tuple[Labels, NDArray[np.float32]]:
    """Give every face to the cluster of lowest cost; return the labels and that cost, both ``(F,)``.

    Costs are averaged over neighbouring faces first, as many times as `rounds` tells.
    """
    clusters = [motion.moments(np.flatnonzero(labels == k)) for k in np.unique(labels)]
    costs = motion.costs(clusters).astype(np.float32)  # half the memory to move, and all that labels need
    for _ in range(rounds):
        costs = motion.averaging @ costs
    updated = np.argmin(costs, axis=1).astype(np.int64)
    return updated, np.take_along_axis(costs, updated[:, None], axis=1)[:, 0]


def _ball(topology: Topology, face: int, size: int) -> NDArray[np.intp]:
    """Faces around a face, ring by ring, until there are `size` of them or no more."""
    inside = np.zeros(len(topology.faces))
    inside[face] = 1.0
    while True:
        grown = ((topology.face_adjacency @ inside + inside) > 0).astype(np.float64)
        if grown.sum() >= size or grown.sum() == inside.sum():
            return np.flatnonzero(grown)
        inside = grown


def _borders(topology: Topology, patches: Labels) -> Labels:
    """Pairs ``(B, 2)`` of neighbouring patches, lower number first."""
    pairs = np.sort(patches[topology.hinge_faces], axis=1)
    return np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0)


def _absorb_crumbs(motion: _Motion, patches: Labels, settings: MotionSettings) -> Labels:
    """Give every small patch to the neighbour with which the rigid error grows least, smallest first."""
    smallest = max(4, round(settings.crumb * len(patches)))
    cache = {int(p): motion.moments(np.flatnonzero(patches == p)) for p in np.unique(patches)}
    patches = patches.copy()
    kept: set[int] = set()
    while True:
        sizes = np.bincount(patches)
        crumbs = [int(p) for p in np.flatnonzero((sizes > 0) & (sizes < smallest)) if int(p) not in kept]
        if not crumbs:
            return patches
        crumb = min(crumbs, key=lambda p: (sizes[p], p))
        borders = _borders(motion.topology, patches)
        neighbours = borders[(borders == crumb).any(axis=1)].sum(axis=1) - crumb
        if not len(neighbours):
            kept.add(crumb)  # a component of its own
            continue
        into = min(
            (int(n) for n in neighbours),
            key=lambda n: ((cache[n] + cache[crumb]).error() - cache[n].error(), n),
        )
        cache[into] += cache.pop(crumb)
        patches[patches == crumb] = into


def _merge(motion: _Motion, patches: Labels, parts: int | None, settings: MotionSettings) -> Labels:
    """Merge neighbours, the stiffest pair first, until `parts` are left or every boundary bends enough."""
    patches = patches.copy()
    cache = {int(p): motion.moments(np.flatnonzero(patches == p)) for p in np.unique(patches)}
    turns = {p: m.motion()[0] for p, m in cache.items()}
    bends: dict[tuple[int, int], float] = {}
    while parts is None or len(cache) > parts:
        pairs = [(int(i), int(j)) for i, j in _borders(motion.topology, patches)]
        bends = {(i, j): bends.get((i, j), bend(turns[i], turns[j])) for i, j in pairs}
        if not bends:
            break
        narrow = _narrowness(motion.topology, patches)
        worth = {
            (i, j): b / (1.0 + settings.narrow * max(narrow[i], narrow[j])) for (i, j), b in bends.items()
        }
        soft = {p for p, m in cache.items() if m.softness > settings.soft}
        for i, j in bends:
            if (i in soft or j in soft) and (cache[i] + cache[j]).softness < settings.stiff:
                worth[i, j] = 0.0
        keep, drop = min(worth, key=lambda pair: (worth[pair], bends[pair], pair))
        if parts is None and worth[keep, drop] > settings.bend:
            break
        patches[patches == drop] = keep
        cache[keep] += cache.pop(drop)
        turns[keep] = cache[keep].motion()[0]
        bends = {pair: b for pair, b in bends.items() if keep not in pair and drop not in pair}
    return patches


def _narrowness(topology: Topology, patches: Labels) -> Float:
    """Share of each patch's corners on its boundary or one edge away: what joints would take from it."""
    crossing = patches[topology.hinge_faces[:, 0]] != patches[topology.hinge_faces[:, 1]]
    depth = np.zeros(topology.vertex_count, dtype=np.int64)
    depth[topology.edges[topology.hinge_edges[crossing]]] = 2
    near = (spread(topology, depth) > 0)[topology.faces].mean(axis=1)
    return np.asarray(np.bincount(patches, near) / np.maximum(np.bincount(patches), 1), dtype=np.float64)


def _by_area(labels: Labels, area: Float) -> Labels:
    """Number labels by decreasing area (ties: by first face)."""
    _, first, dense = np.unique(labels, return_index=True, return_inverse=True)
    order = np.lexsort((first, -np.bincount(dense, area)))
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return np.asarray(rank[dense], dtype=np.int64)
