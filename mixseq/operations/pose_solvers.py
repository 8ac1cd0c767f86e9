r"""Poses from positions of handles: points of pose space, or of a still mesh, whose parts turn about their joints.

A handle is a row of weights of the vertices, whose weighted sum is to reach a target: that of a vertex or of the centre
of a part, or the sums by which `mixseq.operations.handles` describes how a part is turned.

*Models of several frames.* Positions :math:`x_i` of handles depend on a point c of pose space, where the frames have
the covariance :math:`\Sigma`, and on the placement b. With targets :math:`y_i`, and the pose :math:`c_0` and placement
:math:`b_0` before the edit, the solution minimises

.. math::

    \sum_i |x_i(c, b) - y_i|^2 / s^2 + (c - c_0)^T \Sigma^{-1} (c - c_0) + |b - b_0|^2 ,

with the softness s in diagonals, and rotations of bodies weighted by their radii of gyration. This is the example-based
inverse kinematics of Sumner and others 2005 (MeshIK), in a space whose vectors rotate with the parts. The energy does
not depend on the coordinates of pose space. Only vertices of handles are skinned; derivatives are exact, by a complex
step.

*Models of a single frame* have no other poses. Their parts are chains: a part j turns by a rotation vector
:math:`\theta_j` about its pivot, the middle of its boundary with its parent, and roots are placed by b. The solution
minimises

.. math::

    \sum_i |x_i(\theta, b) - y_i|^2 / s^2 + \sum_j |\theta_j|^2 / \beta^2 + |b - b_0|^2 .

Derivatives are those of kinematic chains: a part below the pivot :math:`q_j` that turns by :math:`\omega` moves by
:math:`\omega \times (x - q_j)`. P_m of the vector of the still mesh with these part poses makes the mesh: parts are
rigid, joints keep the lengths and angles of the still mesh.

Both energies are minimised by Levenberg-Marquardt steps. The distance between skinned and projected vertices of joints
is constant in a round, and updated by decoding the mesh once.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from scipy import sparse

from mixseq.errors import SettingsError
from mixseq.mesh.rotations import (
    matrix_to_quat,
    matrix_to_rotvec,
    quat_multiply,
    quat_to_matrix,
    rotate_vectors,
    rotvec_to_matrix,
    rotvec_to_quat,
)
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.spaces.mixed.joint_projection import from_complex_step, to_complex_step
from mixseq.spaces.mixed.mixed_space import MixedBlocks
from mixseq.spaces.temporal import Poses
from mixseq.types import Float, Index

MIN_DEVIATION_RATIO = 1e-6  # standard deviation of a direction that is a rounding error, relative to the largest
JOINT_DEVIATION = 0.5  # rotation of a joint of a still mesh whose energy is 1, in radians
MAX_STEPS, STEP_TOLERANCE, ENERGY_TOLERANCE = 30, 1e-4, 1e-5  # steps, standard deviations, relative decrease
START_DAMPING, MAX_DAMPING = 1e-3, 1e8  # first damping of steps, and the one at which none lowers the energy
MAX_PROJECTION_ROUNDS, PROJECTION_TOLERANCE = 3, 1e-5  # rounds for joints, and change of offsets in diagonals

State = TypeVar("State")


def minimise(
    state: State,
    residuals: Callable[[State], Float],
    jacobian: Callable[[State], Float],
    after_step: Callable[[State, Float], State],
) -> State:
    """Minimise the squares of residuals ``(m,)`` with derivatives ``(m, n)``, by Levenberg-Marquardt steps ``(n,)``."""
    damping, errors = START_DAMPING, residuals(state)
    energy = float(errors @ errors)
    for _ in range(MAX_STEPS):
        slopes = jacobian(state)
        gradient, hessian = slopes.T @ errors, slopes.T @ slopes
        lowered, step = np.inf, gradient
        while lowered > energy and damping <= MAX_DAMPING:
            step = np.asarray(-np.linalg.solve(hessian + damping * np.diag(np.diag(hessian)), gradient))
            candidate = after_step(state, step)
            errors = residuals(candidate)
            lowered = float(errors @ errors)
            damping *= 0.1 if lowered <= energy else 10.0
        if lowered > energy:
            break
        decrease, state, energy = energy - lowered, candidate, lowered
        if decrease <= ENERGY_TOLERANCE * energy or np.abs(step).max() <= STEP_TOLERANCE:
            break
    return state


class HandleSolver(ABC, Generic[State]):
    """Solver for poses of a model from positions of handles, weighted sums of vertices."""

    def __init__(self, model: Model, rows: Sequence[sparse.csr_array], softness: float, is_free: bool) -> None:
        """Take the weights ``(1, V)`` of every handle, the softness in diagonals, and whether bodies move, too."""
        self.model, self.rows, self.softness, self.is_free = model, rows, softness, is_free
        self.space = model.mixed
        if self.space.placement == "free":
            raise SettingsError("the free placement ignores poses of parts; fit with placement='anchored'")
        self._decoded: tuple[State | None, float, Float] = (None, 0.0, np.empty((0, 3)))

    @abstractmethod
    def unchanged(self) -> State:
        """Return the pose before the edit."""

    @abstractmethod
    def positions(self, points: Float) -> Float:
        """Return the positions ``(n, 3)`` of handles in a mesh ``(V, 3)``."""

    @abstractmethod
    def _decode(self, time: float, pose: State) -> Float:
        """Return the points ``(V, 3)`` of a pose at a time."""

    @abstractmethod
    def _joint_offsets(self, time: float, pose: State) -> Float:
        """Return the displacements ``(n, 3)`` of handles by the projection of joints, in diagonals."""

    @abstractmethod
    def _minimise(self, time: float, targets: Float, prior: State, start: State) -> State:
        """Minimise the energy of skinned handles with targets ``(n, 3)`` in diagonals, starting from a pose."""

    def points(self, time: float, pose: State) -> Float:
        """Return the decoded points ``(V, 3)`` of a pose at a time; those of the last pose are kept."""
        if self._decoded[0] is not pose or self._decoded[1] != time:
            self._decoded = pose, time, self._decode(time, pose)
        return self._decoded[2]

    def solve(
        self,
        time: float,
        targets: Float,
        prior: State | None = None,
        start: State | None = None,
        rounds: int = MAX_PROJECTION_ROUNDS,
    ) -> State:
        """Solve for the pose at a time that moves handles to targets ``(n, 3)``, in the units of the sequence.

        The prior is the likeliest pose, by default the unchanged one. Iterations start from it, or from another pose.
        One round is enough while handles are dragged, from the pose before.
        """
        prior = self.unchanged() if prior is None else prior
        pose = start or prior
        offsets = self._joint_offsets(time, pose)
        for _ in range(rounds):
            pose = self._minimise(time, targets / self.space.scale - offsets, prior, pose)
            previous, offsets = offsets, self._joint_offsets(time, pose)
            if np.abs(offsets - previous).max() <= PROJECTION_TOLERANCE:
                break
        return pose


class PoseChange(NamedTuple):
    """A change of pose and placement, in the units of its prior."""

    scores: Float  # (r,) standard deviations along the directions of pose space
    moves: Float  # (B, 6) rotation vectors of bodies in world axes in radians, shifts of their centres in diagonals


class PoseSolver(HandleSolver[PoseChange]):
    """Solver for changes of the poses of a model of several frames."""

    def __init__(self, model: Model, rows: Sequence[sparse.csr_array], softness: float, is_free: bool) -> None:
        super().__init__(model, rows, softness, is_free)
        if not len(self.directions):
            raise SettingsError("the model has a single pose, so that there are no others to find by handles")
        self._vertex_ids: Index = np.unique(np.concatenate([row.indices for row in rows]))
        self._sums = np.concatenate([row[:, self._vertex_ids].toarray() for row in rows])
        self._skinned, self._columns = self.space.at_vertices(self._vertex_ids)
        shapes = model.shapes[:, self._columns[self._columns < self.space.shape_dim]]
        self._shape_steps = self.directions @ model.pose.matrix @ (shapes - shapes[0])  # (r, S')
        move_weights = np.ones((self.space.rotation_count if is_free else 0, 6))
        move_weights[:, :3] = self.space.articulation.body_radii[: len(move_weights), None]
        self._weights = np.append(np.ones(len(self.directions)), move_weights)

    @cached_property
    def directions(self) -> Float:
        """Standard deviations ``(r, k)`` of the frames along the principal directions of pose space."""
        points = self.model.time(self.model.times)
        _, sizes, axes = np.linalg.svd((points - points.mean(axis=0)) / np.sqrt(len(points)), full_matrices=False)
        kept = sizes > MIN_DEVIATION_RATIO * sizes.max(initial=0.0)
        return np.asarray(sizes[kept, None] * axes[kept])

    def unchanged(self) -> PoseChange:
        """Implement `HandleSolver.unchanged`."""
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

    def moved_model(self, change: PoseChange) -> Model:
        """Return the model with a change at all times."""
        time, placement = self.model.time, self.model.placement
        placements = np.stack([self.placement(each, change.moves) for each in placement.values])
        return self.model.edited(
            time=Curve(time.times, time.values + change.scores @ self.directions),
            placement=Curve(placement.times, placements),
        )

    def positions(self, points: Float) -> Float:
        """Implement `HandleSolver.positions`, also of several meshes ``(..., V, 3)``."""
        return np.asarray(self._sums @ points[..., self._vertex_ids, :])

    def _decode(self, time: float, change: PoseChange) -> Float:
        return np.asarray(self.space.decode(self.vectors(time, change))[0])

    def _joint_offsets(self, time: float, change: PoseChange) -> Float:
        projection = self.space.projection
        if not (projection.steps or (projection.share and self.space.joint_faces.any())):
            return np.zeros((len(self.rows), 3))
        skinned = self._sums @ self._skinned.skin(self.vectors(time, change)[:, self._columns])[0]
        return np.asarray(self.positions(self.points(time, change)) / self.space.scale - skinned)

    def _minimise(self, time: float, targets: Float, prior: PoseChange, start: PoseChange) -> PoseChange:
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

        def residuals(change: PoseChange) -> Float:
            points = self._skinned.skin(vector(change)[None])[0]
            misses = (self._sums @ points - targets).reshape(-1) / self.softness
            steps = np.append(change.scores - prior.scores, change.moves - prior.moves)[: len(weights)]
            return np.append(misses, weights * steps)

        def jacobian(change: PoseChange) -> Float:
            at = vector(change)
            rates[pose_count:, placement] = self._move_rates(at[placement])[: len(weights) - pose_count]
            slopes = from_complex_step(self._skinned.skin(to_complex_step(at, rates)))[1]
            slopes = (self._sums @ slopes).reshape(len(weights), -1) / self.softness
            return np.concatenate([slopes.T, np.diag(weights)])

        return minimise(start, residuals, jacobian, self._after_step)

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


class JointRotations(NamedTuple):
    """A pose of a still mesh of p parts."""

    rotations: Float  # (p, 3, 3) of parts about their pivots, in the axes of their parents
    shifts: Float  # (p, 3) of roots, in diagonals; zero for other parts


class StillSolver(HandleSolver[JointRotations]):
    """Solver for poses of a model of a single frame, which are the same at all times, and likeliest unchanged."""

    def __init__(self, model: Model, rows: Sequence[sparse.csr_array], softness: float, is_free: bool) -> None:
        super().__init__(model, rows, softness, is_free)
        self.tree = self.space.articulation
        if model.bodies:
            raise SettingsError("the model is a still of several bodies; pose one of them, and then give it the others")
        if len(self.space.decomposition.parts) == 1:
            raise SettingsError(
                "the model is a still of one part, which cannot bend; fit it with parts=, a number or labels of faces"
            )
        count, (parts, parents) = len(self.tree.parents), self.tree.links
        self.is_root = self.tree.parents < 0
        self._order = np.append(np.flatnonzero(self.is_root), parts)  # parents first
        self.pivots = self.tree.rest_centres.copy()
        self.pivots[parts] += self.tree.pivots[self.tree.link_relations]
        self._is_below = np.eye(count, dtype=bool)  # (p, p) whether a part moves with the rotation of another
        for part, parent in zip(parts[::-1], parents[::-1], strict=True):
            self._is_below[parent] |= self._is_below[part]
        self._is_variable = np.repeat(np.append(~self.is_root | is_free, np.full(self.is_root.sum(), is_free)), 3)
        radii = self.tree.body_radii[self.tree.body_of_part]
        self._weights = np.where(self.is_root, radii, 1.0 / JOINT_DEVIATION)
        points = model(model.start) / self.space.scale
        by_part = [row.T.multiply(self.space.skinning_weights) for row in rows]  # (V, p) each
        self._loads = np.stack([each.sum(axis=0) for each in by_part])  # (n, p) weights of parts at handles
        self._moments = np.stack([each.T @ points for each in by_part])  # (n, p, 3) weighted sums of positions

    def positions(self, points: Float) -> Float:
        """Implement `HandleSolver.positions`."""
        return np.concatenate([row @ points for row in self.rows])

    def unchanged(self) -> JointRotations:
        """Implement `HandleSolver.unchanged`."""
        count = len(self.is_root)
        return JointRotations(np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)))

    def _joint_offsets(self, time: float, pose: JointRotations) -> Float:
        return np.asarray(self.positions(self.points(time, pose)) / self.space.scale - self.skin(pose).sum(axis=1))

    def _decode(self, time: float, pose: JointRotations) -> Float:
        rotations, shifts = self.motions(pose)
        centres = rotate_vectors(rotations, self.tree.rest_centres) + shifts
        world = Poses(matrix_to_quat(rotations)[None], centres[None])
        bodies = self.tree.fit_bodies(world)
        parts = self.tree.add_relations(self.tree.to_body_axes(world, bodies))
        still = self.space.split(self.model.vectors[:1])
        vector = self.space.join(MixedBlocks(*still[:3], *parts, *bodies, still.corrections))
        return np.asarray(self.space.decode(vector)[0])

    def motions(self, pose: JointRotations) -> tuple[Float, Float]:
        """Return the motions ``x -> R x + t`` of parts: rotations ``(p, 3, 3)`` and shifts ``(p, 3)`` in diagonals."""
        rotations = pose.rotations.copy()
        shifts = pose.shifts + self.pivots - rotate_vectors(pose.rotations, self.pivots)
        for part in self._order[self.is_root.sum() :]:
            parent = self.tree.parents[part]
            shifts[part] = rotations[parent] @ shifts[part] + shifts[parent]
            rotations[part] = rotations[parent] @ rotations[part]
        return rotations, shifts

    def skin(self, pose: JointRotations) -> Float:
        """Return the weighted positions ``(n, p, 3)`` of handles that move with every part; their sums are skinned."""
        rotations, shifts = self.motions(pose)
        return np.asarray(rotate_vectors(rotations, self._moments) + self._loads[..., None] * shifts)

    def _parent_rotations(self, pose: JointRotations) -> Float:
        """Return the axes ``(p, 3, 3)`` in which parts rotate."""
        return np.where(self.is_root[:, None, None], np.eye(3), self.motions(pose)[0][self.tree.parents])

    def _minimise(self, time: float, targets: Float, prior: JointRotations, start: JointRotations) -> JointRotations:
        """Implement `HandleSolver._minimise`; variables are rotation vectors in world axes, and shifts of roots."""
        count, root_count = len(self.is_root), int(self.is_root.sum())

        def residuals(pose: JointRotations) -> Float:
            misses = (self.skin(pose).sum(axis=1) - targets) / self.softness
            turns = self._weights[:, None] * matrix_to_rotvec(pose.rotations)
            return np.concatenate([misses, turns, pose.shifts[self.is_root]]).reshape(-1)

        def jacobian(pose: JointRotations) -> Float:
            rotations, shifts = self.motions(pose)
            pivots = rotate_vectors(rotations, self.pivots) + shifts
            sums, loads = np.einsum("jp,npa->nja", self._is_below, self.skin(pose)), self._loads @ self._is_below.T
            result = np.zeros((len(targets) + count + root_count, 3, count + root_count, 3))
            by_handle, own = result[: len(targets)], result[len(targets) :]
            by_handle[:, :, :count] = -_cross_matrices(sums - loads[..., None] * pivots).swapaxes(1, 2) / self.softness
            by_handle[:, :, count:] = np.einsum("nb,ac->nabc", loads[:, self.is_root], np.eye(3)) / self.softness
            turn_axes = self._weights[:, None, None] * self._parent_rotations(pose)
            axes = np.append(turn_axes, np.tile(np.eye(3), (root_count, 1, 1)), axis=0)
            own[np.arange(len(axes)), :, np.arange(len(axes))] = axes.swapaxes(1, 2)
            return result.reshape(-1, 3 * (count + root_count))[:, self._is_variable]

        def after_step(pose: JointRotations, step: Float) -> JointRotations:
            steps = np.zeros(len(self._is_variable))
            steps[self._is_variable] = step
            turns, root_shifts = np.split(steps.reshape(-1, 3), [count])
            in_axes = np.einsum("pba,pb->pa", self._parent_rotations(pose), turns)
            shifts = pose.shifts.copy()
            shifts[self.is_root] += root_shifts
            return JointRotations(rotvec_to_matrix(in_axes) @ pose.rotations, shifts)

        return minimise(start, residuals, jacobian, after_step)


def _cross_matrices(vectors: Float) -> Float:
    """Return the matrices ``(..., 3, 3)`` of products ``vector x w``."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    rows = (zero, -z, y), (z, zero, -x), (-y, x, zero)
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
