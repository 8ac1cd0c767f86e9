r"""Keep named vertices of the target from sliding: contacts of the target rest where those of the source rest.

The scheme (constraints found in the motion, the root first, then the limbs, blends in between) is that of Kovar,
Schreiner and Gleicher 2002, "Footskate cleanup for motion capture editing".

*Stances*: when the feet of the source are on the ground. From frame to frame every point of a contact moves at a speed
v, the mean over its points. A *step* between two frames is at rest if both its speed and its height z above the lowest
are small,

.. math:: v < \max(a\, v_{95},\ a_0\, d), \qquad z - z_0 < \max(b\, (z_1 - z_0),\ b_0\, d),

where :math:`v_{95}` is the speed that 95 % of the steps stay below, :math:`z_0` and :math:`z_1` are the lowest and the
highest height, and d is the size of the body. So the thresholds follow the motion, and contacts that hardly move rest.
A run of steps is a stance if all of them are at rest by the wide thresholds and one of them by the narrow ones
(hysteresis: Canny 1986 does so along edges). It joins at least two frames.

*The body* moves as far as its feet agree. Let x be the transferred path of the middle of a contact. In every stance s
it should stay at an anchor, and misses it by :math:`d = \bar x - x`, with the mean :math:`\bar x` over the stance. The
common shift r of the whole body minimises

.. math::

    \min_{r, b} \sum_{s} \sum_{t \in s} |d_{st} + b_s - r_t|^2
    + \alpha \sum_t |r_{t+1} - 2 r_t + r_{t-1}|^2 + \beta \sum_t |r_{t+1} - r_t|^2 .

Along the ground the anchor is :math:`\bar x + b`, with free b, so that strides that do not fit the legs lengthen or
shorten the path, and the body moves evenly; upwards b is zero and :math:`\gamma \sum_t |r_t|^2` is added against
climbing and sinking. :math:`\alpha` leaves what is quicker than `PERIOD` to the limbs, and :math:`\beta` lets the shift
come to rest within about `MEMORY` where no foot is on the ground.

*Limbs* rotate by the rest, :math:`e = d + b - r` (`mixseq.retargeting.limbs`). Before and after a stance e fades by
cubic Hermite splines with its value and slope, so that feet land and lift smoothly. A foot in the air keeps its path,
although its limb may share parts with others.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import MixseqWarning, SettingsError
from mixseq.mesh.rotations import rotate_vectors
from mixseq.retargeting.limbs import ArticulatedBody, Contact, leg_ratio, move_contacts
from mixseq.retargeting.mixed_transfer import MixedTransfer
from mixseq.retargeting.parts import PartPoses, vertex_parts
from mixseq.runtime.low_memory import LargeArray
from mixseq.runtime.parallel import Executor
from mixseq.runtime.progress import Progress, no_progress
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import iterate_blocks
from mixseq.types import Float, FloatArray, Index, Mask

FASTEST = 95.0
"""Percentile of speeds that counts as the fastest, against outliers."""


@dataclass(frozen=True)
class StanceSettings:
    """Thresholds, narrow and wide."""

    speed: tuple[float, float] = (0.05, 0.1)  # of speeds, as fractions of the contact's fast speed
    # Of speeds, in sizes of the body per second; these are at rest in any motion.
    still: tuple[float, float] = (0.01, 0.02)
    height: tuple[float, float] = (0.15, 0.3)  # of heights, as fractions of the contact's range of heights
    # Of heights, in sizes of the body; these are on the ground in any motion.
    ground: tuple[float, float] = (0.005, 0.01)

    def __post_init__(self) -> None:
        for name in ("speed", "still", "height", "ground"):
            narrow, wide = getattr(self, name)
            if not 0 <= narrow <= wide < np.inf:
                raise SettingsError(
                    f"the thresholds of {name} are {narrow:g} and {wide:g}; give two finite numbers, the narrow one "
                    "first and not negative"
                )


@dataclass(frozen=True)
class Stance:
    """A contact at rest."""

    group: str  # name of the contact
    start: int  # first frame
    stop: int  # frame after the last

    @property
    def frames(self) -> slice:
        """Slice of the frames."""
        return slice(self.start, self.stop)


def stances(
    group: str,
    trajectory: FloatArray,
    up: str,
    fps: float,
    size: float,
    settings: StanceSettings | None = None,
) -> tuple[Stance, ...]:
    """Find disjoint stances of a contact with points ``(T, k, 3)``, in order.

    `up` is the upward axis, `size` the diagonal of the body in the units of the points. A single frame, or a contact
    that never moves, is one stance.
    """
    settings = settings or StanceSettings()
    path = np.asarray(trajectory, dtype=np.float64)
    if path.ndim != 3 or path.shape[2] != 3 or 0 in path.shape or not np.isfinite(path).all():
        raise SettingsError(
            f"the path of contact '{group}' has shape {path.shape}; finite points (T, k, 3) of at least one frame and "
            "one vertex are expected"
        )
    if not (0 < fps < np.inf and 0 < size < np.inf):
        raise SettingsError(f"fps is {fps:g} and size is {size:g}; positive numbers are expected")
    if len(path) == 1:
        return (Stance(group, 0, 1),)
    speeds = fps * np.linalg.norm(np.diff(path, axis=0), axis=2).mean(axis=1)
    heights = path[:, :, axis_of(up)].mean(axis=1)
    heights = heights - heights.min()
    above = np.maximum(heights[1:], heights[:-1])  # of a step: where it is farther from the ground
    fast = np.percentile(speeds, FASTEST)

    def at_rest(which: int) -> Mask:
        slow = max(settings.speed[which] * fast, settings.still[which] * size)
        low = max(settings.height[which] * heights.max(), settings.ground[which] * size)
        return np.asarray((speeds < slow) & (above < low))

    narrow, wide = at_rest(0), at_rest(1)
    edges = np.flatnonzero(np.diff(wide, prepend=False, append=False))
    runs = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    return tuple(Stance(group, first, last + 1) for first, last in runs if narrow[first:last].any())


def axis_of(up: str) -> int:
    """Return the number of an axis."""
    if up not in ("X", "Y", "Z"):
        raise SettingsError(f"the up axis is {up!r}; X, Y or Z is expected")
    return "XYZ".index(up)


Knot = tuple[int, Float, Float]
"""A frame, the value there and the slope per frame."""

PERIOD = 0.5
"""Shortest period of the body's shift, in seconds."""

