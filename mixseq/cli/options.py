"""Arguments and options shared by several commands."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mixseq.choices import PLACEMENTS, PROJECTIONS, SEGMENTATIONS, SPACES
from mixseq.cli.settings import setting
from mixseq.errors import SettingsError

if TYPE_CHECKING:
    from mixseq.mapping import Executor

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
    from mixseq.unit_conversion import metres_of

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
    from mixseq.cluster import cluster

    return cluster(address)


@contextmanager
def threads_held(count: int | None) -> Iterator[Executor]:
    """Set the number of threads meanwhile, also for code without the executor."""
    from mixseq.mapping import on_threads

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
