"""Attach disconnected pieces of a mesh, such as eyes, teeth and shoes, to each other.

Every piece but the first is attached at one vertex to one vertex of another piece: the nearest of those attached
already, as in the shortest spanning tree (Prim 1957). Pieces that follow a leader are attached to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from mixseq.arrays import Float, Index


@dataclass(frozen=True, eq=False)
class Attachments:
    """A tree of pieces: each but the root is attached to another one at a vertex."""

    root: int  # the piece that holds all others
    pieces: Index  # (n,) the others, each after its holder
    own: Index  # (n,) the vertex by which each is held
    other: Index  # (n,) the vertex of the holder
    holders: Index  # (n,) the piece of that vertex

    def __len__(self) -> int:
        return len(self.pieces)


def attach(pieces: Sequence[Index], points: Float, leaders: Index) -> Attachments:
    """Attach every piece of a mesh ``(V, 3)`` but the largest to another one, or to its leader ``(V,)``."""
    led = np.array([bool((leaders[each] != each).all()) for each in pieces])
    sizes = np.array([np.linalg.norm(np.ptp(points[each], axis=0)) for each in pieces])
    root = int(np.argmax(np.where(led, -1.0, sizes)))
    free = [number for number in range(len(pieces)) if number != root and not led[number]]
    rows = _spanning_tree(pieces, points, root, free)
    home = np.full(len(points), -1, dtype=np.int64)
    for number in np.flatnonzero(~led)[::-1].tolist():
        home[pieces[number]] = number
    for number in np.flatnonzero(led).tolist():
        other = int(leaders[pieces[number][0]])
        near = np.linalg.norm(points[pieces[number]] - points[other], axis=1).argmin()
        rows.append((number, int(pieces[number][near]), other, int(home[other])))
    table = np.array(rows, dtype=np.int64).reshape(-1, 4)
    return Attachments(root, *table.T)


def _spanning_tree(
    pieces: Sequence[Index], points: Float, root: int, free: list[int]
) -> list[tuple[int, int, int, int]]:
    """Return rows of piece, own vertex, other vertex, holder."""
    if not free:
        return []
    vertices = np.concatenate([pieces[number] for number in free])
    owner = np.repeat(free, [len(pieces[number]) for number in free])
    distance = np.full(len(vertices), np.inf)
    other = np.zeros((2, len(vertices)), dtype=np.int64)
    rows: list[tuple[int, int, int, int]] = []
    newest = root
    while len(vertices):
        found, nearest = map(np.asarray, cKDTree(points[pieces[newest]]).query(points[vertices]))
        closer = found < distance
        distance[closer] = found[closer]
        other[0, closer], other[1, closer] = pieces[newest][nearest[closer]], newest
        first = int(distance.argmin())
        newest = int(owner[first])
        rows.append((newest, int(vertices[first]), int(other[0, first]), int(other[1, first])))
        rest = owner != newest
        vertices, owner, distance, other = vertices[rest], owner[rest], distance[rest], other[:, rest]
    return rows
