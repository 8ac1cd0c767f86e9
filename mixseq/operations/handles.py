r"""Pose a character by handles: vertices or parts that are given positions at some times.

The pose is a point c of the model's pose space, where the frames have the covariance :math:`\Sigma`. With the positions
:math:`x_i(c, b)` of handles in the placement b, their targets :math:`y_i`, and the pose :math:`c_0` and placement
:math:`b_0` before the edit, it minimises

.. math::

    \sum_i |x_i(c, b) - y_i|^2 / s^2 + (c - c_0)^T \Sigma^{-1} (c - c_0) + |b - b_0|^2 ,

with the softness s in diagonals, and rotations of bodies weighted by their radii of gyration. This is the example-based
inverse kinematics of Sumner and others 2005 (MeshIK), in a space whose vectors rotate with the parts. The energy does
not depend on the coordinates of pose space. It is minimised by Levenberg-Marquardt steps. Only vertices of handles are
skinned; derivatives are exact, by a complex step. The distance between skinned and projected vertices of joints is
constant in a round, and updated by decoding the mesh once.

Over time, the change fades in and out, and from key to key. Kept vertices stay on their paths: at every time, they are
handles, and the faded change takes the place of :math:`c_0`. What is still missing at *exact* handles is the smoothest
displacement d that interpolates them, the minimum of :math:`\int |d - l^2 \Delta d|^2`, stored as a key shape like that
of a sculpted edit.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse.linalg import splu

from mixseq.errors import MixseqWarning, SettingsError
from mixseq.mesh.rotations import matrix_to_rotvec, quat_multiply, quat_to_matrix, rotvec_to_quat
from mixseq.operations.sculpt import add_key_shape, weight_sites
from mixseq.operations.sections import (
    breakpoints,
    fade_window,
    interpolate_adaptively,
    model_sites,
    placement_norm,
    shape_norm,
    snap_time,
    splice,
)
from mixseq.operations.sketch import check_reach
from mixseq.runtime.public import public
from mixseq.segmentation.silhouettes import Diffusion
from mixseq.sequence.frame_rates import Seconds
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.spaces.mixed.joint_projection import from_complex_step, to_complex_step
from mixseq.types import Float, Index

DEFAULT_SOFTNESS = 5e-3
"""Default softness: distance from a target whose energy is that of one standard deviation of the pose, in diagonals."""

MIN_DEVIATION_RATIO = 1e-6
"""Standard deviation below which a direction of pose space is a rounding error, as a fraction of the largest."""

MIN_HANDLES_OF_FREE_BODY = 3
"""Number of handles, the kept vertices included, from which on bodies move: three points determine a rigid motion."""

MAX_STEPS, STEP_TOLERANCE, ENERGY_TOLERANCE = 30, 1e-4, 1e-5
"""Largest number of Levenberg-Marquardt steps; they stop at a step in standard deviations, or a relative decrease."""

START_DAMPING, MAX_DAMPING = 1e-3, 1e8
"""First damping of steps, and the damping at which no step is left that lowers the energy."""

MAX_PROJECTION_ROUNDS, PROJECTION_TOLERANCE = 3, 1e-5
"""Largest number of rounds for handles at joints, and the change of their offsets at which they stop, in diagonals."""

SIGNAL_TOLERANCE = 1e-4
"""Largest error of signals between sites, in diagonals."""

MAX_SILENT_MISS = 0.01
"""Distance of a handle from its target above which a warning is given, in diagonals."""

RESIDUAL_RADIUS = 0.05
"""Radius l of the displacement at exact handles, in diagonals."""


@dataclass(frozen=True)
class Handle:
    """A target position of a vertex, or of the centre of a part's vertices, at a time."""

    time: float  # in seconds
    position: ArrayLike  # (3,) target in the units of the sequence
    vertex: int | None = None  # number of a vertex; or of a part:
    part: int | None = None

    def vertices(self, model: Model) -> Index:
        """Return the vertices ``(n,)`` of the handle; raise `SettingsError` if they do not exist."""
        if (self.vertex is None) == (self.part is None):
            raise SettingsError(f"the handle at {self.time:g} s has a vertex and a part, or neither; give one")
        if self.part is None:
            return _check_vertices(model, [self.vertex], "handle")
        parts = model.decomposition.parts
        if not 0 <= self.part < len(parts):
            raise SettingsError(f"there is no part {self.part}; the model has {len(parts)}, from 0 on")
        return parts[self.part]

    def target(self) -> Float:
        """Return the position ``(3,)``; raise `SettingsError` if it is no point."""
        target = np.asarray(self.position, dtype=np.float64)
        if target.shape != (3,) or not np.isfinite(target).all():
            name = f"part {self.part}" if self.vertex is None else f"vertex {self.vertex}"
            raise SettingsError(
                f"the handle of {name} at {self.time:g} s has the position {target}; three finite numbers are expected"
            )
        return target


