"""Settings: rare options, given as ``--set NAME=VALUE``, to keep the list of options short.

The setting ``joint_width`` is also the option ``--joint-width``. Help lists settings apart from options.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import click

ON = ("yes", "true", "on", "1")
OFF = ("no", "false", "off", "0")


class Setting(click.Option):
    """An option listed among the settings."""

    @property
    def key(self) -> str:
        """Name of the setting."""
        return self.opts[-1].removeprefix("--").replace("-", "_")

    def usage(self, ctx: click.Context) -> str:
        """Return the usage of the setting in help."""
        return f"{self.key}={'yes' if self.is_flag else self.make_metavar(ctx)}"

    def spelled(self, value: str) -> list[str]:
        """Return the arguments of a value."""
        if not self.is_flag:
            return [self.opts[-1], value]
        if value.lower() in ON:
            return [self.opts[-1]]
        if value.lower() not in OFF:
            raise click.BadParameter(f"{self.key}={value} is neither yes nor no", param_hint="'--set'")
        return self.secondary_opts[-1:]


setting = partial(click.option, cls=Setting)
"""Decorator like `click.option`, for a setting."""


class CommandWithSettings(click.Command):
    """A command with settings listed after its options; if it has any, it gets the option ``--set``."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        if self.settings:
            text = "One of the settings below; may be given several times."
            self.params.append(
                click.Option(["--set"], metavar="NAME=VALUE", multiple=True, expose_value=False, help=text)
            )

    @property
    def settings(self) -> dict[str, Setting]:
        """Its settings by name."""
        return {each.key: each for each in self.params if isinstance(each, Setting)}

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse arguments, with settings expanded to options."""
        return super().parse_args(ctx, list(self._spelled(ctx, args)) if self.settings else args)

    def _spelled(self, ctx: click.Context, args: list[str]) -> Iterator[str]:
        rest = iter(args)
        for arg in rest:
            option, given, text = arg.partition("=")
            if option != "--set":
                yield arg
                if arg == "--":
                    yield from rest
                continue
            if not given:
                text = next(rest, "")
            name, given, value = text.partition("=")
            found = self.settings.get(name.replace("-", "_"))
            if found is None or not given:
                names = ", ".join(self.settings)
                raise click.BadParameter(
                    f"{text!r} is not NAME=VALUE with one of: {names}", ctx=ctx, param_hint="'--set'"
                )
            yield from found.spelled(value)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, and after them the settings."""
        options, settings = [], []
        for param in self.get_params(ctx):
            record = param.get_help_record(ctx)
            if isinstance(param, Setting) and record is not None:
                settings.append((param.usage(ctx), record[1]))
            elif isinstance(param, click.Option) and record is not None:
                options.append(record)
        for title, rows in (("Options", options), ("Settings (--set NAME=VALUE)", settings)):
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)
