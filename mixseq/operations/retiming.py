r"""Retiming: maps from output time to source time, and models composed with such maps.

.. math:: s = r(o), \qquad y_\text{out}(o) = y(r(o)), \qquad \dot y_\text{out}(o) = r'(o)\, \dot y(r(o))

for frames, and for all signals y of a model. Both times are in seconds. Where the map :math:`r` falls, the source runs
backwards; where it is level, the source stands still. Its slope :math:`r'` is the speed of the source.

Where r is linear, a retimed signal is a cubic spline whose knots are the output times at which r passes knots of y.
Elsewhere it is approximated by a spline through the keys, the times at which r passes knots, and further sites between
these. Sites are dense next to a kink of r: their distances to it double from one to the next.

Files of retimings are pairs of output and source times, as CSV or TOML.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator, PPoly

from mixseq.errors import FormatError, SettingsError
from mixseq.operations.sections import SLACK, between, breakpoints, measures_of, sampled, sites_of
from mixseq.runtime.lazy import PickledWithoutCaches
from mixseq.runtime.public import public
from mixseq.sequence.header import frame_times
from mixseq.signals.curve import MIN_KNOT_SPACING, Curve
from mixseq.signals.decoding import ResidualLayer
from mixseq.signals.detail import DeviationNorm
from mixseq.signals.model import Model
from mixseq.types import Float

ACCURACY = 2e-6
"""Largest error of the splines between sites, in diagonals; errors of vertices in joints may be many times larger."""

DOUBLINGS = 10
"""Number of times that the distance to a kink doubles, up to half the distance to the next key."""


@dataclass(frozen=True, eq=False)
class Retiming:
    """A map from times of the output to times of the source.

    Make it with `through`, `section` or `hold`, or read it from a file with `read_retiming`.

    Attributes
    ----------
    start, end : float
        First and last time of the output, in seconds.
    curve : scipy.interpolate.PPoly
        Times of the source, a piecewise polynomial of the time of the output.

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
        """Make the map through points.

        Parameters
        ----------
        outputs : (n,) array_like
            Times of the output in seconds, increasing.
        sources : (n,) array_like
            Times of the source in seconds.
        smooth : bool
            Interpolate by Fritsch and Carlson's monotone cubic, with a continuous slope; else linearly.

        Raises
        ------
        SettingsError
            If there are fewer than two points, times are not finite, too close or too large, or outputs do not
            increase.
        """
        x, y = np.asarray(outputs, dtype=np.float64), np.asarray(sources, dtype=np.float64)
        if x.ndim != 1 or x.shape != y.shape or len(x) < 2:
            raise SettingsError(
                f"a retiming has {x.size} output times and {y.size} source times; two of each, or more, are expected"
            )
        if not (np.isfinite(x).all() and np.isfinite(y).all() and (np.diff(x) > 0).all()):
            raise SettingsError("the times of a retiming must be finite, and its output times increase")
        if (
            np.diff(x).min() < MIN_KNOT_SPACING
            or max(np.abs(x).max(), np.abs(y).max()) > 1 / MIN_KNOT_SPACING
        ):
            raise SettingsError(
                f"the output times of a retiming must be {MIN_KNOT_SPACING:g} s apart or more, and no time beyond "
                f"{1 / MIN_KNOT_SPACING:g} s"
            )
        lines = np.stack([np.diff(y) / np.diff(x), y[:-1]])
        return cls(float(x[0]), float(x[-1]), PchipInterpolator(x, y) if smooth else PPoly(lines, x))

    @classmethod
    def section(cls, start: float, end: float, speed: float = 1.0, reverse: bool = False) -> Retiming:
        """Make the map that shows the source from `start` to `end` at a constant speed, forwards or backwards.

        The output also begins at `start`. SettingsError if the end is before the start, or the speed is not positive.
        """
        if not (np.isfinite(start) and np.isfinite(end) and start <= end):
            raise SettingsError(f"there is no time between the start, {start:g} s, and the end, {end:g} s")
        if not (np.isfinite(speed) and speed > 0):
            raise SettingsError(f"speed is {speed:g}; a positive number is expected (1 keeps the speed)")
        first, slope = (end, -speed) if reverse else (start, speed)
        return cls(start, start + (end - start) / speed, _line(first - slope * start, slope))

    @classmethod
    def hold(cls, source: float, start: float, end: float) -> Retiming:
        """Make the map that shows one time of the source from `start` to `end` of the output.

        Raises `SettingsError` if the end is before the start, or a time is not finite.
        """
        if not (np.isfinite([source, start, end]).all() and start <= end):
            raise SettingsError(f"{source:g} s cannot be held from {start:g} to {end:g} s")
        return cls(start, end, _line(source, 0.0))

    def __call__(self, times: ArrayLike) -> Float:
        """Return source times ``(N,)`` at output times ``(N,)``; SettingsError for times outside the retiming."""
        return np.asarray(self.curve(self._inside(times)), dtype=np.float64)

    def slope(self, times: ArrayLike) -> Float:
        """Return seconds of the source per second of the output ``(N,)``; at a kink, the slope after it."""
        return np.asarray(self.curve(self._inside(times), nu=1), dtype=np.float64)

    def _inside(self, times: ArrayLike) -> Float:
        wanted = np.atleast_1d(np.asarray(times, dtype=np.float64))
        outside = ~((wanted >= self.start) & (wanted <= self.end))
        if outside.any():
            raise SettingsError(
                f"the retiming is from {self.start:g} to {self.end:g} s of the output, and tells nothing of "
                f"{wanted[outside][0]:g} s"
            )
        return wanted


