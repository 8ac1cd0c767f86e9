r"""Find events of a motion in its frames: cuts, pops, holds, repeated poses and keys of linearly baked motion.

All thresholds are ratios. Steps are root mean squares over the vertices of a component between consecutive frames, and
*bends* the distances of a frame from the chord of its neighbours. A step or bend is *null* if no coordinate exceeds
rounding errors, or if it is noise, which is not alike at both ends a and b of mesh edges:

.. math:: \frac{\sum a \cdot b}{\sum (a \cdot a + b \cdot b) / 2} < \frac{1}{2} .

- A component *pops* where its size passes from below `COLLAPSED_RATIO` to over half of its median.
- Poses *repeat* if equal frames recur: at a constant rate (on twos, 24 frames in 30), if the first frames of poses are
  :math:`\lceil \rho j + \varphi \rceil` for a rate :math:`\rho`, or with any durations. Other equal frames are *held*.
- The motion is *cut* where a step of distinct frames is `CUT_RATIO` times the steps nearby, and differs
  by `CUT_RATIO` times more from the speed of its neighbours than these do.
- It is linear between *keys* if the bends of most moving frames are null, or large at one phase of a period only.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.choices import BetweenName
from mixseq.errors import SettingsError
from mixseq.runtime.low_memory import LargeArray, new_large_array
from mixseq.sequence.header import FileKeys, SequenceHeader
from mixseq.sequence.sequence import FrameStore, iterate_blocks
from mixseq.types import Float, Index, IntArray, Mask, evenly_spaced

if TYPE_CHECKING:
    from mixseq.mesh.topology import Topology

SAMPLED_EDGES = 768  # number of edges whose vertices are compared, shared by the components
MIN_COMPONENT_EDGES, MAX_COMPONENTS = 48, 64  # compared edges of a component, and components examined alone
MAX_GROUPS = 8  # groups of components with cuts and pops of their own, each with as many modes as frames
CUT_RATIO = 5.0  # least ratio of a cut to the two steps on either side; with 4, real motions have cuts
COMPONENT_CUT_RATIO = 8.0  # the same for one of several components
FLANK_RATIO = 3.0  # largest ratio of the steps beside a cut to the steps beyond them; in a burst of motion it is larger
MIN_CUT_DIAGONALS, MIN_STILL_CUT_DIAGONALS = 1e-3, 0.1  # least cut of moving and of still components
ROUNDING_UNITS, MOVING_UNITS = 2.0, 8.0  # units in the last place: largest equal, and least moving difference
NOISE_SIMILARITY, MIN_NOISE_VERTICES = 0.5, 30  # similarity of neighbours below which a step is noise
COLLAPSED_RATIO = 0.1  # ratio of a component's size to its median below which it has collapsed
MIN_EVIDENCE = 3  # least number of standstills, kinks or periods that make a pattern
MAX_POSE_RATIO = 4  # largest ratio of the duration of a repeated pose to the median duration
PHASE_RATIO = 3.0  # least ratio of the median bend at the phase of the keys to the medians at other phases
ROWS_PER_BLOCK = 32  # number of frames, steps or bends that are measured at a time
MAX_KEY_PERIOD, MAX_PULLDOWN_PERIOD = 8, 12  # largest period, in frames, of baked keys and of single duplicates


CutChoice = Literal["auto", "none"] | Sequence[int]
"""Cuts of a sequence: found in its frames, none, or the first frames after them, counted from 0."""


@dataclass(frozen=True)
class Events:
    """Events of a motion; frames are counted from 0."""

    cuts: tuple[int, ...] = ()  # intervals k between frames k and k + 1 where the motion is cut
    pops: tuple[int, ...] = ()  # intervals in which the component appears or disappears
    holds: tuple[tuple[int, int], ...] = ()  # first and last frame of equal frames
    poses: tuple[int, ...] = ()  # first frames of repeated poses; empty if poses do not repeat
    frames_per_pose: float = 0.0  # zero if repeated poses have different durations
    keys: tuple[int, ...] = ()  # frames that are keys of a linearly baked motion


@dataclass(frozen=True)
class SequenceEvents:
    """Events of a sequence, and of the components of its mesh that have others."""

    whole: Events = Events()
    components: tuple[tuple[int, Events], ...] = ()  # by component of `Topology.component_of_vertex`

    def group_components(self, component_of_vertex: IntArray) -> tuple[list[Events], Index]:
        """Group components ``(V,)`` by their cuts and pops; return the events of the groups, and the group ``(V,)``.

        Components without cuts or pops of their own are the first group. Above `MAX_GROUPS`, the smallest are together.
        """
        own: dict[Events, list[int]] = {}
        for component, events in self.components:
            if events.pops or events.cuts != self.whole.cuts:
                own.setdefault(events, []).append(component)
        sizes = np.bincount(component_of_vertex)
        groups = sorted(own.items(), key=lambda item: -int(sizes[item[1]].sum()))
        if len(groups) >= MAX_GROUPS:
            groups, rest = groups[: MAX_GROUPS - 2], groups[MAX_GROUPS - 2 :]
            cuts, pops = (sorted({k for each, _ in rest for k in getattr(each, name)}) for name in ("cuts", "pops"))
            united = replace(self.whole, cuts=tuple(cuts), pops=tuple(pops))
            groups.append((united, [component for _, ids in rest for component in ids]))
        group_of_component = np.zeros(len(sizes), dtype=np.int64)
        for number, (_, ids) in enumerate(groups, 1):
            group_of_component[ids] = number
        numbers, group_of_vertex = np.unique(group_of_component[component_of_vertex], return_inverse=True)
        all_events = [self.whole, *(events for events, _ in groups)]
        return [all_events[number] for number in numbers], group_of_vertex

    def with_keys(self, keys: FileKeys) -> SequenceEvents:
        """Return the events with the keys of a file, instead of repeated poses and keys found in the frames."""
        if keys.is_held:
            return SequenceEvents(Events(poses=keys.frames))
        changes: dict[str, Any] = {"keys": keys.frames, "poses": (), "frames_per_pose": 0.0}
        components = tuple((component, replace(events, **changes)) for component, events in self.components)
        return SequenceEvents(replace(self.whole, **changes), components)

    def with_cuts(self, cuts: CutChoice, header: SequenceHeader) -> SequenceEvents:
        """Return the events with chosen cuts instead of those found."""
        if cuts == "auto":
            return self
        frames = [] if cuts == "none" else np.unique(np.asarray(cuts)).tolist()
        for frame in frames:
            if not (isinstance(frame, int) and 0 < frame < header.frame_count):
                raise SettingsError(
                    f"cuts has the frame {frame!r}; first frames after cuts are expected, whole numbers from 1 to "
                    f"{header.frame_count - 1}"
                )
        return SequenceEvents(replace(self.whole, cuts=tuple(frame - 1 for frame in frames), pops=()))

    def describe(self, header: SequenceHeader, between: BetweenName) -> str:
        """Return the events in words, by frame number, and how to change the motion; empty without events."""
        whole = self.whole

        def pairs_of(intervals: Sequence[int]) -> str:
            pairs = [f"{header.frame_number(k)} and {header.frame_number(k + 1)}" for k in intervals]
            return "; ".join(pairs[:4]) + (f"; {len(pairs) - 4} more" if len(pairs) > 4 else "")

        texts = [f"cut between {pairs_of(whole.cuts)}"] if whole.cuts else []
        alone = [(each, set(each.cuts) - set(whole.cuts)) for _, each in self.components]
        for name, intervals in (
            ("cuts of components", {k for _, cuts in alone for k in cuts}),
            ("components appear or disappear", {k for each, _ in alone for k in each.pops} | set(whole.pops)),
        ):
            if intervals:
                texts.append(f"{name} between {pairs_of(sorted(intervals))}")
        if whole.holds:
            ranges = [f"{header.frame_number(a)}-{header.frame_number(b)}" for a, b in whole.holds]
            texts.append("held " + ", ".join(ranges[:4]) + (f", {len(ranges) - 4} more" if len(ranges) > 4 else ""))
        if whole.frames_per_pose:
            rate = whole.frames_per_pose
            names = {2.0: "on twos", 3.0: "on threes"}
            texts.append(names.get(round(rate, 2), f"a new pose every {rate:.3g} frames"))
        elif whole.poses:
            texts.append(f"{len(whole.poses)} poses, held for different times")
        if whole.keys:
            texts.append(f"straight between {len(whole.keys)} keys")
        cure = "makes ones" if whole.poses else "rounds them" if whole.keys else ""
        cure = f": --between smooth {cure}" if cure and between == "auto" else ""
        return "; ".join(texts) + cure


def describe_cuts(frames: Sequence[int], header: SequenceHeader) -> str:
    """Return cuts before frames in words, as `SequenceEvents.describe`."""
    return SequenceEvents(Events(cuts=tuple(frame - 1 for frame in frames))).describe(header, "smooth")


def distinct_poses(frames: FrameStore, groups: Sequence[Events]) -> tuple[FrameStore, list[Events]]:
    """Return the repeated poses at their own times, or the keys of a baked motion, without the frames between them.

    The events are those of groups of components, which have the same poses and keys.
    """
    events = groups[0]
    times, holds, count = frames.header.times, events.holds, len(frames.header.times)
    added_holds: list[tuple[int, int]] = []
    if events.keys:
        ids, new_times = np.array(events.keys), times[list(events.keys)]
    elif events.poses:
        poses = np.array(events.poses)
        tail = np.arange(holds[-1][0] if holds and holds[-1][0] > poses[-1] else count - 1, count)
        ids = np.concatenate([np.arange(poses[0]), poses, tail])
        new_times = times[ids].copy()
        if events.frames_per_pose:  # pose j first appears in the frame at or after its time
            moments = events.frames_per_pose * np.arange(len(poses))
            step = (times[-1] - times[0]) / (count - 1)
            new_times[poses[0] : poses[0] + len(poses)] = times[0] + step * (moments + (poses - moments).min())
        if poses[-1] == count - 1:
            ids, new_times = ids[:-1], np.append(new_times[:-2], times[-1])
        elif not holds or holds[-1][0] <= poses[-1]:
            added_holds.append((int(poses[-1]), count - 1))
    else:
        return frames, list(groups)

    def new_id(frame: int) -> int:
        return int(np.searchsorted(ids, frame, side="right")) - 1

    points = new_large_array((len(ids), *frames.points.shape[1:]), frames.points.dtype)
    for row, frame in enumerate(ids):
        points[row : row + 1] = frames.points[frame : frame + 1]
    new_events = []
    for each in groups:
        cuts, pops = (tuple(map(new_id, intervals)) for intervals in (each.cuts, each.pops))
        kept = [(a, b) for a, b in each.holds if not events.keys or (a in events.keys and b in events.keys)]
        new_holds = tuple((new_id(a), new_id(b)) for a, b in (*kept, *added_holds) if new_id(a) < new_id(b))
        new_events.append(Events(cuts, pops, new_holds))
    return FrameStore(frames.header.with_times(new_times), points), new_events


class _Motion(NamedTuple):
    """Sampled motion of a component over T frames, and its steps."""

    times: Float  # (T,)
    points: Float  # (T, n, 3)
    edges: Index  # (e, 2)
    unit: float  # unit in the last place of the coordinates
    is_equal: Mask  # (T - 1,) whether frame k + 1 equals frame k
    steps: Float  # (T - 1,)

    @property
    def noise(self) -> float:
        """Median step between equal frames."""
        return float(np.median(self.steps[self.is_equal])) if self.is_equal.any() else 0.0

    @property
    def floor(self) -> float:
        """Least step of a moving component."""
        return max(MOVING_UNITS * self.unit, 2 * self.noise)


def find_events(points: LargeArray, times: Float, topology: Topology) -> SequenceEvents:
    """Find the events of points ``(T, V, 3)`` at times ``(T,)``."""
    if len(times) < 3:
        return SequenceEvents()
    labels = topology.component_of_vertex[topology.edges[:, 0]] if len(topology.edges) else np.zeros(0, dtype=np.int32)
    edge_ids = [np.flatnonzero(labels == label) for label in np.unique(labels)[:MAX_COMPONENTS]]
    edge_ids = [np.arange(len(labels))] if len(np.unique(labels)) > MAX_COMPONENTS else edge_ids
    count = max(SAMPLED_EDGES // max(len(edge_ids), 1), MIN_COMPONENT_EDGES)
    chosen = [topology.edges[ids[evenly_spaced(len(ids), count)]] for ids in edge_ids]
    if not chosen:
        chosen = [np.repeat(evenly_spaced(topology.vertex_count, SAMPLED_EDGES)[:, None], 2, axis=1)]
    vertex_ids, rows = np.unique(np.concatenate(chosen), return_inverse=True)
    edges = np.split(rows.reshape(-1, 2), np.cumsum([len(each) for each in chosen])[:-1])
    samples, first = np.empty((len(times), len(vertex_ids), 3)), 0
    for block in iterate_blocks(points):
        samples[first : first + len(block)] = block[:, vertex_ids]
        first += len(block)
    diagonal = float(np.median(np.linalg.norm(np.ptp(samples, axis=1), axis=1)))
    motion = _measure(times, samples, np.concatenate(edges))
    whole = _find(motion, diagonal, CUT_RATIO)
    if len(edges) == 1:
        return SequenceEvents(whole)
    lengths = _each_step(samples, lambda fields: np.linalg.norm(fields, axis=2))
    most = [k for k in whole.cuts if np.mean(lengths[k] > CUT_RATIO / 2 * _largest_beside(lengths, k)) > 0.5]
    whole = replace(whole, cuts=tuple(most), pops=())
    components = []
    for each in edges:
        ids, local = np.unique(each, return_inverse=True)
        own = _measure(times, samples[:, ids], local.reshape(-1, 2), motion)
        found = _find(own, diagonal, COMPONENT_CUT_RATIO)
        pops = set(found.pops)
        cuts = sorted({*found.cuts, *whole.cuts} - pops)
        holds = tuple(sorted({*found.holds, *whole.holds}))
        found = replace(whole, cuts=tuple(cuts), pops=found.pops, holds=whole.holds if whole.poses else holds)
        if found != whole:
            components.append((int(topology.component_of_vertex[vertex_ids[ids[0]]]), found))
    return SequenceEvents(whole, tuple(components))


def _measure(times: Float, points: Float, edges: Index, whole: _Motion | None = None) -> _Motion:
    """Measure steps of points ``(T, n, 3)``; few vertices are equal where the whole is, up to its noise."""
    unit, steps = _rounding_unit(points), _each_step(points, _rms)
    is_null = _each_step(points, lambda fields: _is_null(fields, unit, edges))
    is_equal, first = np.zeros(len(steps), dtype=bool), 0
    for k in np.flatnonzero(is_null):  # also equal to the first of its run, so that slow motion is no hold
        first = first if k and is_equal[k - 1] else int(k)
        is_equal[k] = first == k or _is_null(points[k + 1 : k + 2] - points[first], unit, edges)[0]
    if whole is not None and whole.is_equal.any():
        is_equal |= whole.is_equal & (steps <= 1.5 * whole.noise)
    return _Motion(times, points, edges, unit, is_equal, steps)


def _each_step(points: Float, measure: Callable[[Float], NDArray[Any]]) -> NDArray[Any]:
    """Measure the steps of points ``(T, n, 3)``."""
    return _in_blocks(len(points) - 1, lambda first, end: measure(np.diff(points[first : end + 1], axis=0)))


def _in_blocks(count: int, measure: Callable[[int, int], NDArray[Any]]) -> NDArray[Any]:
    """Measure rows from first to end, of `count`, in blocks: all at once would take several times their memory."""
    firsts = range(0, count, ROWS_PER_BLOCK)
    return np.concatenate([measure(first, min(first + ROWS_PER_BLOCK, count)) for first in firsts])


def _rounding_unit(points: Float) -> float:
    """Return the unit in the last place of the largest coordinate, in the shortest type that holds all exactly."""
    largest = np.abs(points).max(initial=0.0) or 1.0
    if largest < np.finfo(np.float16).max and np.array_equal(points.astype(np.float16), points):
        return float(np.spacing(np.float16(largest)))
    return float(np.spacing(np.float32(largest)))


def _rms(fields: Float) -> Float:
    """Return root mean square lengths ``(N,)`` of vectors ``(N, n, 3)``."""
    return np.asarray(np.sqrt(np.einsum("nvi,nvi->n", fields, fields) / max(fields.shape[1], 1)))


def _extents(points: Float) -> Float:
    """Return root mean square distances ``(N,)`` of points ``(N, n, 3)`` from their centres."""
    return _rms(points - points.mean(axis=1, keepdims=True))


def _is_null(fields: Float, unit: float, edges: Index) -> Mask:
    """Whether fields ``(N, n, 3)`` are rounding errors or noise, ``(N,)``."""
    is_null = np.abs(fields).max(axis=(1, 2), initial=0.0) <= ROUNDING_UNITS * unit
    if fields.shape[1] < MIN_NOISE_VERTICES or not len(edges):
        return np.asarray(is_null)
    a, b = fields[:, edges[:, 0]], fields[:, edges[:, 1]]
    squares = (np.einsum("nei,nei->n", a, a) + np.einsum("nei,nei->n", b, b)) / 2
    return np.asarray(is_null | (np.einsum("nei,nei->n", a, b) < NOISE_SIMILARITY * squares))


def _find(motion: _Motion, diagonal: float, cut_ratio: float) -> Events:
    """Find the events of a component, or of all."""
    is_equal, steps = motion.is_equal, motion.steps
    if is_equal.all():
        return Events()
    extents = _in_blocks(len(motion.points), lambda first, end: _extents(motion.points[first:end]))
    size = float(np.median(extents[extents > COLLAPSED_RATIO * extents.max()])) if extents.any() else 0.0
    is_gone = extents < COLLAPSED_RATIO * size
    larger = np.maximum(extents[:-1], extents[1:])
    pops = tuple(np.flatnonzero((is_gone[:-1] != is_gone[1:]) & (larger > size / 2)).tolist())

    firsts = np.append(0, np.flatnonzero(~is_equal) + 1)
    lasts = np.append(firsts[1:] - 1, len(steps))
    events, pattern = _find_repeats(motion, firsts, lasts)
    largest = _each_step(motion.points, lambda fields: np.abs(fields).max(axis=(1, 2)))
    is_exact = largest <= ROUNDING_UNITS * motion.unit
    holds = tuple(
        (int(a), int(b))
        for run, (a, b) in enumerate(zip(firsts, lasts, strict=True))
        if a < b
        and run not in pattern
        and (_stands_still(motion, a, b) or (b - a >= MIN_EVIDENCE - 1 and is_exact[a:b].all()))
    )
    cuts = set()
    if len(firsts) > 3:
        at = (motion.times[firsts] + motion.times[lasts]) / 2 if events.poses else motion.times[firsts]
        poses = motion.points if not is_equal.any() else motion.points[firsts]  # a copy is as large as the sequence
        floor = max(ROUNDING_UNITS * motion.unit, 2 * motion.noise)
        cuts = {int(lasts[k]) for k in _find_cuts(at, poses, diagonal, cut_ratio, floor)}
    if not events.poses:  # a still component that is moved once
        far = np.flatnonzero(~is_equal & (steps > max(4 * size, MIN_STILL_CUT_DIAGONALS * diagonal)))
        still = (k for k in far if k >= 2 and k + 3 <= len(steps) and is_equal[[k - 2, k - 1, k + 1, k + 2]].all())
        cuts |= set(map(int, still))
    events = replace(events, cuts=tuple(sorted(cuts - set(pops))), pops=pops, holds=holds)
    return events if events.poses else replace(events, keys=_find_keys(motion, events))


def _stands_still(motion: _Motion, first: int, last: int) -> bool:
    """Whether equal frames stand still where the motion beside them is fast; turning points do not."""
    times, points = motion.times, motion.points
    is_inner = first > 0 and last < len(times) - 1
    beside = [motion.steps[k] for k in (first - 1, last) if 0 <= k < len(motion.steps)]
    if min(beside) <= motion.floor:
        return False
    if last - first > 1 or not is_inner:
        return True
    before = (points[first] - points[first - 1]) / (times[first] - times[first - 1])
    after = (points[last + 1] - points[last]) / (times[last + 1] - times[last])
    predicted = _rms(((before + after) / 2 * (times[last] - times[first]))[None])[0]
    return bool(predicted > 0.5 * min(beside))


def _find_repeats(motion: _Motion, firsts: Index, lasts: Index) -> tuple[Events, range]:
    """Find repeated poses from runs ``(n,)`` of equal frames; return the events, and the runs that belong to them."""
    lengths, none = lasts - firsts + 1, range(0)
    start, stop, inner = 0, len(firsts), lengths[1:-1].max(initial=0)
    if len(firsts) > 2 and lengths[0] > inner:  # a long first or last run is a hold
        start += 1
    if stop - start > 2 and lengths[-1] > inner:
        stop -= 1
    runs = range(start, stop)
    held = [run for run in runs if lengths[run] > 1]
    sure = [run for run in held if _stands_still(motion, firsts[run], lasts[run])]
    if len(sure) < MIN_EVIDENCE or lengths[start:stop].max() > MAX_POSE_RATIO * np.median(lengths[sure]):
        return Events(), none
    if len(runs) < 2 * MIN_EVIDENCE or np.median(motion.steps[~motion.is_equal]) <= motion.floor:
        return Events(), none
    rate = _pose_rate(firsts[start:stop])
    if rate > 1.05 and len(sure) >= 0.8 * len(held):
        return Events(poses=tuple(firsts[start:stop].tolist()), frames_per_pose=rate), runs
    is_mixed = len(sure) >= len(runs) / 4
    # Single duplicates of one period, of which some are not recognised because the motion is slow there.
    seconds, frames = firsts[sure] + 1, np.arange(len(motion.times))
    for period in range(MIN_EVIDENCE, MAX_PULLDOWN_PERIOD + 1) if (lengths[sure] == 2).all() else ():
        phase = seconds[0] % period
        if (seconds % period == phase).all() and len(sure) >= max(0.6 * (len(frames) // period), MIN_EVIDENCE + 1):
            poses = tuple(frames[frames % period != phase].tolist())
            return Events(poses=poses, frames_per_pose=period / (period - 1)), range(len(firsts))
    return (Events(poses=tuple(firsts[start:stop].tolist())), runs) if is_mixed else (Events(), none)


def _pose_rate(starts: Index) -> float:
    r"""Return the rate :math:`\rho` with starts :math:`\lceil \rho j + \varphi \rceil`; zero if there is none."""
    low, high = -np.inf, np.inf  # every pair of starts i, j bounds it: |starts_i - starts_j - rho (i - j)| < 1
    for gap in range(1, len(starts)):
        spans = starts[gap:] - starts[:-gap]
        low, high = max(low, (spans.max() - 1) / gap), min(high, (spans.min() + 1) / gap)
    mean = (starts[-1] - starts[0]) / (len(starts) - 1)
    return float(np.clip(mean, low + 1e-9, high - 1e-9)) if low < high - 1e-12 else 0.0


def _largest_beside(values: Float, k: int) -> Float:
    """Return the largest of the two values ``(N, ...)`` before and the two after k."""
    ids = [k + offset for offset in (-2, -1, 1, 2) if 0 <= k + offset < len(values)]
    return np.asarray(values[ids].max(axis=0, initial=0.0))


def _find_cuts(times: Float, poses: Float, diagonal: float, ratio: float, floor: float) -> list[int]:
    """Return the intervals of distinct poses ``(n, v, 3)`` at times ``(n,)`` that are cuts."""
    durations = np.diff(times)
    usual = float(np.median(durations))
    durations = np.maximum(durations, 1e-9 * usual)
    steps = _each_step(poses, _rms)
    speeds = steps / durations
    share = (durations[2:] / (durations[:-2] + durations[2:]))[:, None, None]

    def measure_errors(first: int, end: int) -> Float:
        velocities = np.diff(poses[first : end + 3], axis=0) / durations[first : end + 2, None, None]
        predicted = share[first:end] * velocities[:-2] + (1 - share[first:end]) * velocities[2:]
        return _rms((velocities[1:-1] - predicted) * durations[first + 1 : end + 1, None, None])

    errors = np.full(len(steps), np.nan)  # distance of a step from the one that the speeds beside it predict
    errors[1:-1] = _in_blocks(len(steps) - 2, measure_errors)
    cuts = []
    for k in range(1, len(steps) - 1):  # a single frame at an end is no evidence
        fastest = float(_largest_beside(speeds, k))
        duration = durations[k] if durations[k] >= usual / 20 else usual  # two keys at nearly the same time
        beside = max(fastest * max(duration, durations[k]), floor)
        if steps[k] < max(ratio * beside, MIN_CUT_DIAGONALS * diagonal):
            continue
        is_burst = any(
            0 <= k + 2 * side < len(steps)
            and speeds[k + side] > FLANK_RATIO * max(speeds[k + 2 * side], floor / 4 / durations[k])
            for side in (-1, 1)
        )
        if is_burst and steps[k] < 2 * COMPONENT_CUT_RATIO * beside:
            continue
        others = [
            errors[j]
            for j in (k - 4, k - 3, k - 2, k + 2, k + 3, k + 4)
            if 0 < j < len(errors) - 1 and steps[j - 1 : j + 2].max() < steps[k] / 2
        ]
        if others and errors[k] >= ratio * max(*others, floor):
            cuts.append(k)
    return cuts


def _find_keys(motion: _Motion, events: Events) -> tuple[int, ...]:
    """Return the frames between which the motion is linear; empty if it is not baked."""
    times, points, steps, unit = motion.times, motion.points, motion.steps, motion.unit
    count, durations = len(times), np.diff(times)
    if count < 3 * MIN_EVIDENCE:
        return ()
    share = (durations[:-1] / (durations[:-1] + durations[1:]))[:, None, None]

    def measure_bends(first: int, end: int) -> Float:  # at frames 1, 2, ...
        before, own, after = (points[first + k : end + k] for k in range(3))
        fields = own - (1 - share[first:end]) * before - share[first:end] * after
        return np.stack([_rms(fields), _is_null(fields, unit, motion.edges)], axis=1)

    bends, is_null = _in_blocks(count - 2, measure_bends).T
    is_zero = is_null > 0
    least = MOVING_UNITS * unit
    is_cut = np.isin(np.arange(count - 1), [*events.cuts, *events.pops])
    is_stopped = is_cut | motion.is_equal | (steps <= least)
    is_moving = ~is_stopped[:-1] & ~is_stopped[1:]
    is_linear = is_zero & is_moving
    level = float(np.median(bends[is_linear])) if is_linear.any() else 0.0
    is_kink = is_moving & ~is_zero & (bends > max(least, PHASE_RATIO * level))
    linear, kinks, moving = is_linear.sum(), is_kink.sum(), is_moving.sum()
    is_pattern = moving >= 2 * MIN_EVIDENCE and kinks >= MIN_EVIDENCE and linear >= 0.5 * moving
    if is_pattern and linear + kinks >= 0.9 * moving:
        return (0, *(np.flatnonzero(~is_linear) + 1).tolist(), count - 1)
    if motion.is_equal.any() or np.ptp(durations) > 0.1 * durations.mean():
        return ()
    beside_cut = is_cut[:-1] | is_cut[1:]
    period, phase = _find_phase(np.where(beside_cut, np.median(bends), bends))
    if not period or np.median(bends[phase::period]) <= least:
        return ()
    return tuple(sorted({0, count - 1, *range(phase + 1, count - 1, period)}))


def _find_phase(bends: Float) -> tuple[int, int]:
    """Return the period, and the one phase in which bends ``(n,)`` are large; zeros if there is none."""
    for period in range(2, MAX_KEY_PERIOD + 1):
        if len(bends) // period < MIN_EVIDENCE + 2:
            break
        medians = np.array([np.median(bends[phase::period]) for phase in range(period)])
        phase = int(medians.argmax())
        others = float(np.delete(medians, phase).max())
        if PHASE_RATIO * others < medians[phase]:
            is_large = bends > np.sqrt(others * medians[phase])
            is_key = np.arange(len(bends)) % period == phase
            if is_large[is_key].mean() >= 0.8 and is_large[~is_key].mean() <= 0.2:
                return period, phase
    return 0, 0
