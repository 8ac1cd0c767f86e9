"""The camera option of films, pages and the viewer."""

from __future__ import annotations

import click

from mixseq.cli.settings import setting


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
