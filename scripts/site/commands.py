"""The page about all commands and their options, made from the code of the command line."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from html import escape

import click

from mixseq.cli import main
from mixseq.cli.options import Setting

INTRODUCTION = """# Commands and options

Made from the code: what `mixseq COMMAND --help` prints. [Command line](cli.md) tells more about each.
"""


def commands_page() -> str:
    """Return the page, in Markdown."""
    context = click.Context(main, info_name="mixseq", **main.context_settings)
    overview = ["| command | what it does |", "|---|---|"]
    sections = []
    for name in main.list_commands(context):
        command = main.get_command(context, name)
        assert command is not None
        overview.append(f"| [`{name}`](#mixseq-{name}) | {_plain(command.get_short_help_str(200))} |")
        sections.append("\n\n".join(_section(command, click.Context(command, info_name=name, parent=context))))
    return "\n\n".join([INTRODUCTION, "\n".join(overview), *sections]) + "\n"


def _section(command: click.Command, context: click.Context) -> Iterator[str]:
    yield f"## {context.command_path}"
    usage = " ".join([context.command_path, *command.collect_usage_pieces(context)])
    yield f"```text\n{usage}\n```"
    for paragraph in inspect.cleandoc(command.help or "").replace("\b\n", "").split("\n\n"):
        yield _plain(" ".join(paragraph.split()))
    rows = ["| option | meaning |", "|---|---|"]
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        if record is not None and isinstance(parameter, click.Option):
            names, meaning = record
            if isinstance(parameter, Setting):
                names = f"--set {parameter.usage(context)}"
            rows.append(f"| {_code(names)} | {_plain(meaning)} |")
    yield "\n".join(rows)
    more, _, examples = (command.epilog or "").replace("\b\n", "").partition("Examples:\n")
    if more:
        yield f"```text\n{more.strip()}\n```"
    if examples:
        yield f"```sh\n{inspect.cleandoc(examples)}\n```"


def _plain(text: str) -> str:
    """Escape what Markdown takes for more than text."""
    return re.sub(r"([*_<>`\[\]#$|])", r"\\\1", text)


def _code(text: str) -> str:
    """Return code for a cell of a table, where Markdown keeps the backslash of an escaped bar."""
    return f"<code>{escape(text).replace('|', '&#124;')}</code>"
