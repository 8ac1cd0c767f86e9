r"""Footskate cleanup: fix contacts of the target while the contacts of the source rest on the ground.

The scheme follows Kovar, Schreiner and Gleicher 2002, "Footskate cleanup for motion capture editing". Constraints are
detected in the motion, and imposed first on the root, then on the limbs, with blends around them.

*Stances* are the times when the feet of the source are on the ground. A *step* between two frames has the mean speed v
of the contact's points, and their height z. The step is at rest if both speed and height are small,

.. math:: v < \max(a\, v_{95},\ a_0\, d), \qquad z - z_0 < \max(b\, (z_1 - z_0),\ b_0\, d),

where :math:`v_{95}` is the 95th percentile of speeds, :math:`z_0` and :math:`z_1` are the lowest and the highest
height, and d is the size of the body. The thresholds adapt to the motion; contacts that hardly move are at rest. A run
of steps is a stance if all its steps pass the wide thresholds and at least one step passes the narrow thresholds
(hysteresis, Canny 1986). A stance has at least two frames.

*The body* is shifted first. Let x be the transferred path of the middle of a contact. In every stance s the contact
should stay at an anchor. Its offset to the mean :math:`\bar x` over the stance is :math:`d = \bar x - x`. The shift r
of the whole body minimises

.. math::

    \min_{r, b} \sum_{s} \sum_{t \in s} |d_{st} + b_s - r_t|^2
    + \alpha \sum_t |r_{t+1} - 2 r_t + r_{t-1}|^2 + \beta \sum_t |r_{t+1} - r_t|^2 .

Along the ground the anchor is :math:`\bar x + b` with free b, so that the path adapts to the target's strides and the
body moves evenly. Vertically b is zero, and the term :math:`\gamma \sum_t |r_t|^2` prevents climbing and sinking. The
weight :math:`\alpha` leaves motions faster than `MIN_SHIFT_PERIOD_SECONDS` to the limbs. The weight :math:`\beta` lets
the shift level off within about `SHIFT_DECAY_SECONDS` while no foot is on the ground.

*Limbs* make the remaining moves :math:`e = d + b - r` (`mixseq.retargeting.limbs`). Before and after a stance cubic
Hermite splines blend e with its value and slope to zero, so that feet land and lift smoothly. A foot in the air keeps
its path, even if its limb shares parts with other limbs.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import MixseqWarning, SettingsError
from mixseq.mesh.rotations import rotate_vectors
from mixseq.retargeting.limbs import ArticulatedBody, Contact, leg_length, solve_limbs
from mixseq.retargeting.mixed_transfer import MixedTransfer
from mixseq.retargeting.parts import PartPoses, assign_vertices_to_parts
from mixseq.runtime.low_memory import LargeArray
from mixseq.runtime.parallel import Executor
from mixseq.runtime.progress import Progress, log_progress
from mixseq.sequence.header import UP_AXES, SequenceHeader
from mixseq.sequence.sequence import iterate_blocks
from mixseq.types import Float, FloatArray, Index, Mask

FAST_SPEED_PERCENTILE = 95.0  # percentile of a contact's speeds that is its fast speed; robust against outliers
# Narrow and wide thresholds of stances.
SPEED_RATIOS = 0.05, 0.1  # a: speed, relative to the contact's fast speed
REST_SPEEDS = 0.01, 0.02  # a_0: speed at rest in any motion, in body sizes per second
HEIGHT_RATIOS = 0.15, 0.3  # b: height, relative to the contact's range of heights
REST_HEIGHTS = 0.005, 0.01  # b_0: height on the ground in any motion, in body sizes


@dataclass(frozen=True)
class Stance:
    """Range of frames in which a contact is at rest."""

    start: int  # first frame
    stop: int  # frame after the last frame

    @property
    def frames(self) -> slice:
        """Frames of the stance as a slice."""
        return slice(self.start, self.stop)


def find_stances(path: Float, axis: int, fps: float) -> tuple[Stance, ...]:
    """Find the disjoint stances of a contact ``(T, k, 3)`` in body sizes, in order of time; `axis` points up.

    The result is one stance for a single frame, and for a contact that never moves.
    """
    if len(path) == 1:
        return (Stance(0, 1),)
    speeds = fps * np.linalg.norm(np.diff(path, axis=0), axis=2).mean(axis=1)
    heights = path[:, :, axis].mean(axis=1)
    heights = heights - heights.min()
    step_heights = np.maximum(heights[1:], heights[:-1])
    fast_speed = np.percentile(speeds, FAST_SPEED_PERCENTILE)

    def at_rest(level: int) -> Mask:
        max_speed = max(SPEED_RATIOS[level] * fast_speed, REST_SPEEDS[level])
        max_height = max(HEIGHT_RATIOS[level] * heights.max(), REST_HEIGHTS[level])
        return np.asarray((speeds < max_speed) & (step_heights < max_height))

    narrow, wide = at_rest(0), at_rest(1)
    edges = np.flatnonzero(np.diff(wide, prepend=False, append=False))
    runs = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    return tuple(Stance(first, last + 1) for first, last in runs if narrow[first:last].any())


HermiteKnot = tuple[int, Float, Float]
"""Knot of a Hermite spline: frame, value, and slope per frame."""

MIN_SHIFT_PERIOD_SECONDS = 0.5  # shortest period of the body's shift
SHIFT_DECAY_SECONDS = 2.0  # decay time of the body's shift while no foot is on the ground
BODY_HEIGHT_WEIGHT = 0.05  # gamma: weight of vertical shifts, relative to a foot on the ground
MAX_FADE_SECONDS = 0.25  # longest blend of a contact before and after a stance
MIN_SLIDE_DIAGONALS = 1e-9  # offset below which contacts are left unchanged and reported as 0, in diagonals


def anchor_offsets(paths: Float, stances: Sequence[Sequence[Stance]]) -> Float:
    """Return offsets ``(g, T, 3)`` of contacts to their mean in each stance, or zero if in the air or negligible."""
    offsets = np.zeros_like(paths)
    for contact_offsets, path, contact_stances in zip(offsets, paths, stances, strict=True):
        for stance in contact_stances:
            offset = path[stance.frames].mean(axis=0) - path[stance.frames]
            if np.abs(offset).max() > MIN_SLIDE_DIAGONALS:
                contact_offsets[stance.frames] = offset
    return offsets


def solve_body_shift(offsets: Float, stances: Sequence[Sequence[Stance]], axis: int, fps: float) -> tuple[Float, Float]:
    """Return the body's shift ``(T, 3)`` and the remaining moves ``(g, T, 3)`` of contacts: offsets ``(g, T, 3)``."""
    from scipy import sparse
    from scipy.sparse.linalg import splu

    count = offsets.shape[1]
    numbered = [(group, stance) for group, found in enumerate(stances) for stance in found]
    lengths = [stance.stop - stance.start for _, stance in numbered]
    frames = np.concatenate([np.arange(stance.start, stance.stop) for _, stance in numbered])
    contact_ids = np.repeat([group for group, _ in numbered], lengths)
    stance_ids = np.repeat(np.arange(len(numbered)), lengths)
    stance_offsets = offsets[contact_ids, frames]

    def selection_matrix(columns: Index, size: int) -> sparse.csr_array:
        row_ids = np.arange(len(columns))
        return sparse.csr_array((np.ones(len(columns)), (row_ids, columns)), shape=(len(columns), size))

    differences = (sparse.eye_array(count - 1, count, k=1) - sparse.eye_array(count - 1, count)).tocsr()
    curvature = differences[:-1, :-1] @ differences
    alpha = (fps * MIN_SHIFT_PERIOD_SECONDS / (2 * np.pi)) ** 4
    beta = alpha / (fps * SHIFT_DECAY_SECONDS) ** 2
    smoothness = alpha * curvature.T @ curvature + beta * differences.T @ differences
    body_rows = selection_matrix(frames, count)
    ground_rows = sparse.hstack([body_rows, -selection_matrix(stance_ids, len(numbered))])
    # A common shift of body and anchors along the ground is free: fix the first frame, then remove the mean.
    gauge = sparse.coo_array(([1.0], ([0], [0])), shape=(count, count))
    stance_count = len(numbered)
    ground_smoothness = sparse.block_diag([smoothness + gauge, sparse.coo_array(2 * (stance_count,))])

    ground = np.arange(3) != axis
    shift, anchors = np.zeros((count, 3)), np.zeros((len(numbered), 3))
    ground_system = ground_rows.T @ ground_rows + ground_smoothness
    ground_solution = splu(ground_system.tocsc()).solve(ground_rows.T @ stance_offsets[:, ground])
    ground_solution -= ground_solution[:count].mean(axis=0)
    shift[:, ground], anchors[:, ground] = ground_solution[:count], ground_solution[count:]
    height_system = body_rows.T @ body_rows + smoothness + BODY_HEIGHT_WEIGHT * sparse.eye_array(count)
    shift[:, axis] = splu(height_system.tocsc()).solve(body_rows.T @ stance_offsets[:, axis])
    remaining = np.zeros_like(offsets)
    remaining[contact_ids, frames] = stance_offsets + anchors[stance_ids] - shift[frames]
    return shift, remaining


