r"""Pose a character by handles: vertices or parts that are given positions at some times, and parts that are turned.

Poses at the times of handles are those of `mixseq.operations.pose_solvers`. Over time, the change fades in and out, and
from key to key. Kept vertices stay on their paths: at every time, they are handles, and the faded change takes the
place of the pose before the edit. A model of a single frame has no motion to fade into: the result goes from pose to
pose.

A part is turned by its moments :math:`\sum_i u_{ik}\, x_i / \sqrt n`, where the columns of u are the principal axes of
its n vertices, with :math:`\sum_i u_{ik} = 0` and unit lengths. They turn as the part turns, and do not depend on where
it is: a target is the moment before the edit, turned. Their errors are root mean square distances of vertices.

*Exact* handles deform the mesh by the smoothest displacement d that moves them to their targets, the minimum of
:math:`\int |d - l^2 \Delta d|^2`, stored as a key shape like that of a sculpted edit.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse.linalg import splu

from mixseq.errors import MixseqWarning, SettingsError
from mixseq.mesh.rotations import rotvec_to_matrix
from mixseq.operations.pose_solvers import HandleSolver, PoseChange, PoseSolver, StillSolver
from mixseq.operations.sculpt import add_key_shape, weight_sites
from mixseq.operations.sections import (
    KeyWeights,
    breakpoints,
    interpolate_adaptively,
    placement_norm,
    shape_norm,
    snap_time,
    splice,
)
from mixseq.operations.sketch import check_reach
from mixseq.runtime.public import public
from mixseq.segmentation.silhouettes import Diffusion
from mixseq.sequence.frame_rates import Seconds
from mixseq.sequence.provenance import as_edited
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.curve import Curve
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.types import Float, Index

DEFAULT_SOFTNESS = 5e-3  # distance from a target whose energy is that of one standard deviation, in diagonals
MIN_HANDLES_OF_FREE_BODY = 3  # handles from which on bodies move: three points determine a rigid motion
SIGNAL_TOLERANCE = 1e-4  # largest error of signals between sites, in diagonals
MAX_SILENT_MISS = 0.01  # distance of a handle from its target above which a warning is given, in diagonals
RESIDUAL_RADIUS = 0.05  # radius l of the displacement at exact handles, in diagonals
MIN_EXTENT_RATIO = 1e-6  # extent of a part along an axis below which it has no moment, as a fraction of the largest


class Key(NamedTuple):
    """Rows of the handles at a time."""

    rows: list[sparse.csr_array]  # (1, V) weights of vertices
    targets: Float  # (n, 3) targets of the weighted sums
    is_free: bool  # whether they determine where bodies are


@dataclass(frozen=True)
class Handle:
    """A target of a vertex, or of a part, at a time: a position, or how far the part is turned, or both."""

    time: float  # in seconds
    position: ArrayLike | None = None  # (3,) target in the units of the sequence: of the vertex, or the part's centre
    vertex: int | None = None  # number of a vertex; or of a part:
    part: int | None = None
    # (3,) rotation of the part from its pose before the edit: degrees about the x, y and z axis, as a rotation vector;
    # zeros keep its directions
    rotation: ArrayLike | None = None

    @property
    def name(self) -> str:
        """The vertex or part, for messages."""
        return f"part {self.part}" if self.vertex is None else f"vertex {self.vertex}"

    def targets(self, model: Model, points: Float) -> tuple[list[sparse.csr_array], list[Float]]:
        """Return rows ``(1, V)`` and their targets ``(3,)``, given the points ``(V, 3)`` before the edit.

        Raises `SettingsError` if the vertex or part does not exist, or has no target.
        """
        vertex_ids = self._vertices(model)
        rows, targets = [], []
        if self.position is None and self.rotation is None:
            raise SettingsError(
                f"the handle of {self.name} at {self.time:g} s has no position and no rotation; give one"
            )
        if self.position is not None:
            rows.append(weight_row(len(points), vertex_ids, np.full(len(vertex_ids), 1.0 / len(vertex_ids))))
            targets.append(self._numbers(self.position, "position"))
        if self.rotation is not None:
            rotation = rotvec_to_matrix(np.radians(self._numbers(self.rotation, "rotation")))
            offsets = points[vertex_ids] - points[vertex_ids].mean(axis=0)
            axes, sizes, _ = np.linalg.svd(offsets, full_matrices=False)
            for axis in axes.T[sizes > MIN_EXTENT_RATIO * sizes[0]] / np.sqrt(len(offsets)):
                rows.append(weight_row(len(points), vertex_ids, axis))
                targets.append(rotation @ (axis @ offsets))
        return rows, targets

    def _vertices(self, model: Model) -> Index:
        """Return the vertices ``(n,)`` of the handle."""
        if (self.vertex is None) == (self.part is None):
            raise SettingsError(f"the handle at {self.time:g} s has a vertex and a part, or neither; give one")
        if self.part is None:
            if self.rotation is not None:
                raise SettingsError(f"{self.name} cannot be turned, only a part; give the part of a rotation")
            return _check_vertices(model, [self.vertex], "handle")
        parts = model.decomposition.parts
        if not 0 <= self.part < len(parts):
            raise SettingsError(f"there is no part {self.part}; the model has {len(parts)}, from 0 on")
        return parts[self.part]

    def _numbers(self, values: ArrayLike, name: str) -> Float:
        numbers = np.asarray(values, dtype=np.float64)
        if numbers.shape != (3,) or not np.isfinite(numbers).all():
            raise SettingsError(
                f"the handle of {self.name} at {self.time:g} s has the {name} {numbers}; three finite numbers are "
                "expected"
            )
        return numbers


def weight_row(count: int, vertex_ids: Index, weights: Float) -> sparse.csr_array:
    """Return weights ``(n,)`` of some vertices as a row ``(1, V)``."""
    return sparse.csr_array((weights, (np.zeros_like(vertex_ids), vertex_ids)), shape=(1, count))


def _check_vertices(model: Model, vertex_ids: Sequence[int | None], name: str) -> Index:
    count = model.header.vertex_count
    for vertex in vertex_ids:
        if not (isinstance(vertex, int | np.integer) and 0 <= vertex < count):
            raise SettingsError(f"{name}: there is no vertex {vertex}; the model has {count:,}, from 0 on")
    return np.array(vertex_ids, dtype=np.int64)


def _kept_rows(model: Model, keep: Sequence[int]) -> list[sparse.csr_array]:
    """Return a row ``(1, V)`` for every kept vertex."""
    ids = _check_vertices(model, keep, "keep")
    return [weight_row(model.header.vertex_count, vertex_ids, np.ones(1)) for vertex_ids in ids[:, None]]


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

    The parts of a still, a model of a single frame, turn about their joints, which keep their lengths and angles. The
    result goes from the still, at its own time, to its poses at the times of the handles.

    Parameters
    ----------
    model : Model
        A model in the mixed space with anchored parts; that of a single frame needs two parts or more.
    handles : sequence of Handle
        Target positions of vertices or parts, and rotations of parts in degrees, at one or several times.
    keep : sequence of int
        Vertices that stay on their paths while the change lasts, such as those of planted feet.
    start, end : float, optional
        Interval of the full change in seconds; by default from the first to the last time of the handles.
    fade : float, optional
        Seconds before `start` and after `end` in which the change fades; by default 1/8 of the motion, at least 2
        frames. A still has none of the three.
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
        If a vertex, part or time does not exist, a handle has no target, or one that is not finite, a vertex or part
        has two handles at a time, or the model has no parts, or is a still of one part.

    Warns
    -----
    MixseqWarning
        If a handle misses its target by more than 0.01 diagonals.
    """
    if not (np.isfinite(softness) and softness > 0):
        raise SettingsError(f"softness is {softness}; a positive number of diagonals is expected")
    kept = _kept_rows(model, keep)
    keys = _sort_by_time(model, handles, kept, move_bodies)
    if len(model.times) == 1:
        if not (start is end is fade is None):
            raise SettingsError("the model is a still, with no motion to fade into; leave out start, end and fade")
        stills = [StillSolver(model, key.rows, softness, key.is_free) for key in keys.values()]
        return _pose_still(model, keys, stills, exact)
    weights = _key_weights(model, np.array(list(keys)), start, end, fade)
    solvers = [PoseSolver(model, key.rows, softness, key.is_free) for key in keys.values()]
    changes = [solver.solve(time, key.targets) for solver, (time, key) in zip(solvers, keys.items(), strict=True)]
    posed = _fade_changes(model, weights, solvers, changes, kept)
    for number, (time, key) in enumerate(keys.items()):
        points = posed(time)
        edited = _reach(solvers[number], time, points, key.targets, exact)
        if exact:
            difference = posed.space.shape_difference(posed.curve([time])[0], points, edited)
            sites = weight_sites(posed, np.concatenate([breakpoints(posed.time), weights.knots]))
            posed = add_key_shape(posed, difference, Curve(sites, weights.at(sites)[:, [number]]))
    return posed


