"""What MkDocs does to the pages on their way to the site; in the repository they stay plain Markdown.

Formulas, written as GitHub has them, are set by KaTeX. Headings get GitHub's anchors. The change log, which is outside
`docs`, becomes a page, the commands of `mixseq` become another one, notebooks become pages, and the Python page gets
the docstrings.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from pymdownx.arithmatex import arithmatex_fenced_format

from scripts.site.anchors import anchor
from scripts.site.commands import commands_page
from scripts.site.names import with_docstrings
from scripts.site.notebooks import FOLDER, page_of, read

ROOT = Path(__file__).parents[2]
ASSETS = Path(__file__).parent / "assets"
MODULES = ROOT / ".venv" / "node" / "node_modules"
KATEX = MODULES / "katex" / "dist"
IFRAME_WORKER = MODULES / "iframe-worker" / "shim" / "index.js"  # lets search work without a server
COPIED = {"changelog.md": "CHANGELOG.md"}  # pages made of files outside docs, with paths in the project
NOTEBOOKS = {f"notebooks/{path.stem}.md": path for path in sorted(FOLDER.glob("*.ipynb"))}

CODE = re.compile(r"<code>[^<]*</code>")
OPTION = re.compile(r"(?<![\w-])--?[a-z][\w-]*")
LINK = re.compile(r"(?<=\]\()[^)\s:#]+")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Configure the Markdown extensions with functions, which YAML has no safe way to name."""
    math = {"name": "math", "class": "arithmatex", "format": arithmatex_fenced_format(mode="generic")}
    config.mdx_configs.setdefault("pymdownx.superfences", {})["custom_fences"] = [math]
    config.mdx_configs["toc"]["slugify"] = anchor
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add pages and assets that are not in docs."""
    for needed in (KATEX, IFRAME_WORKER):
        if not needed.exists():
            raise PluginError(f"{needed.relative_to(ROOT)} is missing; scripts/docs installs it")
    files.append(File.generated(config, "commands.md", content=commands_page()))
    for page, source in COPIED.items():
        files.append(File.generated(config, page, content=(ROOT / source).read_text(encoding="utf-8")))
    for page, notebook in NOTEBOOKS.items():
        content, pictures = page_of(read(notebook), notebook.stem)
        files.append(File.generated(config, page, content=content))
        for name, picture in pictures.items():
            files.append(File.generated(config, f"notebooks/{name}", content=picture))
    for asset in ASSETS.iterdir():
        files.append(File.generated(config, f"assets/{asset.name}", abs_src_path=str(asset)))
    fonts = {f"katex/fonts/{font.name}": font for font in KATEX.glob("fonts/*.woff2")}
    foreign = fonts | {
        "katex/katex.min.css": KATEX / "katex.min.css",
        "katex/katex.min.js": KATEX / "katex.min.js",
        "katex/LICENSE": KATEX.parent / "LICENSE",
        "iframe-worker.js": IFRAME_WORKER,
        "iframe-worker.LICENSE": IFRAME_WORKER.parents[1] / "LICENSE",
    }
    for name, path in foreign.items():
        files.append(File.generated(config, f"assets/{name}", abs_src_path=str(path)))
    return files


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Keep options such as --max-error whole: browsers break lines at hyphens."""
    return CODE.sub(lambda code: OPTION.sub(r'<span class="word">\g<0></span>', code[0]), html)


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lead links where the site has their targets; add docstrings to the Python page."""
    here = page.file.src_uri
    source = COPIED.get(here, f"docs/{here}")

    def led(match: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(source), match[0]))
        pages = {path: name for name, path in COPIED.items()}
        pages |= {f"docs/notebooks/{path.name}": name for name, path in NOTEBOOKS.items()}
        on_site = pages.get(target, target.removeprefix("docs/"))
        return posixpath.relpath(on_site, posixpath.dirname(here) or ".")

    markdown = LINK.sub(led, markdown)
    return with_docstrings(markdown) if here == "api.md" else markdown
