"""Small meshes and sequences with known properties, made from formulas."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray
from pytest import MonkeyPatch

from mixseq import creature
from mixseq.mesh.topology import Topology
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float, Index

Mesh = tuple[Float, Index]

COARSE_CELL_METRES = 0.04
"""Cells in which the fox has 1,614 vertices instead of 5,598, and is still closed and manifold."""


# Shapes ---------------------------------------------------------------------------------------------------


def tetrahedron() -> Mesh:
    """The regular tetrahedron with edges of length sqrt(8), faces counter-clockwise from outside."""
    points = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    return points, np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])


def grid(rows: int, columns: int) -> Mesh:
    """A flat sheet of rows x columns squares of side 1, each cut into two triangles."""
    y, x = np.mgrid[: rows + 1, : columns + 1].astype(float)
    points = np.stack([x.reshape(-1), y.reshape(-1), np.zeros(x.size)], axis=1)
    return points, _quads(np.arange(x.size).reshape(x.shape))


def tube(sides: int, rings: int, length: float = 4.0, radius: float = 0.5, closed: bool = True) -> Mesh:
    """A tube around the z axis: `rings` rings of `sides` vertices, capped by a vertex at each end if closed."""
    z, angle = np.meshgrid(np.linspace(0, length, rings), np.arange(sides) * 2 * np.pi / sides, indexing="ij")
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=2).reshape(-1, 3)
    number = np.arange(rings * sides).reshape(rings, sides)
    faces = _quads(np.concatenate([number, number[:, :1]], axis=1))
    if not closed:
        return points, faces
    bottom, top = rings * sides, rings * sides + 1
    around = [(number[0, k], number[0, (k + 1) % sides]) for k in range(sides)]
    above = [(number[-1, k], number[-1, (k + 1) % sides]) for k in range(sides)]
    caps = [(bottom, j, i) for i, j in around] + [(top, i, j) for i, j in above]
    points = np.concatenate([points, [[0, 0, 0], [0, 0, length]]])
    return points, np.concatenate([faces, np.array(caps)])


def torus(around: int, across: int, radius: float = 2.0, thickness: float = 0.7) -> Mesh:
    """A torus around the z axis."""
    u, v = np.meshgrid(np.arange(around) * 2 * np.pi / around, np.arange(across) * 2 * np.pi / across, indexing="ij")
    ring = radius + thickness * np.cos(v)
    points = np.stack([ring * np.cos(u), ring * np.sin(u), thickness * np.sin(v)], axis=2).reshape(-1, 3)
    number = np.arange(around * across).reshape(around, across)
    number = np.concatenate([number, number[:1]])
    return points, _quads(np.concatenate([number, number[:, :1]], axis=1))


def pages(count: int = 3, rows: int = 6, columns: int = 4) -> Mesh:
    """A book: `count` sheets that share their spine, the column x = y = 0."""
    sheet, faces = grid(rows, columns)
    spine = np.flatnonzero(sheet[:, 0] == 0)
    points, all_faces = [sheet[spine]], []
    start = len(spine)
    for page in range(count):
        angle = 2 * np.pi * page / count + 0.2 * page
        number = np.full(len(sheet), -1)
        number[spine] = np.arange(len(spine))
        rest = np.flatnonzero(sheet[:, 0] > 0)
        number[rest] = start + np.arange(len(rest))
        start += len(rest)
        x, z = sheet[rest, 0], sheet[rest, 1]
        points.append(np.stack([x * np.cos(angle), x * np.sin(angle), z], axis=1))
        all_faces.append(number[faces])
    whole = np.concatenate(points)
    whole[: len(spine)] = np.stack([np.zeros(len(spine)), np.zeros(len(spine)), sheet[spine, 1]], axis=1)
    return whole, np.concatenate(all_faces)


def joined(*meshes: Mesh) -> Mesh:
    """Several meshes as one, as components of their own."""
    starts = np.cumsum([0, *(len(points) for points, _ in meshes)])
    faces = [faces + start for (_, faces), start in zip(meshes, starts, strict=False)]
    return np.concatenate([points for points, _ in meshes]), np.concatenate(faces)


def flipped(faces: Index, every: int = 3) -> Index:
    """The same faces with every n-th one turned over."""
    result = faces.copy()
    result[::every] = result[::every, ::-1]
    return result


def topology_of(mesh: Mesh) -> Topology:
    return Topology(mesh[1], len(mesh[0]))


def _quads(number: NDArray[np.intp]) -> Index:
    a, b = number[:-1, :-1].reshape(-1), number[:-1, 1:].reshape(-1)
    c, d = number[1:, 1:].reshape(-1), number[1:, :-1].reshape(-1)
    return np.stack([a, b, c, a, c, d], axis=1).reshape(-1, 3)


# Motions --------------------------------------------------------------------------------------------------


def rotation(vector: tuple[float, float, float] | Float) -> Float:
    """The rotation matrix of a rotation vector (Rodrigues' formula)."""
    v = np.asarray(vector, dtype=np.float64)
    angle = float(np.linalg.norm(v))
    if angle == 0:
        return np.eye(3)
    x, y, z = v / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k))


