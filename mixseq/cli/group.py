"""A group of commands that loads each one when it is needed, and fails in one line."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from functools import partial
from importlib import import_module
from typing import Any

import click

from mixseq.cli.failures import exit_code


class LazyGroup(click.Group):
    """Commands in modules of a package, each of which calls its own ``command``.

    Parameters
    ----------
    package : str
        The package.
    sections : dict of tuple of str
        Names of the commands and of their modules, under the titles that help gives them.
    **settings
        What every `click.Group` takes.
    """

    def __init__(self, package: str, sections: Mapping[str, tuple[str, ...]], **settings: Any) -> None:
        super().__init__(**settings)
        self._package = package
        self._sections = sections

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the commands' names."""
        return [name for names in self._sections.values() for name in names]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command."""
        if cmd_name not in self.list_commands(ctx):
            return None
        command: click.Command = import_module(f"{self._package}.{cmd_name}").command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands, by what they are for."""
        width = formatter.width - 6 - max(map(len, self.list_commands(ctx)))
        for title, names in self._sections.items():
            commands = ((name, self.get_command(ctx, name)) for name in names)
            with formatter.section(title):
                formatter.write_dl(
                    [(name, each.get_short_help_str(width)) for name, each in commands if each]
                )

    def main(self, *args: Any, standalone_mode: bool = True, **settings: Any) -> Any:
        """Run the command line, as `click.Group.main` does, with our own messages."""
        run = partial(super().main, *args, standalone_mode=False, **settings)
        if not standalone_mode:
            return run()
        sys.exit(exit_code(run))