def _check_vertices(model: Model, vertex_ids: Sequence[int | None], name: str) -> Index:
    count = model.header.vertex_count
    for vertex in vertex_ids:
        if not (isinstance(vertex, int | np.integer) and 0 <= vertex < count):
            raise SettingsError(f"{name}: there is no vertex {vertex}; the model has {count:,}, from 0 on")
    return np.array(vertex_ids, dtype=np.int64)


class PoseChange(NamedTuple):
    """A change of pose and placement, in the units of its prior."""

    scores: Float  # (r,) standard deviations along the directions of pose space
    moves: Float  # (B, 6) rotation vectors of bodies in world axes in radians, shifts of their centres in diagonals


class PoseSolver:
    """Solver for poses of a model from positions of handles, means of groups of vertices."""

    def __init__(self, model: Model, groups: Sequence[Index], softness: float, is_free: bool) -> None:
        """Take the vertices ``(n,)`` of every handle, the softness in diagonals, and whether bodies move, too."""
        self.model, self.groups, self.softness, self.is_free = model, groups, softness, is_free
        self.space = model.mixed
        if self.space.placement == "free":
            raise SettingsError("the free placement ignores poses of parts; fit with placement='anchored'")
        if not len(self.directions):
            raise SettingsError("the model has a single pose, so that there are no others to find by handles")
        sizes = np.array([len(vertex_ids) for vertex_ids in groups])
        table = np.repeat(1.0 / sizes, sizes), np.concatenate(groups), np.append(0, np.cumsum(sizes))
        self.means = sparse.csr_array(table, shape=(len(groups), model.header.vertex_count))
        self._vertex_ids = np.unique(np.concatenate(groups))
        self._means = self.means[:, self._vertex_ids].toarray()
        self._skinned, self._columns = self.space.at_vertices(self._vertex_ids)
        shapes = model.shapes[:, self._columns[self._columns < self.space.shape_dim]]
        self._shape_steps = self.directions @ model.pose.matrix @ (shapes - shapes[0])  # (r, S')
        move_weights = np.ones((self.space.rotation_count if is_free else 0, 6))
        move_weights[:, :3] = self.space.articulation.body_radii[: len(move_weights), None]
        self._weights = np.append(np.ones(len(self.directions)), move_weights)
        self._decoded: tuple[PoseChange | None, float, Float] = (None, 0.0, np.empty((0, 3)))

    @cached_property
    def directions(self) -> Float:
        """Standard deviations ``(r, k)`` of the frames along the principal directions of pose space."""
        points = self.model.time(self.model.times)
        _, sizes, axes = np.linalg.svd((points - points.mean(axis=0)) / np.sqrt(len(points)), full_matrices=False)
        kept = sizes > MIN_DEVIATION_RATIO * sizes.max(initial=0.0)
        return np.asarray(sizes[kept, None] * axes[kept])

    def unchanged(self) -> PoseChange:
        """Return the change that leaves pose and placement as they are."""
        return PoseChange(np.zeros(len(self.directions)), np.zeros((self.space.rotation_count, 6)))

    def placement(self, placement: Float, moves: Float) -> Float:
        """Return a placement ``(P,)`` after moves ``(B, 6)`` of its bodies."""
        poses = self.space.unpack_placements(placement[None])
        rotations = quat_multiply(rotvec_to_quat(moves[:, :3]), poses.rotations[0])
        return np.append(rotations, poses.centres[0] + moves[:, 3:])

    def vectors(self, time: float, change: PoseChange) -> Float:
        """Return the vector ``(1, D)`` of the model at a time, with a change."""
        point = self.model.time([time]) + change.scores @ self.directions
        placement = self.placement(self.model.placement([time])[0], change.moves)
        weights = self.model.pose.weights(point)
        return np.concatenate([weights @ self.model.shapes, placement[None], self.model.correction([time])], axis=1)

    def positions(self, points: Float) -> Float:
        """Return the positions ``(..., n, 3)`` of handles in meshes ``(..., V, 3)``."""
        return np.asarray(self._means @ points[..., self._vertex_ids, :])

    def points(self, time: float, change: PoseChange) -> Float:
        """Return the decoded points ``(V, 3)`` of a change at a time; those of the last change are kept."""
        if self._decoded[0] is not change or self._decoded[1] != time:
            self._decoded = change, time, self.space.decode(self.vectors(time, change))[0]
        return self._decoded[2]

    def solve(
        self,
        time: float,
        targets: Float,
        prior: PoseChange | None = None,
        start: PoseChange | None = None,
        rounds: int = MAX_PROJECTION_ROUNDS,
    ) -> PoseChange:
        """Solve for the change at a time that moves handles to targets ``(n, 3)``, in the units of the sequence.

        The prior is the likeliest change, by default none. Iterations start from it, or from another change. One round
        is enough while handles are dragged, from the change before.
        """
        prior = self.unchanged() if prior is None else prior
        change, targets = start or prior, targets / self.space.scale
        offsets = self._joint_offsets(time, change)
        for _ in range(rounds):
            change = self._minimise(time, targets - offsets, prior, change)
            previous, offsets = offsets, self._joint_offsets(time, change)
            if np.abs(offsets - previous).max() <= PROJECTION_TOLERANCE:
                break
        return change

    def _joint_offsets(self, time: float, change: PoseChange) -> Float:
        """Return the displacements ``(n, 3)`` of handles by the projection of joints, in diagonals."""
        projection = self.space.projection
        if not (projection.steps or (projection.share and self.space.joint_faces.any())):
            return np.zeros((len(self.groups), 3))
        skinned = self._means @ self._skinned.skin(self.vectors(time, change)[:, self._columns])[0]
        return np.asarray(self.positions(self.points(time, change)) / self.space.scale - skinned)

    def _minimise(self, time: float, targets: Float, prior: PoseChange, change: PoseChange) -> PoseChange:
        """Minimise the energy of skinned handles with targets ``(n, 3)`` in diagonals, starting from a change."""
        base = self.vectors(time, self.unchanged())[0, self._columns]
        weights, (pose_count, shape_dim) = self._weights, self._shape_steps.shape
        placement = slice(shape_dim, shape_dim + self.space.placement_dim)
        rates = np.zeros((len(weights), len(base)))
        rates[:pose_count, :shape_dim] = self._shape_steps

        def vector(change: PoseChange) -> Float:
            result: Float = base.copy()
            result[:shape_dim] += change.scores @ self._shape_steps
            result[placement] = self.placement(base[placement], change.moves)
            return result

        def residuals(change: PoseChange, points: Float) -> tuple[Float, Float]:
            steps = np.append(change.scores - prior.scores, change.moves - prior.moves)[: len(weights)]
            return (self._means @ points - targets).reshape(-1) / self.softness, weights * steps

        def energy(change: PoseChange) -> float:
            points = self._skinned.skin(vector(change)[None])[0]
            return float(np.square(np.concatenate(residuals(change, points))).sum())

        damping, current = START_DAMPING, energy(change)
        for _ in range(MAX_STEPS):
            at = vector(change)
            rates[pose_count:, placement] = self._move_rates(at[placement])[: len(weights) - pose_count]
            points, slopes = from_complex_step(self._skinned.skin(to_complex_step(at, rates)))
            slopes = (self._means @ slopes).reshape(len(weights), -1) / self.softness
            misses, departures = residuals(change, points[0])
            gradient, hessian = slopes @ misses + weights * departures, slopes @ slopes.T + np.diag(np.square(weights))
            lowered, step = np.inf, np.zeros(len(weights))
            while lowered > current and damping <= MAX_DAMPING:
                step = -np.linalg.solve(hessian + damping * np.diag(np.diag(hessian)), gradient)
                candidate = self._after_step(change, step)
                lowered = energy(candidate)
                damping *= 0.1 if lowered <= current else 10.0
            if lowered > current:
                break
            decrease, change, current = current - lowered, candidate, lowered
            if decrease <= ENERGY_TOLERANCE * current or np.abs(weights * step).max() <= STEP_TOLERANCE:
                break
        return change

    def _move_rates(self, placement: Float) -> Float:
        """Return the rates ``(6 B, P)`` of a placement for rotations and shifts of all bodies."""
        count = self.space.rotation_count
        rates = np.zeros((count, 6, len(placement)))
        for body, quaternion in enumerate(placement[: 4 * count].reshape(-1, 4)):
            rates[body, :3, 4 * body : 4 * body + 4] = 0.5 * quat_multiply(np.eye(4)[1:], quaternion)
            rates[body, 3:, 4 * count + 3 * body :][:, :3] = np.eye(3)
        return rates.reshape(-1, len(placement))

    def _after_step(self, change: PoseChange, step: Float) -> PoseChange:
        """Return the change after a step ``(n,)``, whose rotations follow those of the change."""
        scores, steps = np.split(step, [len(change.scores)])
        moves = change.moves.copy()
        if self.is_free:
            turns = (rotvec_to_quat(each[:, :3]) for each in (steps.reshape(-1, 6), moves))
            moves[:, 3:] += steps.reshape(-1, 6)[:, 3:]
            moves[:, :3] = matrix_to_rotvec(quat_to_matrix(quat_multiply(*turns)))
        return PoseChange(change.scores + scores, moves)


