"""Settings: options by name and value, listed apart."""

from __future__ import annotations

import re

import click
import pytest
from click.testing import CliRunner

import mixseq
from mixseq.cli import main
from mixseq.cli.options import argument, command, option, setting
from mixseq.spaces.mixed.mixed_space import MixedSpace
from tests.cli.conftest import Run


@command(
    "try",
    words=argument(nargs=-1, type=str),
    loud=option("--loud", "Loudly."),
    how_often=setting("--how-often N", "So often.", type=int),
    polite=setting("--polite/--rude", "Say please.", default=True),
    everything=setting("--all", "All of it."),
)
def tried(words: tuple[str, ...], loud: bool, how_often: int | None, polite: bool, everything: bool) -> None:
    click.echo(f"{' '.join(words)}|{loud}|{how_often}|{polite}|{everything}")


def told(*arguments: str) -> str:
    return CliRunner().invoke(tried, arguments).output.strip()


@pytest.mark.parametrize(
    "arguments",
    [
        ("--set", "how_often=3", "--set", "polite=no", "--set=all=yes", "a"),
        ("--set", "how-often=3", "a", "--set", "all=ON", "--set", "polite=0"),
        ("--how-often", "3", "--rude", "--all", "a"),
    ],
)
def test_settings_are_options_by_name(arguments: tuple[str, ...]) -> None:
    assert told(*arguments) == "a|False|3|False|True"


def test_what_is_off_stays_off() -> None:
    assert told("--set", "all=no", "--set", "polite=yes", "--loud") == "|True|None|True|False"


def test_arguments_may_look_like_settings() -> None:
    assert told("--", "--set", "x") == "--set x|False|None|True|False"


@pytest.mark.parametrize("text", ["", "how_often", "volume=3", "loud=yes"])
def test_other_names_are_refused(text: str) -> None:
    assert "is not NAME=VALUE with one of: how_often, polite, all" in told("--set", text)


def test_switches_are_on_or_off() -> None:
    assert "polite=maybe is neither yes nor no" in told("--set", "polite=maybe")
    assert "'x' is not a valid integer" in told("--set", "how_often=x")


def test_help_lists_settings_apart() -> None:
    options, _, settings = told("--help").partition("Settings (--set NAME=VALUE):")
    assert re.findall(r"--[a-z-]+", options) == ["--loud", "--set", "--help"]
    assert re.findall(r"^  ([a-z_]+)=", settings, re.MULTILINE) == ["how_often", "polite", "all"]


def test_commands_take_settings(run: Run) -> None:
    arguments = ("--set", "placement=free", "--set", "joint_width=1", "--parts", "3")
    assert run("encode", "bar.npz", "new.h5", *arguments).exit_code == 0
    space = mixseq.load("new.h5").space
    assert isinstance(space, MixedSpace)
    assert space.placement == "free"


def test_wrong_values_are_told_in_one_line(run: Run) -> None:
    for arguments, message in (
        (("--set", "joint_width=0"), "0 is not in the range"),
        (("--size", "1MB", "--set", "knots=3"), "--knots is for models"),
    ):
        result = run("encode", "bar.npz", "new.h5", *arguments)
        assert result.exit_code == 2
        assert message in result.stderr and result.stderr.count("\n") == 1


def test_few_options_are_left_in_sight() -> None:
    context = click.Context(main)
    commands = [main.get_command(context, name) for name in main.list_commands(context)]
    names = {
        each.opts[0]
        for command in commands
        if command is not None
        for each in command.params
        if isinstance(each, click.Option) and type(each) is click.Option
    }
    assert len(names) <= 53
