"""Arguments and options shared by several commands.

Settings: rare options, given as ``--set NAME=VALUE``, to keep the list of options short.

The setting ``joint_width`` is also the option ``--joint-width``. Help lists settings apart from options.

The camera option of films, pages and the viewer.

Frames chosen by their numbers in the time line: ``1005-1010``, ``1001,1005-1010``.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mixseq.choices import PLACEMENTS, PROJECTIONS, SEGMENTATIONS, SPACES
from mixseq.errors import SettingsError
from mixseq.sequence.frame_rates import NEAR, frames_text, number_at, number_text, rate_text, time_of

if TYPE_CHECKING:
    from mixseq.runtime.parallel import Executor
    from mixseq.sequence.header import SequenceHeader
    from mixseq.types import FloatArray


ON = ("yes", "true", "on", "1")
OFF = ("no", "false", "off", "0")


class Setting(click.Option):
    """An option listed among the settings."""

    @property
    def key(self) -> str:
        """Name of the setting."""
        return self.opts[-1].removeprefix("--").replace("-", "_")

    def usage(self, ctx: click.Context) -> str:
        """Return the usage of the setting in help."""
        return f"{self.key}={'yes' if self.is_flag else self.make_metavar(ctx)}"

    def spelled(self, value: str) -> list[str]:
        """Return the arguments of a value."""
        if not self.is_flag:
            return [self.opts[-1], value]
        if value.lower() in ON:
            return [self.opts[-1]]
        if value.lower() not in OFF:
            raise click.BadParameter(f"{self.key}={value} is neither yes nor no", param_hint="'--set'")
        return self.secondary_opts[-1:]


setting = partial(click.option, cls=Setting)
"""Decorator like `click.option`, for a setting."""


class CommandWithSettings(click.Command):
    """A command with settings listed after its options; if it has any, it gets the option ``--set``."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        if self.settings:
            text = "One of the settings below; may be given several times."
            self.params.append(
                click.Option(["--set"], metavar="NAME=VALUE", multiple=True, expose_value=False, help=text)
            )

    @property
    def settings(self) -> dict[str, Setting]:
        """Its settings by name."""
        return {each.key: each for each in self.params if isinstance(each, Setting)}

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse arguments, with settings expanded to options."""
        return super().parse_args(ctx, list(self._spelled(ctx, args)) if self.settings else args)

    def _spelled(self, ctx: click.Context, args: list[str]) -> Iterator[str]:
        rest = iter(args)
        for arg in rest:
            option, given, text = arg.partition("=")
            if option != "--set":
                yield arg
                if arg == "--":
                    yield from rest
                continue
            if not given:
                text = next(rest, "")
            name, given, value = text.partition("=")
            found = self.settings.get(name.replace("-", "_"))
            if found is None or not given:
                names = ", ".join(self.settings)
                raise click.BadParameter(
                    f"{text!r} is not NAME=VALUE with one of: {names}", ctx=ctx, param_hint="'--set'"
                )
            yield from found.spelled(value)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, and after them the settings."""
        options, settings = [], []
        for param in self.get_params(ctx):
            record = param.get_help_record(ctx)
            if isinstance(param, Setting) and record is not None:
                settings.append((param.usage(ctx), record[1]))
            elif isinstance(param, click.Option) and record is not None:
                options.append(record)
        for title, rows in (("Options", options), ("Settings (--set NAME=VALUE)", settings)):
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)


def _as_camera(
    context: click.Context, option: click.Parameter, value: str | None
) -> tuple[float, float] | None:
    if value is None:
        return None
    try:
        angle, height = map(float, value.split(","))
    except ValueError:
        raise click.BadParameter(f"{value!r} is no angle and height such as 30,15") from None
    return angle, height


camera_option = setting(
    "--camera",
    callback=_as_camera,
    metavar="ANGLE,HEIGHT",
    help="Degrees from the body's front, to its left, and above the horizon.  [default: front and a side]",
)
"""Option ``--camera``; the command gets ``camera``, a pair of numbers or None."""


Command = Callable[..., None]

FILE = click.Path(path_type=Path)