def bent(points: Float, angle: float, middle: float = 2.0, blend: float = 0.8) -> Float:
    """Linear blend skinning to two bones along z that meet at z = `middle`; the upper one turns about x."""
    weight = np.clip((points[:, 2:] - middle) / blend + 0.5, 0.0, 1.0)
    pivot = np.array([0.0, 0.0, middle])
    turned = (points - pivot) @ rotation((angle, 0, 0)).T + pivot
    return np.asarray((1 - weight) * points + weight * turned)


def bending(mesh: Mesh, frames: int = 5, angle: float = np.pi / 2, wobble: float = 0.05) -> Float:
    """Frames of a mesh along z in [0, 4] that bends in the middle, swells a little and wanders off."""
    points = mesh[0]
    result = []
    for t in np.linspace(0, 1, frames):
        swollen = points * (1 + wobble * np.sin(3 * points[:, 2:] + 5 * t) * [1, 1, 0])
        moved = bent(swollen, angle * t) @ rotation((0.3 * t, 0.9 * t, -0.4 * t)).T
        result.append(moved + np.array([t, 2 * t, -t]))
    return np.stack(result)


def bar(sides: int = 8, rings: int = 25, frames: int = 5, closed: bool = True) -> MeshSequence:
    """A two-bone bar that bends by 90 degrees."""
    mesh = tube(sides, rings, closed=closed)
    return MeshSequence.from_arrays(bending(mesh, frames), mesh[1], fps=10, name="bar")


# Sequences that are awkward in one way each ------------------------------------------------------------------


def _folding_sheet() -> MeshSequence:
    points, faces = grid(16, 5)
    upright = np.stack([points[:, 0] / 4, 0.05 * np.sin(7 * points[:, 0]), points[:, 1] / 4], axis=1)
    return MeshSequence.from_arrays(bending((upright, faces)), faces)


def _with_a_rigid_part() -> MeshSequence:
    body, moon = bar(), tetrahedron()
    path = []
    for t in np.linspace(0, 1, body.frame_count):
        path.append(0.3 * moon[0] @ rotation((0, 5 * t, 0.2)).T + [3 + t, 0, 2 * t])
    points = np.concatenate([body.points, np.stack(path)], axis=1)
    return MeshSequence.from_arrays(points, joined((body.points[0], body.faces.astype(np.int64)), moon)[1])


def _several_components() -> MeshSequence:
    mesh = tube(6, 13)
    other = tube(5, 9, closed=False)
    points = np.concatenate([bending(mesh), bending(other, angle=-1.2) + np.array([3.0, 0, 0])], axis=1)
    triangle = np.linspace(0, 1, 5)[:, None, None] + np.array([[5.0, 0, 0], [6, 0, 0], [5, 1, 0]])
    points = np.concatenate([points, triangle], axis=1)
    return MeshSequence.from_arrays(points, joined(mesh, other, (triangle[0], np.array([[0, 1, 2]])))[1])


def _three_pages() -> MeshSequence:
    points, faces = pages(3, rows=16, columns=3)
    mesh = points * [0.2, 0.2, 0.25], faces
    return MeshSequence.from_arrays(bending(mesh), faces)


