r"""The projection P_m at joints, which moves skinned vertices so that joints have the target lengths and angles.

Joint faces, and one ring of faces around them, move; all other faces stay skinned. Lengths and angles of the skinned
mesh change by a *share* of their differences from the targets; a share of 0 preserves the skinned mesh.

1. *Faces.* Relative rotations across hinges follow from lengths and angles. The frames of the skinned faces are rotated
   to fit these by rotation averaging (`mixseq.shells.face_frames`): two rounds with one constant matrix.
2. *Vertices* follow from the changes of the sides s of faces, by one back-substitution with a constant matrix,

   .. math:: \min_d \sum_f \sum_{ab} w_{ab}\, |d_b - d_a - (s'_{ab} - s_{ab})|^2 + \eta\, w \sum_v |d_v|^2 .

All quantities are differences from the skinned mesh, so that frames of the sequence are exact. Degenerate skinned
triangles keep their shapes and angles, which are noise. Rotations are unit quaternions (w, x, y, z), lengths in
diagonals.

The projection is analytic. Velocities are derivatives by a complex step, exact to rounding (Squire and Trapp 1998),

.. math:: f'(x)\, \dot x = \mathrm{Im}\, f(x + i h \dot x) / h + O(h^2) .

Nothing is subtracted, so that h can be tiny and the error below rounding. Compiled loops take real or complex arrays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.mesh.measures import dihedral_angles, edge_lengths, wrap_angles
from mixseq.mesh.topology import Topology
from mixseq.runtime.jit import compiled, inlined
from mixseq.runtime.lazy import PickledWithoutCaches, cached_property
from mixseq.shells.face_frames import MIN_SIDE_LENGTH, HingeFrames, averaging_right_side, multiply, multiply_inverse_by
from mixseq.shells.shell import Shell
from mixseq.shells.solvers import Factor, factorise_laplacian, index_of
from mixseq.types import Float, Index, Mask

COMPLEX_STEP = 2.0**-400  # step h, whose square is below rounding and whose products with rates are normal numbers

RealOrComplex = NDArray[Any]
"""Real numbers, or complex numbers whose imaginary parts are rates times `COMPLEX_STEP`."""


def to_complex_step(values: Float, rates: Float) -> RealOrComplex:
    """Return complex numbers from values and rates."""
    return np.asarray(values + 1j * (COMPLEX_STEP * rates))


def from_complex_step(numbers: RealOrComplex) -> tuple[Float, Float]:
    """Return the values and rates of complex numbers; the inverse of `to_complex_step`."""
    return np.ascontiguousarray(numbers.real), numbers.imag / COMPLEX_STEP


def solve_columns(factor: Factor, right: RealOrComplex) -> RealOrComplex:
    """Solve a real system with real or complex right-hand sides ``(n, k)``."""
    if not np.iscomplexobj(right):
        return np.asarray(factor.solve(right))
    columns = right.shape[1]
    solution = factor.solve(np.concatenate(from_complex_step(right), axis=1))
    return to_complex_step(solution[:, :columns], solution[:, columns:])


def _solve_frames(factor: Factor, right_sides: list[RealOrComplex]) -> RealOrComplex:
    """Return solutions ``(T, n, 3)`` for right-hand sides ``(n, 3)`` of T frames; the factor is read once for all."""
    solutions = solve_columns(factor, np.concatenate(right_sides, axis=1))
    return np.ascontiguousarray(np.swapaxes(solutions.reshape(len(solutions), -1, 3), 0, 1))


MIN_HEIGHT_RATIO = 1e-12  # least height to side of triangles; the frame of lower ones is the unit quaternion

# Ratio of doubled area to squared sides, at most 0.29, below which a triangle's lengths and angles have less weight, as
# it may turn over between frames. Chosen by the accelerations of fox_run.
SLIVER_AREA_RATIO = 0.06


@compiled
def analytic_edge_lengths(x: Float, edges: Index) -> Float:
    """Return the lengths ``(e,)`` of edges ``(e, 2)``."""
    lengths = np.empty(len(edges), x.dtype)
    for k in range(len(edges)):
        a, b = edges[k, 0], edges[k, 1]
        p, q, r = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
        square = p * p + q * q + r * r
        lengths[k] = np.sqrt(square) if square.real > 0.0 else 0.0 * square
    return lengths


@compiled
def flatten_triangles(lengths: Float, face_edges: Index) -> Float:
    """Unfold triangles into the plane: length of side 01, and position of corner 2 ``(m, 3)``."""
    flat = np.empty((len(face_edges), 3), lengths.dtype)
    for f in range(len(face_edges)):
        a, b, c = lengths[face_edges[f, 0]], lengths[face_edges[f, 1]], lengths[face_edges[f, 2]]
        if a.real < MIN_SIDE_LENGTH:
            a = a - a.real + MIN_SIDE_LENGTH
        if c.real < MIN_SIDE_LENGTH:
            c = c - c.real + MIN_SIDE_LENGTH
        x = (a * a + c * c - b * b) / (2.0 * a)
        square = c * c - x * x
        if square.real <= 0.0:  # the triangle inequality is violated: collapse to a line
            x = c if x.real > 0.0 else -c
            flat[f, 2] = 0.0
        else:
            flat[f, 2] = np.sqrt(square)
        flat[f, 0], flat[f, 1] = a, x
    return flat


@compiled
def triangle_quality(flat: Float) -> Float:
    """Return the weights ``(m,)`` of lengths and angles of flat triangles ``(m, 3)``: a smooth step of the area."""
    quality = np.ones(len(flat), flat.dtype)
    for f in range(len(flat)):
        u, v, h = flat[f, 0], flat[f, 1], flat[f, 2]
        ratio = u * h / (u * u + v * v + (v - u) * (v - u) + 2.0 * h * h) / SLIVER_AREA_RATIO
        if ratio.real < 1.0:
            quality[f] = ratio * ratio * (3.0 - 2.0 * ratio)
    return quality


@compiled
def analytic_frames(x: Float, faces: Index) -> Float:
    """Return the frames ``(m, 4)`` of triangles: axes along side 01, across it in the plane, along the normal."""
    frames = np.empty((len(faces), 4), x.dtype)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ux, uy, uz = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
        vx, vy, vz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        u2, v2, n2 = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, nx * nx + ny * ny + nz * nz
        if not n2.real > MIN_HEIGHT_RATIO**2 * (u2 * v2).real:
            frames[f, 0] = 1.0
            frames[f, 1] = frames[f, 2] = frames[f, 3] = 0.0
            continue
        scale = 1.0 / np.sqrt(u2)
        ux, uy, uz = ux * scale, uy * scale, uz * scale
        scale = 1.0 / np.sqrt(n2)
        nx, ny, nz = nx * scale, ny * scale, nz * scale
        mx, my, mz = ny * uz - nz * uy, nz * ux - nx * uz, nx * uy - ny * ux
        # Compute the quaternion from its largest component (Shepperd 1978).
        trace = ux + my + nz
        if trace.real >= max(ux.real, my.real, nz.real):
            p, q, r, s = 1.0 + trace, mz - ny, nx - uz, uy - mx
        elif ux.real >= my.real and ux.real >= nz.real:
            p, q, r, s = mz - ny, 1.0 + 2.0 * ux - trace, uy + mx, nx + uz
        elif my.real >= nz.real:
            p, q, r, s = nx - uz, uy + mx, 1.0 + 2.0 * my - trace, mz + ny
        else:
            p, q, r, s = uy - mx, nx + uz, mz + ny, 1.0 + 2.0 * nz - trace
        scale = 1.0 / np.sqrt(p * p + q * q + r * r + s * s)
        frames[f, 0], frames[f, 1], frames[f, 2], frames[f, 3] = p * scale, q * scale, r * scale, s * scale
    return frames


@inlined
def _half_direction(flat: Float, f: int, side: int, is_backward: bool) -> tuple[float, float]:
    """Return cosine and sine, up to a common sign, of half the angle from side 01 to a side of a flat triangle."""
    if side == 0:
        u, v = flat[f, 0], 0.0 * flat[f, 0]
    elif side == 1:
        u, v = flat[f, 1] - flat[f, 0], flat[f, 2]
    else:
        u, v = -flat[f, 1], -flat[f, 2]
    square = u * u + v * v
    length = np.sqrt(square) if square.real > 0.0 else square
    if u.real > 0.0:
        p, q = length + u, v
    else:
        p, q = v, length - u
    square = p * p + q * q
    if not square.real > 0.0:
        p, q, square = 1.0 + 0.0 * u, 0.0 * u, 1.0 + 0.0 * u
    scale = 1.0 / np.sqrt(square)
    p, q = p * scale, q * scale
    if is_backward:
        return -q, p
    return p, q


@compiled
def target_rotations(
    frames: Float,
    pairs: Index,
    flat: Float,
    target_flat: Float,
    quality: Float,
    side_ids: Index,
    backward: Index,
    reversed_normals: Float,
    angle_ids: Index,
    angles: Float,
    share: float,
) -> Float:
    """Return target rotations ``(h, 4)`` of the second face of each hinge relative to the first.

    Frames ``(m, 4)``, flat triangles ``(m, 3)`` and quality ``(m,)`` are of skinned faces; side_ids and backward
    ``(h, 2)`` are of the edge in both faces. `angle_ids` ``(h,)`` index target angles ``(k,)`` in radians, else -1.
    """
    result = np.empty((len(pairs), 4), frames.dtype)
    skinned, about_edge = np.empty(4, frames.dtype), np.empty(4, frames.dtype)
    target, change = np.empty(4, frames.dtype), np.empty(4, frames.dtype)
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        multiply_inverse_by(frames[i], frames[j], skinned)
        w, x, y, z = skinned[0], skinned[1], skinned[2], skinned[3]
        # Find half the skinned angle; in axes along the edge, the relative rotation is about the edge.
        ci, si = _half_direction(flat, i, side_ids[k, 0], backward[k, 0] != 0)
        cj, sj = _half_direction(flat, j, side_ids[k, 1], backward[k, 1] != 0)
        ca, sa, cb, sb = ci * cj + si * sj, si * cj - ci * sj, ci * cj - si * sj, si * cj + ci * sj
        c, s = w * ca + z * sa, x * cb + y * sb
        square = c * c + s * s
        if not square.real > 0.0:
            result[k, 0], result[k, 1], result[k, 2], result[k, 3] = w, x, y, z
            continue
        scale = 1.0 / np.sqrt(square)
        c, s = c * scale, s * scale
        about_edge[0], about_edge[1], about_edge[2], about_edge[3] = c * ca, s * cb, s * sb, c * sa
        if angle_ids[k] >= 0:
            half = 0.5 * (angles[angle_ids[k]] + reversed_normals[k])
            ct, st = np.cos(half), np.sin(half)
            cd, sd = c * ct + s * st, c * st - s * ct
            if cd.real < 0.0:
                cd, sd = -cd, -sd
            # The share vanishes at differences of 180 degrees, whose direction jumps.
            square = 1.0 - cd * cd
            smooth_share = share * (1.0 - square * square)
            cd, sd = 1.0 - smooth_share + smooth_share * cd, smooth_share * sd
            scale = 1.0 / np.sqrt(cd * cd + sd * sd)
            c, s = (c * cd - s * sd) * scale, (s * cd + c * sd) * scale
        ci, si = _half_direction(target_flat, i, side_ids[k, 0], backward[k, 0] != 0)
        cj, sj = _half_direction(target_flat, j, side_ids[k, 1], backward[k, 1] != 0)
        target[0], target[1] = c * (ci * cj + si * sj), s * (ci * cj - si * sj)
        target[2], target[3] = s * (si * cj + ci * sj), c * (si * cj - ci * sj)
        # The skinned rotation, times the change to the target, which is exactly the identity at frames of the sequence.
        multiply_inverse_by(about_edge, target, change)
        weight = quality[i] * quality[j]
        sign = -1.0 if change[0].real < 0.0 else 1.0
        a, b, d, e = sign * change[0], sign * change[1], sign * change[2], sign * change[3]
        a, b, d, e = 1.0 - weight + weight * a, weight * b, weight * d, weight * e
        scale = 1.0 / np.sqrt(a * a + b * b + d * d + e * e)
        change[0], change[1], change[2], change[3] = a * scale, b * scale, d * scale, e * scale
        multiply(skinned, change, result[k])
    return result


@compiled
def apply_small_rotations(frames: Float, steps: Float) -> Float:
    """Return frames ``(m, 4)`` with the first n rotated by small rotation vectors ``(n, 3)``."""
    turned = frames.copy()
    for f in range(len(steps)):
        a, b, c = 0.5 * steps[f, 0], 0.5 * steps[f, 1], 0.5 * steps[f, 2]
        w, x, y, z = frames[f, 0], frames[f, 1], frames[f, 2], frames[f, 3]
        p, q = w - a * x - b * y - c * z, x + a * w + b * z - c * y
        r, s = y - a * z + b * w + c * x, z + a * y - b * x + c * w
        scale = 1.0 / np.sqrt(p * p + q * q + r * r + s * s)
        turned[f, 0], turned[f, 1], turned[f, 2], turned[f, 3] = p * scale, q * scale, r * scale, s * scale
    return turned


@inlined
def _rotate_corner(frames: Float, f: int, u: float, v: float) -> tuple[float, float, float]:
    """Rotate a point (u, v) of a flat triangle by the frame of the triangle."""
    w, x, y, z = frames[f, 0], frames[f, 1], frames[f, 2], frames[f, 3]
    return (
        (1.0 - 2.0 * (y * y + z * z)) * u + 2.0 * (x * y - w * z) * v,
        2.0 * (x * y + w * z) * u + (1.0 - 2.0 * (x * x + z * z)) * v,
        2.0 * (x * z - w * y) * u + 2.0 * (y * z + w * x) * v,
    )


@compiled
def displacement_right_side(
    frames: Float,
    flat: Float,
    target_frames: Float,
    target_flat: Float,
    faces: Index,
    weights: Float,
    moving_index: Index,
    count: int,
) -> Float:
    """Return the right-hand side ``(count, 3)`` of displacements, from weighted changes of sides of faces.

    Frames ``(m, 4)`` and flat triangles ``(m, 3)`` are of skinned and target faces. Weights ``(n, 3)`` of sides 01, 12,
    20 are zero without area. `moving_index` ``(V,)`` is the index of a vertex among moving vertices, else -1.
    """
    right = np.zeros((count, 3), frames.dtype)
    for f in range(len(faces)):
        p0, p1, p2 = _rotate_corner(target_frames, f, target_flat[f, 0], 0.0 * target_flat[f, 0])
        q0, q1, q2 = _rotate_corner(frames, f, flat[f, 0], 0.0 * flat[f, 0])
        a0, a1, a2 = p0 - q0, p1 - q1, p2 - q2
        p0, p1, p2 = _rotate_corner(target_frames, f, target_flat[f, 1], target_flat[f, 2])
        q0, q1, q2 = _rotate_corner(frames, f, flat[f, 1], flat[f, 2])
        b0, b1, b2 = p0 - q0, p1 - q1, p2 - q2
        for side in range(3):
            w = weights[f, side]
            if side == 0:
                s0, s1, s2 = w * a0, w * a1, w * a2
            elif side == 1:
                s0, s1, s2 = w * (b0 - a0), w * (b1 - a1), w * (b2 - a2)
            else:
                s0, s1, s2 = -w * b0, -w * b1, -w * b2
            p, q = moving_index[faces[f, side]], moving_index[faces[f, (side + 1) % 3]]
            if q >= 0:
                right[q, 0] += s0
                right[q, 1] += s1
                right[q, 2] += s2
            if p >= 0:
                right[p, 0] -= s0
                right[p, 1] -= s1
                right[p, 2] -= s2
    return right


FACE_AVERAGING_ROUNDS = 2  # rounds of rotation averaging over faces
MOVING_RINGS = 1  # rings of faces around joint faces that move with them, because joints alone are too stiff


@dataclass(frozen=True, eq=False)
class JointProjection(PickledWithoutCaches):
    """Projection of one mesh at its joints."""

    topology: Topology  # connectivity of the mesh
    reference: Float  # (V, 3) reference frame in diagonals, which determines the weights
    joint_faces: Mask  # (F,) faces whose lengths and angles have targets
    position_weight: float  # weight of skinned vertices and frames relative to sides and hinges

    @cached_property
    def edge_ids(self) -> Index:
        """Edges ``(E',)`` with a target length: the edges of joint faces, ascending."""
        if not self.joint_faces.any():  # needs no tables of edges
            return np.zeros(0, dtype=np.int64)
        return np.unique(self.topology.face_edges[self.joint_faces]).astype(np.int64)

    @cached_property
    def hinge_ids(self) -> Index:
        """Hinges ``(H',)`` with a target angle: the hinges of joint faces, ascending."""
        if not self.joint_faces.any():
            return np.zeros(0, dtype=np.int64)
        return np.flatnonzero(self.joint_faces[self.topology.hinge_faces].any(axis=1))

    @cached_property
    def shell(self) -> Shell:
        """The mesh as a shell, for the weights of sides and hinges."""
        lengths = edge_lengths(self.reference, self.topology.edges)
        position_weights = np.full(self.topology.vertex_count, self.position_weight)
        return Shell(self.topology, self.reference, lengths, position_weights)

    @cached_property
    def _moving_face_ids(self) -> Index:
        """Joint faces and `MOVING_RINGS` rings around them."""
        moving, faces = self.joint_faces, self.topology.faces
        for _ in range(MOVING_RINGS):
            is_corner = np.zeros(self.topology.vertex_count, dtype=bool)
            is_corner[faces[moving]] = True
            moving = np.asarray(is_corner[faces].any(axis=1))
        return np.flatnonzero(moving)

    @cached_property
    def _moving_hinge_ids(self) -> Index:
        """Hinges of moving faces with area."""
        is_moving = np.isin(self.topology.hinge_faces, self._moving_face_ids).any(axis=1)
        return np.flatnonzero(is_moving & self.shell.sound_hinge_mask)

    @cached_property
    def _face_ids(self) -> Index:
        """Moving faces, then their fixed neighbours ``(m,)``."""
        face_ids = np.unique(self.topology.hinge_faces[self._moving_hinge_ids])
        fixed = np.setdiff1d(face_ids, self._moving_face_ids)
        return np.concatenate([self._moving_face_ids, fixed]).astype(np.int64)

    @cached_property
    def _faces(self) -> Index:
        return self.topology.faces[self._face_ids].astype(np.int64)

    @cached_property
    def _edge_tables(self) -> tuple[Index, Index, Index]:
        """Edges ``(e,)`` of the faces, indices ``(m, 3)`` of sides, and indices of the edges with a target length."""
        sides = self.topology.face_edges[self._face_ids]
        edges, index = np.unique(sides, return_inverse=True)
        targeted = np.searchsorted(edges, self.edge_ids)
        return edges.astype(np.int64), index.reshape(sides.shape).astype(np.int64), targeted.astype(np.int64)

    @cached_property
    def _edges(self) -> Index:
        return self.topology.edges[self._edge_tables[0]].astype(np.int64)

    @cached_property
    def _pairs(self) -> Index:
        """Indices ``(h, 2)`` of the faces of every hinge."""
        index = index_of(self._face_ids, len(self.topology.faces))
        return index[self.topology.hinge_faces[self._moving_hinge_ids]]

    @cached_property
    def _hinge_tables(self) -> tuple[Index, Index, Float, Index]:
        """Sides of hinges in their faces, and indices of their target angles; see `target_rotations`."""
        hinges = self.topology.hinges[self._moving_hinge_ids].astype(np.int64)
        frames = HingeFrames(self._faces, hinges, self._pairs)
        angle_ids = index_of(self.hinge_ids, len(self.topology.hinge_faces))[self._moving_hinge_ids]
        return frames.side_ids, frames.backward_mask.astype(np.int64), frames.reversed_normals, angle_ids

    @cached_property
    def _angle_weights(self) -> Float:
        return np.ascontiguousarray(self.shell.relative_angle_weights[self._moving_hinge_ids])

    @cached_property
    def frame_factor(self) -> Factor | None:
        """Factor of the matrix of rotation averaging over moving faces, or None without moving faces."""
        count = len(self._moving_face_ids)
        if not count:
            return None
        pairs = np.where(self._pairs < count, self._pairs, -1)
        return factorise_laplacian(pairs, self._angle_weights, np.full(count, self.position_weight))

    @cached_property
    def moving_vertex_ids(self) -> Index:
        """Vertices ``(n,)`` of moving faces only."""
        faces, ids = self.topology.faces, self._moving_face_ids
        return np.setdiff1d(faces[ids], np.delete(faces, ids, axis=0)).astype(np.int64)

    @cached_property
    def _moving_index(self) -> Index:
        return index_of(self.moving_vertex_ids, self.topology.vertex_count)

    @cached_property
    def _side_weights(self) -> Float:
        """Weights ``(n, 3)`` of the sides of moving faces, zero for faces without area."""
        weights = self.shell.side_weights[self._moving_face_ids]
        weights[np.isin(self._moving_face_ids, self.shell.degenerate_face_ids)] = 0.0
        return weights

    @cached_property
    def vertex_factor(self) -> Factor | None:
        """Factor of the matrix of displacements, or None without moving vertices."""
        if not len(self.moving_vertex_ids):
            return None
        corners = self._faces[: len(self._moving_face_ids)]
        ends = self._moving_index[np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2)]
        weight = self.position_weight * self.shell.tie_weight
        position_weights = np.full(len(self.moving_vertex_ids), weight)
        return factorise_laplacian(ends, self._side_weights.reshape(-1), position_weights)

    def mesh_targets(self, x: Float, lengths: Float, angles: Float) -> tuple[Float, Float]:
        """Return lengths ``(E,)`` and angles ``(H,)`` of the mesh: targets at joints, skinned values elsewhere."""
        topology = self.topology
        all_lengths, all_angles = edge_lengths(x, topology.edges), dihedral_angles(x, topology.hinges)
        quality = triangle_quality(flatten_triangles(all_lengths, topology.face_edges.astype(np.int64)))
        weights = quality[topology.hinge_faces[self.hinge_ids]].prod(axis=1)
        all_angles[self.hinge_ids] += weights * wrap_angles(angles - all_angles[self.hinge_ids])
        all_lengths[self.edge_ids] = np.maximum(lengths, 0.0)
        return all_lengths, all_angles

    def project(self, x: RealOrComplex, lengths: RealOrComplex, angles: RealOrComplex, share: float) -> RealOrComplex:
        """Move skinned vertices ``(..., V, 3)`` by a share towards lengths ``(..., E')`` and angles ``(..., H')``."""
        if not share or self.frame_factor is None or self.vertex_factor is None:
            return x
        result = x.copy()
        meshes = result.reshape(-1, *x.shape[-2:])
        goals = lengths.reshape(len(meshes), -1), angles.reshape(len(meshes), -1)
        planned = [self._targets(*frame, share) for frame in zip(meshes, *goals, strict=True)]
        triangles, rotations = zip(*planned, strict=True)
        target_frames, moving_count = [frames for frames, *_ in triangles], len(self._moving_face_ids)
        for _ in range(FACE_AVERAGING_ROUNDS):
            right = [
                averaging_right_side(frames, self._pairs, each, self._angle_weights, moving_count)
                for frames, each in zip(target_frames, rotations, strict=True)
            ]
            steps = _solve_frames(self.frame_factor, right)
            target_frames = [apply_small_rotations(*pair) for pair in zip(target_frames, steps, strict=True)]
        moving = self._faces[:moving_count], self._side_weights, self._moving_index, len(self.moving_vertex_ids)
        right = [
            displacement_right_side(frames, flat, each, target_flat, *moving)
            for each, (frames, flat, target_flat) in zip(target_frames, triangles, strict=True)
        ]
        meshes[:, self.moving_vertex_ids] += _solve_frames(self.vertex_factor, right)
        return result

    def _targets(
        self, x: RealOrComplex, lengths: RealOrComplex, angles: RealOrComplex, share: float
    ) -> tuple[tuple[RealOrComplex, RealOrComplex, RealOrComplex], RealOrComplex]:
        """Return frames, flat and target triangles of a skinned mesh ``(V, 3)``, and target rotations of hinges."""
        _, face_edges, targeted = self._edge_tables
        skinned_lengths = analytic_edge_lengths(x, self._edges)
        target_lengths = skinned_lengths.copy()
        changes = np.where(lengths.real > 0.0, lengths, 0.0) - skinned_lengths[targeted]
        target_lengths[targeted] += share * changes
        flat = flatten_triangles(skinned_lengths, face_edges)
        quality = triangle_quality(flat)
        target_flat = flat + quality[:, None] * (flatten_triangles(target_lengths, face_edges) - flat)
        frames = analytic_frames(x, self._faces)
        arguments = frames, self._pairs, flat, target_flat, quality, *self._hinge_tables, angles, share
        return (frames, flat, target_flat), target_rotations(*arguments)
