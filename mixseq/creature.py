"""A walking fox: the sample animation of mixseq, made from a table of bones.

Bones move nearly rigidly and only joints bend, so the fox is also a test case with a known segmentation
(`part_of_vertex`).

*Body.* The tapered flesh around the bones is blended into one closed surface. Surface nets (Gibson 1998) put one vertex
into every grid cell, and one quad around every grid edge, that the surface crosses. The mesh is closed and oriented,
and manifold if the shape is smooth at the scale of a cell. Relaxation makes triangles more even. At rest the fox stands
on the plane ``y = 0``, faces ``+x``, and has its right side at ``+z``, in metres. A bone off the plane ``z = 0`` is a
right bone; the left bone is its mirror image.

*Walk.* Spine, head and tail swing by a table of harmonics (forward kinematics). Paws follow a path that is fixed to the
ground during stance. Legs follow the paws by inverse kinematics of two bones. The fox walks on the spot, as on a
treadmill: a paw on the ground moves backwards at constant speed. All motion has period 1 in the phase.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from mixseq.runtime.parallel import one_blas_thread
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float, Index

Implicit = Callable[[Float], Float]


def polygonise(implicit: Implicit, low: Float, high: Float, cell: float, rounds: int = 6) -> tuple[Float, Index]:
    """Mesh the zero set of a function of ``(..., 3)`` from low to high ``(3,)``; return ``(V, 3)`` and ``(F, 3)``."""
    shape = np.ceil((high - low) / cell).astype(int) + 1
    origin = (low + high - (shape - 1) * cell) / 2  # a centred grid gives a symmetric mesh of a symmetric shape
    lattice = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1)
    points, quads = surface_nets(implicit(origin + cell * lattice))
    points = relax(origin + cell * points, quads, implicit, rounds)
    faces = triangulate(points, quads)
    return relax(points, faces, implicit, rounds), faces


def surface_nets(values: Float) -> tuple[Float, Index]:
    """Return points ``(V, 3)`` and quads ``(Q, 4)`` of the zero set of grid values ``(X, Y, Z)``."""
    crossings, quads_of_edges = [], []
    for axis in range(3):
        u, v = np.eye(3, dtype=np.int64)[[(axis + 1) % 3, (axis + 2) % 3]]
        count = values.shape[axis] - 1
        start = np.take(values, np.arange(count), axis=axis)
        end = np.take(values, np.arange(1, count + 1), axis=axis)
        is_crossed = (start < 0) != (end < 0)
        node = np.argwhere(is_crossed)
        start, end = start[is_crossed], end[is_crossed]
        # Cells around the edge, counter-clockwise seen from the edge's end; values increase outwards.
        cells = np.stack([node, node - u, node - u - v, node - v], axis=1)
        quads_of_edges.append(np.where((start < 0)[:, None, None], cells, cells[:, ::-1]))
        crossings.append(node + (start / (start - end))[:, None] * np.eye(3)[axis])
    corners = np.concatenate(quads_of_edges)
    cells, vertex = np.unique(
        np.ravel_multi_index(tuple(np.moveaxis(corners, -1, 0)), values.shape), return_inverse=True
    )
    quads = vertex.reshape(-1, 4).astype(np.int64)
    points = np.zeros((len(cells), 3))
    np.add.at(points, quads, np.concatenate(crossings)[:, None])
    return points / np.bincount(quads.ravel())[:, None], quads


def triangulate(points: Float, quads: Index) -> Index:
    """Cut each quad ``(Q, 4)`` along its shorter diagonal into triangles ``(2Q, 3)``."""
    a, b, c, d = np.moveaxis(points[quads], 1, 0)
    is_ac_shorter = np.linalg.norm(a - c, axis=1) <= np.linalg.norm(b - d, axis=1)
    triangles = np.where(is_ac_shorter[:, None], quads[:, [0, 1, 2, 0, 2, 3]], quads[:, [1, 2, 3, 1, 3, 0]])
    return triangles.reshape(-1, 3)


def neighbour_mean(faces: Index, vertex_count: int) -> csr_array:
    """Return the matrix ``(V, V)`` that averages the values of a vertex's neighbours.

    The mesh must be closed and oriented, so that each neighbour follows the vertex in exactly one face.
    """
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    degree = np.bincount(start, minlength=vertex_count)
    return csr_array((1 / degree[start], (start, end)), shape=(vertex_count, vertex_count))


def relax(points: Float, faces: Index, implicit: Implicit, rounds: int) -> Float:
    """Move vertices ``(V, 3)`` along the surface, each towards the mean of its neighbours."""
    mean = neighbour_mean(faces, len(points))
    for _ in range(rounds):
        value, gradient = _linearise(implicit, points)
        step = 0.6 * (mean @ points - points)
        # Project the step so that value + gradient . step = 0.
        excess = (value + np.sum(gradient * step, axis=1)) / np.sum(gradient**2, axis=1)
        points = points + step - excess[:, None] * gradient
    return points


def _linearise(implicit: Implicit, points: Float, delta: float = 1e-5) -> tuple[Float, Float]:
    """Return value ``(V,)`` and gradient ``(V, 3)`` of the function, by central differences."""
    ahead, behind = (implicit(points[:, None] + sign * delta * np.eye(3)) for sign in (1, -1))
    return (ahead + behind).mean(axis=1) / 2, (ahead - behind) / (2 * delta)


Vec3 = tuple[float, float, float]


@dataclass(frozen=True)
class Bone:
    """A bone and its flesh; the flesh is the hull of a ball at the head and a ball at the tail; lengths in metres.

    Parents (empty for the root) precede children. `head` and `tail` are rest positions (3,) of joint and far end.
    `fillet` is the width of the blend with earlier bones, which thickens the body by up to a quarter of the width.
    """

    name: str
    parent: str
    head: Vec3
    tail: Vec3
    head_radius: float
    tail_radius: float
    fillet: float


def _mirror_bones(right_bones: Iterable[Bone]) -> tuple[Bone, ...]:
    """Mirror every bone off the plane ``z = 0``; name right and left bones ``name.r`` and ``name.l``."""
    bones: list[Bone] = []
    paired: set[str] = set()
    for bone in right_bones:
        if bone.head[2] == bone.tail[2] == 0:
            bones.append(bone)
            continue
        paired.add(bone.name)
        for suffix, side in ((".r", 1.0), (".l", -1.0)):
            bones.append(
                replace(
                    bone,
                    name=bone.name + suffix,
                    parent=bone.parent + suffix if bone.parent in paired else bone.parent,
                    head=(bone.head[0], bone.head[1], side * bone.head[2]),
                    tail=(bone.tail[0], bone.tail[1], side * bone.tail[2]),
                )
            )
    return tuple(bones)


# fmt: off
BONES = _mirror_bones((
    #    name            parent         head                    tail                    radii         fillet
    Bone("pelvis",       "",            (-0.25, 0.575, 0.000),  (-0.12, 0.580, 0.000),  0.112, 0.110, 0.00),
    Bone("belly",        "pelvis",      (-0.12, 0.580, 0.000),  ( 0.05, 0.580, 0.000),  0.110, 0.118, 0.01),
    Bone("chest",        "belly",       ( 0.05, 0.580, 0.000),  ( 0.20, 0.580, 0.000),  0.118, 0.138, 0.01),
    Bone("neck",         "chest",       ( 0.21, 0.650, 0.000),  ( 0.31, 0.770, 0.000),  0.118, 0.096, 0.06),
    Bone("head",         "neck",        ( 0.33, 0.815, 0.000),  ( 0.37, 0.820, 0.000),  0.112, 0.106, 0.04),
    Bone("muzzle",       "head",        ( 0.42, 0.790, 0.000),  ( 0.575, 0.768, 0.000), 0.077, 0.034, 0.05),
    Bone("nose",         "muzzle",      ( 0.580, 0.784, 0.00),  ( 0.597, 0.785, 0.00),  0.025, 0.025, 0.01),
    Bone("cheek",        "head",        ( 0.35, 0.800, 0.050),  ( 0.315, 0.755, 0.135), 0.078, 0.020, 0.03),
    Bone("ear",          "head",        ( 0.315, 0.885, 0.068), ( 0.285, 1.030, 0.108), 0.056, 0.019, 0.02),
    Bone("arm",          "chest",       ( 0.205, 0.550, 0.085), ( 0.130, 0.360, 0.090), 0.082, 0.052, 0.04),
    Bone("forearm",      "arm",         ( 0.130, 0.360, 0.090), ( 0.165, 0.130, 0.088), 0.052, 0.038, 0.01),
    Bone("forepastern",  "forearm",     ( 0.165, 0.130, 0.088), ( 0.180, 0.052, 0.088), 0.038, 0.040, 0.01),
    Bone("forepaw",      "forepastern", ( 0.180, 0.048, 0.088), ( 0.240, 0.039, 0.088), 0.044, 0.039, 0.01),
    Bone("thigh",        "pelvis",      (-0.250, 0.540, 0.080), (-0.180, 0.355, 0.094), 0.106, 0.062, 0.04),
    Bone("shank",        "thigh",       (-0.180, 0.355, 0.094), (-0.300, 0.190, 0.092), 0.062, 0.038, 0.01),
    Bone("hindpastern",  "shank",       (-0.300, 0.190, 0.092), (-0.280, 0.052, 0.092), 0.038, 0.039, 0.01),
    Bone("hindpaw",      "hindpastern", (-0.280, 0.048, 0.092), (-0.220, 0.039, 0.092), 0.044, 0.039, 0.01),
    Bone("tail1",        "pelvis",      (-0.33, 0.615, 0.000),  (-0.46, 0.585, 0.000),  0.046, 0.068, 0.05),
    Bone("tail2",        "tail1",       (-0.46, 0.585, 0.000),  (-0.61, 0.530, 0.000),  0.068, 0.092, 0.01),
    Bone("tail3",        "tail2",       (-0.61, 0.530, 0.000),  (-0.75, 0.490, 0.000),  0.092, 0.080, 0.01),
    Bone("tail4",        "tail3",       (-0.75, 0.490, 0.000),  (-0.93, 0.475, 0.000),  0.080, 0.024, 0.01),
))
# fmt: on

BONE_NAMES = tuple(bone.name for bone in BONES)
BONE_PARENTS = tuple(BONE_NAMES.index(bone.parent) if bone.parent else -1 for bone in BONES)
BONE_HEADS: Float = np.array([bone.head for bone in BONES])
BONE_TAILS: Float = np.array([bone.tail for bone in BONES])
BONE_LENGTHS: Float = np.linalg.norm(BONE_TAILS - BONE_HEADS, axis=1)
BONE_AXES: Float = (BONE_TAILS - BONE_HEADS) / BONE_LENGTHS[:, None]


def bone_distances(points: Float) -> Float:
    """Return the signed distance ``(..., B)`` from points ``(..., 3)`` to the flesh of every bone.

    The hull of two balls is a cone with round ends. The nearest ball along its axis is shifted from the foot of the
    perpendicular by the slope of the cone, towards the thicker end.
    """
    radius = np.array([bone.head_radius for bone in BONES])
    sine = (radius - np.array([bone.tail_radius for bone in BONES])) / BONE_LENGTHS
    along = points @ BONE_AXES.T - np.sum(BONE_HEADS * BONE_AXES, axis=1)
    head_squares = np.sum(BONE_HEADS**2, axis=1)
    squared = np.sum(points**2, axis=-1, keepdims=True) - 2 * points @ BONE_HEADS.T + head_squares
    across = np.sqrt(np.maximum(squared - along**2, 0))
    ball = np.clip(along - across * (sine / np.sqrt(1 - sine**2)), 0, BONE_LENGTHS)
    distances: Float = np.hypot(along - ball, across) - (radius - sine * ball)
    return distances


def body_distance(points: Float) -> Float:
    """Return the implicit function ``(...)`` of the fox at points ``(..., 3)``: the blended flesh of all bones."""
    first, *others = np.moveaxis(bone_distances(points), -1, 0)
    body: Float = first
    for bone, other in zip(BONES[1:], others, strict=True):
        # Quadratic smooth minimum (Quilez), exact where both distances differ by more than the fillet.
        overlap = np.maximum(bone.fillet - np.abs(body - other), 0)
        body = np.minimum(body, other) - overlap**2 / (4 * bone.fillet)
    return body


STANCE_FRACTION = 0.64  # fraction of the cycle with a paw on the ground
STANCE_TRAVEL_METRES = 0.30  # distance by which the ground moves during stance
PAW_LIFT_METRES = 0.062
SIDE_AXIS = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Swing:
    """A rotation of a bone: ``degrees * cos(2 pi (cycles * phase - delay))`` about ``axis``.

    Axis x rolls the bone, y yaws it (to the left if positive), z pitches it (nose up if positive).
    """

    bone: str
    axis: str
    degrees: float
    cycles: int
    delay: float


@dataclass(frozen=True)
class Leg:
    """A leg: its four bones, the phase at which its paw lands, and degrees by which the pastern curls in mid-air."""

    upper: str
    lower: str
    pastern: str
    paw: str
    landing: float
    curl: float


# The lateral sequence of a walk: left hind, left fore, right hind, right fore.
LEGS = (
    Leg("thigh.l", "shank.l", "hindpastern.l", "hindpaw.l", landing=0.00, curl=20.0),
    Leg("arm.l", "forearm.l", "forepastern.l", "forepaw.l", landing=0.25, curl=40.0),
    Leg("thigh.r", "shank.r", "hindpastern.r", "hindpaw.r", landing=0.50, curl=20.0),
    Leg("arm.r", "forearm.r", "forepastern.r", "forepaw.r", landing=0.75, curl=40.0),
)

SWINGS = (
    Swing("pelvis", "y", 3.0, 1, 0.05),
    Swing("pelvis", "x", 2.5, 1, 0.30),
    Swing("pelvis", "z", 0.8, 2, 0.10),
    Swing("belly", "y", -3.0, 1, 0.05),
    Swing("belly", "x", -2.5, 1, 0.35),
    Swing("chest", "y", -3.0, 1, 0.05),
    Swing("chest", "z", 1.2, 2, 0.50),
    Swing("neck", "z", 5.0, 2, 0.15),
    Swing("neck", "y", 4.0, 1, 0.10),
    Swing("head", "z", -3.0, 2, 0.05),
    Swing("head", "y", 3.0, 1, 0.15),
    Swing("ear.r", "z", 5.0, 2, 0.30),
    Swing("ear.l", "z", 5.0, 2, 0.40),
    Swing("tail1", "y", 8.0, 1, 0.20),
    Swing("tail2", "y", 9.0, 1, 0.32),
    Swing("tail3", "y", 10.0, 1, 0.44),
    Swing("tail4", "y", 10.0, 1, 0.56),
    Swing("tail1", "z", 3.0, 2, 0.10),
    Swing("tail2", "z", 4.0, 2, 0.25),
    Swing("tail3", "z", 4.0, 2, 0.40),
    Swing("tail4", "z", 4.0, 2, 0.55),
)


def pose_skeleton(phase: Float) -> tuple[Float, Float]:
    """Return rotations ``(T, B, 3, 3)`` and head positions ``(T, B, 3)`` of all bones at phases ``(T,)``."""
    swings = np.tile(np.eye(3), (len(phase), len(BONE_NAMES), 1, 1))
    for swing in SWINGS:
        angle = np.radians(swing.degrees) * np.cos(2 * np.pi * (swing.cycles * phase - swing.delay))
        swings[:, BONE_NAMES.index(swing.bone)] @= _axis_rotations("xyz".index(swing.axis), angle)

    rotations, heads = np.empty_like(swings), np.empty((len(phase), len(BONE_NAMES), 3))
    rotations[:, 0] = swings[:, 0]
    heads[:, 0] = BONE_HEADS[0] + _body_offset(phase)
    for bone, parent in list(enumerate(BONE_PARENTS))[1:]:
        rotations[:, bone] = rotations[:, parent] @ swings[:, bone]
        heads[:, bone] = heads[:, parent] + rotations[:, parent] @ (BONE_HEADS[bone] - BONE_HEADS[parent])
    for leg in LEGS:
        _place_leg(leg, phase, rotations, heads)
    return rotations, heads


def paw_path(phase: Float) -> tuple[Float, Float, Float]:
    """Return forward offset, height and pitch ``(T,)``, at phases ``(T,)``, of a paw that lands at phase 0."""
    phase = phase % 1.0
    air = np.clip((phase - STANCE_FRACTION) / (1 - STANCE_FRACTION), 0, 1)
    # In the air, the path is a cubic with the speed of the ground at both ends.
    overshoot = (1 - STANCE_FRACTION) / STANCE_FRACTION
    swing = air**2 * (3 - 2 * air) * (1 + overshoot) - overshoot * air
    stance = phase / STANCE_FRACTION
    forward = STANCE_TRAVEL_METRES * np.where(phase < STANCE_FRACTION, 0.5 - stance, swing - 0.5)
    height = PAW_LIFT_METRES * np.sin(np.pi * air**0.85) ** 2
    pitch = np.radians(14 * _bump(phase, 0.93, 0.07) - 48 * _bump(phase, 0.72, 0.18))
    return forward, height, pitch


def _body_offset(phase: Float) -> Float:
    """Return the offset ``(T, 3)`` of the body: down when a hind paw lands, and sideways to the supporting leg."""
    once, twice = 2 * np.pi * phase, 4 * np.pi * phase
    return np.stack([0.006 * np.sin(twice), -0.012 - 0.010 * np.cos(twice - 0.6), -0.010 * np.sin(once)], axis=1)


def _axis_rotations(axis: int, angle: Float) -> Float:
    """Return rotations ``(T, 3, 3)`` about a coordinate axis by angles ``(T,)`` in radians."""
    return Rotation.from_rotvec(angle[:, None] * np.eye(3)[axis]).as_matrix()


def _bump(phase: Float, centre: float, width: float) -> Float:
    """Return a smooth bump of height 1 and half width ``width`` at phase ``centre``."""
    offset = (phase - centre + 0.5) % 1.0 - 0.5
    return np.where(np.abs(offset) < width, np.cos(np.pi / 2 * offset / width) ** 2, 0.0)


def _place_leg(leg: Leg, phase: Float, rotations: Float, heads: Float) -> None:
    """Write the poses of a leg's four bones, so that its paw follows its path."""
    upper, lower, pastern, paw = map(BONE_NAMES.index, (leg.upper, leg.lower, leg.pastern, leg.paw))
    rest, swing_fraction = BONE_HEADS, 1 - STANCE_FRACTION
    phase = (phase - leg.landing) % 1.0
    forward, height, pitch = paw_path(phase)

    lean = np.arctan(forward / rest[upper, 1])
    bump = _bump(phase, STANCE_FRACTION + 0.4 * swing_fraction, 0.5 * swing_fraction + 0.04)
    fold = np.radians(leg.curl) * bump
    rotations[:, paw] = _axis_rotations(2, pitch)
    rotations[:, pastern] = _axis_rotations(2, lean - fold)
    toes = BONE_TAILS[paw] + np.stack([forward, height, 0 * phase], axis=1)
    heads[:, paw] = toes - rotations[:, paw] @ (BONE_TAILS[paw] - rest[paw])
    heads[:, pastern] = heads[:, paw] - rotations[:, pastern] @ (rest[paw] - rest[pastern])

    heads[:, lower], side = _solve_knee(heads[:, upper], heads[:, pastern], rest[[upper, lower, pastern]])
    for bone, child in ((upper, lower), (lower, pastern)):
        rotations[:, bone] = _align_bone(heads[:, child] - heads[:, bone], rest[child] - rest[bone], side)


