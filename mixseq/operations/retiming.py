r"""Retime models: compose their signals with a map from output time to source time.

.. math:: s = r(o), \qquad y_\text{out}(o) = y(r(o)), \qquad \dot y_\text{out}(o) = r'(o)\, \dot y(r(o))

for all signals y of a model, and its frames. Both times are in seconds. The slope :math:`r'` is the speed of the
source: the source runs backwards where r decreases, and stands still where r is constant.

Where r is linear, a retimed signal is a cubic spline whose knots are the output times at which r passes knots of y.
Elsewhere the signal is approximated by a spline with sites at the keys of r, where r passes knots, and between these.
Sites are dense near a kink of r; their distances from the kink double from site to site.

A retiming file contains pairs of output and source times, as CSV or TOML.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count, pairwise
from pathlib import Path
from typing import Any, Literal, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator, PPoly

from mixseq.errors import FormatError, SettingsError
from mixseq.operations.sections import breakpoints, interpolate_adaptively, merge_sites, signal_norms, strictly_between
from mixseq.runtime.public import FileOr, public
from mixseq.runtime.text_files import read_text
from mixseq.sequence.frame_rates import FRAME_TOLERANCE, format_frame
from mixseq.sequence.header import SequenceHeader, frame_times
from mixseq.signals.curve import MIN_KNOT_SPACING, Curve
from mixseq.signals.detail import DeviationNorm
from mixseq.signals.model import Model
from mixseq.types import Float

SIGNAL_TOLERANCE = 2e-6  # largest error of signals between sites, in diagonals; vertices in joints may have larger ones
KINK_SITE_COUNT = 10  # sites on each side of a kink, whose distances double up to half the distance to the next key
NEGLIGIBLE_TIME = 1e-100  # absolute value in seconds below which source times are rounded to zero


@dataclass(frozen=True, eq=False)
class Retiming:
    """A map from times of the output to times of the source.

    Create it with `through`, `section` or `hold`, or read it from a file with `read_retiming`.

    Attributes
    ----------
    start, end : float
        First and last time of the output, in seconds.
    curve : scipy.interpolate.PPoly
        Time of the source as a piecewise polynomial of the time of the output.

    Examples
    --------
    >>> slow = Retiming.section(1.0, 2.0, speed=0.5)
    >>> slow.start, slow.end, slow([1.0, 2.0, 3.0]).tolist(), slow.slope([2.0]).item()
    (1.0, 3.0, [1.0, 1.5, 2.0], 0.5)
    """

    start: float
    end: float
    curve: PPoly

    @classmethod
    def through(cls, outputs: ArrayLike, sources: ArrayLike, smooth: bool = True) -> Retiming:
        """Make the map that interpolates pairs of output and source times.

        Parameters
        ----------
        outputs : (n,) array_like
            Times of the output in seconds, increasing.
        sources : (n,) array_like
            Times of the source in seconds.
        smooth : bool
            Interpolate by Fritsch and Carlson's monotone cubic, with a continuous slope; if false, linearly.

        Raises
        ------
        SettingsError
            If there are fewer than two points, times are not finite, too close or too large, or output times do not
            increase.
        """
        x, y = np.asarray(outputs, dtype=np.float64), np.asarray(sources, dtype=np.float64)
        if x.ndim != 1 or x.shape != y.shape or len(x) < 2:
            raise SettingsError(
                f"a retiming has {x.size} output times and {y.size} source times; two of each, or more, are expected"
            )
        if not (np.isfinite(x).all() and np.isfinite(y).all() and (np.diff(x) > 0).all()):
            raise SettingsError("the times of a retiming must be finite, and its output times increase")
        largest = max(np.abs(x).max(), np.abs(y).max())
        if np.diff(x).min() < MIN_KNOT_SPACING or largest > 1 / MIN_KNOT_SPACING:
            raise SettingsError(
                f"the output times of a retiming must be {MIN_KNOT_SPACING:g} s apart or more, and no time beyond "
                f"{1 / MIN_KNOT_SPACING:g} s"
            )
        y = np.where(np.abs(y) < NEGLIGIBLE_TIME, 0.0, y)  # slopes of subnormal numbers have inverses that overflow
        coefficients = np.stack([np.diff(y) / np.diff(x), y[:-1]])
        return cls(float(x[0]), float(x[-1]), PchipInterpolator(x, y) if smooth else PPoly(coefficients, x))

    @classmethod
    def section(cls, start: float, end: float, speed: float = 1.0, reverse: bool = False) -> Retiming:
        """Make the map of a section of the source at constant speed, forwards or backwards.

        The output also begins at the time `start`. Raises `SettingsError` if the end is before the start, or the speed
        is not positive.
        """
        if not (np.isfinite(start) and np.isfinite(end) and start <= end):
            raise SettingsError(f"there is no time between the start, {start:g} s, and the end, {end:g} s")
        if not (np.isfinite(speed) and speed > 0):
            raise SettingsError(f"speed is {speed:g}; a positive number is expected (1 keeps the speed)")
        first, slope = (end, -speed) if reverse else (start, speed)
        return cls(start, start + (end - start) / speed, _linear_map(first - slope * start, slope))

    @classmethod
    def hold(cls, source: float, start: float, end: float) -> Retiming:
        """Make the map that freezes the source at the time `source` from `start` to `end` of the output.

        Raises `SettingsError` if the end is before the start, or a time is not finite.
        """
        if not (np.isfinite([source, start, end]).all() and start <= end):
            raise SettingsError(f"{source:g} s cannot be held from {start:g} to {end:g} s")
        return cls(start, end, _linear_map(source, 0.0))

    def __call__(self, times: ArrayLike) -> Float:
        """Map output times ``(N,)`` to source times ``(N,)``; raise SettingsError for times outside the retiming."""
        return np.asarray(self.curve(self._inside(times)), dtype=np.float64)

    def slope(self, times: ArrayLike) -> Float:
        """Return slopes ``(N,)`` in source seconds per output second; at a kink, return the slope after it."""
        return np.asarray(self.curve(self._inside(times), nu=1), dtype=np.float64)

    def _inside(self, times: ArrayLike) -> Float:
        outputs = np.atleast_1d(np.asarray(times, dtype=np.float64))
        outside_mask = ~((outputs >= self.start) & (outputs <= self.end))
        if outside_mask.any():
            raise SettingsError(
                f"{outputs[outside_mask][0]:g} s is outside the retiming, which is from {self.start:g} to "
                f"{self.end:g} s of the output"
            )
        return outputs


def _linear_map(origin: float, slope: float) -> PPoly:
    return PPoly(np.array([[slope], [origin]]), np.array([0.0, 1.0]))  # extrapolated


@public
def retime(model: Model, keys: FileOr[ArrayLike], smooth: bool = True) -> Model:
    """Retime a model by a map of time: play it faster, slower or backwards, or freeze it.

    `mixseq.operations.resample` with a `Retiming` does the same, but returns a sequence.

    Parameters
    ----------
    model : Model
        The source.
    keys : (n, 2) array_like
        Two or more pairs of an output time and its source time, in seconds. Output times increase.
    smooth : bool
        Interpolate with a continuous slope. If false, interpolate linearly, see `Retiming.through`.

    Returns
    -------
    Model
        Model from the first to the last output time. Its frames start there and have the frame rate of the source.

    Raises
    ------
    SettingsError
        If the keys are not a valid retiming, contain times outside the model, or result in too many frames.
    """
    keys = cast("ArrayLike", keys)
    points = np.asarray(keys, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2:
        raise SettingsError(
            f"keys have shape {points.shape}; (n, 2) is expected, pairs of a time of the output and one of the source"
        )
    outputs, sources = points.T
    retiming = Retiming.through(outputs, sources, smooth)
    try:
        model.clip_times(sources)  # the map is monotone between its keys
    except SettingsError as error:
        raise SettingsError(f"the retiming goes beyond the source: {error}") from None
    frames = frame_times(retiming.start, retiming.end, model.header.fps, FRAME_TOLERANCE)
    kink_sites = np.zeros(0) if smooth else _sites_near_kinks(outputs, sources)
    time, placement, correction = (
        _compose(model, curve, retiming, kink_sites, norm)
        for curve, norm in zip(model.curves, signal_norms(model), strict=True)
    )
    header = model.header.with_times(frames)
    return model.edited(header=header, time=time, placement=placement, correction=correction)


def _compose(model: Model, curve: Curve, retiming: Retiming, kink_sites: Float, norm: DeviationNorm) -> Curve:
    """Compose a signal of the model with a retiming; `kink_sites` ``(m,)`` are additional sites."""

    def inside(times: Float) -> Float:
        return strictly_between(times, retiming.start, retiming.end)

    def passes(times: Float) -> Float:
        found = [np.zeros(0), *(retiming.curve.solve(time, extrapolate=False) for time in times)]
        return inside(np.concatenate(found))  # solutions are NaN where the source stands still

    knots = np.concatenate([passes(breakpoints(curve)), inside(kink_sites)])
    pieces = []
    for start, end in pairwise([retiming.start, *np.unique(passes(curve.breaks)), retiming.end]):
        edges = np.array([start, *strictly_between(retiming.curve.x, start, end), end])
        middle = model.clip_times(retiming([(start + end) / 2]))
        piece = curve.pieces[np.searchsorted(curve.breaks, middle[0], side="right")]

        def values(times: Float, piece: Curve = piece) -> Float:
            return piece(np.clip(model.clip_times(retiming(times)), piece.start, piece.end))

        sites = merge_sites(edges, strictly_between(knots, start, end))
        pieces.append(interpolate_adaptively(values, sites, SIGNAL_TOLERANCE, norm))
    return Curve.from_pieces(pieces)


def _sites_near_kinks(outputs: Float, sources: Float) -> Float:
    """Return sites on both sides of the keys at which the slope of a piecewise linear map jumps."""
    slopes = np.diff(sources) / np.diff(outputs)
    kinks = 1 + np.flatnonzero(np.abs(np.diff(slopes)) > 1e-9 * np.abs(slopes).max())
    fractions = 0.5 ** np.arange(1, KINK_SITE_COUNT + 1)
    before = outputs[kinks, None] + (outputs[kinks - 1] - outputs[kinks])[:, None] * fractions
    after = outputs[kinks, None] + (outputs[kinks + 1] - outputs[kinks])[:, None] * fractions
    return np.concatenate([before, after]).reshape(-1)


_INTEGER_LIMIT = 2**63
_MAX_NESTING_DEPTH = 20


def parse_toml(file: Path, text: str) -> dict[str, Any]:
    """Parse the text of a TOML file; raise FormatError for invalid, too deeply nested or too large values."""
    try:
        parsed = tomllib.loads(text)
    except RecursionError:
        raise FormatError(f"{file} is not a TOML file: its tables or lists are nested too deeply") from None
    except ValueError as error:  # also raised for integers of thousands of digits
        raise FormatError(f"{file} is not a TOML file: {error}") from None
    level: list[Any] = [parsed]
    for _ in range(_MAX_NESTING_DEPTH):
        values = [value for node in level for value in (node.values() if isinstance(node, dict) else node)]
        for value in values:
            if isinstance(value, int) and not -_INTEGER_LIMIT <= value < _INTEGER_LIMIT:
                raise FormatError(f"{file} is not a TOML file: {str(value)[:20]}... has more than 64 bits")
        level = [value for value in values if isinstance(value, dict | list)]
        if not level:
            return parsed
    raise FormatError(f"{file} is not a TOML file: its tables or lists are nested too deeply")


Point = tuple[str, float, float]
"""A point of a retiming: its place in the file, the output time and the source time."""

Unit = Literal["seconds", "frames"]


class RetimingKeys(NamedTuple):
    """Points of a retiming as stored in a file."""

    points: Float  # (n, 2) output and source times
    unit: Unit | None  # unit of the times; None if the file does not specify a unit
    places: Sequence[str] = ()  # places of the points, such as "ramp.csv, line 4"; by default their numbers

    def in_seconds(
        self, output_fps: float, source: SequenceHeader, unit: Unit = "seconds", hold: bool | None = None
    ) -> Float:
        """Return the points ``(n, 2)`` in seconds; raise SettingsError beyond the source, unless its ends are held.

        `hold` is None where they cannot be held.
        """
        in_frames = (self.unit or unit) == "frames"
        rates = np.array([output_fps, source.fps]) if in_frames else np.ones(2)
        first, last = source.times[[0, -1]]
        for place, time in zip(self.places or map("point {}".format, count(1)), self.points[:, 1], strict=False):
            seconds = time / rates[1]
            if hold or abs(np.clip(seconds, first, last) - seconds) <= FRAME_TOLERANCE / source.fps:
                continue
            name, end = ("last", last) if seconds > last else ("first", first)
            limit = format_frame(end, source.fps) if in_frames else f"{end:g} s"
            asked = f"source frame {time:g}" if in_frames else f"source time {time:g} s"
            cure = "" if hold is None else ", or hold the ends (--hold)"
            raise SettingsError(f"{place}: {asked}, but the {name} is {limit}; change it{cure}")
        return np.asarray(self.points / rates)


@public
def read_retiming(
    path: str | os.PathLike[str], smooth: bool = True, output_fps: float | None = None, source_fps: float | None = None
) -> Retiming:
    """Read a retiming from a text file.

    Parameters
    ----------
    path : path-like
        A CSV file has one line ``output,source`` per point, in seconds. A header may swap the columns; empty lines and
        text after ``#`` are skipped. A TOML file, named ``*.toml``, has tables ``[[key]]`` with ``output`` and
        ``source``, or two arrays of these names. After a first line ``unit = "frames"``, times are frame numbers.
    smooth : bool
        As in `Retiming.through`.
    output_fps, source_fps : float, optional
        Frame rates of output and source, for files in frames. The output has by default the rate of the source.

    Raises
    ------
    FormatError
        If the file cannot be read, or its points are not a valid retiming. The message names the file and the line.
    SettingsError
        If the file is in frames and `source_fps` is missing.
    """
    keys = read_retiming_keys(path)
    if source_fps is None and keys.unit == "frames":
        raise SettingsError(f"{path} is in frames; give source_fps, the frames per second of the source")
    rates = [output_fps or source_fps, source_fps] if keys.unit == "frames" else 1.0
    outputs, sources = (keys.points / np.asarray(rates, dtype=np.float64)).T
    return Retiming.through(outputs, sources, smooth)


def read_retiming_keys(path: str | os.PathLike[str]) -> RetimingKeys:
    """Read the points of a retiming, with files and errors as in `read_retiming`."""
    file = Path(path)
    text = read_text(file, "a CSV or TOML file")
    unit: Unit | None
    if file.suffix.lower() == ".toml":
        data = parse_toml(file, text)
        unit = check_unit(data.pop("unit", None), f"{file}")
        points = list(_toml_points(file, data))
    else:
        unit, points = _csv_points(file, text)
    for (before_place, before, _), (place, output, source) in pairwise([("", -np.inf, 0.0), *points]):
        if not np.isfinite([output, source]).all():
            raise FormatError(f"{file}, {place}: the times {output:g}, {source:g} are not finite")
        if output <= before:
            raise FormatError(
                f"{file}, {place}: the output time {output:g} is not after {before:g} of {before_place}; output times "
                "must increase"
            )
    if len(points) < 2:
        raise FormatError(f"{file} has {len(points)} points; a retiming needs two or more")
    places = [f"{file}, {place}" for place, *_ in points]
    return RetimingKeys(np.array([times for _, *times in points]), unit, places)


def check_unit(unit: object, where: str) -> Unit | None:
    """Validate the unit of a file and return it; None means that the file has no unit."""
    if unit not in (None, "seconds", "frames"):
        raise SettingsError(f"{where}: the unit is {unit!r}; 'seconds' or 'frames' is expected")
    return unit


def _csv_points(file: Path, text: str) -> tuple[Unit | None, list[Point]]:
    """Return the unit from the first line of a CSV file, if any, and the points of all other non-empty lines."""
    lines = [
        (number, [field.strip() for field in line.partition("#")[0].split(",")])
        for number, line in enumerate(text.splitlines(), start=1)
        if line.partition("#")[0].strip()
    ]
    name, equals, text = lines[0][1][0].partition("=") if lines else ("", "", "")
    unit: Unit | None = None
    if equals and name.strip().lower() == "unit":
        unit = check_unit(text.strip().strip("\"'"), f"{file}, line {lines.pop(0)[0]}")
    names = [name.lower() for name in lines[0][1]] if lines else []
    if sorted(names) == ["output", "source"]:
        del lines[0]
    else:
        names = ["output", "source"]
    points = []
    for number, fields in lines:
        try:
            times = dict(zip(names, map(float, fields), strict=True))
        except ValueError:
            raise FormatError(
                f"{file}, line {number}: {','.join(fields)[:40]!r} is not a point of a retiming; two times, "
                "output,source, are expected"
            ) from None
        points.append((f"line {number}", times["output"], times["source"]))
    return unit, points


def _toml_points(file: Path, data: dict[str, Any]) -> Iterator[Point]:
    tables = data.get("key")
    if data.keys() == {"output", "source"} and all(isinstance(times, list) for times in data.values()):
        if len(data["output"]) != len(data["source"]):
            raise FormatError(
                f"{file} has {len(data['output'])} output times and {len(data['source'])} source times, not equal"
            )
        pairs = zip(data["output"], data["source"], strict=True)
        tables = [{"output": output, "source": source} for output, source in pairs]
    elif data.keys() != {"key"} or not isinstance(tables, list):
        raise FormatError(
            f"{file} has {', '.join(data) or 'nothing'}; tables [[key]] of output and source, or arrays output and "
            "source, are expected"
        )
    for number, table in enumerate(tables, start=1):
        if not isinstance(table, dict) or table.keys() != {"output", "source"}:
            raise FormatError(f"{file}, key {number}: an output and a source are expected, and nothing else")
        if not all(type(time) in (int, float) for time in table.values()):
            raise FormatError(f"{file}, key {number}: the output or the source is not a time")
        yield f"key {number}", float(table["output"]), float(table["source"])
