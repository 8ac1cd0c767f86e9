r"""Rotations of faces from edge lengths and dihedral angles.

Edge lengths determine the shape of every triangle. Its *frame* is a rotation with three columns: the direction of side
01, the in-plane normal of that side, and the face normal. In the frame, a hinge's edge has an angle :math:`\alpha` that
follows from the lengths. The frames of both faces thus differ by a known rotation (Wang, Liu and Tong 2012)

.. math:: F_j = F_i T_{ij}, \qquad T_{ij} = R_z(\alpha_i)\, R_x(\theta)\, R_z(-\alpha_j) .

Blended lengths and angles are inconsistent: no frames satisfy all of these equations. *Rotation averaging* (after
Govindu 2004) distributes the misfits :math:`F_i T_{ij} F_j^{-1}`, rotations by angles :math:`\varphi` about axes a, by
solving

.. math:: \min_\omega \sum_{ij} w_{ij}\, |\omega_j - \omega_i - a_{ij} \sin \varphi_{ij}|^2 ,

a linear system with a constant matrix. Each round rotates frames by :math:`\exp \omega`. The sine is smooth at 180
degrees, where rotation vectors jump.

Averaging starts from given or *chained* frames. Chaining is breadth-first from known frames. Each frame is the mean of
the predictions by neighbours in the preceding layer. Chained frames are exact for consistent lengths and angles.

Frames are unit quaternions (w, x, y, z).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from mixseq.mesh.rotations import matrix_to_quat, normalise_quat, quat_multiply, rotvec_to_quat
from mixseq.mesh.topology import connected_components
from mixseq.mesh.triangle_mesh import normalise, perpendicular
from mixseq.runtime.jit import compiled, inlined
from mixseq.runtime.lazy import PickledWithoutCaches, cached_property
from mixseq.shells.solvers import Factor, factorise_laplacian
from mixseq.types import Float, Index, IntArray, Mask


@inlined
def multiply(p: Float, q: Float, r: Float) -> None:
    """Write the product ``p q`` to r, which must not alias p or q."""
    r[0] = p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3]
    r[1] = p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2]
    r[2] = p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1]
    r[3] = p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0]


@inlined
def multiply_by_inverse(p: Float, q: Float, r: Float) -> None:
    """Write the product ``p conj(q)`` to r, which must not alias p or q."""
    r[0] = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3]
    r[1] = -p[0] * q[1] + p[1] * q[0] - p[2] * q[3] + p[3] * q[2]
    r[2] = -p[0] * q[2] + p[1] * q[3] + p[2] * q[0] - p[3] * q[1]
    r[3] = -p[0] * q[3] - p[1] * q[2] + p[2] * q[1] + p[3] * q[0]


@inlined
def multiply_inverse_by(p: Float, q: Float, r: Float) -> None:
    """Write the product ``conj(p) q`` to r, which must not alias p or q."""
    r[0] = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3]
    r[1] = p[0] * q[1] - p[1] * q[0] - p[2] * q[3] + p[3] * q[2]
    r[2] = p[0] * q[2] + p[1] * q[3] - p[2] * q[0] - p[3] * q[1]
    r[3] = p[0] * q[3] - p[1] * q[2] + p[2] * q[1] - p[3] * q[0]


@compiled
def _chain_frames(
    pairs: Index, rotations: Float, weights: Float, order: Index, starts: Index, links: Index, frames: Float
) -> None:
    """Write frames ``(n, 4)`` in an order ``(k,)``; each is the mean of the predictions by links to earlier frames.

    The links of ``order[k]`` are ``links[starts[k] : starts[k + 1]]``: indices of pairs ``(h, 2)``, or -1 - index where
    the frame is the first of its pair. Frames that are not in the order are known.
    """
    seen, total = np.empty(4), np.empty(4)
    for k in range(len(order)):
        total[:] = 0.0
        for place in range(starts[k], starts[k + 1]):
            pair = links[place]
            if pair >= 0:
                multiply(frames[pairs[pair, 0]], rotations[pair], seen)
            else:
                pair = -1 - pair
                multiply_by_inverse(frames[pairs[pair, 1]], rotations[pair], seen)
            cosine = total[0] * seen[0] + total[1] * seen[1] + total[2] * seen[2] + total[3] * seen[3]
            square = total[0] ** 2 + total[1] ** 2 + total[2] ** 2 + total[3] ** 2
            # A quaternion and its negative are the same rotation; predictions 180 degrees off the mean have no weight.
            weight = weights[pair] * (cosine / math.sqrt(square) if square > 0.0 else 1.0)
            for i in range(4):
                total[i] += weight * seen[i]
        square = total[0] ** 2 + total[1] ** 2 + total[2] ** 2 + total[3] ** 2
        if square > 0.0:
            frames[order[k]] = total / math.sqrt(square)


@compiled
def averaging_right_side(frames: Float, pairs: Index, rotations: Float, weights: Float, count: int) -> Float:
    """Return the right-hand side ``(count, 3)`` of an averaging round: weighted misfit axes times misfit sines.

    The first `count` frames move, the remaining frames are fixed. Arrays are real or complex.
    """
    right = np.zeros((count, 3), frames.dtype)
    expected, misfit = np.empty(4, frames.dtype), np.empty(4, frames.dtype)
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        multiply(frames[i], rotations[k], expected)
        multiply_by_inverse(expected, frames[j], misfit)
        scale = 2.0 * weights[k] * misfit[0]
        for c in range(3):
            if j < count:
                right[j, c] += scale * misfit[1 + c]
            if i < count:
                right[i, c] -= scale * misfit[1 + c]
    return right


MIN_SIDE_LENGTH = 1e-12  # least length of sides in diagonals, since side 01 defines the frame of a triangle


def flat_triangles(lengths: Float) -> Float:
    """Unfold triangles with sides ``(m, 3)`` = 01, 12, 20 into the plane, as corners ``(m, 3, 2)``.

    Triangles that violate the triangle inequality collapse to a line.
    """
    l01, l12, l20 = np.maximum(lengths, MIN_SIDE_LENGTH).T
    x = np.clip((l01**2 + l20**2 - l12**2) / (2.0 * l01), -l20, l20)
    y = np.sqrt(l20**2 - x**2)
    zero = np.zeros_like(x)
    return np.stack([zero, zero, l01, zero, x, y], axis=1).reshape(-1, 3, 2)


MIN_HEIGHT_RATIO = 1e-12  # ratio of height to side up to which the normal is any perpendicular to the first side


def triangle_frames(x: Float, faces: IntArray) -> Float:
    """Return the frames ``(m, 4)`` of triangles ``(m, 3)`` with vertices ``(n, 3)``."""
    a, b, c = (x[corner] for corner in faces.T)
    along, side = normalise(b - a), c - a
    along[~along.any(axis=1), 0] = 1.0
    normals = np.cross(along, side)
    is_flat = np.linalg.norm(normals, axis=1) <= MIN_HEIGHT_RATIO * np.linalg.norm(side, axis=1)
    normals[is_flat] = perpendicular(along[is_flat])
    normals = normalise(normals)
    return matrix_to_quat(np.stack([along, np.cross(normals, along), normals], axis=2))


def rotate_sides(rotations: Float, flat: Float) -> Float:
    """Return the sides 01, 12, 20 ``(F, 3, 3)`` of flat triangles ``(F, 3, 2)``, rotated by matrices ``(F, 3, 3)``."""
    return np.asarray(np.einsum("fij,fkj->fki", rotations[:, :, :2], np.roll(flat, -1, axis=1) - flat))


@dataclass(frozen=True, eq=False)
class HingeFrames:
    """Hinges, expressed in the frames of their two faces."""

    faces: IntArray  # (m, 3) triangles
    hinges: IntArray  # (h, 4) hinges a, b, c, d: edge ab, opposite vertices c and d
    hinge_faces: IntArray  # (h, 2) the two faces of every hinge

    @cached_property
    def _edge_corners(self) -> tuple[Index, Index]:
        """Corners ``(h, 2)`` of both faces at the start and at the end of a hinge's edge."""
        faces = self.faces[self.hinge_faces]  # (h, 2, 3)
        return tuple((faces == self.hinges[:, None, end : end + 1]).argmax(axis=2) for end in (0, 1))

    @cached_property
    def backward_mask(self) -> Mask:
        """Whether the sides ``(h, 2)`` of both faces run against the hinge's edge."""
        start, end = self._edge_corners
        return np.asarray((start + 1) % 3 != end)

    @cached_property
    def side_ids(self) -> Index:
        """Index ``(h, 2)`` of the side of both faces that lies on the hinge's edge."""
        return np.where(self.backward_mask, self._edge_corners[1], self._edge_corners[0])

    @cached_property
    def reversed_normals(self) -> Float:
        """Angles ``(h,)`` added to hinge angles: pi between inconsistently oriented faces, else zero."""
        return np.where(self.backward_mask[:, 1], 0.0, np.pi)

    def rotations(self, flat: Float, angles: Float) -> Float:
        """Return the rotations T ``(h, 4)`` across hinges from flat triangles ``(m, 3, 2)`` and angles ``(h,)``."""
        sides = np.roll(flat, -1, axis=1) - flat
        directions = np.arctan2(sides[..., 1], sides[..., 0])
        alpha = directions[self.hinge_faces, self.side_ids] + np.where(self.backward_mask, np.pi, 0.0)
        bend, (first, second) = (angles + self.reversed_normals) / 2, alpha.T
        along, across = (first - second) / 2, (first + second) / 2
        c, s = np.cos(bend), np.sin(bend)
        # R_z(alpha_i) R_x(theta) R_z(-alpha_j)
        return np.stack([c * np.cos(along), s * np.cos(across), s * np.sin(across), c * np.sin(along)], axis=1)


