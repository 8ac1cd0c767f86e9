"""The documentation site: it builds without warnings, all pages are in its menu, what is made from the code is whole.

Building needs the extra ``docs`` and KaTeX, which ``scripts/test`` installs; without them those tests are skipped.
"""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import click
import pytest
import yaml

import mixseq
from mixseq import errors, operations
from mixseq.cli import main
from mixseq.cli.options import Setting
from scripts.site.anchors import anchor
from scripts.site.check import faults
from scripts.site.commands import commands_page
from scripts.site.names import ROW, with_docstrings, with_tables
from scripts.site.notebooks import FOLDER
from tests.test_docs import page
from tests.viewer.conftest import NewPage, browser, new_page

__all__ = ["browser", "new_page"]  # fixtures

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
MODULES = ROOT / ".venv" / "node" / "node_modules"
CONFIG = ROOT / "scripts" / "site" / "mkdocs.yml"
MADE = {
    "commands.md",
    "changelog.md",
    *(f"notebooks/{path.stem}.md" for path in FOLDER.glob("*.ipynb")),
}  # by hooks

CONTEXT = click.Context(main, info_name="mixseq", **main.context_settings)
COMMANDS = main.list_commands(CONTEXT)


def targets(nav: Any) -> list[str]:
    """Return the pages of a part of the menu."""
    if isinstance(nav, str):
        return [nav]
    return [target for each in (nav.values() if isinstance(nav, dict) else nav) for target in targets(each)]


def test_every_page_is_in_the_menu_once() -> None:
    pages = {str(path.relative_to(DOCS)) for path in DOCS.rglob("*.md")}
    found = targets(yaml.safe_load(CONFIG.read_text(encoding="utf-8"))["nav"])
    assert len(found) == len(set(found))
    assert set(found) == pages | MADE


@pytest.mark.parametrize("name", COMMANDS)
def test_commands_are_whole(name: str) -> None:
    command = main.get_command(CONTEXT, name)
    assert command is not None
    section = commands_page().partition(f"\n## mixseq {name}\n")[2].partition("\n## ")[0]
    for parameter in command.get_params(CONTEXT):
        if isinstance(parameter, Setting):
            assert f"--set {parameter.key}=" in section
        elif isinstance(parameter, click.Option):
            row = next(
                line
                for line in section.splitlines()
                if line.startswith("|") and re.search(rf"[ >]{parameter.opts[-1]}\b", line)
            )
            for option in (*parameter.opts, *parameter.secondary_opts):
                assert option in row
        else:
            assert parameter.make_metavar(CONTEXT) in section


def test_rows_of_options_are_cells() -> None:
    rows = [line for line in commands_page().splitlines() if line.startswith("|")]
    assert len(rows) > 100
    for row in rows:
        assert len(re.findall(r"(?<!\\)\|", row)) == 3, row


def test_names_are_whole() -> None:
    listed = ROW.findall(page("docs/api.md"))
    assert len(listed) == len(set(listed))
    public = {f"mixseq.{name}" for name in mixseq.__all__ if name not in ("operations", "__version__")}
    public |= {f"mixseq.operations.{name}" for name in operations.__all__}
    public |= {f"mixseq.errors.{name}" for name, value in vars(errors).items() if isinstance(value, type)}
    assert public <= set(listed)


def test_names_are_explained_by_their_docstrings() -> None:
    text = page("docs/api.md")
    assert with_tables(text) == text, "run `python -m scripts.site.names`"


def test_docstrings_follow_the_tables() -> None:
    text = "# Python\n\n## A\n\n| name | what |\n|---|---|\n| `mixseq.read` | Read. |\n\n## B\n\nNothing.\n"
    made = with_docstrings(text)
    assert "| [`mixseq.read`][mixseq.read] | Read. |" in made
    assert made.index("::: mixseq.read") < made.index("## B")
    assert "## B\n\nNothing.\n" in made


@pytest.mark.parametrize(
    ("heading", "expected"),
    [
        ("Two placements", "two-placements"),
        ("Why io/ has no __init__.py", "why-io-has-no-__init__py"),
        ("Units, the diagonal", "units-the-diagonal"),
        ("S_e & S_m", "s_e--s_m"),
    ],
)
def test_anchors_are_those_of_github(heading: str, expected: str) -> None:
    assert anchor(heading) == expected


def test_files_for_contributors_are_there() -> None:
    named = re.findall(r"`((?:mixseq|io|tests|scripts|docs)/[\w./-]+)`", page("docs/contributing.md"))
    assert len(named) > 40
    for name in named:
        assert (ROOT / name).exists(), name


def test_names_for_contributors_are_there() -> None:
    """What the steps tell to extend is in the file that they name."""
    steps = re.split(r"^(?=\d+\. |## )", page("docs/contributing.md"), flags=re.MULTILINE)
    for step in steps:
        files = re.findall(r"`((?:mixseq|io|tests)/[\w./-]+\.py)`", step)
        texts = "".join((ROOT / file).read_text(encoding="utf-8") for file in files)
        for name in re.findall(r"`(_?[A-Z]+[A-Z_]*|[A-Z]\w+Name)`", step) if files else ():
            assert name in texts, f"{name}: {files}"