def _unused_vertices() -> MeshSequence:
    body = bar(frames=4)
    rng = np.random.default_rng(1)
    stray = rng.normal(size=(4, 3, 3))
    points = np.concatenate([stray[:, :2], body.points, stray[:, 2:]], axis=1)
    return MeshSequence.from_arrays(points, body.faces + 2)


def _zero_area() -> MeshSequence:
    """Vertices in the middle of edges, with a triangle of no area that closes the mesh there."""
    body = bar(rings=17)
    points, faces = list(np.moveaxis(body.points, 1, 0)), body.faces.tolist()
    for face in range(0, len(body.faces), 11):
        a, b, c = body.faces[face].tolist()
        middle = len(points)
        points.append((points[a] + points[b]) / 2)
        faces[face] = [a, middle, c]
        faces += [[middle, b, c], [a, b, middle]]
    return MeshSequence.from_arrays(np.stack(points, axis=1), faces)


def _repeated_corners() -> MeshSequence:
    """Triangles that name a vertex twice: a lone one, and one on an edge of the surface."""
    body = bar(rings=17)
    a, b, _ = body.faces[len(body.faces) // 2].tolist()
    return MeshSequence.from_arrays(body.points, [*body.faces.tolist(), [a, a, b], [5, 5, 5]])


def _bowtie() -> MeshSequence:
    """Two bars that touch in one vertex, in the middle of both."""
    mesh = tube(6, 17)
    points = bending(mesh)
    other = points * [1, 1, 1] + (points[:, 6 * 8] - points[:, 6 * 8 + 3])[:, None]
    count = points.shape[1]
    faces = mesh[1] + count
    faces[faces == count + 6 * 8 + 3] = 6 * 8
    whole = np.concatenate([points, other], axis=1)
    whole[:, count + 6 * 8 + 3] = whole[:, 6 * 8]
    return MeshSequence.from_arrays(whole, np.concatenate([mesh[1], faces]))


def _still() -> MeshSequence:
    mesh = tube(6, 9)
    return MeshSequence.from_arrays(np.repeat(mesh[0][None], 3, axis=0), mesh[1])


SEQUENCES: dict[str, Callable[[], MeshSequence]] = {
    "bar": bar,
    "open bar": lambda: bar(closed=False),
    "folding sheet": _folding_sheet,
    "rigid component": _with_a_rigid_part,
    "several components": _several_components,
    "three pages": _three_pages,
    "inconsistent": lambda: MeshSequence.from_arrays(bar().points, flipped(bar().faces.astype(np.int64))),
    "unused vertices": _unused_vertices,
    "zero area": _zero_area,
    "repeated corners": _repeated_corners,
    "bowtie": _bowtie,
    "still": _still,
    "one frame": lambda: bar(frames=1),
    "float32": lambda: bar().with_points(bar().points.astype(np.float32)),
    "far away and small": lambda: bar().with_points(1e-3 * bar().points + 10.0),
}
"""Sequences by what is awkward about them."""


# Random input ---------------------------------------------------------------------------------------------

seeds = st.integers(0, 2**32 - 1)

_number = st.floats(-3.0, 3.0, allow_nan=False, width=32)
_triple = st.tuples(_number, _number, _number)

rigid_motions: st.SearchStrategy[tuple[Float, Float]] = st.builds(
    lambda turn, shift: (rotation(turn), np.array(shift)), _triple, _triple
)
"""Pairs of a rotation matrix and a translation."""


def coarse_walk(frames: int, fps: float = 24.0) -> MeshSequence:
    """The walk of a fox of 1,614 vertices."""
    with MonkeyPatch.context() as patch:
        patch.setattr(creature, "CELL_METRES", COARSE_CELL_METRES)
        return creature.walk_cycle(frames, fps)


def coarse_bones() -> list[str]:
    """The bone of every vertex of that fox."""
    with MonkeyPatch.context() as patch:
        patch.setattr(creature, "CELL_METRES", COARSE_CELL_METRES)
        part, names = creature.part_of_vertex()
    return [names[bone] for bone in part]
