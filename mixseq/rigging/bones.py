"""Initial bones, and motions as matrices.

A motion of frame t, :math:`M_{tb} = (R_{tb}, T_{tb})`, is stored transposed, ``(4, 3)``, next to those of all frames.
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.geometry.rigid import kabsch, nearest_rotations
from mixseq.rigging.weights import Binding
from mixseq.segmentation.rigid_error import moments, union_errors


def transposed(rotations: Float, translations: Float) -> Float:
    """Return rotations ``(T, 3, 3)`` and translations ``(T, 3)`` as a transposed motion ``(4, 3T)``."""
    whole = np.concatenate([rotations, translations[:, :, None]], axis=2)
    return whole.transpose(2, 0, 1).reshape(4, -1)


def on_rotations(motions: Float) -> Float:
    """Return transposed motions ``(B, 4, 3T)`` with the nearest rotations."""
    parts = motions.reshape(len(motions), 4, -1, 3).transpose(0, 2, 3, 1)  # (B, T, 3, 4)
    turns = nearest_rotations(parts[..., :3])
    return np.stack([transposed(turn, part[..., 3]) for turn, part in zip(turns, parts, strict=True)])


def motion_of(tracks: Float, rest: Float, vertices: Index) -> Float:
    """Return the best rigid motion ``(4, 3T)`` of some vertices."""
    some = tracks[vertices].reshape(len(vertices), -1, 3).swapaxes(0, 1)
    return transposed(*kabsch(rest[vertices], some))


def vertex_labels(faces: Index, labels: Index, vertex_count: int) -> Index:
    """Return the most frequent label ``(V,)`` of triangles at a vertex, ties to the lowest; 0 where there is none."""
    votes = np.zeros((vertex_count, int(labels.max()) + 1), dtype=np.int64)
    np.add.at(votes, (faces.reshape(-1), np.repeat(labels, 3)), 1)
    return np.asarray(votes.argmax(axis=1), dtype=np.int64)


def merged(tracks: Float, labels: Index, count: int) -> Index:
    """Merge bones, in contact or not, down to `count`, first the pair whose common rigid motion costs least."""
    labels = np.unique(labels, return_inverse=True)[1]
    x = tracks.reshape(len(tracks), -1, 3)
    bones = int(labels.max()) + 1
    own = [x[labels == bone] for bone in range(bones)]
    sums = [moments(each[:, 0], each, np.ones(len(each))) for each in own]
    errors = np.array([each.error() for each in sums])
    left = list(range(bones))
    costs = np.full((bones, bones), np.inf)  # above the diagonal
    if bones > count:
        for i in range(bones - 1):
            costs[i, i + 1 :] = union_errors(sums[i], sums[i + 1 :]) - errors[i] - errors[i + 1 :]
    while len(left) > count:
        keep, drop = divmod(int(costs.argmin()), bones)
        labels[labels == drop] = keep
        left.remove(drop)
        sums[keep] += sums[drop]
        errors[keep] = sums[keep].error()
        costs[drop] = costs[:, drop] = np.inf
        others = np.array([bone for bone in left if bone != keep], dtype=np.int64)
        if others.size:
            unions = union_errors(sums[keep], [sums[bone] for bone in others])
            costs[np.minimum(keep, others), np.maximum(keep, others)] = unions - errors[keep] - errors[others]
    return np.asarray(np.unique(labels, return_inverse=True)[1], dtype=np.int64)


def seeded(tracks: Float, binding: Binding, count: int, size: int) -> Float:
    """Return motions ``(n, 4, 3T)`` of new bones at vertices of largest error, with the `size` nearest vertices."""
    errors = binding.errors.copy()
    found = []
    for _ in range(count):
        worst = int(errors.argmax())
        if errors[worst] <= 0:
            break
        off = tracks - tracks[worst]
        near = np.argpartition(np.einsum("vi,vi->v", off, off), min(size, len(off)) - 1)[:size]
        found.append(motion_of(tracks, binding.rest, np.sort(near)))
        errors[near] = 0.0
        errors[worst] = 0.0
    return np.stack(found) if found else np.zeros((0, 4, tracks.shape[1]))
