"""Command line interface: one module per subcommand, imported when the subcommand runs.

Modules here import numerical packages only when a subcommand runs, so that ``mixseq --help`` answers at once.
"""

from __future__ import annotations

import click

import mixseq
from mixseq.cli.group import LazyGroup
from mixseq.cli.options import HELP_OPTIONS, examples


@click.command(
    cls=LazyGroup,
    package=__name__,
    sections={
        "Look": ("demo", "info", "plot", "view", "formats"),
        "Share": ("convert", "encode", "batch", "decode", "web", "blender"),
        "Change": ("resample", "edit", "interpolate", "transfer", "segment"),
        "Check": ("compare", "verify"),
        "Prepare": ("warm-up",),
    },
    epilog=examples("mixseq demo", "mixseq encode walk.usdc walk.h5", "mixseq decode walk.h5 walk48.usdc --fps 48"),
    invoke_without_command=True,
    context_settings={"help_option_names": HELP_OPTIONS, "max_content_width": 100},
)
@click.version_option(mixseq.__version__, message="mixseq %(version)s")
@click.pass_context
def main(context: click.Context) -> None:
    """Take deforming mesh sequences into the mixed shape space and back."""
    if context.invoked_subcommand is None:
        click.echo(context.get_help())
