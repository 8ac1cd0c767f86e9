"""Define the arguments and options of all commands; a command gets a group of options as one argument.

Rare options are settings: ``--joint-width 2`` can be written ``--set joint_width=2``. Help lists settings last.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial
from inspect import signature
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from mixseq.choices import BETWEENS, PLACEMENTS, PROJECTIONS, SEGMENTATIONS, SPACES
from mixseq.cli.files import LabelChoice, claim_of_command
from mixseq.cli.group import parse_length
from mixseq.errors import SettingsError
from mixseq.runtime.parallel import environment
from mixseq.sequence.frame_rates import FRAME_TOLERANCE, format_number, number_to_time

if TYPE_CHECKING:
    from mixseq.runtime.parallel import Executor
    from mixseq.sequence.header import SequenceHeader


Command = Callable[..., None]

YES_WORDS = ("yes", "true", "on", "1")
NO_WORDS = ("no", "false", "off", "0")


class Setting(click.Option):
    """An option that help lists as a setting."""

    @property
    def key(self) -> str:
        """Name of the setting."""
        return self.opts[-1].removeprefix("--").replace("-", "_")

    def usage(self, ctx: click.Context) -> str:
        """Return the usage text of the setting for help."""
        return f"{self.key}={'yes' if self.is_flag else self.make_metavar(ctx)}"

    def arguments(self, value: str) -> list[str]:
        """Return the command-line arguments that give the setting a value."""
        if not self.is_flag:
            return [self.opts[-1], value]
        if value.lower() in YES_WORDS:
            return [self.opts[-1]]
        if value.lower() not in NO_WORDS:
            raise click.BadParameter(f"{self.key}={value} is neither yes nor no", param_hint="'--set'")
        return self.secondary_opts[-1:]


HELP_OPTIONS = ["-h", "--help"]


class CommandWithSettings(click.Command):
    """A command whose help lists settings after options; a command with settings also has the option ``--set``."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        if self.settings:
            text = "One of the settings below; may be given several times."
            self.params.append(
                click.Option(["--set"], metavar="NAME=VALUE", multiple=True, expose_value=False, help=text)
            )

    @property
    def settings(self) -> dict[str, Setting]:
        """Settings of the command by name."""
        return {each.key: each for each in self.params if isinstance(each, Setting)}

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse arguments after expanding ``--set`` to options."""
        return super().parse_args(ctx, list(self._expanded(ctx, args)) if self.settings else args)

    def _expanded(self, ctx: click.Context, args: list[str]) -> Iterator[str]:
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
            matches = self.settings.get(name.replace("-", "_"))
            if matches is None or not given:
                names = ", ".join(self.settings)
                raise click.BadParameter(
                    f"{text!r} is not NAME=VALUE with one of: {names}", ctx=ctx, param_hint="'--set'"
                )
            yield from matches.arguments(value)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, then the settings."""
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


Option = Callable[..., click.Parameter]
"""Function that makes an option from the name of its argument, by default as it is spelled."""


class Group:
    """Options that a command gets as one argument: the result of `gather` for the given ones, as keywords."""

    def __init__(self, *options: Option, gather: Callable[..., Any] = dict) -> None:
        self._options = options
        self.gather = gather

    def make(self) -> list[click.Parameter]:
        """Return the options."""
        return [option() for option in self._options]


Part = Option | Group


def examples(*lines: str) -> str:
    """Return the examples at the end of a help text, marked so that click does not reflow them."""
    return "\b\nExamples:\n" + "\n".join(f"  {line}" for line in lines)