def fade_moves(moves: Float, stances: Sequence[Stance], fps: float) -> Float:
    """Blend the moves ``(T, 3)`` of a contact to zero before and after its stances, or between nearby stances."""
    faded = np.zeros_like(moves)
    fade_frames = max(2, round(MAX_FADE_SECONDS * fps))
    zero = np.zeros(3)

    def interpolate(start: HermiteKnot, stop: HermiteKnot) -> None:
        frames = np.arange(max(start[0], 0), min(stop[0] + 1, len(faded)))
        faded[frames] = _hermite(frames, start, stop)

    previous: HermiteKnot | None = None
    for stance in stances:
        knot = _hermite_knot(moves, stance.start, min(stance.start + 1, stance.stop - 1))
        if previous is not None and knot[0] - previous[0] <= 2 * fade_frames:
            interpolate(previous, knot)
        else:
            if previous is not None:
                interpolate(previous, (previous[0] + fade_frames, zero, zero))
            interpolate((knot[0] - fade_frames, zero, zero), knot)
        faded[stance.frames] = moves[stance.frames]
        previous = _hermite_knot(moves, stance.stop - 1, max(stance.stop - 2, stance.start))
    if previous is not None:
        interpolate(previous, (previous[0] + fade_frames, zero, zero))
    return faded


