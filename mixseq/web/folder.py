"""The npm package for web projects, as a folder: decoder, three.js plugin, pages, types, schema."""

from __future__ import annotations

import json
from collections.abc import Mapping

from mixseq.version import __version__
from mixseq.web.bundle import bundled, module

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

COPIED = (
    "mesh_sequence.js",
    "mesh_sequence.d.ts",
    "mixseq.d.ts",
    "example.html",
    "player.html",
    "MIXSEQ_mesh_sequence.schema.json",
    "README.md",
)


def contents() -> Mapping[str, str]:
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
        **{name: module(f"three/{name}") for name in COPIED},
    }
