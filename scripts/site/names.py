"""The tables of the Python page: ``python -m scripts.site.names`` writes them into docs/api.md, from the docstrings.

In the repository the page is these tables. On the site every section goes on with the full docstrings of its names.
"""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "api.md"

ROW = re.compile(r"^\| `(mixseq[\w.]*)` \|.*\n", re.MULTILINE)


def table_row(name: str) -> str:
    """Return a row of a table, ended: the name, and what its docstring says first."""
    module, _, attribute = name.rpartition(".")
    first = (getattr(import_module(module), attribute).__doc__ or "").strip().partition("\n\n")[0]
    text = " ".join(first.split()).replace("``", "`").replace("|", "\\|")
    return f"| `{name}` | {text} |\n"


def with_tables(page: str) -> str:
    """Return the page with the rows as they should be."""
    return ROW.sub(lambda match: table_row(match[1]), page)


def with_docstrings(page: str) -> str:
    """Return the page for the site: names in tables are links, the docstrings follow at the end of each section."""
    start, *sections = re.split(r"^(?=## )", page, flags=re.MULTILINE)
    return start + "".join(map(_with_docstrings, sections))


def _with_docstrings(section: str) -> str:
    directives = "".join(f"\n::: {name}\n" for name in ROW.findall(section))
    return re.sub(r"^\| `(mixseq[\w.]*)` \|", r"| [`\1`][\1] |", section, flags=re.MULTILINE) + directives + "\n"


if __name__ == "__main__":
    PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