def _hermite_knot(values: Float, frame: int, neighbour: int) -> HermiteKnot:
    slope = (values[neighbour] - values[frame]) / (neighbour - frame or 1)
    return frame, values[frame], slope


def _hermite(frames: Index, start: HermiteKnot, stop: HermiteKnot) -> Float:
    """Return the cubic Hermite spline ``(n, 3)`` between two knots."""
    (first, a, slope_a), (last, b, slope_b) = start, stop
    span = last - first
    s = ((frames - first) / span)[:, None]
    slope_terms = span * (s * (1 - s) ** 2 * slope_a - s * s * (1 - s) * slope_b)
    return np.asarray(a + s * s * (3 - 2 * s) * (b - a) + slope_terms)


@dataclass(frozen=True)
class GroupReport:
    """Sliding of one contact before and after its correction, in diagonals of the target."""

    name: str  # name of the contact
    stances: tuple[Stance, ...]  # stances of the contact
    before: float  # path length of the contact's middle in all stances, before correction
    after: float  # path length of the contact's middle in all stances, after correction
    residual: float  # largest stretch of the contact's limb


@dataclass(frozen=True)
class ContactReport:
    """Sliding of all contacts, and sizes of the corrections."""

    groups: tuple[GroupReport, ...] = ()  # report of each contact
    shift: float = 0.0  # largest shift of the whole body, in diagonals of the target
    turn: float = 0.0  # largest rotation of a part of a limb, in degrees


