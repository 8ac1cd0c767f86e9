"""Compiled loops of `mixseq.mesh.measures` over the elements of one frame, and the vectors they are made of.

Elements are rows of vertices. Every loop writes the value of each element. Temporary arrays of NumPy take several times
as long, and ten times the memory of the results.
"""

from __future__ import annotations

import math

from mixseq.runtime.jit import compiled, force_inlined
from mixseq.types import Float, Int32, Mask

Vector = tuple[float, float, float]


@force_inlined
def side(x: Float, a: int, b: int) -> Vector:
    """Return the vector from vertex a to vertex b."""
    return x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]


@force_inlined
def cross(p: Vector, q: Vector) -> Vector:
    """Return the cross product of p and q."""
    return p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]


@force_inlined
def dot(p: Vector, q: Vector) -> float:
    """Return the scalar product of p and q."""
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


@force_inlined
def length(x: Float, a: int, b: int) -> float:
    """Return the length of the edge ab."""
    e = side(x, a, b)
    return math.sqrt(dot(e, e))


@force_inlined
def sides_and_normals(x: Float, a: int, b: int, c: int, d: int) -> tuple[Vector, ...]:
    """Return the sides ab, ac and ad of the hinge abcd, and the normals of its faces."""
    e, p, q = side(x, a, b), side(x, a, c), side(x, a, d)
    return e, p, q, cross(e, p), cross(q, e)


@force_inlined
def opening(e: Vector, n: Vector, m: Vector) -> tuple[float, float]:
    """Return cosine and sine of the angle from normal n to m about e, times the lengths of n, m and e."""
    # Adding zero makes negative zeros positive, so that hinges of degenerate faces have the angle 0, and not pi.
    return (0.0 + dot(n, m)) * math.sqrt(dot(e, e)), 0.0 + dot(cross(n, m), e)


@force_inlined
def angle(x: Float, a: int, b: int, c: int, d: int) -> float:
    """Return the dihedral angle of the hinge abcd."""
    e, _, _, n, m = sides_and_normals(x, a, b, c, d)
    cosine, sine = opening(e, n, m)
    return math.atan2(sine, cosine)


@compiled
def measure_lengths(x: Float, edges: Int32, lengths: Float) -> None:
    """Write the lengths ``(E,)`` of edges."""
    for k in range(len(edges)):
        lengths[k] = length(x, edges[k, 0], edges[k, 1])


@compiled
def measure_angles(x: Float, hinges: Int32, angles: Float) -> None:
    """Write the dihedral angles ``(H,)`` of hinges in radians."""
    for k in range(len(hinges)):
        angles[k] = angle(x, hinges[k, 0], hinges[k, 1], hinges[k, 2], hinges[k, 3])


@compiled
def measure_areas(x: Float, faces: Int32, areas: Float) -> None:
    """Write the areas ``(F,)`` of triangles."""
    for f in range(len(faces)):
        n = cross(side(x, faces[f, 0], faces[f, 1]), side(x, faces[f, 0], faces[f, 2]))
        areas[f] = 0.5 * math.sqrt(dot(n, n))


@compiled
def mark_degenerate(x: Float, faces: Int32, height_ratio: float, mask: Mask) -> None:
    """Mark the triangles ``(F,)`` with a height of at most `height_ratio` times their longest side."""
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        p, q, o = side(x, a, b), side(x, b, c), side(x, c, a)
        n = cross(p, q)
        mask[f] = math.sqrt(dot(n, n)) <= height_ratio * max(dot(p, p), dot(q, q), dot(o, o))