@public
def pose(
    model: Model,
    handles: Sequence[Handle],
    keep: Sequence[int] = (),
    start: Seconds | None = None,
    end: Seconds | None = None,
    fade: Seconds | None = None,
    exact: bool = False,
    softness: float = DEFAULT_SOFTNESS,
    move_bodies: bool | None = None,
) -> Model:
    """Pose a character by handles, as its own motion poses it.

    The change of the pose is the likeliest one by which the handles reach their targets. It fades in before the first
    time of the handles and out after the last one, and blends from each time to the next.

    Parameters
    ----------
    model : Model
        A model in the mixed space with anchored parts.
    handles : sequence of Handle
        Target positions of vertices or parts, at one or several times.
    keep : sequence of int
        Vertices that stay on their paths while the change lasts, such as those of planted feet.
    start, end : float, optional
        Interval of the full change in seconds; by default from the first to the last time of the handles.
    fade : float, optional
        Seconds before `start` and after `end` in which the change fades; by default 1/8 of the motion, at least 2
        frames.
    exact : bool
        Whether to deform the mesh around handles that the poses of the model do not reach, so that all reach their
        targets.
    softness : float
        Distance from a target whose energy is that of one standard deviation of the pose, in diagonals.
    move_bodies : bool, optional
        Whether the bodies of the character move and turn as a whole, too; by default with three handles or more at a
        time, the kept vertices included.

    Raises
    ------
    SettingsError
        If a vertex, part or time does not exist, a position is not finite, a vertex or part has two targets at a time,
        or the model has no parts or only one pose.

    Warns
    -----
    MixseqWarning
        If a handle misses its target by more than 0.01 diagonals.
    """
    if not (np.isfinite(softness) and softness > 0):
        raise SettingsError(f"softness is {softness}; a positive number of diagonals is expected")
    kept = [ids[None] for ids in _check_vertices(model, keep, "keep")]
    keys = _sort_by_time(model, handles, kept)
    weights = _KeyWeights.from_times(model, np.array(list(keys)), start, end, fade)
    solvers, changes = [], []
    for time, (groups, targets) in keys.items():
        is_free = len(groups) >= MIN_HANDLES_OF_FREE_BODY if move_bodies is None else move_bodies
        solvers.append(PoseSolver(model, groups, softness, is_free))
        changes.append(solvers[-1].solve(time, targets))
    posed = _fade_changes(model, weights, solvers, changes, kept)
    for number, (time, (_, targets)) in enumerate(keys.items()):
        points = posed(time)
        misses = targets - solvers[number].positions(points)
        if exact:
            edited = points + interpolate_displacements(model, solvers[number], points, misses)
            difference = posed.space.shape_difference(posed.curve([time])[0], points, edited)
            posed = add_key_shape(posed, difference, weights.curve(posed, number))
        elif (miss := float(np.linalg.norm(misses, axis=1).max()) / model.space.scale) > MAX_SILENT_MISS:
            warnings.warn(
                f"at {time:g} s a handle misses its target by {miss:.2g} diagonals, where the poses of the model do "
                "not reach; give a nearer target, or exact=True to deform the mesh around it",
                MixseqWarning,
                stacklevel=3,
            )
    return posed


