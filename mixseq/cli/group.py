"""A group of commands that loads each one when it is needed, and fails in one line."""

from __future__ import annotations

import sys
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
    names : tuple of str
        Names of the commands and of their modules, in the order of the help.
    **settings
        What every `click.Group` takes.
    """

    def __init__(self, package: str, names: tuple[str, ...], **settings: Any) -> None:
        super().__init__(**settings)
        self._package = package
        self._names = names

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the commands' names."""
        return list(self._names)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command."""
        if cmd_name not in self._names:
            return None
        command: click.Command = import_module(f"{self._package}.{cmd_name}").command
        return command

    def main(self, *args: Any, standalone_mode: bool = True, **settings: Any) -> Any:
        """Run the command line, as `click.Group.main` does, with our own messages."""
        run = partial(super().main, *args, standalone_mode=False, **settings)
        if not standalone_mode:
            return run()
        sys.exit(exit_code(run))
