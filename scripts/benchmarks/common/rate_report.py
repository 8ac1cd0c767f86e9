"""What `scripts/bench compress` shows: a table for each sequence, ours beside the peer to beat, and beside skinning."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from scripts.benchmarks.common.rates import Measure, Point, rate
from scripts.benchmarks.common.section import Section, Table, at_most
from scripts.benchmarks.peers.coder import ERROR_TARGETS, KG_TARGETS

OURS, PEER, SKINNING, FRAMES = "ours", "trajectory", "bones", "draco"

TIMED_AT = 0.1
"""Seconds are those of the setting whose KG error, in percent, is nearest to this."""

WANTED = {1.0: 0.7, 0.5: 0.7, 0.1: 0.7}
"""What ours should be of the peer, in the median, at KG errors in percent; never above 1 anywhere."""

SKINNED, HALF = "horse_gallop", 0.5
"""Where ours should be at most half of skinning at the same error; elsewhere it is only shown."""


class Measured(NamedTuple):
    """The points of all coders on one sequence, by their names."""

    name: str
    vertices: int
    frames: int
    points: Mapping[str, Sequence[Point]]


def sequence_section(measured: Measured, titles: Mapping[str, str]) -> Section:
    """Rates of all coders on one sequence, and their seconds."""
    columns = (
        "coder",
        *(f"KG {kg:g} %" for kg in KG_TARGETS),
        *(f"max {error:g}" for error in ERROR_TARGETS),
        "encode s",
        "decode s",
    )
    rows = []
    for name, points in measured.points.items():
        timed = timing(points)
        rows.append(
            (
                titles[name],
                *(_text(rate(points, "kg_percent", kg)) for kg in KG_TARGETS),
                *(_text(rate(points, "max_error", error)) for error in ERROR_TARGETS),
                *(f"{np.median(seconds):.3g}" for seconds in (timed.encode, timed.decode)),
            )
        )
    return Section(
        f"{measured.name}: {measured.vertices} vertices, {measured.frames} frames",
        [Table("", columns, rows)],
    )


def summary(all_measured: Iterable[Measured]) -> Section:
    """Ours beside the trajectory basis, and beside skinning at the errors that skinning has."""
    both = [each for each in all_measured if OURS in each.points]
    section = Section("In short")
    against_peer = [each for each in both if PEER in each.points]
    if against_peer:
        _against_peer(section, against_peer)
    for each in both:
        if SKINNING in each.points:
            _against_skinning(section, each)
    return section


def timing(points: Sequence[Point]) -> Point:
    """Return the point whose seconds are shown."""
    return min(points, key=lambda point: abs(np.log(max(point.kg_percent, 1e-12) / TIMED_AT)))


def _against_peer(section: Section, sequences: Sequence[Measured]) -> None:
    ratios = np.array([_ratios(each, "kg_percent", KG_TARGETS) for each in sequences])
    errors = np.array([_ratios(each, "max_error", ERROR_TARGETS) for each in sequences])
    rows = []
    for each, of_kg, of_error in zip(sequences, ratios, errors, strict=True):
        ours, peer = (timing(each.points[name]) for name in (OURS, PEER))
        frames = each.points.get(FRAMES)
        faster = f"{np.median(timing(frames).decode) / np.median(ours.decode):.2g}" if frames else ""
        slower = f"{np.median(ours.encode) / np.median(peer.encode):.2g}"
        rows.append((each.name, *map(_ratio, (*of_kg, *of_error)), slower, faster))
    both = np.concatenate([ratios, errors], axis=1)
    rows.append(("**median**", *(f"**{_ratio(np.nanmedian(column))}**" for column in both.T), "", ""))
    rows.append(("largest", *(_ratio(np.nanmax(column)) for column in both.T), "", ""))
    columns = (
        "sequence",
        *(f"KG {kg:g} %" for kg in KG_TARGETS),
        *(f"max {error:g}" for error in ERROR_TARGETS),
        "encode: ours / PCA",
        "decode: Draco / ours",
    )
    section.tables.append(Table("Bits of ours over bits of PCA in trajectory space.", columns, rows))
    for kg, column in zip(KG_TARGETS, ratios.T, strict=True):
        if kg in WANTED:
            section.targets.append(at_most(f"KG {kg:g} %: ours / PCA, median", np.nanmedian(column), WANTED[kg]))
        section.targets.append(at_most(f"KG {kg:g} %: ours / PCA, largest", np.nanmax(column), 1))


def _ratios(measured: Measured, measure: Measure, targets: Sequence[float]) -> list[float]:
    """Return ours over the peer's at every target: infinite where only the peer reaches it, NaN where it does not."""
    found = []
    for target in targets:
        ours, peer = (rate(measured.points[name], measure, target) for name in (OURS, PEER))
        found.append(np.nan if peer is None else np.inf if ours is None else ours / peer)
    return found


def _against_skinning(section: Section, measured: Measured) -> None:
    rows = []
    for point in measured.points[SKINNING]:
        ours = rate(measured.points[OURS], "kg_percent", point.kg_percent)
        rows.append(
            (
                f"{point.setting} bones",
                f"{point.kg_percent:.3g}",
                f"{point.bits:.3g}",
                _text(ours),
                "" if ours is None else f"{ours / point.bits:.2f}",
                f"{np.median(point.encode):.3g}",
            )
        )
        if ours is not None and measured.name == SKINNED:
            what = f"{measured.name}, KG {point.kg_percent:.2g} %: ours / skinning with {point.setting} bones"
            section.targets.append(at_most(what, ours / point.bits, HALF))
    columns = ("skinning", "KG %", "bits", "bits of ours", "ratio", "encode s")
    section.tables.append(Table(f"{measured.name}, at the errors of skinning.", columns, rows))


def _text(bits: float | None) -> str:
    return "-" if bits is None else f"{bits:.3g}"


def _ratio(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:.2f}"