def _sort_by_time(
    model: Model, handles: Sequence[Handle], kept: Sequence[Index]
) -> dict[float, tuple[list[Index], Float]]:
    """Return vertices and targets ``(n, 3)`` of the handles and kept vertices, by increasing time."""
    if not handles:
        raise SettingsError("there are no handles; give one or more")
    by_time: dict[float, list[Handle]] = {}
    for handle in handles:
        by_time.setdefault(snap_time(model, handle.time), []).append(handle)
    result = {}
    for time, at_time in sorted(by_time.items()):
        names = [("part", handle.part) if handle.vertex is None else ("vertex", handle.vertex) for handle in at_time]
        names += [("vertex", int(ids[0])) for ids in kept]
        for name, number in names:
            if names.count((name, number)) > 1:
                raise SettingsError(f"{name} {number} has two targets at {time:g} s; leave one out")
        points = model(time)
        targets = [handle.target() for handle in at_time] + [points[ids[0]] for ids in kept]
        result[time] = [handle.vertices(model) for handle in at_time] + list(kept), np.array(targets)
    return result


class _KeyWeights(NamedTuple):
    """Weights of the changes at K times: 1 at their own time and 0 at the others, C2."""

    times: Float  # (K,)
    start: float  # start and end of the full change
    end: float
    fade: float
    model: Model

    @classmethod
    def from_times(
        cls, model: Model, times: Float, start: float | None, end: float | None, fade: float | None
    ) -> _KeyWeights:
        """Check the interval of the full change, which covers the times ``(K,)``."""
        first = times[0] if start is None else snap_time(model, start, "start")
        last = times[-1] if end is None else snap_time(model, end, "end")
        if not (first <= times[0] and times[-1] <= last):
            raise SettingsError(
                f"handles are at {times[0]:g} to {times[-1]:g} s, outside the interval from {first:g} to {last:g} s; "
                "give a start before them and an end after them"
            )
        return cls(times, first, last, check_reach(model, fade, "fade"), model)

    def ramps(self, number: int) -> tuple[tuple[float, float] | None, tuple[float, float] | None]:
        """Return the rise and the fall of a weight; None at the ends of the model."""
        times = self.times
        rise = (times[number - 1], times[number]) if number else (self.start - self.fade, self.start)
        is_last = number == len(times) - 1
        fall = (self.end, self.end + self.fade) if is_last else (times[number], times[number + 1])
        return None if rise[1] <= self.model.start else rise, None if fall[0] >= self.model.end else fall

    def at(self, times: Float) -> Float:
        """Return the weights ``(N, K)`` at times ``(N,)``."""
        return np.stack([fade_window(times, *self.ramps(number)) for number in range(len(self.times))], axis=1)

    @property
    def knots(self) -> Float:
        """Knots ``(n,)`` of all weights, and the times of the handles."""
        ramps = (ramp for number in range(len(self.times)) for ramp in self.ramps(number) if ramp is not None)
        return np.concatenate([self.times, *(np.linspace(*ramp, 4) for ramp in ramps)])

    def curve(self, model: Model, number: int) -> Curve:
        """Return a weight as a curve, whose sites include those of the time signal."""
        sites = weight_sites(model, np.concatenate([breakpoints(model.time), self.knots]))
        return Curve(sites, self.at(sites)[:, [number]])