class DraggedPose:
    """Poses of a model at one time while its handles are dragged: each is solved from the one before, in one round."""

    def __init__(self, model: Model, handles: Sequence[Handle], keep: Sequence[int] = (), exact: bool = False) -> None:
        """Take handles at one time, whose positions will change, and the other arguments of `pose`."""
        kept = _kept_rows(model, keep)
        ((time, key),) = _sort_by_time(model, handles, kept, None).items()
        solver: type[HandleSolver[Any]] = StillSolver if len(model.times) == 1 else PoseSolver
        self._solver = solver(model, key.rows, DEFAULT_SOFTNESS, key.is_free)
        self._time, self._kept_targets = time, key.targets[len(key.targets) - len(kept) :]
        self._pose = self._solver.unchanged()
        before = self._solver.points(time, self._pose)
        self._basis = displacement_basis(model, key.rows, before) if exact else None

    def points(self, targets: Float) -> Float:
        """Return the points ``(V, 3)`` with handles at targets ``(n, 3)``."""
        targets = np.concatenate([targets, self._kept_targets])
        self._pose = self._solver.solve(self._time, targets, start=self._pose, rounds=1)
        points = self._solver.points(self._time, self._pose)
        if self._basis is not None:
            points = points + self._basis @ (targets - self._solver.positions(points))
        return np.asarray(points)

    def moved_model(self) -> Model:
        """Return the model with the change of the last pose at all times, which moves all bodies."""
        assert isinstance(self._solver, PoseSolver)  # stills have a single body
        return self._solver.moved_model(self._pose)


