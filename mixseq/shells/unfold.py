r"""Linear reconstruction of a patch from edge lengths and dihedral angles (after Wang, Liu and Tong 2012).

Every face f gets a frame ``F_f``: a rotation whose columns are the direction of its side 01, the in-plane normal of
that side and the face normal. Lengths tell the angle ``alpha`` under which the frame sees a hinge's edge, so the
frames of a hinge's two faces differ by a known rotation

.. math:: F_j = F_i T_{ij}, \qquad T_{ij} = R_z(\alpha_i)\, R_x(\theta)\, R_z(-\alpha_j) .

1. Frames: minimise :math:`\sum \|F_j - F_i T_{ij}\|^2`, a sparse linear system; faces whose vertices are all fixed
   have known frames (if nothing is fixed the first face gets the identity). Project every frame to a rotation.
2. Vertices: minimise :math:`\sum_f \sum_{ab \in f} \|x_b - x_a - F_f\, u_{ab}\|^2` over the sides of all faces, where
   ``u`` is the side in the frame; fixed vertices stay (if there are none the first one is the origin).

Where lengths and angles belong to a real mesh the result is that mesh, exactly.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixseq.geometry.rigid import nearest_rotations
from mixseq.shells.patch import Patch

Float = NDArray[np.float64]


def unfold(patch: Patch, lengths: Float, angles: Float, positions: Float) -> Float:
    """Rebuild a patch from edge lengths and dihedral angles.

    Parameters
    ----------
    patch : Patch
        Connectivity; without fixed vertices the result is up to a rigid motion.
    lengths : (e,) float64
        Edge lengths.
    angles : (h,) float64
        Dihedral angles in radians.
    positions : (n, 3) float64
        Positions of the fixed vertices; the others are not looked at.

    Returns
    -------
    (n, 3) float64
        Positions of all vertices.
    """
    return integrate(patch, turned_sides(patch, lengths, angles, positions), positions)


def turned_sides(patch: Patch, lengths: Float, angles: Float, positions: Float) -> Float:
    """Return the sides 01, 12, 20 of all faces ``(m, 3, 3)``, in their frames: `unfold` before its second step."""
    local = _flat_triangles(lengths[patch.face_edges])
    frames = _frames(patch, local, angles, positions)
    return np.asarray(np.einsum("fij,fkj->fki", frames[:, :, :2], np.roll(local, -1, axis=1) - local))


def _flat_triangles(lengths: Float) -> Float:
    """Lay triangles with sides ``(m, 3)`` = 01, 12, 20 into the plane, as corners ``(m, 3, 2)``.

    Interpolated lengths may break the triangle inequality; such a triangle is laid flat on a line.
    """
    l01, l12, l20 = np.maximum(lengths, 1e-12).T
    x = np.clip((l01**2 + l20**2 - l12**2) / (2.0 * l01), -l20, l20)
    y = np.sqrt(l20**2 - x**2)
    zero = np.zeros_like(x)
    return np.stack([zero, zero, l01, zero, x, y], axis=1).reshape(-1, 3, 2)


def _frames(patch: Patch, local: Float, angles: Float, positions: Float) -> Float:
    known = np.zeros((len(patch.faces), 3, 3))
    is_known = patch.fixed_faces.copy()
    if is_known.any():
        known[is_known] = _frames_of(positions[patch.faces[is_known]])
    else:
        is_known[0] = True
        known[0] = np.eye(3)
    number = patch.face_number
    unknown = np.flatnonzero(number >= 0)
    if not unknown.size:
        return known

    # Rows of F (one per world coordinate) are independent: F_j - F_i T = 0 reads f_j - T^T f_i = 0 for rows f.
    i, j = patch.hinge_faces.T
    turns = _transitions(patch, local, angles)
    right = np.zeros((unknown.size, 3, 3))  # (face, column of F, world coordinate)
    for target, source, turn in ((j, i, turns), (i, j, np.swapaxes(turns, 1, 2))):
        border = is_known[source] & ~is_known[target]
        pulled = known[source[border]] @ turn[border]
        np.add.at(right, number[target[border]], np.swapaxes(pulled, 1, 2))

    pattern = patch.frame_pattern
    values = np.zeros(len(pattern.rows))
    counts = np.bincount(patch.hinge_faces.reshape(-1), minlength=len(patch.faces))
    values[pattern.diagonal] = np.repeat(counts[unknown].astype(np.float64), 3)
    inner = ~is_known[i] & ~is_known[j]
    first, second = number[i[inner]], number[j[inner]]
    # -T^T couples row block j to column block i; below the diagonal is the higher number's row.
    turned = turns[inner]
    blocks = -np.where((second > first)[:, None, None], np.swapaxes(turned, 1, 2), turned)
    places = pattern.places[pattern.block(first, second)][:, None, :] + np.arange(3)[:, None]
    np.add.at(values, places, blocks)
    solution = pattern.analysis.factor(values).solve(right.reshape(-1, 3)).reshape(-1, 3, 3)
    known[unknown] = nearest_rotations(np.swapaxes(solution, 1, 2))
    return known


def _frames_of(corners: Float) -> Float:
    """Frames ``(m, 3, 3)`` of triangles with corners ``(m, 3, 3)`` in space."""
    x = corners[:, 1] - corners[:, 0]
    z = np.cross(x, corners[:, 2] - corners[:, 0])
    return nearest_rotations(np.stack([_unit(x), _unit(np.cross(z, x)), _unit(z)], axis=2))


def _unit(vectors: Float) -> Float:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300))


def _transitions(patch: Patch, local: Float, angles: Float) -> Float:
    """Rotations T ``(h, 3, 3)`` with ``F_j = F_i T`` across every hinge."""
    seen = []
    for side in (0, 1):
        face = patch.hinge_faces[:, side]
        is_a = patch.faces[face] == patch.hinges[:, 0, None]
        is_b = patch.faces[face] == patch.hinges[:, 1, None]
        direction = np.einsum("hk,hkx->hx", is_b * 1.0 - is_a * 1.0, local[face])
        seen.append(np.arctan2(direction[:, 1], direction[:, 0]))
    # Two faces that run along their edge in the same direction have normals on opposite sides.
    bend = angles + np.where(patch.reversed_hinges, np.pi, 0.0)
    return np.asarray(_about_z(seen[0]) @ _about_x(bend) @ _about_z(-seen[1]), dtype=np.float64)


def _about_z(angle: Float) -> Float:
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    return np.stack([c, -s, zero, s, c, zero, zero, zero, one], axis=1).reshape(-1, 3, 3)


def _about_x(angle: Float) -> Float:
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    return np.stack([one, zero, zero, zero, c, -s, zero, s, c], axis=1).reshape(-1, 3, 3)


def integrate(patch: Patch, sides: Float, positions: Float) -> Float:
    """Find the vertices whose sides ``x_b - x_a`` are closest to ``(m, 3, 3)`` given ones."""
    count = len(patch.fixed)
    right = np.zeros((count, 3))
    np.add.at(right, patch.faces.reshape(-1), -sides.reshape(-1, 3))
    np.add.at(right, np.roll(patch.faces, -1, axis=1).reshape(-1), sides.reshape(-1, 3))
    result = np.where(patch.fixed[:, None], positions, 0.0)
    coupling = patch.laplacian[patch.integrated][:, patch.fixed]
    right = right[patch.integrated] - coupling @ result[patch.fixed]
    result[patch.integrated] = patch.laplacian_factor.solve(right)
    return result