def _fade_changes(
    model: Model,
    weights: _KeyWeights,
    solvers: Sequence[PoseSolver],
    changes: Sequence[PoseChange],
    kept: Sequence[Index],
) -> Model:
    """Return the model with the changes at all times, faded; kept vertices stay on their paths."""
    solver, dim = solvers[0], model.time.dim
    scores, moves = (np.stack(arrays) for arrays in zip(*changes, strict=True))
    groups = {tuple(ids.tolist()): ids for each in solvers for ids in each.groups}
    keeper = PoseSolver(model, list(groups.values()), solver.softness, any(each.is_free for each in solvers))
    kept_mask = np.array([any(ids is each for each in kept) for ids in groups.values()])

    def signal(times: Float) -> Float:
        rows = []
        for time, weight in zip(times, weights.at(times), strict=True):
            change = PoseChange(weight @ scores, np.tensordot(weight, moves, 1))
            if kept and weight.any():
                faded = model.space.decode(solver.vectors(time, change))[0]
                targets = np.where(kept_mask[:, None], keeper.positions(model(time)), keeper.positions(faded))
                change = keeper.solve(time, targets, change)
            point = model.time([time])[0] + change.scores @ solver.directions
            rows.append(np.append(point, solver.placement(model.placement([time])[0], change.moves)))
        return np.array(rows)

    def norm(steps: Float) -> Float:
        return np.maximum(pose_norm(steps[:, :dim]), body_norm(steps[:, dim:]))

    pose_norm, body_norm = shape_norm(model), placement_norm(model)
    first, last = max(weights.start - weights.fade, model.start), min(weights.end + weights.fade, model.end)
    sites = model_sites(model, first, last, weights.knots)
    for time in weights.times:
        sites[np.abs(sites - time).argmin()] = time  # restores the exact time if it was merged with a knot
    curve = interpolate_adaptively(signal, sites, SIGNAL_TOLERANCE, norm)
    time = splice(model, model.time, Curve(curve.times, curve.values[:, :dim]))
    if not (moves.any() or (kept and keeper.is_free)):
        return model.edited(time=time)
    return model.edited(time=time, placement=splice(model, model.placement, Curve(curve.times, curve.values[:, dim:])))


def interpolate_displacements(model: Model, solver: PoseSolver, points: Float, moves: Float) -> Float:
    """Return the smoothest displacements ``(V, 3)`` of points ``(V, 3)`` that move the handles by moves ``(n, 3)``."""
    diffusion = Diffusion(points / model.space.scale, model.mixed.topology)
    factor = splu(sparse.csc_array(sparse.diags_array(diffusion.areas) + RESIDUAL_RADIUS**2 * diffusion.laplacian))
    spread = factor.solve(solver.means.T.toarray())
    loads = diffusion.areas[:, None] * spread
    return np.asarray(factor.solve(loads @ np.linalg.solve(spread.T @ loads, moves)))