@dataclass(frozen=True, eq=False)
class PlantedMotion:
    """Motions of a body's parts after footskate cleanup."""

    rotations: Float  # (T, p, 3, 3) rotations of the parts
    centres: Float  # (T, p, 3) centres of the parts
    report: ContactReport  # report of the corrections


def remove_footskate(
    body: ArticulatedBody,
    rotations: Float,
    centres: Float,
    contacts: Sequence[Contact],
    source_paths: Sequence[Float],
    axis: int,
    fps: float,
) -> PlantedMotion:
    """Fix contacts in the stances of the source: rotations ``(T, p, 3, 3)``, centres ``(T, p, 3)``.

    The unit is the diagonal of the target. For every contact, `source_paths` has the source points ``(T, k, 3)``.
    """
    stances = tuple(find_stances(path, axis, fps) for path in source_paths)
    for contact, contact_stances in zip(contacts, stances, strict=True):
        if not contact_stances:
            warnings.warn(
                f"contact '{contact.name}' never rests on the ground in the source, so it is not fixed; if the source "
                "walks on the spot, move it over the ground first",
                MixseqWarning,
                stacklevel=2,
            )
    paths = _contact_centre_paths(body, contacts, rotations, centres)
    offsets = anchor_offsets(paths, stances)
    if not offsets.any():
        groups = _report_groups(contacts, stances, paths, paths, np.zeros(len(contacts)))
        return PlantedMotion(rotations, centres, ContactReport(groups))
    shift, remaining = solve_body_shift(offsets, stances, axis, fps)
    moves = np.stack([fade_moves(*pair, fps) for pair in zip(remaining, stances, strict=True)], axis=1)
    result = solve_limbs(body, rotations, centres + shift[:, None], contacts, moves)
    planted_paths = _contact_centre_paths(body, contacts, result.rotations, result.centres)
    residuals = np.linalg.norm(result.residual_moves, axis=2).max(axis=0)
    groups = _report_groups(contacts, stances, paths, planted_paths, residuals)
    min_trace = np.trace(result.limb_rotations, axis1=2, axis2=3).min(initial=3.0)
    max_turn_degrees = float(np.degrees(np.arccos(np.clip((min_trace - 1.0) / 2.0, -1.0, 1.0))))
    report = ContactReport(groups, float(np.linalg.norm(shift, axis=1).max()), max_turn_degrees)
    return PlantedMotion(result.rotations, result.centres, report)


def _contact_centre_paths(
    body: ArticulatedBody, contacts: Sequence[Contact], rotations: Float, centres: Float
) -> Float:
    """Return the paths ``(g, T, 3)`` of the contacts' middles."""
    return np.array([body.contact_path(contact, rotations, centres).mean(axis=1) for contact in contacts])


def _report_groups(
    contacts: Sequence[Contact], stances: Sequence[tuple[Stance, ...]], before: Float, after: Float, residuals: Float
) -> tuple[GroupReport, ...]:
    def slide(path: Float, found: Sequence[Stance]) -> float:
        lengths = [np.linalg.norm(np.diff(path[each.frames], axis=0), axis=1).sum() for each in found]
        return without_noise(float(sum(lengths)))

    def without_noise(value: float) -> float:
        return value if value > MIN_SLIDE_DIAGONALS else 0.0

    rows = zip(contacts, stances, before, after, residuals.tolist(), strict=True)
    return tuple(
        GroupReport(contact.name, found, slide(old, found), slide(new, found), without_noise(residual))
        for contact, found, old, new, residual in rows
    )


