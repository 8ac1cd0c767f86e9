r"""Judge a transfer: whether it is good, or where and in which frame to look.

The *rest poses* differ too much if the best similarity between them leaves a large residual, or if a frame of the
source is far more like the target (`compare_rest_poses`). Points of the target far from each other are in *conflict*
as markers are (`mixseq.retargeting.checks`): where limbs are exchanged, the direction from one to the other is
reversed. The map is *torn* where neighbours on the target are far apart on the source. Sizes far apart are units that
were mistaken.

Measures of the motion (`mixseq.retargeting.report`) are compared with those of the source. Their limits are wide: an
exchanged leg moves as smoothly as the right one, so that most bad transfers are found at rest.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mixseq.mesh.measures import edge_lengths
from mixseq.mesh.topology import Topology
from mixseq.retargeting.checks import find_conflicts, find_suspicious_markers, fit_most_points, normalise_points
from mixseq.retargeting.mixed_transfer import MixedTransfer
from mixseq.retargeting.report import TransferReport
from mixseq.retargeting.transfer import PoseComparison, Transfer, compare_rest_poses
from mixseq.sequence.header import UP_AXES
from mixseq.sequence.sequence import bounding_diagonal
from mixseq.types import Float, Index

# Limits of a good transfer, chosen and tried as docs/benchmarks.md says.
MAX_SIZE_RATIO = 10.0  # largest ratio of sizes in metres
MAX_POSE_RESIDUAL = 0.23  # largest residual of the rest poses, relative to the body's radius
SAMPLE_COUNT = 80  # number of points of the target that are compared with each other
MAX_CONFLICTS = 1  # largest number of conflicts of such a point
MAX_TEAR_DIAGONALS = 0.12  # largest distance of neighbours on the source, beyond that on the target
MIN_AREA_SHARE = 0.95  # smallest share of the target's area that is moved, and that fits the source
MAX_MEAN_DISTANCE_DIAGONALS = 0.015  # largest mean distance of the registered source
MAX_MARKER_DISTANCE_DIAGONALS = 0.02  # largest distance of a marker after registration
MAX_STRAIN_RATIO, MIN_RMS_STRAIN = 1.5, 0.05  # largest ratio of strains, and smallest strain of the source in it
MAX_POP_RATIO = 2.0  # largest acceleration, relative to the source's and to the ratio of all accelerations
MAX_CROSSING_RATIO, MAX_CROSSING_COUNT = 2.0, 10  # largest ratio to pairs at rest and of the source, if above a count
MAX_TURNED_OVER_SHARE, MAX_TURNED_OVER_COUNT = 0.025, 5  # largest share and count of turned-over triangles
MAX_FLAT_SHARE, MAX_FLAT_COUNT = 0.005, 5  # largest share and count of triangles that become flat
MAX_VOLUME_CHANGE = 0.2  # largest volume change, as a logarithm
MAX_LIFT_DIAGONALS = 0.25  # largest height over the ground where the source stands on it
MAX_LIMB_STRETCH = 0.01  # largest lengthening of a limb by contacts


@dataclass(frozen=True)
class Finding:
    """A measure outside its limit, with the place to look at."""

    message: str  # the problem, and its cure if there is one
    vertex: int | None = None  # vertex of the target
    frame: int | None = None  # index of the frame; None for a problem at rest
    is_rest_pose: bool = False  # whether the rest poses are too different


@dataclass(frozen=True)
class Verdict:
    """Whether a transfer is good, and what to look at if it is not."""

    findings: tuple[Finding, ...]  # measures outside their limits, causes before effects; empty if the transfer is good
    text: str  # one line


def judge_transfer(transfer: Transfer, report: TransferReport) -> Verdict:
    """Judge a measured transfer."""
    findings = (*_find_at_rest(transfer, report), *_find_in_motion(transfer, report))
    if not findings:
        return Verdict((), "good: corresponds everywhere, and is as smooth as the source; nothing to check")
    first = findings[0]
    suffix = f"; and {len(findings) - 1} more" if len(findings) > 1 else ""
    if first.is_rest_pose:
        start = "wrong rest pose"
    elif first.vertex is None:
        start = "check"
    else:
        when = "at rest" if first.frame is None else f"in frame {transfer.header.frame_number(first.frame)}"
        start = f"look at {name_place(transfer, first.vertex)} {when}"
    return Verdict(findings, f"{start}: {first.message}{suffix}")


def _find_at_rest(transfer: Transfer, report: TransferReport) -> Iterator[Finding]:
    """Yield the problems of the meshes at rest and of their correspondence."""
    source, rest, quality, covered = transfer.source, transfer.target, transfer.quality, report.coverage
    sizes = [
        header.metres_per_unit * bounding_diagonal(points)
        for header, points in ((transfer.header, rest), (source.header, source.rest))
    ]
    ratio = sizes[0] / sizes[1]
    if max(ratio, 1 / ratio) > MAX_SIZE_RATIO:
        yield Finding(f"the target is {ratio:.2g} times as large as the source, in metres; read it with --units")
    poses = compare_rest_poses(source, rest, transfer.correspondence)
    is_unlike = poses.residual > MAX_POSE_RESIDUAL
    is_cause = poses.is_better or (is_unlike and transfer.proposal is not None)  # proposed markers were sure
    if is_cause:
        yield _rest_finding(transfer, poses)
    if quality is not None:
        markers = quality.markers
        for suspicion in find_suspicious_markers(markers, source.rest[markers.source], rest[markers.target]):
            yield Finding(suspicion.message, int(markers.target[suspicion.marker_ids[0]]))
    samples = sample_far_points(rest, np.flatnonzero(transfer.correspondence.matched))
    x, y = transfer.correspondence.interpolate(source.rest, samples), rest[samples]
    x, y = normalise_points(x), normalise_points(y)
    conflicts = find_conflicts(x @ fit_most_points(x, y).T, y, np.arange(len(x))).sum(axis=1)
    if conflicts.max(initial=0) > MAX_CONFLICTS:
        yield Finding("limbs seem exchanged; set markers there", int(samples[conflicts.argmax()]))
    tear, vertex = _largest_tear(transfer)
    if tear > MAX_TEAR_DIAGONALS:
        yield Finding(f"neighbours are {100 * tear:.0f} % of the source apart; set markers there", vertex)
    if is_unlike and not is_cause:
        yield _rest_finding(transfer, poses)
    if covered.area < MIN_AREA_SHARE and not covered.followers:
        yield Finding(f"{100 * (1 - covered.area):.1f} % of the target has no counterpart; set markers there")
    if quality is None:
        return
    fitting = quality.target_coverage / max(covered.area, 1e-9)  # followers fit nothing
    if fitting < MIN_AREA_SHARE or not quality.mean_distance <= MAX_MEAN_DISTANCE_DIAGONALS:
        yield Finding(f"only {100 * fitting:.1f} % of the target fits the source; set more markers")
    worst = quality.worst_marker
    if quality.marker_distances[worst] > MAX_MARKER_DISTANCE_DIAGONALS:
        name, distance = quality.markers.name(worst), quality.marker_distances[worst]
        message = f"marker {name} is missed by {distance:.2g} diagonals; set it anew"
        yield Finding(message, int(quality.markers.target[worst]))


def _rest_finding(transfer: Transfer, poses: PoseComparison) -> Finding:
    number = transfer.source.header.frame_number(poses.frame)
    cure = f"--rest {number} is more alike" if poses.is_better else "give --rest FRAME or FILE in the target's pose"
    limb, vertex = _most_turned_part(transfer)
    message = f"points are {100 * poses.residual:.0f} % of the body's radius off{limb}; {cure}"
    return Finding(message, vertex, is_rest_pose=True)


def _find_in_motion(transfer: Transfer, report: TransferReport) -> Iterator[Finding]:
    """Yield the problems of the frames of the target."""
    header, smooth, crossings = transfer.header, report.smoothness, report.intersections
    face_count = len(header.faces)
    stretching = report.strain.rms / max(report.source_strain.rms, MIN_RMS_STRAIN)
    if stretching > MAX_STRAIN_RATIO:
        yield Finding(f"stretches {stretching:.2g} times as much as the source")
    if smooth is not None and smooth.ratio is not None:
        pop = smooth.max / smooth.source_max
        if pop > MAX_POP_RATIO * max(smooth.ratio, 1.0):
            yield Finding("pops", smooth.worst_vertex, smooth.worst_frame)
    density = math.sqrt(face_count / len(transfer.source.header.faces))
    expected = max(crossings.rest, density * report.source_intersections.worst, MAX_CROSSING_COUNT)
    if crossings.worst > MAX_CROSSING_RATIO * expected:
        message = f"goes through itself ({crossings.worst:,} pairs)"
        yield Finding(message, crossings.worst_vertex, crossings.worst_frame)
    for counts, limit, what in (
        (report.turned_over, max(MAX_TURNED_OVER_COUNT, MAX_TURNED_OVER_SHARE * face_count), "turned over"),
        (report.flat, max(MAX_FLAT_COUNT, MAX_FLAT_SHARE * face_count), "flat"),
    ):
        if counts.worst > limit:
            yield Finding(f"{counts.worst:,} triangles are {what}", counts.worst_vertex, counts.worst_frame)
    if abs(report.volume.value) > MAX_VOLUME_CHANGE:
        percent = 100 * math.expm1(report.volume.value)
        yield Finding(f"the volume changes by {percent:.0f} % more than the source's", None, report.volume.frame)
    lift = report.lift
    if lift.value > MAX_LIFT_DIAGONALS:
        message = f"{100 * lift.value:.0f} % of the diagonal over the ground, where the source stands on it"
        yield Finding(message, lift.vertex, lift.frame)
    for group in transfer.contacts.groups:
        if group.residual > MAX_LIMB_STRETCH:
            yield Finding(f"the limb of {group.name} gets {100 * group.residual:.2g} % longer")


def sample_far_points(points: Float, vertex_ids: Index, count: int = SAMPLE_COUNT) -> Index:
    """Sample vertices far from each other (Gonzalez 1985): the farthest from the centre, then from all samples."""
    candidates = points[vertex_ids]
    distances = np.linalg.norm(candidates - candidates.mean(axis=0), axis=1)
    samples = [int(distances.argmax())]
    nearest = np.full(len(candidates), np.inf)
    for _ in range(min(count, len(candidates)) - 1):
        nearest = np.minimum(nearest, np.linalg.norm(candidates - candidates[samples[-1]], axis=1))
        samples.append(int(nearest.argmax()))
    return np.asarray(vertex_ids[samples])


def _largest_tear(transfer: Transfer) -> tuple[float, int]:
    """Return the largest distance of neighbours on the source beyond that on the target, in diagonals, and a vertex."""
    edges = Topology(transfer.header.faces, transfer.header.vertex_count).edges
    edges = edges[transfer.correspondence.matched[edges].all(axis=1)]
    meshes = (transfer.correspondence.interpolate(transfer.source.rest), transfer.source.rest), (transfer.target,) * 2
    lengths = [edge_lengths(points, edges) / (bounding_diagonal(whole) or 1.0) for points, whole in meshes]
    tears = lengths[0] - lengths[1]
    worst = int(tears.argmax()) if len(tears) else 0
    return (float(tears[worst]), int(edges[worst, 0])) if len(tears) else (0.0, 0)


MIN_NAMED_TURN_DEGREES = 25.0  # smallest rotation of a part that is named


def _most_turned_part(transfer: Transfer) -> tuple[str, int | None]:
    """Return a text about the part that is turned most between the rest poses, and its middle vertex."""
    if not isinstance(transfer.method, MixedTransfer):
        return "", None
    degrees = transfer.method.limb_turns[1]
    vertices = transfer.method.parts.target.parts[int(degrees.argmax())]
    if degrees.max() < MIN_NAMED_TURN_DEGREES:
        return "", None
    points = transfer.target[vertices]
    vertex = int(vertices[np.linalg.norm(points - points.mean(axis=0), axis=1).argmin()])
    return f", {name_place(transfer, vertex)} is turned by {degrees.max():.0f} degrees", vertex


FRONT_AND_LEFT = {"X": ((1, 1), (2, 1)), "Y": ((2, 1), (0, 1)), "Z": ((1, -1), (0, 1))}
"""Conventional axes and signs for the front and for the left of a body, by up axis."""

MAX_NAME_DIAGONALS = 0.1  # largest distance of a place from the marker after which it is named
MIDDLE_SHARE = 0.15  # half the height, width or length of the middle of a body, relative to the whole


def name_place(transfer: Transfer, vertex: int) -> str:
    """Name a vertex of the target: by the nearest named marker, by its object, and by where it is at rest."""
    header, rest, quality = transfer.header, transfer.target, transfer.quality
    if quality is not None and quality.markers.names:
        distances = np.linalg.norm(rest[quality.markers.target] - rest[vertex], axis=1)
        name = quality.markers.names[int(distances.argmin())]
        if name and distances.min() < MAX_NAME_DIAGONALS * bounding_diagonal(rest):
            return f"the {name} (vertex {vertex})"
    up = UP_AXES.index(header.up_axis)
    low, high = rest.min(axis=0), rest.max(axis=0)
    places = (rest[vertex] - (low + high) / 2) / np.where(high > low, high - low, 1.0)
    words = [
        (far if sign * places[axis] > 0 else near)
        for (axis, sign), far, near in zip(
            ((up, 1), *FRONT_AND_LEFT[header.up_axis]),
            ("top", "front", "left"),
            ("bottom", "back", "right"),
            strict=True,
        )
        if abs(places[axis]) > MIDDLE_SHARE
    ]
    ends = np.cumsum([each.vertex_count for each in header.objects])
    named = f"{header.objects[int(np.searchsorted(ends, vertex, 'right'))].name}, " if len(ends) > 1 else ""
    return f"the {' '.join(words) or 'middle'} ({named}vertex {vertex})"
