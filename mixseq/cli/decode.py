"""``mixseq decode``."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import mixseq
from mixseq.cli.console import announce, print_table, progress_bar
from mixseq.cli.files import check_target, write_frames
from mixseq.cli.options import FILE, examples, quiet_option, workers_options, writer_options
from mixseq.errors import SettingsError

if TYPE_CHECKING:
    from mixseq.mapping import OrderedMap
    from mixseq.sequence import SequenceHeader
    from mixseq.signals import Model


def _as_seconds(
    context: click.Context, option: click.Parameter, value: str | None
) -> tuple[float, ...] | None:
    if value is None:
        return None
    try:
        return tuple(float(item) for item in value.split(","))
    except ValueError:
        raise click.BadParameter(f"{value!r} is not a list of seconds such as 0,0.5,1.25") from None


@click.command(
    "decode",
    epilog=examples(
        "mixseq decode walk.h5 walk48.usdc --fps 48",
        "mixseq decode walk.h5 still.obj --times 0.73",
        "mixseq decode walk.h5 slow.usdc --fps 240 --start 0.5 --end 1 --velocities",
        "mixseq decode walk.h5 again.usdc --cluster tcp://host:8786",
    ),
)
@click.argument("source", metavar="MODEL", type=FILE)
@click.argument("target", type=FILE)
@click.option(
    "--fps",
    type=click.FloatRange(min=0, min_open=True, max=1_000_000),
    metavar="N",
    help="Frames per second.  [default: the original frames]",
)
@click.option(
    "--times", callback=_as_seconds, metavar="S,S,...", help="Decode exactly these times, in seconds."
)
@click.option("--start", type=float, metavar="S", help="First time in seconds.  [default: that of the model]")
@click.option("--end", type=float, metavar="S", help="Last time in seconds.  [default: that of the model]")
@click.option(
    "--velocities/--no-velocities",
    default=False,
    show_default=True,
    help="Also write the velocities of all vertices, for motion blur.",
)
@writer_options
@workers_options
@quiet_option
def command(
    source: Path,
    target: Path,
    fps: float | None,
    times: tuple[float, ...] | None,
    start: float | None,
    end: float | None,
    velocities: bool,
    writing: dict[str, Any],
    workers: AbstractContextManager[OrderedMap],
    quiet: bool,
) -> None:
    """Turn a model back into a sequence, at any frame rate.

    TARGET's format follows from its extension, see "mixseq formats". It is written while frames are decoded.
    """
    check_target(target, source)
    model = mixseq.load(source)
    if times is None:
        header = _range(model, fps, start, end)
    elif start is None and end is None:
        header = model.header_at(times, fps)
    else:
        raise SettingsError("--times tells all times; leave out --start and --end")
    with workers as work, progress_bar(quiet) as progress:
        write_frames(target, model, header, velocities, writing, progress, work)
    if not quiet:
        first, last = header.times[[0, -1]]
        print_table(
            [
                ("frames", f"{header.frame_count}"),
                ("time", f"{first:g} to {last:g} s at {header.fps:g} frames per second"),
            ]
        )
    announce(target)


def _range(model: Model, fps: float | None, start: float | None, end: float | None) -> SequenceHeader:
    """Choose frames from `start` to `end`: at the rate `fps` from the start on, else the original ones."""
    import numpy as np

    first = float(model.times[0]) if start is None else start
    last = float(model.times[-1]) if end is None else end
    if not (np.isfinite(first) and np.isfinite(last) and first <= last):
        raise SettingsError(f"there is no time between the start, {first:g} s, and the end, {last:g} s")
    slack = 1e-6 / (fps or model.header.fps)
    if start is None and end is None:
        return model.header_at(fps=fps)
    if fps is not None:
        for time in (first, last):
            model.header_at([time], fps)  # refuses what could not be counted
        steps = np.arange(int((last - first + slack) * fps) + 1)
        return model.header_at(np.minimum(first + steps / fps, last), fps)
    times = model.times[(model.times >= first - slack) & (model.times <= last + slack)]
    if not times.size:
        raise SettingsError(
            f"the model has no frame from {first:g} to {last:g} s; give --fps to make new ones"
        )
    return model.header_at(times)