MEMORY = 2.0
"""Time in which a shift without feet on the ground decays, in seconds."""

UPRIGHT = 0.05
r"""Weight :math:`\gamma` of the body's own height, where that of a foot on the ground is 1."""

FADE = 0.25
"""Longest time before and after a stance in which a foot moves to and from its place, in seconds."""


def misses(paths: Float, found: Sequence[Sequence[Stance]], negligible: float) -> Float:
    """Return the shifts ``(g, T, 3)`` of contacts to their mean in each stance; zero in the air or if negligible."""
    result = np.zeros_like(paths)
    for miss, path, some in zip(result, paths, found, strict=True):
        for stance in some:
            away = path[stance.frames].mean(axis=0) - path[stance.frames]
            if np.abs(away).max() > negligible:
                miss[stance.frames] = away
    return result


def body_shift(
    missed: Float, found: Sequence[Sequence[Stance]], axis: int, fps: float
) -> tuple[Float, Float]:
    """Return the body's shift ``(T, 3)``, and remaining moves of contacts, from misses, both ``(g, T, 3)``."""
    from scipy import sparse
    from scipy.sparse.linalg import splu

    count = missed.shape[1]
    stances = [(group, stance) for group, some in enumerate(found) for stance in some]
    lengths = [stance.stop - stance.start for _, stance in stances]
    frames = np.concatenate([np.arange(stance.start, stance.stop) for _, stance in stances])
    groups = np.repeat([group for group, _ in stances], lengths)
    numbers = np.repeat(np.arange(len(stances)), lengths)
    wanted = missed[groups, frames]

    def picked(columns: Index, size: int) -> sparse.csr_array:
        rows = np.arange(len(columns))
        return sparse.csr_array((np.ones(len(columns)), (rows, columns)), shape=(len(columns), size))

    step = (sparse.eye_array(count - 1, count, k=1) - sparse.eye_array(count - 1, count)).tocsr()
    curvature = step[:-1, :-1] @ step
    alpha = (fps * PERIOD / (2 * np.pi)) ** 4
    beta = alpha / (fps * MEMORY) ** 2
    calm = alpha * curvature.T @ curvature + beta * step.T @ step
    body = picked(frames, count)
    both = sparse.hstack([body, -picked(numbers, len(stances))])
    # Along the ground body and anchors may shift together: so far the first frame stays, and in the end the mean.
    first = sparse.coo_array(([1.0], ([0], [0])), shape=(count, count))
    calmer = sparse.block_diag([calm + first, sparse.coo_array((len(stances), len(stances)))])

    ground = np.arange(3) != axis
    shift, anchors = np.zeros((count, 3)), np.zeros((len(stances), 3))
    along = splu((both.T @ both + calmer).tocsc()).solve(both.T @ wanted[:, ground])
    along -= along[:count].mean(axis=0)
    shift[:, ground], anchors[:, ground] = along[:count], along[count:]
    upright = body.T @ body + calm + UPRIGHT * sparse.eye_array(count)
    shift[:, axis] = splu(upright.tocsc()).solve(body.T @ wanted[:, axis])
    left = np.zeros_like(missed)
    left[groups, frames] = wanted + anchors[numbers] - shift[frames]
    return shift, left


