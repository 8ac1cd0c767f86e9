"""Names and docstrings use the words of the field: the rules of docs/contributing.md that a program can check."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MODULES = sorted((*(ROOT / "mixseq").rglob("*.py"), *(ROOT / "io" / "mixseq_io").rglob("*.py")))

SINGLE_WORDS = frozenset({"MAGIC", "VERSION"})
"""Constants of one word that need no other."""

PHRASE = re.compile(
    r"\bso (many|often|much|long|few|far)\b"
    r"|\bas (much|many|often) as\b"
    r"|\b(ours|theirs|nobody|somebody|whoever)\b"
    r"|\b(tells?|told|telling|knows?|asks?|speaks?)\b"
    r"|^What ",
    re.MULTILINE,
)
"""Turns of phrase that a reader has to read twice: data that tells or knows, clauses in place of nouns."""


def constants(tree: ast.Module) -> Iterator[tuple[str, ast.expr | None]]:
    """Return names and values of the constants of a module."""
    value: ast.expr | None
    for node in tree.body:
        if isinstance(node, ast.Assign):
            targets, value = node.targets, node.value
        elif isinstance(node, ast.AnnAssign):
            targets, value = [node.target], node.value
        else:
            continue
        for target in targets:
            if isinstance(target, ast.Name) and target.id.isupper():
                yield target.id.strip("_"), value


def unclear(name: str, value: ast.expr | None) -> bool:
    """Whether a constant has one word, which is no plural of a table's entries."""
    if "_" in name or name in SINGLE_WORDS:
        return False
    table = isinstance(value, (ast.Tuple, ast.Dict, ast.Set, ast.List)) or (
        isinstance(value, ast.Call) and not ast.unparse(value.func).startswith("np.")
    )
    return not (table and name.endswith("S"))


def docstrings(tree: ast.Module) -> Iterator[str]:
    """Return the docstrings of a module, its classes and functions."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)):
            yield ast.get_docstring(node) or ""


def test_words() -> None:
    names, phrases = [], []
    for path in MODULES:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        names += [f"{path}: {name}" for name, value in constants(tree) if unclear(name, value)]
        for text in docstrings(tree):
            phrases += [f"{path}: {found[0]}" for found in PHRASE.finditer(text)]
    assert len(MODULES) > 200
    assert not names, f"constants say their quantity and unit: {names}"
    assert not phrases, f"docstrings name what they mean: {phrases}"


def test_few_constants_have_one_word() -> None:
    assert len(SINGLE_WORDS) < 30