def _reach(solver: HandleSolver[Any], time: float, points: Float, targets: Float, exact: bool) -> Float:
    """Return the points ``(V, 3)`` deformed so that handles are exact, if asked for; otherwise warn of misses."""
    misses = targets - solver.positions(points)
    if exact:
        return points + displacement_basis(solver.model, solver.rows, points) @ misses
    if (miss := float(np.linalg.norm(misses, axis=1).max()) / solver.space.scale) > MAX_SILENT_MISS:
        warnings.warn(
            f"at {time:g} s a handle misses its target by {miss:.2g} diagonals, where the poses of the model do "
            "not reach; give a nearer target, or exact=True to deform the mesh around it",
            MixseqWarning,
            stacklevel=4,
        )
    return points


def _pose_still(model: Model, keys: dict[float, Key], solvers: Sequence[StillSolver], exact: bool) -> Model:
    """Fit a model to a still at its time and to its poses with handles at targets."""
    poses = {float(model.times[0]): model(model.start)}
    for solver, (time, key) in zip(solvers, keys.items(), strict=True):
        points = solver.points(time, solver.solve(time, key.targets))
        poses[time] = _reach(solver, time, points, key.targets, exact)
    times = np.array(sorted(poses))
    header = replace(model.header, times=times, provenance=as_edited(model.header.provenance))
    frames = MeshSequence.from_header(header, np.stack([poses[time] for time in times.tolist()]))
    return fit(frames, exact=True, parts=model.parts)