def faded(wanted: Float, some: Sequence[Stance], fps: float) -> Float:
    """Return moves ``(T, 3)`` of a contact, as given in its stances and smooth in between.

    They fade from zero before a stance and to zero after it, or to the next stance if that is near.
    """
    result = np.zeros_like(wanted)
    fade = max(2, round(FADE * fps))
    still = np.zeros(3)

    def lead(start: Knot, stop: Knot) -> None:
        frames = np.arange(max(start[0], 0), min(stop[0] + 1, len(result)))
        result[frames] = _hermite(frames, start, stop)

    last: Knot | None = None
    for stance in some:
        first = _knot(wanted, stance.start, min(stance.start + 1, stance.stop - 1))
        if last is not None and first[0] - last[0] <= 2 * fade:
            lead(last, first)
        else:
            if last is not None:
                lead(last, (last[0] + fade, still, still))
            lead((first[0] - fade, still, still), first)
        result[stance.frames] = wanted[stance.frames]
        last = _knot(wanted, stance.stop - 1, max(stance.stop - 2, stance.start))
    if last is not None:
        lead(last, (last[0] + fade, still, still))
    return result


def _knot(values: Float, frame: int, beside: int) -> Knot:
    slope = (values[beside] - values[frame]) / (beside - frame or 1)
    return frame, values[frame], slope


def _hermite(frames: Index, start: Knot, stop: Knot) -> Float:
    """Return a cubic ``(n, 3)`` between two knots."""
    (first, a, slope_a), (last, b, slope_b) = start, stop
    span = last - first
    s = ((frames - first) / span)[:, None]
    bows = span * (s * (1 - s) ** 2 * slope_a - s * s * (1 - s) * slope_b)
    return np.asarray(a + s * s * (3 - 2 * s) * (b - a) + bows)


NEGLIGIBLE = 1e-9
"""Sliding distance below which feet are left unchanged, in diagonals."""


@dataclass(frozen=True)
class GroupReport:
    """Sliding of one contact, before and after, in diagonals of the target."""

    name: str  # the contact
    stances: tuple[Stance, ...]  # its stances
    before: float  # path length of its middle in all stances, as transferred
    after: float  # path length of its middle in all stances, as corrected
    residual: float  # largest stretch of its limb, where rotation did not suffice