def _solve_knee(hip: Float, ankle: Float, rest: Float) -> tuple[Float, Float]:
    """Return knee and sideways axis ``(T, 3)``, given hip and ankle ``(T, 3)`` and rest positions ``(3, 3)``."""
    thigh, shank = np.linalg.norm(np.diff(rest, axis=0), axis=1)
    span = np.linalg.norm(ankle - hip, axis=1, keepdims=True)
    down = (ankle - hip) / span
    side = SIDE_AXIS - (down @ SIDE_AXIS)[:, None] * down
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    along = (thigh**2 - shank**2 + span**2) / (2 * span)
    aside = np.sqrt(np.maximum(thigh**2 - along**2, 0))
    bend_sign = np.sign(np.cross(rest[2] - rest[0], rest[1] - rest[0])[2])
    return hip + along * down + bend_sign * aside * np.cross(side, down), side


def _align_bone(posed: Float, rest: Float, side: Float) -> Float:
    """Return rotations ``(T, 3, 3)`` that map a bone's rest direction to its posed direction, and +z to ``side``."""
    return _frame(posed, side) @ np.swapaxes(_frame(rest[None], SIDE_AXIS[None]), 1, 2)


def _frame(along: Float, side: Float) -> Float:
    """Return orthonormal frames ``(T, 3, 3)`` with the columns along, across, and nearly ``side``."""
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(side, along)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return np.stack([along, across, np.cross(along, across)], axis=2)


