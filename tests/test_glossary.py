"""Names that users meet consist of the words of the glossary, not of those that it replaces."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import click
import pytest

import mixseq
from mixseq.cli import main
from mixseq.operations.script import OPERATIONS

ROOT = Path(__file__).parents[1]
ROW = re.compile(r"^\| ([^|]+?) \| ([^|]+?) \| ([^|]*?) ?\|$", re.MULTILINE)


def glossary() -> list[tuple[str, str, str]]:
    """Its rows: words, meaning, and words that are not used for it."""
    text = (ROOT / "docs/conventions.md").read_text(encoding="utf-8").partition("## Glossary\n")[2]
    return ROW.findall(text)[1:]  # but for its head


def split(name: str) -> set[str]:
    """Words of a name in camel case or with underscores, without the s of plurals.

    >>> sorted(split("PoseMaps")), sorted(split("--joint-width"))
    (['map', 'pose'], ['joint', 'width'])
    """
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower()
    return {word.removesuffix("s") if len(word) > 3 else word for word in re.findall(r"[a-z]+", spaced)}


def names_of(what: str, value: Any) -> Iterator[str]:
    """Names of a public class or function, of its fields and parameters."""
    yield what
    if is_dataclass(value):
        yield from (field.name for field in fields(value))
    elif inspect.isfunction(value):
        yield from inspect.signature(value).parameters


def public_names() -> dict[str, set[str]]:
    """All names that users meet, by where they are."""
    found = {
        f"mixseq.{name}": set(names_of(name, getattr(mixseq, name)))
        for name in mixseq.__all__
        if not name.startswith("_")
    }
    for module in ("spaces", "segmentation", "operations", "signals", "correspondence", "retargeting"):
        package = import_module(f"mixseq.{module}")
        for name in getattr(package, "__all__", ()):
            found[f"mixseq.{module}.{name}"] = set(names_of(name, getattr(package, name)))
    for name in OPERATIONS:
        found[f"operation {name}"] = {name}
    context = click.Context(main)
    for name in main.list_commands(context):
        command = main.get_command(context, name)
        assert command is not None
        found[f"mixseq {name}"] = {option for each in command.params for option in each.opts}
    return found


REPLACED = {
    word
    for *_, others in glossary()
    for phrase in others.split(", ")
    if len(phrase.split()) == 1
    for word in split(phrase)
}


def test_the_glossary_is_one_sorted_list() -> None:
    words = [word for word, *_ in glossary()]
    assert len(words) > 30
    assert words == sorted(set(words), key=str.lower)
    assert all(meaning for _, meaning, _ in glossary())


@pytest.mark.parametrize("where", sorted(public_names()))
def test_public_names_use_it(where: str) -> None:
    for name in public_names()[where]:
        assert not split(name) & REPLACED, f"{where}: {name}"