quiet_option = click.option("-q", "--quiet", is_flag=True, help="Print neither progress nor tables.")
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")


def examples(*lines: str) -> str:
    """Return the end of a help text, marked so that click does not reflow it."""
    return "\b\nExamples:\n" + "\n".join(f"  {line}" for line in lines)


def reader_options(command: Command) -> Command:
    """Add the options of the formats' readers; the command gets the given ones as ``reading``."""

    @click.option(
        "--prim",
        metavar="PATH",
        help="Mesh to read, or something above it, in USD, Alembic and glTF; / is all.  [default: all that move]",
    )
    @setting(
        "--animation",
        metavar="NAME",
        help="Animation to read of glTF; none is the pose at rest.  [default: the first]",
    )
    @setting(
        "--input-fps",
        "fps",
        type=float,
        metavar="N",
        help="Frames per second of numbered files, npz and PC2, or to sample glTF at.  [default: 24, or its keys]",
    )
    @setting(
        "--start-frame",
        type=float,
        metavar="N",
        help="Number of the first frame, where the file does not tell; 1001 is at 41.708 s of 24 frames per second.",
    )
    @setting("--mesh", type=FILE, help="Mesh of a point cache.  [default: the file of the same name]")
    @setting("--allow-gaps", is_flag=True, help="Accept missing numbers among numbered files.")
    @setting(
        "--up-axis",
        type=click.Choice(["X", "Y", "Z"]),
        help="Axis that points up, where the file does not tell; nothing is turned.",
    )
    @setting(
        "--units",
        "metres_per_unit",
        type=click.FloatRange(min=0, min_open=True),
        metavar="M",
        help="Metres per unit, where the file does not tell; nothing is scaled.",
    )
    @wraps(command)
    def with_options(
        *args: Any,
        prim: str | None,
        animation: str | None,
        fps: float | None,
        start_frame: float | None,
        mesh: Path | None,
        allow_gaps: bool,
        up_axis: str | None,
        metres_per_unit: float | None,
        **settings: Any,
    ) -> None:
        given = {
            "up_axis": up_axis,
            "metres_per_unit": metres_per_unit,
            "prim": prim,
            "animation": animation,
            "fps": fps,
            "start_frame": start_frame,
            "mesh": mesh,
            "allow_gaps": allow_gaps or None,
        }
        command(*args, reading=_those_given(given), **settings)

    return with_options


def _unit(context: click.Context, option: click.Parameter, value: str | None) -> float | None:
    from mixseq.sequence.sequence import metres_of

    return None if value is None else metres_of(value)


def writer_options(command: Command) -> Command:
    """Add the options of writing sequences; the command gets the given ones as ``writing``."""

    @click.option(
        "--flatten", is_flag=True, help="Write USD, Alembic or glTF that does not build on the original file."
    )
    @setting(
        "--keep-start",
        is_flag=True,
        help="Write glTF whose animation begins when the sequence does, and not at 0.",
    )
    @setting(
        "--onto", type=FILE, help="The original file to build on, if it is not where the sequence came from."
    )
    @setting(
        "--clips",
        type=click.IntRange(min=1),
        metavar="N",
        help="Write USD as value clips of N frames per file.",
    )
    @setting(
        "--pack-from",
        type=FILE,
        metavar="FOLDER",
        help="Also pack textures that are in this folder into a .usdz, not only those in the original's.",
    )
    @setting(
        "--convert-axes",
        type=click.Choice(["Y", "Z"]),
        help="Turn the sequence, so that this axis points up.  [default: as it is]",
    )
    @setting(
        "--convert-units",
        callback=_unit,
        metavar="m|cm|...",
        help="Scale the sequence to mm, cm, m, km, in, ft, yd, or a unit of so many metres.  [default: as it is]",
    )
    @wraps(command)
    def with_options(
        *args: Any,
        flatten: bool,
        keep_start: bool,
        onto: Path | None,
        clips: int | None,
        pack_from: Path | None,
        convert_axes: str | None,
        convert_units: float | None,
        **settings: Any,
    ) -> None:
        given = {
            "convert_axes": convert_axes,
            "convert_units": convert_units,
            "flatten": flatten or None,
            "keep_start": keep_start or None,
            "onto": onto,
            "clips": clips,
            "pack_from": pack_from,
        }
        command(*args, writing=_those_given(given), **settings)

    return with_options