def _line(origin: float, slope: float) -> PPoly:
    return PPoly(np.array([[slope], [origin]]), np.array([0.0, 1.0]))  # beyond which it goes on


@public
def retime(model: Model, keys: ArrayLike, smooth: bool = True) -> Model:
    """Return the model faster and slower, backwards or standing still, along a map of time.

    As `mixseq.operations.resample` with a `Retiming`, but the result is a model. The residual layer is retimed with the
    signals.

    Parameters
    ----------
    model : Model
        The source.
    keys : (n, 2) array_like
        Two or more points of the map: output times, increasing, and the source times shown then, in seconds.
    smooth : bool
        Interpolate with a continuous slope, else linearly, see `Retiming.through`.

    Returns
    -------
    Model
        From the first to the last output time, with frames from the first on at the rate of the model.

    Raises
    ------
    SettingsError
        If the keys are no retiming, contain times outside the model, or make too many frames.
    """
    points = np.asarray(keys, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2:
        raise SettingsError(
            f"keys have shape {points.shape}; (n, 2) is expected, pairs of a time of the output and one of the source"
        )
    outputs, sources = points.T
    retiming = Retiming.through(outputs, sources, smooth)
    try:
        model.clip_times(sources)  # between the keys the map is between them, too
    except SettingsError as error:
        raise SettingsError(f"the retiming asks for more than there is: {error}") from None
    frames = frame_times(retiming.start, retiming.end, model.header.fps, SLACK)

    dense = np.zeros(0) if smooth else _near_kinks(outputs, sources)
    time, placement, correction = (
        _composed(model, curve, retiming, dense, measure)
        for curve, measure in zip(model.curves, measures_of(model), strict=True)
    )
    layer = model.residual_layer
    retimed = None if layer is None else RetimedLayer(layer, retiming)
    return model.with_motion(time, placement, correction, model.header.with_times(frames), retimed)


def _composed(model: Model, curve: Curve, retiming: Retiming, dense: Float, measure: DeviationNorm) -> Curve:
    """Return a signal of the model composed with the map; `dense` are additional sites ``(m,)``."""
    keys = retiming.curve.x
    passed = [retiming.curve.solve(knot, extrapolate=False) for knot in breakpoints(curve)]
    inner = np.concatenate([dense, *passed])  # with NaN where the source stands still
    sites = sites_of(keys, between(inner, retiming.start, retiming.end))
    return sampled(lambda at: curve(model.clip_times(retiming(at))), sites, ACCURACY, measure)


def _near_kinks(outputs: Float, sources: Float) -> Float:
    """Return times on both sides of the keys where the slope of a piecewise linear map jumps."""
    slopes = np.diff(sources) / np.diff(outputs)
    kinks = 1 + np.flatnonzero(np.abs(np.diff(slopes)) > 1e-9 * np.abs(slopes).max())
    away = 0.5 ** np.arange(1, DOUBLINGS + 1)
    before = outputs[kinks, None] + (outputs[kinks - 1] - outputs[kinks])[:, None] * away
    after = outputs[kinks, None] + (outputs[kinks + 1] - outputs[kinks])[:, None] * away
    return np.concatenate([before, after]).reshape(-1)


@dataclass(frozen=True, eq=False)
class RetimedLayer(PickledWithoutCaches):
    """A residual layer composed with a retiming."""

    source: ResidualLayer  # the layer in source time
    retiming: Retiming  # map from output time to source time

    def at(self, times: Float) -> Float:
        """Return displacements ``(N, V, 3)`` at times ``(N,)`` in seconds."""
        return self.source.at(self.retiming(times))

    def rates(self, times: Float) -> Float:
        """Return the derivatives ``(N, V, 3)`` of the displacements by time, per second."""
        slopes = self.retiming.slope(times)
        return np.asarray(slopes[:, None, None] * self.source.rates(self.retiming(times)))


_LARGEST = 2**63
_DEEPEST = 20


def parse_toml(file: Path, text: str) -> dict[str, Any]:
    """Parse the text of a TOML file; FormatError for invalid, too deep or too large values."""
    try:
        parsed = tomllib.loads(text)
    except RecursionError:
        raise FormatError(f"{file} is not a TOML file: its tables or lists are nested too deeply") from None
    except ValueError as error:  # integers of thousands of digits are one, too
        raise FormatError(f"{file} is not a TOML file: {error}") from None
    level: list[Any] = [parsed]
    for _ in range(_DEEPEST):
        inner = [value for each in level for value in (each.values() if isinstance(each, dict) else each)]
        for value in inner:
            if isinstance(value, int) and not -_LARGEST <= value < _LARGEST:
                raise FormatError(f"{file} is not a TOML file: {str(value)[:20]}... has more than 64 bits")
        level = [value for value in inner if isinstance(value, dict | list)]
        if not level:
            return parsed
    raise FormatError(f"{file} is not a TOML file: its tables or lists are nested too deeply")


Lines = list[tuple[int, list[str]]]
"""Lines of a file: line numbers and comma-separated fields."""

Unit = Literal["seconds", "frames"]


class RetimingKeys(NamedTuple):
    """Points of a retiming as in a file."""

    points: Float  # (n, 2) output and source times
    unit: Unit | None  # unit of the times; None if the file has none

    def in_seconds(self, output_fps: float, source_fps: float, unit: Unit = "seconds") -> Float:
        """Return the points in seconds."""
        return self.points / [output_fps, source_fps] if (self.unit or unit) == "frames" else self.points


class _Key(NamedTuple):
    """A point of a retiming, and its place in the file."""

    place: str
    output: float
    source: float


@public
def read_retiming(
    path: str | os.PathLike[str],
    smooth: bool = True,
    output_fps: float | None = None,
    source_fps: float | None = None,
) -> Retiming:
    """Read a retiming from a text file.

    Parameters
    ----------
    path : path-like
        CSV: one line ``output,source`` per point, in seconds; a header of these names may change their order; empty
        lines and text after ``#`` are skipped. Or TOML, if the name ends in ``.toml``: tables ``[[key]]`` with
        ``output`` and ``source``, or two arrays of these names. With a first line ``unit = "frames"`` times are frame
        numbers.
    smooth : bool
        As in `Retiming.through`.
    output_fps, source_fps : float, optional
        Frames per second of the output, by default those of the source, and of the source, for files in frames.

    Raises
    ------
    FormatError
        If the file cannot be read, or its points are no retiming; the message names the file and the line.
    SettingsError
        If the file is in frames, and `source_fps` is missing.
    """
    keys = read_retiming_keys(path)
    if source_fps is None and keys.unit == "frames":
        raise SettingsError(f"{path} speaks in frames; give source_fps, the frames per second of the source")
    rate = source_fps or 1.0
    outputs, sources = keys.in_seconds(output_fps or rate, rate).T
    return Retiming.through(outputs, sources, smooth)


def read_retiming_keys(path: str | os.PathLike[str]) -> RetimingKeys:
    """Read the points of a retiming; file and errors as in `read_retiming`."""
    file = Path(path)
    try:
        text = file.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise FormatError(f"{file} cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise FormatError(f"{file} is not text; a CSV or TOML file is expected") from None
    unit: Unit | None
    if file.suffix.lower() == ".toml":
        data = parse_toml(file, text)
        unit = checked_unit(data.pop("unit", None), f"{file}")
        keys = list(_toml_keys(file, data))
    else:
        unit, lines = _csv_lines(file, text)
        keys = list(_csv_keys(file, lines))
    for before, key in zip([None, *keys], keys, strict=False):
        if not (np.isfinite(key.output) and np.isfinite(key.source)):
            raise FormatError(f"{file}, {key.place}: the times {key.output:g}, {key.source:g} are not finite")
        if before is not None and key.output <= before.output:
            raise FormatError(
                f"{file}, {key.place}: the output time {key.output:g} is not after {before.output:g} of "
                f"{before.place}; output times must increase"
            )
    if len(keys) < 2:
        raise FormatError(f"{file} has {len(keys)} points; a retiming needs two or more")
    return RetimingKeys(np.array([[key.output, key.source] for key in keys]), unit)


def checked_unit(unit: object, where: str) -> Unit | None:
    """Return the unit of a file, or None; SettingsError for unknown units."""
    if unit not in (None, "seconds", "frames"):
        raise SettingsError(f"{where}: the unit is {unit!r}; 'seconds' or 'frames' is expected")
    return unit


def _csv_lines(file: Path, text: str) -> tuple[Unit | None, Lines]:
    """Return the unit in the first line, and the other non-empty lines: numbers and fields."""
    lines = [
        (number, [field.strip() for field in line.partition("#")[0].split(",")])
        for number, line in enumerate(text.splitlines(), start=1)
        if line.partition("#")[0].strip()
    ]
    name, told, unit = lines[0][1][0].partition("=") if lines else ("", "", "")
    if not told or name.strip().lower() != "unit":
        return None, lines
    return checked_unit(unit.strip().strip("\"'"), f"{file}, line {lines[0][0]}"), lines[1:]


def _csv_keys(file: Path, lines: Lines) -> Iterable[_Key]:
    names = [name.lower() for name in lines[0][1]] if lines else []
    if sorted(names) == ["output", "source"]:
        del lines[0]
    else:
        names = ["output", "source"]
    for number, fields in lines:
        try:
            times = dict(zip(names, map(float, fields), strict=True))
        except ValueError:
            raise FormatError(
                f"{file}, line {number}: {','.join(fields)[:40]!r} is no point of a retiming; two times, "
                "output,source, are expected"
            ) from None
        yield _Key(f"line {number}", **times)


def _toml_keys(file: Path, data: dict[str, Any]) -> Iterable[_Key]:
    tables = data.get("key")
    if data.keys() == {"output", "source"} and all(isinstance(times, list) for times in data.values()):
        if len(data["output"]) != len(data["source"]):
            raise FormatError(
                f"{file} has {len(data['output'])} output times and {len(data['source'])} source times; give as many"
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
        yield _Key(f"key {number}", float(table["output"]), float(table["source"]))