def command(
    name: str, *lines: str, before: str = "", cls: type[CommandWithSettings] = CommandWithSettings, **own: Part
) -> Callable[[Command], CommandWithSettings]:
    """Return a decorator that makes a command; `lines` are the examples at the end of its help.

    The parameters of the function are its arguments and options, in this order: those in `own` and, by the same names,
    those in `SHARED_OPTIONS`.
    """

    def make(function: Command) -> CommandWithSettings:
        keys = [each.name for each in signature(function).parameters.values() if each.default is each.empty]
        parts = {key: own.get(key) or SHARED_OPTIONS[key] for key in keys}
        params = {key: part.make() if isinstance(part, Group) else [part(key)] for key, part in parts.items()}

        def run(**values: Any) -> None:
            for key, part in parts.items():
                if isinstance(part, Group):
                    members = {str(each.name): values.pop(str(each.name)) for each in params[key]}
                    values[key] = part.gather(**{name: value for name, value in members.items() if value is not None})
            function(**values)

        epilog = before + examples(*lines)
        return cls(name, callback=run, params=[*chain(*params.values())], help=function.__doc__, epilog=epilog)

    return make


def given_options(*names: str) -> list[str]:
    """Return the spellings of those options that are on the command line, without switches set to their default."""
    context = click.get_current_context()
    params = {str(param.name): param for param in context.command.params}
    given = []
    for name in names:
        if name in params and context.get_parameter_source(name) is ParameterSource.COMMANDLINE:
            param, is_off = params[name], context.params[name] is False
            if not (is_off and param.default is False):
                given.append(param.secondary_opts[-1] if is_off else param.opts[0])
    return given


def refuse(*names: str, why: str) -> None:
    """Raise an error if one of the options is on the command line; the message names the first such option."""
    for option in given_options(*names):
        raise SettingsError(f"{option} {why}")


# Types ----------------------------------------------------------------------------------------------------

FILE_PATH = click.Path(path_type=Path)
PATH_METAVARS = ("FILE", "FOLDER", "PAGE", "PNG", "SEQUENCE")
POSITIVE_INTEGER = click.IntRange(min=1)
NON_NEGATIVE_INTEGER = click.IntRange(min=0)
POSITIVE_NUMBER = click.FloatRange(min=0, min_open=True)