@dataclass(frozen=True, eq=False)
class FrameGraph(PickledWithoutCaches):
    """A graph of frames with relative rotations between pairs."""

    pairs: Index  # (h, 2) pairs of different frames
    weights: Float  # (h,) positive weights of the pairs
    known_mask: Mask  # (n,) frames from which chains start: at least one per component

    @cached_property
    def factor(self) -> Factor:
        """Factor of the averaging matrix, in which known frames are softly constrained."""
        return factorise_laplacian(self.pairs, self.weights, np.where(self.known_mask, 1.0, 0.0))

    def average(self, frames: Float, rotations: Float, rounds: int) -> Float:
        """Return frames ``(n, 4)`` averaged to reduce the misfits to relative rotations ``(h, 4)``."""
        for _ in range(rounds):
            right = averaging_right_side(frames, self.pairs, rotations, self.weights, len(frames))
            frames = normalise_quat(quat_multiply(rotvec_to_quat(self.factor.solve(right)), frames))
        return frames

    def chain(self, rotations: Float, known: Float) -> Float:
        """Return frames ``(n, 4)`` chained by relative rotations ``(h, 4)`` from known frames ``(r, 4)``."""
        frames = np.zeros((len(self.known_mask), 4))
        frames[:, 0] = 1.0
        frames[self.known_mask] = known
        _chain_frames(self.pairs, rotations, self.weights, *self._layers, frames)
        return frames

    @cached_property
    def _layers(self) -> tuple[Index, Index, Index]:
        """Order, starts and links of `_chain_frames`, by breadth-first layers from the known frames."""
        count, depth = len(self.known_mask), np.where(self.known_mask, 0, -1)
        source, target = np.concatenate([self.pairs, self.pairs[:, ::-1]]).T
        number = np.arange(len(self.pairs))
        link = np.concatenate([number, -1 - number])
        for layer in range(count):
            neighbours = target[(depth[source] == layer) & (depth[target] < 0)]
            if not neighbours.size:
                break
            depth[neighbours] = layer + 1
        used = np.flatnonzero(depth[source] == depth[target] - 1)
        used = used[np.lexsort((number[used % len(number)], target[used], depth[target[used]]))]
        order = np.flatnonzero(depth > 0)
        order = order[np.argsort(depth[order], kind="stable")]
        counts = np.bincount(target[used], minlength=count)[order]
        return order, np.concatenate([[0], np.cumsum(counts)]).astype(np.int64), link[used]


def bridging_mask(count: int, pairs: IntArray, sound: Mask) -> Mask:
    """Mark sound pairs ``(h, 2)`` of `count` nodes, and a spanning forest of unsound pairs between sound components."""
    components = np.sort(connected_components(count, pairs[sound])[pairs], axis=1)
    separate = np.flatnonzero(components[:, 0] != components[:, 1])
    component_pairs, first = np.unique(components[separate], axis=0, return_index=True)
    graph = sparse.coo_array((1.0 + separate[first], tuple(component_pairs.T)), shape=(count, count)).tocsr()
    mask = sound.copy()
    mask[csgraph.minimum_spanning_tree(graph).data.astype(np.int64) - 1] = True
    return mask
