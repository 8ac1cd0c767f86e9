"""Implement the command ``mixseq formats``."""

from __future__ import annotations

from collections.abc import Sequence

import click

from mixseq.cli import options
from mixseq.cli.group import print_table
from mixseq.cli.options import setting

Table = Sequence[Sequence[str]]


@options.command(
    "formats",
    "mixseq formats",
    "mixseq formats --set markdown=yes",
    markdown=setting("--markdown", "Print the tables in Markdown."),
)
def command(markdown: bool) -> None:
    """List the file formats, with the data that each can hold, the motion that is read from it, and its options."""
    from mixseq_io.registry import capability_table, motion_table

    capabilities = capability_table()
    tables = [capabilities, motion_table()]
    if not markdown:  # in two tables, which fit a terminal
        split = capabilities[0].index("uvs")
        tables[:1] = [[row[:split] for row in capabilities], [(row[0], *row[split:]) for row in capabilities]]
    for number, (titles, *rows) in enumerate(tables):
        if number:
            click.echo()
        if markdown:
            click.echo(as_markdown([titles, *rows]))
        else:
            print_table(rows, titles)


def as_markdown(table: Table) -> str:
    """Format a table as Markdown; the first row has the column titles."""
    titles, *rows = table
    lines = [titles, ["---"] * len(titles), *rows]
    return "\n".join("|" + "|".join(row) + "|" if row[0] == "---" else "| " + " | ".join(row) + " |" for row in lines)
