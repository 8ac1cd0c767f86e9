"""The notebooks of the documentation run, and what is stored in them is what they print and draw."""

from __future__ import annotations

import math
import re
from base64 import b64decode
from io import BytesIO
from pathlib import Path

import pytest

from scripts.site.notebooks import FOLDER, Notebook, clean, contents, page_of, read, run

pytestmark = pytest.mark.slow

NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")


def code(notebook: Notebook) -> list[Notebook]:
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


def printed(cell: Notebook) -> str:
    return "".join(text for kind, text in contents(cell) if kind == "text/plain")


@pytest.fixture(scope="module", params=NOTEBOOKS, ids=lambda path: path.stem)
def path(request: pytest.FixtureRequest) -> Path:
    chosen: Path = request.param
    return chosen


def agree(first: str, second: str) -> bool:
    """Whether two texts differ in numbers only, and in these by little."""
    ours, theirs = ([float(number) for number in NUMBER.findall(text)] for text in (first, second))
    return NUMBER.sub("#", " ".join(first.split())) == NUMBER.sub("#", " ".join(second.split())) and all(
        math.isclose(one, other, rel_tol=0.1, abs_tol=0.01) for one, other in zip(ours, theirs, strict=True)
    )


def test_numbers_may_differ_a_little() -> None:
    assert agree("12 frames, 0.90 mm", "12 frames,  0.91 mm")
    assert not agree("12 frames, 0.90 mm", "12 frames, 9.0 mm")
    assert not agree("12 frames, 0.90 mm", "12 frames, 0.90 m")


def test_a_notebook_runs_and_shows_what_is_stored(path: Path, tmp_path: Path) -> None:
    pytest.importorskip("nbclient")
    stored = read(path)
    ran = run(stored, tmp_path)
    for before, after in zip(code(stored), code(ran), strict=True):
        assert agree(printed(before), printed(after)), f"{printed(after)}; python -m scripts.site.notebooks"
        assert [kind for kind, _ in contents(before)] == [kind for kind, _ in contents(after)]
        assert all(output.get("name") != "stderr" for output in after["outputs"]), printed(after)


def test_stored_notebooks_are_clean_and_small(path: Path) -> None:
    stored = read(path)
    assert path.stat().st_size < 500_000
    assert {cell["execution_count"] for cell in code(stored)} == set(range(1, len(code(stored)) + 1))
    for cell in code(stored):
        assert not re.search(r"(?<![\w.])/(work|home|Users|tmp|root)/", printed(cell))
    assert [printed(cell) for cell in code(clean(stored))] == [printed(cell) for cell in code(stored)]


def test_a_notebook_becomes_a_page(path: Path) -> None:
    from PIL import Image

    page, pictures = page_of(read(path), path.stem)
    assert page.startswith("# ")
    assert f'href="{path.name}"' in page
    assert page.count("```") % 2 == 0
    assert re.findall(r"!\[[^\]]+\]\(([^)]+)\)", page) == list(pictures)
    for name, content in pictures.items():
        assert Image.open(BytesIO(content)).format == {"png": "PNG", "gif": "GIF"}[name[-3:]]


def test_what_a_page_of_a_notebook_shows() -> None:
    outputs = [
        {"output_type": "stream", "name": "stdout", "text": ["2\n"]},
        {"output_type": "display_data", "data": {"image/png": "AAAA", "text/plain": "<Figure>"}},
    ]
    cells = [
        {"cell_type": "markdown", "source": ["# A\n", "b"]},
        {"cell_type": "code", "source": "1 + 1", "outputs": outputs},
    ]
    page, pictures = page_of({"cells": cells}, "a")
    assert page.startswith("# A\n\n*This page is a notebook")
    assert page.endswith("b\n\n```python\n1 + 1\n```\n\n``` {.text .output}\n2\n```\n\n![A](a-1.png)\n")
    assert pictures == {"a-1.png": b64decode("AAAA")}