CELL_METRES = 0.0215  # about the length of an edge
WEIGHT_SMOOTHING_STEPS = 8  # each step widens a joint by one ring of vertices


def walk_cycle(frames: int = 48, fps: float = 24.0) -> MeshSequence:
    """Animate the fox: one walk cycle on the spot.

    Parameters
    ----------
    frames : int
        Number of frames T of one cycle; frame T, which would equal frame 0, is omitted.
    fps : float
        Frames per second.

    Returns
    -------
    MeshSequence
        One closed surface of genus 0, about 1 m high, Y up, facing +X, in metres; float64.

    Examples
    --------
    >>> fox = walk_cycle(frames=4)
    >>> fox.points.shape == (4, fox.vertex_count, 3)
    True
    """
    with one_blas_thread():
        rest, faces, weights = _rest_mesh(CELL_METRES)
        rotations, heads = pose_skeleton(np.arange(frames) / frames)
        # Linear blend skinning: bone b maps a point x to rotation x + (head - rotation rest_head).
        translations = heads - np.einsum("tbij,bj->tbi", rotations, BONE_HEADS)
        blended = np.einsum("vb,tbij->tvij", weights, rotations, optimize=True)
        points = np.einsum("tvij,vj->tvi", blended, rest) + np.einsum(
            "vb,tbi->tvi", weights, translations, optimize=True
        )
    return MeshSequence.from_arrays(points, faces, fps=fps, up_axis="Y", metres_per_unit=1.0, name="fox")