def plant_contacts(
    method: MixedTransfer,
    points: LargeArray,
    header: SequenceHeader,
    contacts: Mapping[str, ArrayLike],
    workers: Executor,
    progress: Progress = log_progress,
) -> tuple[MixedTransfer, PlantedMotion]:
    """Fix contacts ``(k,)`` in the stances of the source, from source frames ``(T, V, 3)``.

    Return the method with strides scaled to the target's legs, and the motions of the target's parts.
    """
    gradients = method.gradients
    target, source = gradients.target, gradients.source
    vertices = {name: _check_vertices(name, given, header.vertex_count) for name, given in contacts.items()}
    part_of_vertex = assign_vertices_to_parts(method.parts.target, target.topology)
    source_contacts, target_contacts = (
        [Contact(name, rest[ids], part_of_vertex[ids]) for name, ids in vertices.items()]
        for rest in (gradients.correspondence.interpolate(source.reference), target.reference)
    )
    scale = gradients.alignment.scale * source.scale / target.scale
    source_length = leg_length(method.source_body, source_contacts)
    if not source_length > 0:
        raise SettingsError("the legs of the source have no length; choose contacts away from the root's pivots")
    method = replace(method, stride_ratio=leg_length(method.body, target_contacts) / source_length / scale)

    vertex_ids = np.concatenate(list(vertices.values()))
    shared = method, vertex_ids, part_of_vertex[vertex_ids]
    rotations, centres, paths, local_points, done_count = [], [], [], [], 0
    for poses, block_path, block_local_points in workers(_measure_contacts, shared, iterate_blocks(points)):
        rotations.append(poses.rotations)
        centres.append(poses.centres)
        paths.append(block_path)
        local_points.append(block_local_points)
        done_count += len(block_path)
        progress(done_count, len(points), "placing feet")
    splits = np.cumsum([len(ids) for ids in vertices.values()])[:-1]
    contact_paths = np.split(np.concatenate(paths) * scale / source.scale, splits, axis=1)
    local_paths = np.split(np.concatenate(local_points), splits, axis=1)
    planted = remove_footskate(
        method.body,
        np.concatenate(rotations),
        np.concatenate(centres),
        [replace(contact, local_points=local) for contact, local in zip(target_contacts, local_paths, strict=True)],
        [path @ gradients.alignment.rotation.T for path in contact_paths],
        UP_AXES.index(header.up_axis),
        header.fps,
    )
    return method, planted


def _measure_contacts(shared: tuple[MixedTransfer, Index, Index], block: FloatArray) -> tuple[PartPoses, Float, Float]:
    """Return part poses for frames ``(B, V, 3)``, and contact points on the source and in the target's rest space."""
    method, vertices, parts = shared
    correspondence = method.gradients.correspondence
    poses, local_points = [], []
    for points, deformed in zip(block, method.deform_by_gradients(block), strict=True):
        _, deformed_poses = method.rest_shapes.register(deformed)
        poses.append(method.transfer_poses(points, deformed_poses))
        # Contact points vary in rest space, since a paw may bend although it is one part with its leg.
        inverse_rotations = np.swapaxes(deformed_poses.rotations[parts], 1, 2)
        arms = rotate_vectors(inverse_rotations, deformed[vertices] - deformed_poses.centres[parts])
        local_points.append(arms + method.rest_shapes.centres[parts])
    source_path = np.stack([correspondence.interpolate(points, vertices) for points in block])
    block_poses = PartPoses(*(np.stack(values) for values in zip(*poses, strict=True)))
    return block_poses, source_path, np.stack(local_points)


def _check_vertices(name: str, vertices: ArrayLike, count: int) -> Index:
    vertices = np.asarray(vertices)
    if vertices.ndim != 1 or not vertices.size or not np.issubdtype(vertices.dtype, np.integer):
        raise SettingsError(f"contact '{name}' is no list of vertices; give at least one vertex number")
    outside = vertices[(vertices < 0) | (vertices >= count)]
    if outside.size:
        raise SettingsError(
            f"contact '{name}' has vertex {outside[0]}, but vertices of the target are 0 to {count - 1}"
        )
    return vertices.astype(np.int64)