def fit_options(command: Command) -> Command:
    """Add the options of fitting shared by files and batches; the command gets all of them as ``fitting``."""

    @click.option("--exact", is_flag=True, help="Keep everything; frames come back up to rounding.")
    @click.option(
        "--tolerance",
        type=click.FloatRange(min=0, min_open=True),
        metavar="X",
        help="Largest error of a vertex, in diagonals of the bounding box.  [default: 0.0005, lossless to the eye]",
    )
    @click.option(
        "--rank",
        type=click.IntRange(min=0),
        metavar="N",
        help="Number of shape modes; parts stay in place exactly.",
    )
    @space_options
    @wraps(command)
    def with_options(*args: Any, making: dict[str, Any], **settings: Any) -> None:
        detail = {name: settings.pop(name) for name in ("exact", "tolerance", "rank")}
        command(*args, fitting=detail | making, **settings)

    return with_options


def space_options(command: Command) -> Command:
    """Add the options of shape spaces; the command gets all of them as ``making``, plain values."""

    @click.option(
        "--space",
        type=click.Choice(SPACES),
        default="mixed",
        show_default=True,
        help="Shape space: parts and joints, vertices, deformation gradients, LRI coordinates, lengths and angles.",
    )
    @click.option(
        "--parts",
        type=click.IntRange(min=1),
        metavar="N",
        help="Number of parts; every connected component has at least one.  [default: automatic]",
    )
    @setting(
        "--segmentation",
        type=click.Choice(SEGMENTATIONS),
        default="motion",
        show_default=True,
        help="How parts are found.",
    )
    @setting(
        "--joint-width",
        type=click.IntRange(min=1),
        default=3,
        show_default=True,
        metavar="N",
        help="Largest width of joints, in strips of triangles on each side of a boundary.",
    )
    @setting(
        "--placement",
        type=click.Choice(PLACEMENTS),
        default="anchored",
        show_default=True,
        help="How parts are placed: by a pose each, or where lengths and angles put them.",
    )
    @setting(
        "--projection",
        type=click.Choice(PROJECTIONS),
        help="How the edge space finds meshes: in a few steps, or by Gauss-Newton.  [default: steps]",
    )
    @setting(
        "--volume",
        type=click.FloatRange(min=0),
        metavar="W",
        help="Weight of the volume in the edge space, with --projection dso.  [default: 0]",
    )
    @wraps(command)
    def with_options(*args: Any, **settings: Any) -> None:
        making = {name: settings.pop(name) for name in _MAKING}
        command(*args, making=_those_given(making), **settings)

    return with_options


_MAKING = (
    *("space", "parts", "segmentation", "joint_width", "placement"),
    *("projection", "volume"),
)


def labels_options(command: Command) -> Command:
    """Add the options of labels made elsewhere; the command gets ``labels`` and ``label_source``."""
    from_file = click.option(
        "--labels",
        type=FILE,
        metavar="FILE",
        help="Parts from labels of the faces made elsewhere: npz, or the same mesh in USD, OBJ, PLY, glTF, ...",
    )
    by = click.option(
        "--source",
        "label_source",
        metavar="NAME",
        help="Which labels in that file, or else in the sequence's own: labels, groups, materials, colours, skeleton, "
        "or a family of USD subsets.  [default: the only ones]",
    )
    return from_file(by(command))


def workers_options(command: Command) -> Command:
    """Add the options of parallel work; the command gets ``workers``, a context that yields an `Executor`."""

    @click.option(
        "--threads", type=click.IntRange(min=1), metavar="N", help="Threads to work on.  [default: all cores]"
    )
    @click.option(
        "--cluster",
        metavar="ADDRESS",
        help="Work on a dask cluster: tcp://host:8786, or local:N for N processes here.",
    )
    @wraps(command)
    def with_options(*args: Any, threads: int | None, cluster: str | None, **settings: Any) -> None:
        command(*args, workers=_workers(threads, cluster), **settings)

    return with_options


