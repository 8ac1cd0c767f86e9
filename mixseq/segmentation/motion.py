"""Segmentation by rigid motion: faces that move together form a part.

1. *Cluster.* Every cluster carries one rigid motion per frame; faces go to the cluster that predicts them best
   (Lloyd's iteration), the costs being diffused over the surface first so that boundaries come out smooth. The
   worst predicted patch seeds the next cluster, until there are enough.
2. *Connect.* Clusters are split into connected patches; crumbs join the neighbour that predicts them best.
3. *Merge.* Neighbours are merged, cheapest pair first, while a boundary buys too little (or until the number of
   parts asked for is reached).

The result depends on nothing but the input: there are no random numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import SettingsError
from mixseq.segmentation.rigid_error import Moments, moments
from mixseq.sequence import FloatArray
from mixseq.topology import Topology, face_patches

Float = NDArray[np.float64]
Labels = NDArray[np.int64]


@dataclass(frozen=True)
class MotionSettings:
    """Settings of `segment_by_motion`; lengths are fractions of the bounding-box diagonal.

    Attributes
    ----------
    clusters : int
        Clusters to start from when the number of parts is found automatically.
    frames : int
        Frames looked at, evenly spread over the sequence.
    smoothing : float
        Rounds of averaging costs over neighbouring faces, per square root of the number of faces, so that
        boundaries are equally smooth on coarse and on dense meshes.
    gain : float
        A boundary is kept if dropping it raises the squared rigid error by more than this fraction, for a
        boundary as long (in edges) as the square root of the number of vertices and in proportion for others:
        long boundaries make large joints and must buy more; ...
    rigid : float
        ... and the error, root mean square, is above this then.
    crumb : float
        Patches below this fraction of the faces join a neighbour.
    """

    clusters: int = 20
    frames: int = 40
    smoothing: float = 0.1
    gain: float = 0.5
    rigid: float = 0.003
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
    clusters = settings.clusters if parts is None else max(parts, round(1.25 * parts))
    labels = _cluster(motion, min(clusters, face_count), settings)
    patches = _absorb_crumbs(motion, _patches(topology, labels), settings)
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
        weights = np.bincount(corners, np.repeat(self.area[faces] / 3.0, 3), self.topology.vertex_count)
        used = np.flatnonzero(weights)
        return moments(self.rest[used], self.moved[used], weights[used])

    def costs(self, clusters: list[Moments]) -> Float:
        """Mean squared distance ``(F, K)`` of every face's corners from where each cluster puts them.

        ``|x - (R h + t)|^2`` is expanded so that all clusters and frames are one matrix product.
        """
        count, frames = len(self.rest), self.moved.shape[1]
        flat = self.moved.reshape(count, -1)
        affine = np.concatenate([self.rest, np.ones((count, 1))], axis=1)
        square = np.einsum("vi,vi->v", flat, flat)
        columns = []
        for cluster in clusters:
            rotation, translation = cluster.motion()
            matrix = np.concatenate([rotation, translation[:, :, None]], axis=2).reshape(-1, 4)
            mixed = np.einsum("vi,vi->v", flat @ matrix, affine)
            columns.append(square - 2.0 * mixed + np.einsum("vi,ij,vj->v", affine, matrix.T @ matrix, affine))
        per_vertex = np.maximum(np.stack(columns, axis=1), 0.0) / frames
        return np.asarray(per_vertex[self.topology.faces].mean(axis=1))


def _cluster(motion: _Motion, count: int, settings: MotionSettings) -> Labels:
    face_count = len(motion.area)
    labels = np.zeros(face_count, dtype=np.int64)
    seed_size = max(4, face_count // (6 * count))
    rounds = max(1, round(settings.smoothing * face_count**0.5))
    costs = _diffuse(motion, motion.costs([motion.moments(np.arange(face_count))]), rounds)
    for _ in range(1, count):
        own = np.take_along_axis(costs, labels[:, None], axis=1)[:, 0]
        labels = labels.copy()
        labels[_ball(motion.topology, int(np.argmax(own)), seed_size)] = labels.max() + 1
        for _ in range(4):
            labels = np.unique(labels, return_inverse=True)[1].reshape(-1)  # some cluster may have died
            found = [motion.moments(np.flatnonzero(labels == k)) for k in range(labels.max() + 1)]
            costs = _diffuse(motion, motion.costs(found), rounds)
            updated = np.argmin(costs, axis=1)
            settled = np.mean(updated == labels) > 0.999
            labels = updated
            if settled:
                break
    return labels


def _diffuse(motion: _Motion, costs: Float, rounds: int) -> Float:
    """Average costs over each face and its neighbours."""
    adjacency = motion.topology.face_adjacency
    degree = np.asarray(adjacency.sum(axis=1)).reshape(-1, 1) + 1.0
    for _ in range(rounds):
        costs = (costs + adjacency @ costs) / degree
    return costs


def _ball(topology: Topology, face: int, size: int) -> NDArray[np.intp]:
    """Faces around a face, ring by ring, until there are `size` of them or no more."""
    inside = np.zeros(len(topology.faces))
    inside[face] = 1.0
    while True:
        grown = ((topology.face_adjacency @ inside + inside) > 0).astype(np.float64)
        if grown.sum() >= size or grown.sum() == inside.sum():
            return np.flatnonzero(grown)
        inside = grown


def _patches(topology: Topology, labels: Labels) -> Labels:
    """Split every label into hinge-connected patches."""
    patches = np.full(len(labels), -1, dtype=np.int64)
    count = 0
    for label in np.unique(labels):
        inside = labels == label
        numbers = face_patches(topology, inside)
        patches[inside] = numbers[inside] + count
        count += int(numbers.max()) + 1
    return patches


def _borders(topology: Topology, patches: Labels) -> tuple[Labels, Labels]:
    """Pairs ``(B, 2)`` of neighbouring patches, lower number first, and how many edges ``(B,)`` they share."""
    pairs = np.sort(patches[topology.hinge_faces], axis=1)
    return np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0, return_counts=True)


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
        borders, _ = _borders(motion.topology, patches)
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
    """Merge neighbours, cheapest first, until `parts` are left or every boundary is worth its length."""
    patches = patches.copy()
    cache = {int(p): motion.moments(np.flatnonzero(patches == p)) for p in np.unique(patches)}
    errors = {p: m.error() for p, m in cache.items()}
    negligible = settings.rigid**2 * float(motion.area.sum()) * motion.moved.shape[1]
    unit = len(motion.rest) ** 0.5
    growth: dict[tuple[int, int], float] = {}
    while parts is None or len(cache) > parts:
        borders, lengths = _borders(motion.topology, patches)
        pairs = [(int(i), int(j)) for i, j in borders]
        growth = {
            p: growth.get(p, (cache[p[0]] + cache[p[1]]).error() - errors[p[0]] - errors[p[1]]) for p in pairs
        }
        prices = [growth[pair] / (length / unit) for pair, length in zip(pairs, lengths, strict=True)]
        if not prices:
            break
        cheapest = int(np.argmin(prices))
        keep, drop = pairs[cheapest]
        total = sum(errors.values())
        if (
            parts is None
            and prices[cheapest] > settings.gain * total
            and total + growth[keep, drop] > negligible
        ):
            break
        patches[patches == drop] = keep
        cache[keep] += cache.pop(drop)
        errors[keep] = cache[keep].error()
        del errors[drop]
        growth = {pair: g for pair, g in growth.items() if keep not in pair and drop not in pair}
    return patches


def _by_area(labels: Labels, area: Float) -> Labels:
    """Number labels by decreasing area (ties: by first face)."""
    _, first, dense = np.unique(labels, return_index=True, return_inverse=True)
    order = np.lexsort((first, -np.bincount(dense, area)))
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return np.asarray(rank[dense], dtype=np.int64)