def _sort_by_time(
    model: Model, handles: Sequence[Handle], kept: Sequence[sparse.csr_array], move_bodies: bool | None
) -> dict[float, Key]:
    """Return the rows of handles, followed by those of kept vertices, by increasing time."""
    if not handles:
        raise SettingsError("there are no handles; give one or more")
    by_time: dict[float, list[Handle]] = {}
    for handle in handles:
        by_time.setdefault(_key_time(model, handle.time), []).append(handle)
    result = {}
    for time, at_time in sorted(by_time.items()):
        names = [handle.name for handle in at_time] + [f"vertex {row.indices[0]}" for row in kept]
        for name in names:
            if names.count(name) > 1:
                raise SettingsError(f"{name} has two targets at {time:g} s; leave one out")
        points = model(np.clip(time, model.start, model.end))
        rows, targets = map(
            chain.from_iterable, zip(*(handle.targets(model, points) for handle in at_time), strict=True)
        )
        placed = sum(handle.position is not None for handle in at_time) + len(kept)
        is_free = placed >= MIN_HANDLES_OF_FREE_BODY if move_bodies is None else move_bodies
        kept_points = (points[row.indices[0]] for row in kept)
        result[time] = Key([*rows, *kept], np.array([*targets, *kept_points]), is_free)
    return result


def _key_time(model: Model, time: float) -> float:
    """Return the time of a handle: that of a model's motion, or any if the model has a single frame."""
    if len(model.times) > 1:
        return snap_time(model, time)
    if not np.isfinite(time):
        raise SettingsError(f"the time of a handle is {time}; a finite number of seconds is expected")
    return float(time)


def _key_weights(model: Model, times: Float, start: float | None, end: float | None, fade: float | None) -> KeyWeights:
    """Return the weights of changes at times ``(K,)``; check the interval of the full change, which covers them."""
    first = times[0] if start is None else snap_time(model, start, "start")
    last = times[-1] if end is None else snap_time(model, end, "end")
    if not (first <= times[0] and times[-1] <= last):
        raise SettingsError(
            f"handles are at {times[0]:g} to {times[-1]:g} s, outside the interval from {first:g} to {last:g} s; "
            "give a start before them and an end after them"
        )
    return KeyWeights(times, first, last, check_reach(model, fade, "fade"), model)


def _fade_changes(
    model: Model,
    weights: KeyWeights,
    solvers: Sequence[PoseSolver],
    changes: Sequence[PoseChange],
    kept: Sequence[sparse.csr_array],
) -> Model:
    """Return the model with the changes at all times, faded; kept vertices stay on their paths."""
    solver, dim = solvers[0], model.time.dim
    scores, moves = (np.stack(arrays) for arrays in zip(*changes, strict=True))
    distinct = {(row.indices.tobytes(), row.data.tobytes()): row for each in solvers for row in each.rows}
    keeper = PoseSolver(model, list(distinct.values()), solver.softness, any(each.is_free for each in solvers))
    kept_mask = np.array([any(row is each for each in kept) for row in distinct.values()])

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
    sites = weights.sites
    for time in weights.times:
        sites[np.abs(sites - time).argmin()] = time  # restores the exact time if it was merged with a knot
    curve = interpolate_adaptively(signal, sites, SIGNAL_TOLERANCE, norm)
    time = splice(model, model.time, Curve(curve.times, curve.values[:, :dim]))
    if not (moves.any() or (kept and keeper.is_free)):
        return model.edited(time=time)
    return model.edited(time=time, placement=splice(model, model.placement, Curve(curve.times, curve.values[:, dim:])))


def displacement_basis(model: Model, rows: Sequence[sparse.csr_array], points: Float) -> Float:
    """Return weights ``(V, n)`` whose products with moves ``(n, 3)`` of handles are the smoothest displacements."""
    diffusion = Diffusion(points / model.space.scale, model.mixed.topology)
    factor = splu(sparse.csc_array(sparse.diags_array(diffusion.areas) + RESIDUAL_RADIUS**2 * diffusion.laplacian))
    spread = factor.solve(np.concatenate([row.toarray() for row in rows]).T)
    loads = diffusion.areas[:, None] * spread
    return np.asarray(np.linalg.solve(spread.T @ loads, factor.solve(loads).T).T)
