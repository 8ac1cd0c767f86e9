"""The notebooks of the documentation: ``python -m scripts.site.notebooks`` runs them and stores what they show.

On the site they are pages (`page_of`); the files are there, too, to be downloaded.
"""

from __future__ import annotations

import json
from base64 import b64decode, b64encode
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

FOLDER = Path(__file__).parents[2] / "docs" / "notebooks"

EXTENSIONS = {"image/png": ".png", "image/gif": ".gif"}
"""Pictures that a notebook may show; GitHub shows these."""

COLOURS = 64
"""Of a picture that is stored; PNG packs few well."""

SECONDS = 120
"""A cell that takes longer has gone wrong."""

Notebook = dict[str, Any]


def read(path: Path) -> Notebook:
    """Read a notebook."""
    return dict(json.loads(path.read_text(encoding="utf-8")))


def run(notebook: Notebook, folder: Path) -> Notebook:
    """Return the notebook with new outputs, from a kernel of its own that runs in the folder.

    Raises
    ------
    nbclient.exceptions.CellExecutionError
        If a cell fails.
    """
    import nbformat
    from nbclient import NotebookClient
    from traitlets.config import Config

    ran = nbformat.reads(json.dumps(notebook), as_version=4)  # type: ignore[no-untyped-call]
    resources = {"metadata": {"path": str(folder)}}
    with TemporaryDirectory() as sockets:  # of the kernel: no network is needed
        kernel = {"transport": "ipc", "connection_file": str(Path(sockets, "kernel.json"))}
        settings = Config({"KernelManager": kernel})
        client = NotebookClient(
            ran,
            config=settings,
            timeout=SECONDS,
            resources=resources,
            record_timing=False,
            coalesce_streams=True,
        )
        client.execute()
    return dict(json.loads(nbformat.writes(ran)))  # type: ignore[no-untyped-call]


def clean(notebook: Notebook) -> Notebook:
    """Return the notebook without what differs from run to run and tells nothing."""
    cells = [
        cell | {"metadata": {}, "outputs": [_clean(output) for output in cell["outputs"]]}
        if cell["cell_type"] == "code"
        else cell
        for cell in notebook["cells"]
    ]
    metadata = {"kernelspec": notebook["metadata"]["kernelspec"], "language_info": {"name": "python"}}
    return notebook | {"cells": cells, "metadata": metadata}


def _clean(output: dict[str, Any]) -> dict[str, Any]:
    """Leave out that a picture is an object at some address; pack it."""
    data = output.get("data", {})
    kept = {kind: value for kind, value in data.items() if kind in EXTENSIONS} or data
    if "image/png" in kept:
        kept = {"image/png": packed(_text(kept["image/png"]))}
    return output | ({"data": kept, "metadata": {}} if data else {})


def packed(picture: str) -> str:
    """Return a PNG, in base 64, in few colours."""
    from PIL import Image

    pixels = Image.open(BytesIO(b64decode(picture))).convert("RGB")
    page = BytesIO()
    pixels.quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE, kmeans=3, dither=Image.Dither.NONE).save(
        page, "PNG", optimize=True
    )
    return b64encode(page.getvalue()).decode("ascii")


def page_of(notebook: Notebook, name: str) -> tuple[str, dict[str, bytes]]:
    """Return the notebook as a page in Markdown, and its pictures by the names that the page has for them."""
    pictures: dict[str, bytes] = {}
    texts = []
    heading = name
    for cell in notebook["cells"]:
        source = _text(cell["source"])
        if cell["cell_type"] == "markdown":
            headings = [line.lstrip("# ") for line in source.splitlines() if line.startswith("#")]
            heading = headings[-1] if headings else heading
            texts.append(source)
            continue
        texts.append(f"```python\n{source}\n```")
        for kind, content in contents(cell):
            if kind == "text/plain":
                texts.append(f"``` {{.text .output}}\n{content.rstrip()}\n```")
            else:
                picture = f"{name}-{len(pictures) + 1}{EXTENSIONS[kind]}"
                pictures[picture] = b64decode(content)
                texts.append(f"![{heading}]({picture})")
    title, _, rest = "\n\n".join(texts).partition("\n")
    download = f'\n*This page is a notebook: <a href="{name}.ipynb" download>{name}.ipynb</a>.*\n'
    return f"{title}\n{download}{rest}\n", pictures


def contents(cell: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield what a cell of code has printed and drawn: the kind, and the text or the picture in base 64."""
    for output in cell["outputs"]:
        if output["output_type"] == "stream":
            yield "text/plain", _text(output["text"])
        else:
            kind = next((kind for kind in EXTENSIONS if kind in output["data"]), "text/plain")
            yield kind, _text(output["data"][kind])


def _text(lines: str | list[str]) -> str:
    return lines if isinstance(lines, str) else "".join(lines)


def main() -> None:
    """Run all notebooks, each in a temporary folder, and store them with their outputs."""
    for path in sorted(FOLDER.glob("*.ipynb")):
        with TemporaryDirectory() as folder:
            ran = clean(run(read(path), Path(folder)))
        path.write_text(json.dumps(ran, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
