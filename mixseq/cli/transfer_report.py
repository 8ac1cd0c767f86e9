"""The report of ``mixseq transfer``, as a table, as JSON and as a picture."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mixseq.arrays import FloatArray
    from mixseq.correspondence.matching import Quality
    from mixseq.retargeting.coverage import Coverage
    from mixseq.retargeting.footskate import ContactReport
    from mixseq.retargeting.report import Counts, TransferReport
    from mixseq.retargeting.transfer import Transfer
    from mixseq.sequence import SequenceHeader
    from mixseq.statistics import Statistics

NAMED = 4
"""Largest number of followers and markers named in the table."""

COLUMNS = 5
"""Number of frames in the picture, beside the rest."""


def facts(made: Transfer, method: str, report: TransferReport) -> dict[str, Any]:
    """Return plain values for JSON."""
    quality = made.quality
    reported = {"method": method, "frames": made.header.frame_count, "vertices": made.header.vertex_count}
    return (
        reported
        | _part_counts(made)
        | {"correspondence": None if quality is None else _quality_facts(quality)}
        | report.as_dict()
        | {"contacts": asdict(made.contacts)}
    )


def rows(made: Transfer, method: str, report: TransferReport) -> list[tuple[str, str]]:
    """Return the table rows."""
    header, parts = made.header, _part_counts(made)
    by = ", ".join(_number(count, what[:-1]) for what, count in parts.items()) or "deformation gradients"
    frames = _number(header.frame_count, "frame")
    return [
        ("transferred", f"{frames} to {header.vertex_count:,} vertices, by {by}"),
        *_coverage_rows(report.coverage),
        *([] if made.quality is None else _quality_rows(made.quality)),
        ("strain", f"{_strain(report.strain)}; source {_strain(report.source_strain)}"),
        ("unlike the source's", _strain(report.excess)),
        ("acceleration", _smoothness(report, header)),
        ("self-intersections", _crossings(report.intersections, header)),
        ("... of the source", _crossings(report.source_intersections, header)),
        ("turned over", _triangles(report.turned_over, header)),
        ("flat", _triangles(report.flat, header)),
        *_contact_rows(made.contacts),
    ]


def _part_counts(made: Transfer) -> dict[str, int]:
    """Return the numbers of parts and joints of the target, if there are any."""
    parts = made.method.parts
    return {} if parts is None else {"parts": len(parts.target.parts), "joints": len(parts.target.joints)}


def _coverage_rows(covered: Coverage) -> list[tuple[str, str]]:
    shares = f"{_percent(covered.area)} of the target's area; {_percent(covered.source_area)} of the source's moves it"
    followers = [
        f"{each.name} ({each.vertices:,} vertices) follows {each.leads}" for each in covered.followers
    ]
    result = [("corresponds", shares)]
    if followers:
        result.append(("without counterpart", _some(followers)))
    return result


def _quality_facts(quality: Quality) -> dict[str, Any]:
    """Return the numeric attributes, and all markers by name."""
    names = [quality.markers.name(number) for number in range(len(quality.markers))]
    missed = zip(names, quality.marker_distances.tolist(), strict=True)
    return {
        "source_coverage": quality.source_coverage,
        "target_coverage": quality.target_coverage,
        "mean_distance": quality.mean,
        "p99_distance": quality.p99,
        "largest_distance": quality.largest,
        "flipped": quality.flipped,
        "filled_vertices": quality.filled_vertices,
        "filled_triangles": quality.filled_faces,
        "followers": quality.followers,
        "markers": [{"name": name, "distance": distance} for name, distance in missed],
    }


def _quality_rows(quality: Quality) -> list[tuple[str, str]]:
    percent = [f"{100 * value:.2g} %" for value in (quality.mean, quality.p99, quality.largest)]
    worst = [f"{name} by {100 * distance:.2g} %" for name, distance in quality.worst_markers(3)]
    return [
        (
            "matched",
            f"{_percent(quality.target_coverage)} of the target's area, {_percent(quality.source_coverage)} of the "
            f"source's; {quality.filled_vertices:,} vertices, {quality.filled_faces:,} triangles like their neighbours",
        ),
        ("distances", f"{percent[0]} of the diagonal on average, {percent[1]} at 99 %, {percent[2]} at most"),
        ("facing away", _number(quality.flipped, "triangle")),
        ("markers", f"{len(quality.markers)}, missed most: {', '.join(worst)}"),
    ]


def _strain(strain: Statistics) -> str:
    return f"{100 * strain.rms:.3g} % rms, {100 * strain.p999:.3g} % at 99.9 %"


def _smoothness(report: TransferReport, header: SequenceHeader) -> str:
    smooth = report.smoothness
    if smooth is None:
        return "takes three frames"
    ratio = "" if smooth.ratio is None else f", {smooth.ratio:.2f} times the source's"
    most = "" if not smooth.source_max else f", {smooth.max / smooth.source_max:.2f} times at most"
    worst = header.frame_number(smooth.worst_frame)
    return f"{smooth.rms:.2g} diagonals per squared frame rms{ratio}{most} (frame {worst})"


def _crossings(counts: Counts, header: SequenceHeader) -> str:
    worst = header.frame_number(counts.worst_frame)
    return (
        f"{_number(counts.rest, 'pair')} at rest, {counts.worst:,} at most (frame {worst}), "
        f"{counts.mean:.3g} on average of {_number(len(counts.frames), 'frame')}"
    )


def _triangles(counts: Counts, header: SequenceHeader) -> str:
    if not counts.worst:
        return "no triangle"
    worst = header.frame_number(counts.worst_frame)
    return f"{_number(counts.worst, 'triangle')} at most (frame {worst}), {counts.mean:.2g} on average"


def _contact_rows(contacts: ContactReport) -> list[tuple[str, str]]:
    """Return table rows of the sliding of every contact, and the cost of keeping it."""
    result = []
    for group in contacts.groups:
        stances = _number(len(group.stances), "stance")
        slid = (
            f"slides {100 * group.before:.2g} % of the diagonal as transferred, {100 * group.after:.2g} % now"
        )
        longer = f", limb longer by {100 * group.residual:.2g} %" if group.residual > 0 else ""
        result.append((group.name, f"{stances}, {slid}{longer}"))
    if contacts.groups:
        moved = f"body by {100 * contacts.shift:.2g} % of the diagonal, limbs by {contacts.turn:.2g} degrees at most"
        result.append(("moved", moved))
    return result


def _some(names: list[str]) -> str:
    more = len(names) - NAMED
    return ", ".join(names[:NAMED]) + (f" and {more} more" if more > 0 else "")


def _number(count: int, what: str) -> str:
    return f"{count:,} {what}{'s' * (count != 1)}"


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


# Picture ---------------------------------------------------------------------------------------------------


def frames_to_draw(made: Transfer, frame: int, rest_file: Path | None) -> list[int]:
    """Choose frames for the picture, without the rest, which is always drawn."""
    from mixseq.arrays import evenly

    count = made.header.frame_count
    chosen = [int(each) for each in evenly(count, COLUMNS)]
    return [each for each in chosen if rest_file is not None or each != frame % count] or chosen


class PassingFrames:
    """Record some frames ``(V', 3)`` of passing blocks."""

    def __init__(self, frames: Sequence[int]) -> None:
        self.frames = frames
        self.points: list[FloatArray] = []

    def passing(self, blocks: Iterable[FloatArray]) -> Iterator[FloatArray]:
        """Pass on blocks of frames."""
        first = 0
        for block in blocks:
            self.points += [
                block[each - first].copy() for each in self.frames if 0 <= each - first < len(block)
            ]
            first += len(block)
            yield block


def draw(picture: Path, made: Transfer, shown: PassingFrames) -> None:
    """Draw the source and the target beside each other in some frames."""
    import numpy as np

    from mixseq.plots.transfers import transfer_sheet
    from mixseq_io.atomic import replacing

    with replacing(picture) as temporary:
        transfer_sheet(temporary, made, shown.frames, np.stack(shown.points))