class FrameRate(click.FloatRange):
    """Frames per second, also as a fraction such as 24000/1001."""

    def __init__(self, highest: float = 1_000_000) -> None:
        super().__init__(min=0, min_open=True, max=highest)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Convert the text of an option."""
        above, slash, below = str(value).partition("/")
        try:
            number = float(above) / float(below) if slash else float(above)
        except (ValueError, ZeroDivisionError):
            self.fail(f"{value!r} is not a frame rate such as 25, 23.976 or 24000/1001", param, ctx)
        return super().convert(number, param, ctx)


_FRAME_RANGE = re.compile(r"\s*(-?\d+)(?:[-:](-?\d+))?\s*")


@dataclass(frozen=True)
class FrameChoice:
    """A choice of frames by their numbers on the time line, such as ``1005-1010``, ``-5:5`` or ``1001,1005-1010``."""

    ranges: tuple[tuple[int, int], ...]  # first and last number of every range; equal for a single frame

    @classmethod
    def from_text(cls, text: str) -> FrameChoice:
        """Parse the text of an option."""
        matches = [_FRAME_RANGE.fullmatch(part) for part in text.split(",")]
        ranges = [(int(each[1]), int(each[2] or each[1])) for each in matches if each]
        if len(ranges) < len(matches) or any(first > last for first, last in ranges):
            raise click.BadParameter(f"{text!r} is not a range of frames such as 1005-1010, or a list of them")
        return cls(tuple(ranges))

    def indices(self, header: SequenceHeader) -> list[int]:
        """Return the indices of the chosen frames of a sequence, in order."""
        import numpy as np

        numbers = header.times * header.fps
        chosen = np.zeros(header.frame_count, dtype=bool)
        for first, last in self.ranges:
            self._check(header, first, last)
            within = (numbers >= first - FRAME_TOLERANCE) & (numbers <= last + FRAME_TOLERANCE)
            if not within.any():
                header.index_of(first)
            chosen |= within
        return [int(index) for index in np.flatnonzero(chosen)]

    def span(self, header: SequenceHeader) -> tuple[float, float]:
        """Return the times in seconds of the first and the last chosen frame."""
        if len(self.ranges) > 1:
            raise SettingsError("--frames is one range here, such as 1005-1010")
        ((first, last),) = self.ranges
        self._check(header, first, last)
        return number_to_time(first, header.fps), number_to_time(last, header.fps)

    def _check(self, header: SequenceHeader, *numbers: int) -> None:
        low, high = (header.times[0] * header.fps - FRAME_TOLERANCE, header.times[-1] * header.fps + FRAME_TOLERANCE)
        for number in numbers:
            if not low <= number <= high:
                raise SettingsError(f"there is no frame {format_number(number)}; frames are {header.frame_numbers}")


def _angles(text: str) -> tuple[float, float]:
    try:
        angle, height = map(float, text.split(","))
    except ValueError:
        raise click.BadParameter(f"{text!r} is no angle and height such as 30,15") from None
    return angle, height


def _shutter(text: str) -> tuple[float, int]:
    angle, comma, samples = text.partition(",")
    try:
        return float(angle), int(samples) if comma else 3
    except ValueError:
        raise click.BadParameter(
            f"{text!r} is no angle, or angle and number of samples, such as 180 or 180,5"
        ) from None


def _unit(text: str) -> float:
    from mixseq.sequence.sequence import parse_unit

    return parse_unit(text)


@contextmanager
def thread_limit(count: int | None) -> Iterator[Executor]:
    """Limit the number of threads inside the ``with`` block, including code that does not use the executor."""
    from mixseq.runtime.parallel import thread_executor

    with environment(**({} if count is None else {"MIXSEQ_THREADS": str(count)})):
        yield thread_executor()


Workers = AbstractContextManager["Executor"]
"""Context of parallel work, which yields an `Executor`."""


def _workers(threads: int | None = None, cluster: str | None = None) -> Workers:
    if cluster is None:
        return thread_limit(threads)
    if threads is not None:
        raise SettingsError("--threads and --cluster exclude each other; a cluster has threads of its own")
    from mixseq.runtime.cluster import connect_to_cluster as connected

    return connected(cluster)


# Options --------------------------------------------------------------------------------------------------
# Commands complete options defined by ``partial``: ``@options.fps(help=...)``.


def argument(**settings: Any) -> Option:
    """Return an argument of a command, by default a path."""
    return lambda key: click.Argument([key], **{"type": FILE_PATH} | settings)


def option(
    spec: str, text: str, name: str | None = None, cls: type[click.Option] = click.Option, **settings: Any
) -> Option:
    """Return an option, spelled ``--name METAVAR`` as in help, with its default shown.

    Without a metavar and a type it is a switch; if the metavar is in `PATH_METAVARS`, the value is a path. In a group,
    `name` is its name if it is spelled differently.
    """
    *spellings, last = spec.split(" ")
    metavar = None if last.startswith("-") else last
    spellings += [last] if metavar is None else []
    settings = {"metavar": metavar, "show_default": settings.get("default") is not None, "help": text} | settings
    if metavar in PATH_METAVARS:
        settings["type"] = FILE_PATH
    elif metavar is None and "type" not in settings:
        settings["is_flag"] = True
    return lambda key=name: cls([*spellings, *([key] if key else [])], **settings)


setting = partial(option, cls=Setting)
"""Make a setting like `option`."""

flag = partial(option, is_flag=True, default=None)
"""Make a switch in a group like `option`; without the switch on the command line there is no value."""

quiet = option("-q --quiet", "Print neither progress nor tables.")
as_json = option("--json", "Print JSON instead of a table.")
out_folder = partial(option, "--out", "Folder for the files, made if missing.", type=FILE_PATH)
frames = partial(option, "--frames A-B", type=FrameChoice.from_text)
fps = partial(option, "--fps N", type=FrameRate())
parts = option(
    "--parts N",
    "Number of parts; every connected component has at least one.  [default: automatic]",
    type=POSITIVE_INTEGER,
)
threads = partial(option, "--threads N", type=POSITIVE_INTEGER)
velocities = partial(option, "--velocities/--no-velocities", default=False)
body = partial(option, "--body NAME")
joint_width = setting(
    "--joint-width N",
    "Largest width of joints, in strips of triangles on each side of a boundary.",
    type=POSITIVE_INTEGER,
    default=3,
)
length = partial(option, type=parse_length)
"""Make an option like `option`, for a fraction of the bounding-box diagonal or a length such as 0.5mm."""

camera = setting(
    "--camera ANGLE,HEIGHT",
    "Degrees from the body's front, to its left, and above the horizon.  [default: front and a side]",
    type=_angles,
)

scalar = option(
    "--scalar FILE",
    "Numbers of the vertices to show as colours, constant or a row for every frame: .npy, .npz or text.",
)

SPACE_OPTIONS = (
    option(
        "--space",
        "Shape space: parts and joints, vertices, deformation gradients, LRI coordinates, lengths and angles.",
        type=click.Choice(SPACES),
        default="mixed",
    ),
    parts,
    setting("--segmentation", "How parts are found.", type=click.Choice(SEGMENTATIONS), default="motion"),
    joint_width,
    setting(
        "--placement",
        "How parts are placed: by a pose each, or where lengths and angles put them.",
        type=click.Choice(PLACEMENTS),
        default="anchored",
    ),
    setting(
        "--projection",
        "How the edge space finds meshes: in a few steps, or by Gauss-Newton.  [default: steps]",
        type=click.Choice(PROJECTIONS),
    ),
    setting(
        "--volume W",
        "Weight of the volume in the edge space, with --projection dso.  [default: 0]",
        type=click.FloatRange(min=0),
    ),
)

# Groups ---------------------------------------------------------------------------------------------------

making = Group(*SPACE_OPTIONS)
"""Options of shape spaces."""


def _fitting(**settings: Any) -> dict[str, Any]:
    if len(given_options("exact", "tolerance", "rank")) > 1:
        raise SettingsError("--exact, --tolerance and --rank exclude each other; give one of them")
    return settings


fitting = Group(
    flag("--exact", "Keep everything; frames come back up to rounding."),
    length(
        "--tolerance X",
        "Largest error of a vertex, as a fraction of the bounding box's diagonal, or 0.5mm.  "
        "[default: 0.0005, lossless to the eye]",
    ),
    option("--rank N", "Number of shape modes; parts stay in place exactly.", type=NON_NEGATIVE_INTEGER),
    *SPACE_OPTIONS,
    gather=_fitting,
)
"""Options of fitting and of shape spaces."""


def _parse_cuts(text: str) -> str | list[float]:
    try:
        return text if text in ("auto", "none") else [float(number) for number in text.split(",")]
    except ValueError:
        raise click.BadParameter(f"{text!r} is not auto, none, or frame numbers such as 1013,1050") from None


sampling = Group(
    setting(
        "--conform N",
        "Play the same frames, with their numbers, at this rate; nothing is interpolated.",
        type=FrameRate(),
    ),
    flag("--hold", "Hold the first and last pose where times are outside SOURCE.", cls=Setting),
    setting(
        "--shutter ANGLE",
        "Also write samples while a shutter is open around each frame, for motion blur: 180, or 180,5 for five.",
        type=_shutter,
    ),
)
"""Options of `mixseq resample` for rates, ends and sub-frames."""

timing = Group(
    setting(
        "--between",
        "Motion between frames: as found in them, smooth through poses on twos and baked keys, straight, "
        "none, or along splines of vertices without parts and joints.  [default: auto]",
        type=click.Choice(BETWEENS),
    ),
    setting(
        "--cuts auto|none|FRAMES",
        "Where the motion jumps: where found, nowhere, or before these frames, such as 1013,1050.  [default: auto]",
        type=_parse_cuts,
    ),
)
"""Options of the motion between frames."""


def at_frames(timing: Mapping[str, Any], header: SequenceHeader) -> dict[str, Any]:
    """Return options of `timing` with indices of frames instead of their numbers."""
    cuts = timing.get("cuts")
    return {**timing, "cuts": [header.index_of(number) for number in cuts]} if isinstance(cuts, list) else {**timing}


reading = Group(
    option(
        "--prim PATH",
        "Mesh to read, or something above it, in USD, Alembic and glTF; / is all.  [default: all that move]",
    ),
    setting(
        "--animation NAME",
        "Animation to read of glTF; none is the pose at rest; in convert, encode, resample and batch, all is a "
        "file for each.  [default: the first]",
    ),
    setting(
        "--input-fps N",
        "Frames per second of numbered files, npz and PC2, or to sample glTF at.  [default: 24, or its keys]",
        name="fps",
        type=FrameRate(),
    ),
    setting(
        "--start-frame N",
        "Number of the first frame, where the file has none; 1001 is at 41.708 s of 24 frames per second.",
        type=float,
    ),
    setting("--mesh", "Mesh of a point cache.  [default: the file of the same name]", type=FILE_PATH),
    flag("--allow-gaps", "Accept missing numbers among numbered files.", cls=Setting),
    setting(
        "--up-axis",
        "Axis that points up, where the file does not say; nothing is turned.",
        type=click.Choice(["X", "Y", "Z"]),
    ),
    setting(
        "--units m|cm|...",
        "Unit, where the file does not say: mm, cm, m, km, in, ft, yd, or metres; nothing is scaled.",
        name="metres_per_unit",
        type=_unit,
    ),
)
"""Options of file readers."""


READING_OPTIONS = {each.opts[0]: str(each.name) for each in reading.make()}
"""Parameters of file readers, by the spelling of their options."""

writing = Group(
    flag("--flatten", "Write USD, Alembic or glTF that does not build on the original file."),
    flag("--keep-start", "Write glTF whose animation begins when the sequence does, and not at 0.", cls=Setting),
    setting("--onto", "The original file to build on, if it is not where the sequence came from.", type=FILE_PATH),
    setting("--clips N", "Write USD as value clips of N frames per file.", type=POSITIVE_INTEGER),
    setting(
        "--pack-from FOLDER",
        "Also pack textures that are in this folder into a .usdz, not only those in the original's.",
    ),
    setting(
        "--convert-axes",
        "Turn the sequence, so that this axis points up.  [default: as it is]",
        type=click.Choice(["Y", "Z"]),
    ),
    setting(
        "--convert-units m|cm|...",
        "Scale the sequence to mm, cm, m, km, in, ft, yd, or a unit in metres.  [default: as it is]",
        type=_unit,
    ),
)
"""Options of sequence writers."""

workers = Group(
    threads("Threads to work on.  [default: all cores]"),
    option("--cluster ADDRESS", "Work on a dask cluster: tcp://host:8786, or local:N for N processes here."),
    gather=_workers,
)
"""Options of parallel work, as `Workers`."""


def picture(beside: str) -> Group:
    """Return the options of a picture drawn in addition to a result."""
    return Group(
        option("--picture PNG", f"Name of the picture.  [default: beside {beside}]"),
        flag("--no-picture", "Draw no picture."),
    )


overwriting = Group(
    option(
        "--overwrite/--no-overwrite",
        "Replace files that exist, or refuse to.  [default: ask, on a terminal]",
        default=None,
    ),
    gather=claim_of_command,
)
"""Option ``--overwrite``; the argument ``claim`` gets a `Claim`, to be called before the work."""

labelling = Group(
    option(
        "--labels FILE",
        "Parts from labels of the faces made elsewhere: npz, or the same mesh in USD, OBJ, PLY, glTF, ...",
    ),
    option(
        "--source NAME",
        "Which labels in that file, or else in the sequence's own: labels, groups, materials, colours, skeleton, "
        "or a family of USD subsets.  [default: the only ones]",
        name="label_source",
    ),
    gather=LabelChoice,
)
"""Options for labels from other programs; the argument ``labels`` gets a `LabelChoice`."""

SHARED_OPTIONS: dict[str, Part] = {
    "source": argument(),
    "target": argument(),
    "velocities": velocities("Also write the velocities of all vertices, for motion blur."),
    "scalar": scalar,
    "reading": reading,
    "writing": writing,
    "making": making,
    "fitting": fitting,
    "parts": parts,
    "joint_width": joint_width,
    "sampling": sampling,
    "timing": timing,
    "labels": labelling,
    "workers": workers,
    "claim": overwriting,
    "as_json": as_json,
    "quiet": quiet,
}
"""Arguments and options of several commands, by the parameters of their functions."""
