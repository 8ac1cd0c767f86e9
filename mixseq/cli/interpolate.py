"""Implement the command ``mixseq interpolate``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

import mixseq
from mixseq.cli import options
from mixseq.cli.files import Claim, LabelChoice, write_sequence
from mixseq.cli.group import announce, print_table, progress_bar
from mixseq.cli.options import argument, option
from mixseq.errors import SettingsError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class Pose(NamedTuple):
    """A frame and its optional weight."""

    frame: int
    weight: float | None


def pose_of(text: str) -> Pose:
    """Parse ``FRAME=WEIGHT`` or ``FRAME``; weights may be fractions, such as ``2=1/4``."""
    frame, has_weight, weight = text.partition("=")
    above, divided, below = weight.partition("/")
    try:
        number = float(above) / float(below if divided else 1) if has_weight else None
        if number is None or math.isfinite(number):
            return Pose(int(frame), number)
    except (ValueError, ZeroDivisionError):
        pass
    raise click.BadParameter(f"{text!r} is not FRAME=WEIGHT, for example 2=0.5 or 2=1/3")


@options.command(
    "interpolate",
    "mixseq interpolate lion.npz half.obj --pose 2=0.5 --pose 5=0.5",
    "mixseq interpolate lion.npz mean.ply --pose 0=1/3 --pose 2=1/3 --pose 5=1/3 --space edge",
    "mixseq interpolate lion.npz morph.usdc --pose 2 --pose 5 --steps 24",
    source=argument(metavar="IN"),
    target=argument(metavar="OUT"),
    poses=option(
        "--pose FRAME[=WEIGHT]",
        "A frame of IN, counted from 0, and its weight; give several. The weights add up to one.",
        type=pose_of,
        multiple=True,
    ),
    steps=option(
        "--steps N",
        "Write N frames from one pose to another, two without weights, instead of one blend.",
        type=click.IntRange(min=2),
    ),
)
def command(
    source: Path,
    target: Path,
    poses: tuple[Pose, ...],
    steps: int | None,
    making: dict[str, Any],
    labels: LabelChoice,
    reading: dict[str, Any],
    writing: dict[str, Any],
    workers: options.Workers,
    claim: Claim,
    quiet: bool,
) -> None:
    """Blend poses of a mesh in a shape space.

    IN is a sequence in any format, whose frames are the poses. OUT is one frame, the blend of the poses. The parts of
    the mesh are found from all frames of IN, including frames without a weight.

    With --steps, OUT is a sequence of even steps from the first --pose to the second. Two frames need no --pose.
    """
    _check(poses, steps)
    claim(target)
    from mixseq.operations.interpolation import PoseInterpolator

    with workers as work, progress_bar(quiet) as progress, mixseq.open_sequence(source, **reading) as reader:
        numbered = [pose._replace(frame=reader.header.index_of(pose.frame)) for pose in poses]
        weights = _weights(numbered, steps, reader.header.frame_count)
        making["parts"] = labels.parts(reader, making.get("parts"), reading)
        used = [pose for pose, column in enumerate(weights.T) if column.any()]
        interpolator = PoseInterpolator.from_poses(reader, **making, pose_ids=used, progress=progress, workers=work)
        header = interpolator.header.with_times([step / interpolator.header.fps for step in range(len(weights))])
        frames = (points[None] for points in interpolator.iterate_blends(weights[:, used], progress, work))
        write_sequence(target, header, frames, None, writing)
    if not quiet:
        named = {pose: reader.header.frame_number(pose) for pose in used}
        names = [name if steps else f"{name} = {weights[0, pose]:g}" for pose, name in named.items()]
        print_table(
            [
                ("space", f"{interpolator.space.name}, dim {interpolator.space.dim:,}"),
                ("poses", ", ".join(names)),
                ("frames", f"{len(weights):,}"),
            ]
        )
    announce(target)


def _check(poses: Sequence[Pose], steps: int | None) -> None:
    """Raise an error for invalid poses before the sequence is read."""
    frames = [pose.frame for pose in poses]
    for pose in poses:
        if frames.count(pose.frame) > 1:
            raise SettingsError(f"--pose {pose.frame} is given more than once; give every frame once")
        if steps is not None and pose.weight is not None:
            raise SettingsError(f"--steps chooses the weights; give --pose {pose.frame} without one")
        if steps is None and pose.weight is None:
            raise SettingsError(f"--pose {pose.frame} has no weight; give --pose {pose.frame}=WEIGHT, or --steps")
    if steps is None and not poses:
        raise SettingsError("there are no poses to blend; give some as --pose FRAME=WEIGHT, or --steps")
    if steps is not None and len(poses) not in (0, 2):
        raise SettingsError(f"--steps goes from one pose to another; give --pose twice, not {len(poses)} times")


def _weights(poses: Sequence[Pose], steps: int | None, count: int) -> NDArray[np.float64]:
    """Return weights ``(m, n)`` of the n frames of a sequence for each of the m frames of the result."""
    import numpy as np

    from mixseq.operations.interpolation import normalise_weights

    if not poses and count != 2:
        raise SettingsError(f"there are {count} poses; name two of them by --pose FRAME --pose FRAME")
    blended = list(poses) or [Pose(0, None), Pose(1, None)]
    weights = np.zeros((steps or 1, count))
    columns = [pose.frame for pose in blended]
    if steps is None:
        weights[0, columns] = [pose.weight for pose in blended]
        normalise_weights(weights[0], count)
    else:
        along = np.linspace(0.0, 1.0, steps)
        weights[:, columns] = np.stack([1.0 - along, along], axis=1)
    return weights
