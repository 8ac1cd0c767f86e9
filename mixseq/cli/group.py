"""A command group that imports commands on demand, and reports errors in one line, without a traceback.

Exit codes:

====  ======================================================================
0     success
1     the reader of a pipe went away; an asset of a batch failed; or a bound does not hold
2     an error that the user can fix
130   interrupted by Ctrl-C
129   its terminal was closed
143   terminated by a signal
====  ======================================================================

Anything else is a bug in mixseq, and those do come with a traceback.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from typing import Any

import click

from mixseq.cli.address_space import is_short_of_memory, make_do
from mixseq.cli.console import say
from mixseq.errors import MixseqError, MixseqWarning
from mixseq.interrupts import unwinding
from mixseq.warned import warnings_heard


class LazyGroup(click.Group):
    """Commands in modules of a package, each in its own ``command``."""

    def __init__(
        self,
        package: str,
        sections: Mapping[str, tuple[str, ...]],
        shared: Sequence[click.Option] = (),
        **settings: Any,
    ) -> None:
        super().__init__(**settings)
        self.shared = shared
        self._package = package
        self._sections = sections

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the commands' names."""
        return [name for names in self._sections.values() for name in names]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command."""
        if cmd_name not in self.list_commands(ctx):
            return None
        command: click.Command = import_module(f"{self._package}.{cmd_name.replace('-', '_')}").command
        command.params += [each for each in self.shared if each not in command.params]
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find a command, or suggest the one of most similar spelling."""
        name, commands = args[0], self.list_commands(ctx)
        if name not in commands and not ctx.resilient_parsing:
            from difflib import get_close_matches

            for near in get_close_matches(name, commands, n=1, cutoff=0.7):
                ctx.fail(f"No such command {name!r}; did you mean {near}?")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands, grouped by purpose."""
        width = formatter.width - 6 - max(map(len, self.list_commands(ctx)))
        for title, names in self._sections.items():
            commands = ((name, self.get_command(ctx, name)) for name in names)
            with formatter.section(title):
                formatter.write_dl(
                    [(name, each.get_short_help_str(width)) for name, each in commands if each]
                )

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; help needs no memory."""
        if not set(ctx.help_option_names) & set(ctx.args):
            make_do()
        return super().invoke(ctx)

    def main(self, *args: Any, standalone_mode: bool = True, **settings: Any) -> Any:
        """Run the command line as `click.Group.main` does, with mixseq's messages."""
        run = partial(super().main, *args, standalone_mode=False, **settings)
        if not standalone_mode:
            return run()
        sys.exit(exit_code(run))


def exit_code(run: Callable[[], object]) -> int:
    """Run a command, report its errors and warnings, and return the exit code of the process."""
    try:
        with _warnings_in_one_line(), unwinding():
            result = run()
        return result if isinstance(result, int) else 0
    except MixseqError as error:
        _say(f"error: {error}")
    except click.ClickException as error:
        _say(f"error: {error.format_message()}{_hint(error)}")
    except (click.Abort, KeyboardInterrupt):
        _say("interrupted")
        return 130
    except (OSError, ImportError, RuntimeError) as error:
        if is_short_of_memory(error):
            _say(f"error: there is not enough memory ({str(error).splitlines()[0]})")
        elif isinstance(error, OSError):
            where = f"{error.filename}: " if error.filename else ""
            _say(f"error: {where}{error.strerror or error}")
        else:
            raise
    except MemoryError as error:
        _say(f"error: there is not enough memory {f'({error})' if str(error) else ''}")
    return 2


def _hint(error: click.ClickException) -> str:
    context = error.ctx if isinstance(error, click.UsageError) else None
    return f" (see {context.command_path} --help)" if context else ""


def _say(message: str) -> None:
    """Print a message on one line of stderr; the lines of a list become an enumeration."""
    head, *rest = (line.strip() for line in message.splitlines())
    say(f"mixseq: {head} {', '.join(rest)}".rstrip(), err=True)


@contextmanager
def _warnings_in_one_line() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("always", MixseqWarning)
        with warnings_heard(lambda text: _say(f"warning: {text}"), instead=True):
            yield