def part_of_vertex() -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Return the bone with the largest skinning weight of each vertex.

    Returns
    -------
    part : (V,) int64
        Index of the bone with the largest weight.
    names : (B,) str
        Names of the bones.
    """
    with one_blas_thread():
        return np.argmax(_rest_mesh(CELL_METRES)[2], axis=1), BONE_NAMES


@cache
def _rest_mesh(cell: float) -> tuple[Float, Index, Float]:
    """Return rest pose ``(V, 3)``, faces ``(F, 3)`` and skinning weights ``(V, B)``, cached and read-only."""
    low, high = np.array([-1.05, -0.05, -0.24]), np.array([0.70, 1.08, 0.24])
    points, faces = polygonise(body_distance, low, high, cell)
    arrays = points, faces, skin_weights(points, faces)
    for array in arrays:
        array.flags.writeable = False
    return arrays


def skin_weights(points: Float, faces: Index) -> Float:
    """Return skinning weights ``(V, B)`` of points ``(V, 3)``, faces ``(F, 3)``: smoothed weights of nearest bones."""
    weights: Float = np.eye(len(BONE_NAMES))[np.argmin(bone_distances(points), axis=1)]
    mean = neighbour_mean(faces, len(points))
    for _ in range(WEIGHT_SMOOTHING_STEPS):
        weights = (weights + mean @ weights) / 2
    return weights