def write_site(folder: Path, **pages: str) -> Path:
    for name, body in pages.items():
        (folder / f"{name}.html").write_text(f"<html><body>{body}</body></html>", encoding="utf-8")
    return folder


@pytest.mark.parametrize(
    ("body", "fault"),
    [
        ('<a href="b.html">b</a>', None),
        ('<a href="b.html#there">b</a>', None),
        ('<a href="https://example.org/x?y#z">x</a>', None),
        ('<a href="mailto:a@example.org">x</a>', None),
        ('<img src="data:image/png;base64,AAAA">', None),
        ('<a href="c.html">c</a>', "leads nowhere"),
        ('<a href="b.html#gone">b</a>', "anchor that is not there"),
        ('<a href="#gone">b</a>', "anchor that is not there"),
        ('<a href="https://example">x</a>', "no address"),
        ('<a href="htp://example.org">x</a>', "no address"),
        ('<script src="https://cdn.example.org/x.js"></script>', "from elsewhere"),
        ('<link rel="stylesheet" href="//fonts.example.org/x.css">', "from elsewhere"),
        ('<img src="gone.png">', "not there"),
    ],
)
def test_faults_of_a_site(body: str, fault: str | None, tmp_path: Path) -> None:
    found = list(faults(write_site(tmp_path, a=body, b='<p id="there">.</p>')))
    assert len(found) == (fault is not None)
    assert fault is None or fault in found[0]


def test_style_sheets_load_nothing_from_elsewhere(tmp_path: Path) -> None:
    (tmp_path / "a.css").write_text("@font-face { src: url('https://fonts.example.org/x.woff2') }", encoding="utf-8")
    assert "from elsewhere" in next(iter(faults(tmp_path)))


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the site, built without warnings."""
    if importlib.util.find_spec("mkdocs") is None:
        pytest.skip("mkdocs is not installed; it is in the extra docs")
    if not all((MODULES / name).is_dir() for name in ("katex", "iframe-worker")):
        pytest.skip("KaTeX is not installed; scripts/test and scripts/docs take it from npm")
    folder = tmp_path_factory.mktemp("site")
    build = f"-m mkdocs build --strict --config-file {CONFIG} --site-dir {folder}"
    quiet = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    result = subprocess.run([sys.executable, *build.split()], cwd=ROOT, env=quiet, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    return folder


def test_the_site_is_whole(site: Path) -> None:
    assert list(faults(site)) == []
    for source in (*DOCS.rglob("*.md"), *map(Path, MADE)):
        name = source.relative_to(DOCS) if source.is_absolute() else source
        assert (site / name).with_suffix(".html").is_file()
    assert len(list(site.rglob("*.html"))) > 40
    formulas = (site / "mixed-space.html").read_text(encoding="utf-8")
    assert formulas.count('class="arithmatex"') == len(
        re.findall(r"^```math|\$[^$\n]+\$", page("docs/mixed-space.md"), re.M)
    )
    api = (site / "api.html").read_text(encoding="utf-8")
    for name in ROW.findall(page("docs/api.md")):
        assert f'id="{name}"' in api


def test_notebooks_are_pages_and_files(site: Path) -> None:
    for notebook in FOLDER.glob("*.ipynb"):
        assert (site / "notebooks" / notebook.name).read_bytes() == notebook.read_bytes()
        text = (site / "notebooks" / f"{notebook.stem}.html").read_text(encoding="utf-8")
        for name in re.findall(r'<img alt="[^"]+" src="([^"]+)"', text):
            assert (site / "notebooks" / name).stat().st_size > 1000


@pytest.mark.parametrize("name", ["reconstruction", "compression", "notebooks/walk"])
def test_formulas_are_set_in_a_browser(name: str, site: Path, new_page: NewPage) -> None:
    shown = new_page()
    shown.goto((site / f"{name}.html").as_uri())
    written = shown.locator(".arithmatex").count()
    shown.locator(".arithmatex .katex").nth(written - 1).wait_for(state="attached")
    assert written > 0
    assert shown.locator(".katex").count() == written
    assert shown.locator(".katex-error").count() == 0
    assert shown.evaluate("document.documentElement.scrollWidth <= window.innerWidth")  # nothing sticks out


BROKEN = """[...document.querySelectorAll('.word')].filter((word) => word.getClientRects().length > 1)
  .map((word) => word.textContent)"""
"""Options that are in several lines."""


@pytest.mark.parametrize(
    "name", ["index", "gallery", "tutorial", "signals", "api", "cli", "commands", "notebooks/walk"]
)
def test_pages_fit_a_phone(name: str, site: Path, new_page: NewPage) -> None:
    shown = new_page(390, 844)
    shown.goto((site / f"{name}.html").as_uri())
    assert shown.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    assert shown.evaluate(BROKEN) == []
    assert name != "index" or shown.locator(".word").count() > 1
