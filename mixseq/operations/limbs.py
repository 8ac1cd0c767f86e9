r"""Edits of one limb, a part with all parts below it: exaggerate or damp its motion in its joint, or hold it.

The parts of a component are a tree by their boundaries: the root is the largest part, every other part hangs on its
*parent*, one boundary nearer to the root. The *stance* of a limb is the pose of the part relative to its parent: a turn
:math:`\tau` since the reference frame, and a gap g at the pivot, the middle of their boundary there, which is p from
either part's centre,

.. math:: R_i^T R_j = \exp(\tau), \qquad R_j p_j + t_j = R_i (p_i + g) + t_i ,

for poses relative to the body, rotations since the reference frame. It is six numbers over time, with turns as rotation
vectors, unwrapped along the knots of a model, so whole turns count. Edits change it,

.. math::

    \tau' = \bar\tau + \text{gain}\, (\tau - \bar\tau), \qquad
    \tau' = \tau + w(t)\, (\tau(t_0) - \tau).

A changed stance moves the part from :math:`(R, t)` to :math:`(R', t')`, and the whole limb with it as one rigid body,
:math:`x \to R' R^T (x - t) + t'`. Quaternions change by :math:`\exp(\tau') \exp(\tau)^{-1}`, with continuous signs for
any distance of times. Poses are changed by the model's correction.

Between limb and body the skin follows the poses of both; the remaining shape change in the joint follows the same
formula. As the results are no cubic splines, signals are adaptively sampled.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csgraph

from mixseq.errors import SettingsError
from mixseq.mesh.rotations import (
    continuous_vectors,
    exponentials,
    inverse,
    normalised,
    product,
    rotations_of,
    turned,
    unwrap,
)
from mixseq.operations.filters import check_gain
from mixseq.operations.sections import (
    ACCURACY,
    CurveSection,
    Seam,
    blended_poses,
    correction_measure,
    join,
    refined,
    sampled,
    shape_measure,
    sites_within,
    snapped,
    window,
)
from mixseq.runtime.public import public
from mixseq.sequence.frame_rates import Seconds
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.signals.pose import PoseMap
from mixseq.spaces.mixed.mixed_space import MixedSpace, as_mixed
from mixseq.spaces.temporal import Poses
from mixseq.types import Float, Mask

STRIPS = 4
"""Width, in edges, over which joint coordinates pass from one border of parts to another."""


@dataclass(frozen=True, eq=False)
class Limb:
    """A part of a body and all parts below it."""

    space: MixedSpace  # the space of the parts
    part: int  # root part of the limb
    parent: int  # neighbouring part of the body, to which the root part is joined
    parts: Mask  # (p,) the part and all parts below it

    @cached_property
    def _pivots(self) -> tuple[Float, Float]:
        """Middle of the boundary ``(3,)``, from the centre of the parent and of the part."""
        articulation = self.space.articulation
        near, far = (
            articulation.pivots[np.flatnonzero((articulation.pairs == ends).all(axis=1))[0]]
            for ends in ((self.part, self.parent), (self.parent, self.part))
        )
        return near, far

    def stance(self, model: Model, times: Float) -> Float:
        """Return turns and gaps ``(N, 6)`` of the limb in a model at times ``(N,)``.

        Turns are unwrapped from the first frame, which has the shortest turn.
        """
        knots = np.concatenate([model.time.times, model.correction.times])
        known, asked = np.unique(np.concatenate([knots, times]), return_inverse=True)
        poses = part_poses(model, known)
        near, far = self._pivots
        rotations = rotations_of(poses.rotations)
        back = np.swapaxes(rotations[:, self.parent], -1, -2)
        turns = continuous_vectors(back @ rotations[:, self.part])
        pivots = rotations[:, self.part] @ far + poses.centres[:, self.part]
        gaps = turned(back, pivots - poses.centres[:, self.parent]) - near
        return np.concatenate([turns, gaps], axis=1)[asked[len(knots) :]]

    def corrections(self, model: Model, times: Float, stance: Float) -> Float:
        """Return the corrections ``(N, C)`` at times ``(N,)`` with another stance ``(N, 6)`` of the limb.

        Turns continue those of the model's correction at the first time, by less than half a turn from time to time.
        """
        before, poses = self.stance(model, times), part_poses(model, times)
        near, far = self._pivots
        base = normalised(poses.rotations[:, self.parent])
        change = product(exponentials(stance[:, :3]), inverse(exponentials(before[:, :3])))
        turn = product(product(base, change), inverse(base))
        rotations, centres = poses.rotations.copy(), poses.centres.copy()
        rotations[:, self.parts] = product(turn[:, None], rotations[:, self.parts])
        parent, part = (rotations_of(rotations[:, which]) for which in (self.parent, self.part))
        place = turned(parent, near + stance[:, 3:]) + centres[:, self.parent] - part @ far
        away = centres[:, self.parts] - centres[:, [self.part]]
        centres[:, self.parts] = turned(rotations_of(turn)[:, None], away) + place[:, None]
        targets = np.concatenate([each.reshape(len(times), -1) for each in (rotations, centres)], axis=1)
        corrections = self.space.pose_corrections(blended_poses(model, times), targets)
        spins, before = (
            each.reshape(len(each), 2, -1, 3)[:, 0] for each in (corrections, model.correction(times[:1]))
        )
        spins[:] = unwrap(spins, before[0])
        return corrections

    def joint(self) -> Float:
        """Return shares ``(S,)`` of key shape coordinates in the joints between limb and body.

        They are 1 near the border of the limb, 0 near other borders, and blended in joints of several borders; 0 for
        vertices that follow one part alone, or are outside the limb.
        """
        space, topology = self.space, self.space.topology
        sides = space.decomposition.part_of_face[topology.hinge_faces]
        ours = self.parts[sides[:, 0]] != self.parts[sides[:, 1]]
        others = (sides[:, 0] != sides[:, 1]) & ~ours
        own, other = self._away(ours), self._away(others)
        closer = np.where(np.isfinite(own), other, 0.0) - np.where(np.isfinite(own), own, np.inf)
        near = np.clip(0.5 + closer / STRIPS, 0.0, 1.0)
        along = near[topology.edges].mean(axis=1)
        follows = space.skinning_weights @ self.parts.astype(np.float64) > 0
        vertices = np.where(follows & (space.rigid_part_of_vertex < 0), near, 0.0)
        hinges = topology.hinge_edges[space.hinge_ids]
        return np.concatenate(
            [along[space.edge_ids], along[hinges], np.repeat(vertices, 3), np.zeros(space.pose_dim)]
        )

    def own_shape(self) -> Float:
        """Return 1 for the coordinates ``(S,)`` of key shapes that follow the part alone, 0 elsewhere."""
        own = np.repeat(self.space.rigid_part_of_vertex == self.part, 3).astype(np.float64)
        return np.pad(own, (sum(self.space.block_sizes[:2]), self.space.pose_dim))

    def _away(self, hinges: Mask) -> Float:
        """Return the distances ``(V,)`` of vertices from hinges, in edges."""
        topology = self.space.topology
        start = np.unique(topology.edges[topology.hinge_edges[hinges]])
        if not len(start):
            return np.full(topology.vertex_count, np.inf)
        graph = topology.vertex_adjacency
        return np.asarray(csgraph.dijkstra(graph, indices=start, unweighted=True, min_only=True))


def part_poses(model: Model, times: Float) -> Poses:
    """Return the poses ``(N, p)`` of all parts relative to their bodies, at times ``(N,)``."""
    return as_mixed(model.space).correct_poses(blended_poses(model, times), model.correction(times))


def limb_of(model: Model, part: int) -> Limb:
    """Return the limb of a part; SettingsError if it does not exist or has no parent."""
    space, count = as_mixed(model.space), len(model.decomposition.parts)
    if space.placement == "free":
        raise SettingsError(
            "the free placement ignores poses of parts; fit a model with placement='anchored'"
        )
    if not 0 <= part < count:
        raise SettingsError(f"there is no part {part}; the model has {count}, from 0 on")
    above = space.articulation.parents
    parent = int(above[part])
    if parent < 0:
        linked = bool((space.articulation.pairs == part).any())
        why = "is the root, which others hang on" if linked else "has no neighbours"
        raise SettingsError(f"part {part} {why}; give a part that hangs on another one")
    parts = np.zeros(count, dtype=bool)
    parts[part] = True
    for _ in range(count):
        parts |= (above >= 0) & parts[above]
    return Limb(space, part, parent, parts)


Change = Callable[[Float, Float], Float]
"""From times ``(N,)`` and stances ``(N, 6)`` to changed stances ``(N, 6)``."""

NEGLIGIBLE = 1e-3
"""Size of modes of a held part and its joints below which they are left out, as a fraction of the largest."""

STEP = 1.0
"""Largest turn added to a part between sites, in radians, so that whole turns are resolved."""

FADE = 0.2
"""Default duration over which a part comes to rest, in seconds."""


@public
def exaggerate_part(model: Model, part: int, gain: float) -> Model:
    """Return the model with the motion of a part in its joint scaled about its mean.

    The residual layer is kept.

    Parameters
    ----------
    model : Model
        A model in the mixed space, parts anchored.
    part : int
        Number of the part. Its limb moves with it as one body.
    gain : float
        1 changes nothing, 2 doubles the motion, 0 stops it, a negative number reverses it.

    Raises
    ------
    SettingsError
        If the parts of the model have no poses of their own, the part does not exist or has no parent, or the gain is
        not finite.
    """
    limb = limb_of(model, part)
    check_gain(gain)
    mean = limb.stance(model, model.times).mean(axis=0)
    sites = sites_within(model, model.start, model.end)
    correction = _moved(model, limb, sites, lambda _, stance: mean + gain * (stance - mean))
    return replace(model, correction=correction, shapes=_scaled_joint(model, limb, gain))


@public
def hold(model: Model, part: int, time: Seconds, start: Seconds, end: Seconds, fade: Seconds = FADE) -> Model:
    """Return the model with a part at rest against its parent, as it is at a time.

    The residual layer is kept.

    Parameters
    ----------
    model : Model
        A model in the mixed space, parts anchored.
    part : int
        Number of the part. Its limb moves with it as one body.
    time : float
        Time of the stance that is held, in seconds.
    start, end : float
        First and last time of rest, in seconds.
    fade : float
        Seconds before the start over which the part comes to rest, and after the end over which it moves off again.

    Raises
    ------
    SettingsError
        If the parts of the model have no poses of their own, the part does not exist or has no parent, or a time is out
        of range.
    """
    limb = limb_of(model, part)
    time, start, end = snapped(model, time), snapped(model, start, "start"), snapped(model, end, "end")
    if start > end:
        raise SettingsError(f"the start, {start:g} s, is after the end, {end:g} s")
    if not (np.isfinite(fade) and fade > 0):
        raise SettingsError(f"fade is {fade}; a positive number of seconds is expected")

    def rest(times: Float) -> Float:
        rise = (start - fade, start) if start > model.start else None
        fall = (end, end + fade) if end < model.end else None
        return window(times, rise, fall)[:, None]

    first, last = max(start - fade, model.start), min(end + fade, model.end)
    knots = np.concatenate([np.linspace(start - fade, start, 4), np.linspace(end, end + fade, 4)])
    sites = sites_within(model, first, last, knots)
    still = limb.stance(model, np.array([time]))
    correction = _moved(model, limb, sites, lambda times, stance: stance + rest(times) * (still - stance))
    wider, resting = _with_rest(model, limb)
    here = model.time([time])

    def held(times: Float) -> Float:
        points = model.time(times)
        added = rest(times) * resting(here - points)
        return np.concatenate([points, added], axis=1)

    signal = sampled(held, sites, ACCURACY, shape_measure(wider))
    return replace(
        wider,
        time=_spliced(wider, wider.time, signal),
        correction=_spliced(wider, model.correction, correction),
    )


def _moved(model: Model, limb: Limb, sites: Float, change: Change) -> Curve:
    """Return the whole correction with a changed stance of a limb, from the first to the last site."""

    def moved(times: Float) -> Float:
        return limb.corrections(model, times, change(times, limb.stance(model, times)))

    stance = limb.stance(model, sites)
    more = np.diff(change(sites, stance)[:, :3] - stance[:, :3], axis=0)
    parts = 1 + int(np.abs(more).max(initial=0.0) / STEP)
    return sampled(moved, refined(sites, parts), ACCURACY, correction_measure(model))


def _spliced(model: Model, curve: Curve, inside: Curve) -> Curve:
    """Return a signal of the model over its duration, replaced by another curve while that lasts.

    Interpolation errors at the ends are absorbed by the first and last interval of `inside`.
    """
    first, last = inside.start, inside.end
    if first == last:
        return inside
    sections, seams = [CurveSection(inside, first, last)], []
    if model.start < first:
        sections.insert(0, CurveSection(curve, model.start, first))
        seams.append(Seam(inside.times[2] - first, share=0.0))
    if last < model.end:
        sections.append(CurveSection(curve, last, model.end))
        seams.append(Seam(last - inside.times[-3], share=1.0))
    return join(sections, seams)


# Joints ---------------------------------------------------------------------------------------------------


def _scaled_joint(model: Model, limb: Limb, gain: float) -> Float:
    """Return the key shapes ``(K, S)`` with the joint coordinates of the limb scaled about their mean."""
    share = limb.joint()
    joint = np.flatnonzero(share)
    shapes = model.shapes.copy()
    mean = (model.pose.weights(model.time(model.times)) @ shapes[:, joint]).mean(axis=0)
    shapes[:, joint] += (gain - 1.0) * share[joint] * (shapes[:, joint] - mean)
    return shapes


def _with_rest(model: Model, limb: Limb) -> tuple[Model, Callable[[Float], Float]]:
    """Return the model with pose coordinates for a part and its joints alone, and the map from time-signal steps."""
    share, metric = limb.joint() + limb.own_shape(), model.space.shape_weights
    some = np.flatnonzero(share * metric)
    dim, keys = model.pose.matrix.shape
    steps = model.pose.matrix @ (model.shapes[:, some] - model.shapes[0, some]) * (share * metric)[some]
    frames = model.time(model.times)
    _, sizes, directions = np.linalg.svd((frames - frames.mean(axis=0)) @ steps, full_matrices=False)
    directions = directions[sizes > NEGLIGIBLE * sizes.max(initial=0.0)]
    rank = len(directions)
    shapes = np.repeat(model.shapes[:1], rank, axis=0)
    shapes[:, some] += directions / metric[some]
    matrix = np.zeros((dim + rank, keys + rank))
    matrix[:dim, :keys] = model.pose.matrix
    matrix[dim:, 0], matrix[dim:, keys:] = -1.0, np.eye(rank)
    wider = replace(
        model,
        time=Curve(model.time.times, np.pad(model.time.values, ((0, 0), (0, rank)))),
        pose=PoseMap(np.pad(model.pose.offset, (0, rank)), matrix),
        shapes=np.concatenate([model.shapes, shapes]),
    )
    into = steps @ directions.T
    return wider, lambda changes: np.asarray(changes @ into)
