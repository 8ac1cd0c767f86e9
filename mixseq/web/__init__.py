"""Bundle mixseq's JavaScript modules into one module without imports, and make the files of the npm package.

The npm package has the decoder, a plugin for three.js, pages, types and a schema.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from posixpath import dirname, join, normpath

from mixseq.version import __version__

SEQUENCE_MODULE = "decoder/sequence.js"
"""Module that opens compressed sequences and imports the whole decoder."""

_IMPORT_LINE = re.compile(r'^import \{([^}]*)\} from "(\.[^"]+)";\n', re.MULTILINE)
_EXPORT_KEYWORD = re.compile(r"^export (?=(?:async )?(function\*?|class|const|let) (\w+)([^\n]*))", re.MULTILINE)
_REEXPORT_LINE = re.compile(r"^export \{([\w, ]*)\};\n", re.MULTILINE)
_STRING_PATTERN = r"""(?P<text>"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*'|`(?:\\.|[^`\\])*`)"""
_COMMENT_OR_BREAK = re.compile(_STRING_PATTERN + r"|/\*.*?\*/|[ \t]*//[^\n]*|(?P<gap>\s*\n\s*)", re.DOTALL)
_SPACED_SIGN = re.compile(_STRING_PATTERN + r"| ?(?P<sign>[-+]=|[=,;:?{}()\[\]<>*&|]) ?")


def read_module(path: str) -> str:
    """Return the source of a JavaScript module, such as ``"decoder/arithmetic.js"``."""
    return files("mixseq.web").joinpath(*path.split("/")).read_text(encoding="utf-8")


@cache
def bundled(*entries: str) -> str:
    """Bundle modules and their imports into one minified ES module, in which each module is a function."""
    entries = entries or (SEQUENCE_MODULE,)
    sources: dict[str, str] = {}
    for entry in entries:
        _add_module(entry, sources)
    names = {path: f"module{number}" for number, path in enumerate(sources)}
    parts = [minify(_to_function(path, sources[path], names)) for path in sources]
    exports = [f"export const {{ {_exported_names(sources[path])} }} = {names[path]};\n" for path in entries]
    return "".join(parts) + minify("".join(exports))


def _add_module(path: str, sources: dict[str, str]) -> None:
    """Add the source of a module to `sources` after its imports, which must not be circular."""
    if path not in sources:
        source = read_module(path)
        for _, imported in _IMPORT_LINE.findall(source):
            _add_module(_resolve(path, imported), sources)
        sources[path] = source


def _resolve(path: str, imported: str) -> str:
    return normpath(join(dirname(path), imported))


def _to_function(path: str, source: str, names: dict[str, str]) -> str:
    def to_constants(match: re.Match[str]) -> str:
        return f"const {{{match[1].replace(' as ', ': ')}}} = {names[_resolve(path, match[2])]};\n"

    body = _EXPORT_KEYWORD.sub("", _REEXPORT_LINE.sub("", _IMPORT_LINE.sub(to_constants, source)))
    return f"const {names[path]} = (() => {{\n{body}\nreturn {{ {_exported_names(source)} }};\n}})();\n"


def _exported_names(source: str) -> str:
    names = []
    for keyword, first, rest in _EXPORT_KEYWORD.findall(source):
        names += [first, *(re.findall(r", (\w+) = ", rest) if keyword in ("const", "let") else [])]
    return ", ".join([*names, *_REEXPORT_LINE.findall(source)])


def minify(source: str) -> str:
    """Remove comments, indentation and most spaces from a script without regular expressions that contain operators."""

    def replacement(match: re.Match[str]) -> str:
        return match["text"] or ("\n" if match["gap"] else "")

    for _ in range(2):
        source = _COMMENT_OR_BREAK.sub(replacement, source)
    return _SPACED_SIGN.sub(lambda match: match["text"] or match["sign"], source.lstrip())


MODULES = (
    "decoder/sequence.js",
    "decoder/surface.js",
    "player/drawn_mesh.js",
    "player/field_textures.js",
    "player/glb.js",
    "player/remote.js",
)
"""Modules bundled into ``mixseq.js``."""

PAGE_SCRIPTS = (
    "frame_numbers.js",
    "clock.js",
    "camera.js",
    "transport.js",
    "shaders.js",
    "programs.js",
    "mesh.js",
    "stage.js",
)
"""Scripts of pages in loading order, joined to ``page.js``: controls, lighting and drawing of exported pages, too."""

COPIED_FILES = (
    "mesh_sequence.js",
    "mesh_sequence.d.ts",
    "mixseq.d.ts",
    "MIXSEQ_mesh_sequence.schema.json",
    "README.md",
)


PAGES = ("example.html", "player.html")
"""Pages that begin with ``three/head.html``."""


def package_files() -> Mapping[str, str]:
    """Return the text of every file of the npm package by file name."""
    package = {
        "name": "mixseq-web",
        "version": __version__,
        "description": "Compressed mesh sequences in browsers, and a plugin for three.js",
        "license": "MIT",
        "type": "module",
        "exports": {
            ".": {"types": "./mixseq.d.ts", "default": "./mixseq.js"},
            "./three": {"types": "./mesh_sequence.d.ts", "default": "./mesh_sequence.js"},
        },
        "peerDependencies": {"three": ">=0.140"},
        "peerDependenciesMeta": {"three": {"optional": True}},
    }
    return {
        "mixseq.js": bundled(*MODULES),
        "page.js": "\n".join(read_module(f"page/{name}") for name in PAGE_SCRIPTS),
        "page.css": read_module("page/page.css"),
        "package.json": json.dumps(package, indent=2) + "\n",
        **{name: read_module(f"three/{name}") for name in COPIED_FILES},
        **{name: _page(name) for name in PAGES},
    }


def _page(name: str) -> str:
    """Return a page of the package: the head that all have, with the page's title, and the rest of the page."""
    title, rest = read_module(f"three/{name}").split("\n", 1)
    return read_module("three/head.html").replace("<title></title>", title) + rest
