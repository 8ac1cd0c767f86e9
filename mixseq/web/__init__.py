"""mixseq's JavaScript: modules bundled as one without imports, and the npm package of them as a folder.

The package has the decoder, a plugin for three.js, pages, types and a schema.
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
"""The module that opens compressed sequences; it imports all of the decoder."""

_IMPORT = re.compile(r'^import \{([^}]*)\} from "(\.[^"]+)";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(?:async )?(function\*?|class|const|let) (\w+)([^\n]*))", re.MULTILINE)
_AGAIN = re.compile(r"^export \{([\w, ]*)\};\n", re.MULTILINE)
_TEXT = r"""(?P<text>"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*'|`(?:\\.|[^`\\])*`)"""
_TOKEN = re.compile(_TEXT + r"|/\*.*?\*/|[ \t]*//[^\n]*|(?P<gap>\s*\n\s*)", re.DOTALL)
_SPACED = re.compile(_TEXT + r"| ?(?P<sign>[-+]=|[=,;:?{}()\[\]<>*&|]) ?")


def module(path: str) -> str:
    """Return the text of a module, such as ``"decoder/arithmetic.js"``."""
    return files("mixseq.web").joinpath(*path.split("/")).read_text(encoding="utf-8")


@cache
def bundled(*entries: str) -> str:
    """Return modules and all they import, `minify`, as one ES module; each becomes a function with its own names."""
    entries = entries or (SEQUENCE_MODULE,)
    places: dict[str, str] = {}
    for entry in entries:
        _place(entry, places)
    names = {path: f"module{number}" for number, path in enumerate(places)}
    parts = [minify(_as_function(path, places[path], names)) for path in places]
    exports = [f"export const {{ {_exported(places[path])} }} = {names[path]};\n" for path in entries]
    return "".join(parts) + minify("".join(exports))


def _place(path: str, places: dict[str, str]) -> None:
    """Add a module after its imports; circular imports are not allowed."""
    if path in places:
        return
    source = module(path)
    for _, imported in _IMPORT.findall(source):
        _place(_target(path, imported), places)
    places[path] = source


def _target(path: str, imported: str) -> str:
    return normpath(join(dirname(path), imported))


def _as_function(path: str, source: str, names: dict[str, str]) -> str:
    def taken(match: re.Match[str]) -> str:
        return f"const {{{match[1].replace(' as ', ': ')}}} = {names[_target(path, match[2])]};\n"

    body = _EXPORT.sub("", _AGAIN.sub("", _IMPORT.sub(taken, source)))
    return f"const {names[path]} = (() => {{\n{body}\nreturn {{ {_exported(source)} }};\n}})();\n"


def _exported(source: str) -> str:
    names = []
    for what, first, rest in _EXPORT.findall(source):
        names += [first, *(re.findall(r", (\w+) = ", rest) if what in ("const", "let") else [])]
    return ", ".join([*names, *_AGAIN.findall(source)])


def minify(source: str) -> str:
    """Return scripts without comments, indentation and most spaces; they have no regular expressions with signs."""

    def kept(match: re.Match[str]) -> str:
        return match["text"] or ("\n" if match["gap"] else "")

    once = _TOKEN.sub(kept, source)
    return _SPACED.sub(lambda match: match["text"] or match["sign"], _TOKEN.sub(kept, once).lstrip())


MODULES = (
    "decoder/sequence.js",
    "decoder/surface.js",
    "player/drawn_mesh.js",
    "player/field_textures.js",
    "player/glb.js",
    "player/remote.js",
    "player/worker.js",
)
"""Modules in ``mixseq.js``."""

COPIED_FILES = (
    "mesh_sequence.js",
    "mesh_sequence.d.ts",
    "mixseq.d.ts",
    "example.html",
    "player.html",
    "MIXSEQ_mesh_sequence.schema.json",
    "README.md",
)


def package_files() -> Mapping[str, str]:
    """Return the texts of all files by their names."""
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
        "package.json": json.dumps(package, indent=2) + "\n",
        **{name: module(f"three/{name}") for name in COPIED_FILES},
    }