def _workers(threads: int | None, address: str | None) -> AbstractContextManager[Executor]:
    if address is None:
        return threads_held(threads)
    if threads is not None:
        raise SettingsError("--threads and --cluster exclude each other; a cluster has threads of its own")
    from mixseq.runtime.cluster import cluster

    return cluster(address)


@contextmanager
def threads_held(count: int | None) -> Iterator[Executor]:
    """Set the number of threads meanwhile, also for code without the executor."""
    from mixseq.runtime.parallel import on_threads

    before = os.environ.get("MIXSEQ_THREADS")
    if count is not None:
        os.environ["MIXSEQ_THREADS"] = str(count)
    try:
        yield on_threads()
    finally:
        if count is not None:
            os.environ.pop("MIXSEQ_THREADS")
        if before is not None:
            os.environ["MIXSEQ_THREADS"] = before


def _those_given(options: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in options.items() if value is not None}


_RANGE = re.compile(r"\s*(-?\d+)(?:-(-?\d+))?\s*")


@dataclass(frozen=True)
class FrameChoice:
    """Frames by their numbers."""

    ranges: tuple[tuple[int, int], ...]  # first and last number of every range; equal for a single frame

    def indices(self, header: SequenceHeader) -> list[int]:
        """Return the indices of the chosen frames of a sequence, in order."""
        import numpy as np

        numbers = header.times * header.fps
        chosen = np.zeros(header.frame_count, dtype=bool)
        for first, last in self.ranges:
            self._check(header, first, last)
            within = (numbers >= first - NEAR) & (numbers <= last + NEAR)
            if not within.any():
                header.index_of(first)
            chosen |= within
        return [int(index) for index in np.flatnonzero(chosen)]

    def span(self, header: SequenceHeader) -> tuple[float, float]:
        """Return the times of the first and last chosen frame, in seconds."""
        if len(self.ranges) > 1:
            raise SettingsError("--frames is one range here, such as 1005-1010")
        ((first, last),) = self.ranges
        self._check(header, first, last)
        return time_of(first, header.fps), time_of(last, header.fps)

    def _check(self, header: SequenceHeader, *numbers: int) -> None:
        low, high = header.times[0] * header.fps - NEAR, header.times[-1] * header.fps + NEAR
        for number in numbers:
            if not low <= number <= high:
                raise SettingsError(
                    f"there is no frame {number_text(number)}; frames are {header.frame_numbers}"
                )


def _as_choice(context: click.Context, option: click.Parameter, value: str | None) -> FrameChoice | None:
    if value is None:
        return None
    found = [_RANGE.fullmatch(part) for part in value.split(",")]
    ranges = [(int(each[1]), int(each[2] or each[1])) for each in found if each]
    if len(ranges) < len(found) or any(first > last for first, last in ranges):
        raise click.BadParameter(f"{value!r} is not a range of frames such as 1005-1010, or a list of them")
    return FrameChoice(tuple(ranges))


def frames_option(help_text: str, metavar: str = "A-B") -> Callable[[Command], Command]:
    """Return the option ``--frames``; the command gets ``frames``, a `FrameChoice` or None."""
    return click.option("--frames", callback=_as_choice, metavar=metavar, help=help_text)


def chosen_blocks(blocks: Iterable[FloatArray], indices: Iterable[int]) -> Iterator[FloatArray]:
    """Yield the chosen frames of a sequence's blocks, in order; later ones are not read."""
    left, first = sorted(indices), 0
    for block in blocks:
        here = [index - first for index in left if index < first + len(block)]
        if here:
            yield block[here]
        left, first = left[len(here) :], first + len(block)
        if not left:
            return


def time_rows(header: SequenceHeader) -> list[tuple[str, str]]:
    """Return table rows about the written frames."""
    first, last = (float(time) for time in header.times[[0, -1]])
    numbers = (number_at(time, header.fps) for time in (first, last))
    return [
        ("frames", frames_text(header.frame_count, *numbers)),
        ("time", f"{first:g} to {last:g} s at {rate_text(header.fps)} frames per second"),
    ]
