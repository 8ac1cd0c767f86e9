"""``mixseq formats``."""

from __future__ import annotations

import click

from mixseq.cli.console import print_table
from mixseq.cli.options import examples


@click.command("formats", epilog=examples("mixseq formats"))
def command() -> None:
    """List the file formats."""
    from mixseq_io import FORMATS

    print_table(
        (
            (
                form.name,
                " ".join(
                    f"{each} (only read)" if each in form.unwritable else each for each in form.extensions
                ),
                form.description,
            )
            for form in FORMATS
        ),
        heading=("format", "extensions", "holds"),
    )
