r"""Retiming: which time of the source is shown at which time of the output.

.. math:: s = r(o), \qquad x_\text{out}(o) = x(r(o)), \qquad \dot x_\text{out}(o) = r'(o)\, \dot x(r(o))

Both times are in seconds. The map :math:`r` need not increase: where it falls, the source runs backwards, where it
is level, the source stands still. Its slope :math:`r'` is the speed of the source.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator, PPoly

from mixseq.arrays import Float
from mixseq.errors import FormatError, SettingsError


@dataclass(frozen=True, eq=False)
class Retiming:
    """A map from times of the output to times of the source.

    Make it with `through`, `section` or `hold`, or read it from a file with `read_retiming`.

    Attributes
    ----------
    start, end : float
        From where to where the output lasts, in seconds.
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
            Times of the output, increasing.
        sources : (n,) array_like
            Times of the source.
        smooth : bool
            Join the points by a curve whose slope is continuous, and which rises and falls only where they do
            (Fritsch and Carlson's monotone cubic); else by straight lines, whose slope jumps.

        Raises
        ------
        SettingsError
            If there are fewer than two points, or they are not finite, or outputs do not increase.
        """
        x, y = np.asarray(outputs, dtype=np.float64), np.asarray(sources, dtype=np.float64)
        if x.ndim != 1 or x.shape != y.shape or len(x) < 2:
            raise SettingsError(
                f"a retiming has {x.size} output times and {y.size} source times; two of each, or more, are expected"
            )
        if not (np.isfinite(x).all() and np.isfinite(y).all() and (np.diff(x) > 0).all()):
            raise SettingsError("the times of a retiming must be finite, and its output times increase")
        lines = np.stack([np.diff(y) / np.diff(x), y[:-1]])
        return cls(float(x[0]), float(x[-1]), PchipInterpolator(x, y) if smooth else PPoly(lines, x))

    @classmethod
    def section(cls, start: float, end: float, speed: float = 1.0, reverse: bool = False) -> Retiming:
        """Make the map that shows the source from `start` to `end` at a constant speed, forwards or backwards.

        The output begins at `start` too, so that at the speed 1 all times are kept.

        Raises
        ------
        SettingsError
            If the end is before the start, or the speed is not positive.
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

        Raises
        ------
        SettingsError
            If the end is before the start, or a time is not finite.
        """
        if not (np.isfinite([source, start, end]).all() and start <= end):
            raise SettingsError(f"{source:g} s cannot be held from {start:g} to {end:g} s")
        return cls(start, end, _line(source, 0.0))

    def __call__(self, times: ArrayLike) -> Float:
        """Return the times ``(N,)`` of the source at times ``(N,)`` of the output.

        Raises
        ------
        SettingsError
            If a time is outside the retiming.
        """
        return np.asarray(self.curve(self._inside(times)), dtype=np.float64)

    def slope(self, times: ArrayLike) -> Float:
        """Return seconds of the source per second of the output ``(N,)``; at a kink those of what follows."""
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


# From text ------------------------------------------------------------------------------------------------


class _Key(NamedTuple):
    """A point of a retiming, and where in the file it is."""

    place: str
    output: float
    source: float


def read_retiming(path: str | os.PathLike[str], smooth: bool = True) -> Retiming:
    """Read a retiming from a text file.

    Parameters
    ----------
    path : path-like
        CSV: one line ``output,source`` per point, in seconds; lines of another order begin with a header of these
        names; empty lines and what follows ``#`` are skipped. Or TOML, if the name ends in ``.toml``: tables
        ``[[key]]`` with ``output`` and ``source``, or two arrays of these names.
    smooth : bool
        As in `Retiming.through`.

    Raises
    ------
    FormatError
        If the file cannot be read, or its points are no retiming; the message names the file and the line.
    """
    outputs, sources = read_keys(path).T
    return Retiming.through(outputs, sources, smooth)


def read_keys(path: str | os.PathLike[str]) -> Float:
    """Read the points ``(n, 2)`` of a retiming, output and source times; file and errors as in `read_retiming`."""
    file = Path(path)
    try:
        text = file.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise FormatError(f"{file} cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise FormatError(f"{file} is not text; a CSV or TOML file is expected") from None
    keys = list(_toml_keys(file, text) if file.suffix.lower() == ".toml" else _csv_keys(file, text))
    for before, key in zip([None, *keys], keys, strict=False):
        if not (np.isfinite(key.output) and np.isfinite(key.source)):
            raise FormatError(f"{file}, {key.place}: the times {key.output:g}, {key.source:g} are not finite")
        if before is not None and key.output <= before.output:
            raise FormatError(
                f"{file}, {key.place}: the output time {key.output:g} s is not after {before.output:g} s of "
                f"{before.place}; output times must increase"
            )
    if len(keys) < 2:
        raise FormatError(f"{file} has {len(keys)} points; a retiming needs two or more")
    return np.array([[key.output, key.source] for key in keys])


def _csv_keys(file: Path, text: str) -> Iterable[_Key]:
    lines = [
        (number, [field.strip() for field in line.partition("#")[0].split(",")])
        for number, line in enumerate(text.splitlines(), start=1)
        if line.partition("#")[0].strip()
    ]
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
                f"{file}, line {number}: {','.join(fields)[:40]!r} is no point of a retiming; two times in seconds, "
                "output,source, are expected"
            ) from None
        yield _Key(f"line {number}", **times)


def _toml_keys(file: Path, text: str) -> Iterable[_Key]:
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise FormatError(f"{file} is not TOML: {error}") from None
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
            raise FormatError(f"{file}, key {number}: the output or the source is not a time in seconds")
        yield _Key(f"key {number}", float(table["output"]), float(table["source"]))