@dataclass(frozen=True)
class ContactReport:
    """Sliding of all contacts, and the motions that removed it."""

    groups: tuple[GroupReport, ...] = ()  # one for each contact
    shift: float = 0.0  # largest shift of the whole body, in diagonals of the target
    turn: float = 0.0  # largest rotation of a part of a limb, in degrees


@dataclass(frozen=True, eq=False)
class PlantedMotion:
    """Motions of parts without sliding feet."""

    rotations: Float  # (T, p, 3, 3) of the parts
    centres: Float  # (T, p, 3) where their rest centres go
    report: ContactReport  # report of the changes


def remove_footskate(
    body: ArticulatedBody,
    rotations: Float,
    centres: Float,
    contacts: Sequence[Contact],
    trajectories: Sequence[FloatArray],
    up: str,
    fps: float,
    diagonal: float,
    settings: StanceSettings | None = None,
) -> PlantedMotion:
    """Move parts so that contacts do not slide while those of the source rest; motions without sliding are unchanged.

    Rotations and centres are ``(T, p, 3, 3), (T, p, 3)``; trajectories ``(T, k, 3)`` are those of the source's contact
    points, in the target's units, as is the diagonal.
    """
    lengths = [len(path) for path in trajectories]
    if lengths != len(contacts) * [len(centres)]:
        raise SettingsError(
            f"there are {len(contacts)} contacts and motions of {len(centres)} frames, but {len(lengths)} paths of "
            f"{', '.join(map(str, lengths)) or 'no'} frames; give one path for each contact, over all frames"
        )
    for contact in contacts:
        body.limb(contact)
    axis = axis_of(up)
    found = tuple(
        stances(contact.name, path, up, fps, diagonal, settings)
        for contact, path in zip(contacts, trajectories, strict=True)
    )
    for contact, some in zip(contacts, found, strict=True):
        if not some:
            warnings.warn(
                f"contact '{contact.name}' never rests on the ground in the source, so nothing holds it; if the source "
                "walks on the spot, move it over the ground first",
                MixseqWarning,
                stacklevel=2,
            )
    before = _paths(body, contacts, rotations, centres)
    missed = misses(before, found, NEGLIGIBLE * diagonal)
    if not missed.any():
        groups = _groups(contacts, found, before, before, np.zeros(len(contacts)), diagonal)
        return PlantedMotion(rotations, centres, ContactReport(groups))
    shift, left = body_shift(missed, found, axis, fps)
    moves = np.stack([faded(*pair, fps) for pair in zip(left, found, strict=True)], axis=1)
    result = move_contacts(body, rotations, centres + shift[:, None], contacts, moves)
    after = _paths(body, contacts, result.rotations, result.centres)
    residuals = np.linalg.norm(result.left, axis=2).max(axis=0)
    groups = _groups(contacts, found, before, after, residuals, diagonal)
    lowest = np.trace(result.turns, axis1=2, axis2=3).min(initial=3.0)
    turn = float(np.degrees(np.arccos(np.clip((lowest - 1.0) / 2.0, -1.0, 1.0))))
    report = ContactReport(groups, float(np.linalg.norm(shift, axis=1).max()) / diagonal, turn)
    return PlantedMotion(result.rotations, result.centres, report)


def _paths(body: ArticulatedBody, contacts: Sequence[Contact], rotations: Float, centres: Float) -> Float:
    """Return the middles ``(g, T, 3)`` of contacts."""
    paths = [body.path(each, rotations, centres).mean(axis=1) for each in contacts]
    return np.array(paths).reshape(len(contacts), len(centres), 3)


def _groups(
    contacts: Sequence[Contact],
    found: Sequence[tuple[Stance, ...]],
    before: Float,
    after: Float,
    residuals: Float,
    diagonal: float,
) -> tuple[GroupReport, ...]:
    def slide(path: Float, some: Sequence[Stance]) -> float:
        steps = [np.linalg.norm(np.diff(path[stance.frames], axis=0), axis=1).sum() for stance in some]
        return float(sum(steps)) / diagonal

    rows = zip(contacts, found, before, after, residuals.tolist(), strict=True)
    return tuple(
        GroupReport(contact.name, some, slide(old, some), slide(new, some), residual / diagonal)
        for contact, some, old, new, residual in rows
    )


@dataclass(frozen=True, eq=False)
class PlantedTransfer:
    """A transfer without sliding contacts."""

    method: MixedTransfer  # the transfer, with the stride of the target's legs
    poses: PartPoses  # of the target's parts in all frames, rotations (T, p', 3, 3) and centres (T, p', 3)
    report: ContactReport  # report of the changes


def plant_contacts(
    method: MixedTransfer,
    points: LargeArray,
    header: SequenceHeader,
    contacts: Mapping[str, ArrayLike],
    workers: Executor,
    progress: Progress = no_progress,
) -> PlantedTransfer:
    """Find poses in which contacts ``(k,)`` rest as those of the source ``(T, V, 3)``; travel scales with the legs."""
    target, source, correspondence = (
        method.gradients.target,
        method.gradients.source,
        method.gradients.correspondence,
    )
    vertices = {name: _vertices(name, given, header.vertex_count) for name, given in contacts.items()}
    part = vertex_parts(method.parts.target, target.topology)
    on_source = correspondence.interpolate(source.reference)
    own = [Contact(name, target.reference[chosen], part[chosen]) for name, chosen in vertices.items()]
    theirs = [Contact(name, on_source[chosen], part[chosen]) for name, chosen in vertices.items()]
    ratio = method.gradients.alignment.scale * source.scale / target.scale
    striding = replace(method, stride=leg_ratio(method.source_body, method.body, theirs, own) / ratio)

    chosen = np.concatenate(list(vertices.values()))
    rotations, centres, paths, soles, done = [], [], [], [], 0
    for poses, path, sole in workers(_measure, (striding, chosen, part[chosen]), iterate_blocks(points)):
        rotations.append(poses.rotations)
        centres.append(poses.centres)
        paths.append(path)
        soles.append(sole)
        done += len(path)
        progress(done, len(points), "placing feet")
    ends = np.cumsum([len(each) for each in vertices.values()])[:-1]
    ways = np.split(np.concatenate(paths) * ratio / source.scale, ends, axis=1)
    local = np.split(np.concatenate(soles), ends, axis=1)
    found = remove_footskate(
        method.body,
        np.concatenate(rotations),
        np.concatenate(centres),
        [replace(contact, local=each) for contact, each in zip(own, local, strict=True)],
        [method.gradients.alignment.turned_points(way) for way in ways],
        header.up_axis,
        header.fps,
        1.0,
    )
    return PlantedTransfer(striding, PartPoses(found.rotations, found.centres), found.report)


def _measure(shared: tuple[MixedTransfer, Index, Index], block: FloatArray) -> tuple[PartPoses, Float, Float]:
    """Return part poses in frames ``(B, V, 3)``, contact vertices on the source, and on the target's rest parts."""
    method, vertices, parts = shared
    poses, soles = [], []
    for x in block:
        smooth = method.by_gradients(x)
        _, moved = method.shapes.register(smooth)
        poses.append(method.poses(x, moved))
        # A paw may bend although it is one with its leg.
        back = np.swapaxes(moved.rotations[parts], 1, 2)
        soles.append(
            rotate_vectors(back, smooth[vertices] - moved.centres[parts]) + method.shapes.centres[parts]
        )
    path = np.stack([method.gradients.correspondence.interpolate(x)[vertices] for x in block])
    return PartPoses(*(np.stack(values) for values in zip(*poses, strict=True))), path, np.stack(soles)


def _vertices(name: str, given: ArrayLike, count: int) -> Index:
    vertices = np.asarray(given)
    if vertices.ndim != 1 or not vertices.size or not np.issubdtype(vertices.dtype, np.integer):
        raise SettingsError(f"contact '{name}' is no list of vertices; give at least one number")
    outside = vertices[(vertices < 0) | (vertices >= count)]
    if outside.size:
        raise SettingsError(
            f"contact '{name}' names vertex {outside[0]}, but those of the target are 0 to {count - 1}"
        )
    return vertices.astype(np.int64)
