"""A site on this machine: files that pages ask for, three.js among them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING
from zipfile import ZipFile

import pytest

from mixseq.web import package_files

if TYPE_CHECKING:
    from playwright.sync_api import Page, Route

ADDRESS = "http://127.0.0.1/"

_KINDS = {".css": "text/css", ".js": "text/javascript", ".html": "text/html", ".json": "application/json"}

_SHIM = """
export const { BufferAttribute, BufferGeometry, GLBufferAttribute, GLTFLoader, Mesh, MeshStandardMaterial,
  PerspectiveCamera, Scene, WebGLRenderer } = globalThis.THREE;
"""
"""A module of three.js for what is a global name."""


@cache
def three_of_trimesh() -> str:
    """The script of three.js 0.140, with its GLTFLoader, that is in trimesh's page; it makes the global name THREE."""
    packed = files("trimesh").joinpath("resources", "templates", "viewer.zip").read_bytes()
    with ZipFile(BytesIO(packed)) as archive:
        (name,) = archive.namelist()
        page = archive.read(name).decode()
    end = "THREE.GLTFLoader=GLTFLoader;})();"
    if end not in page:
        pytest.skip("this version of trimesh brings another three.js")
    return page[page.index("<script>") + len("<script>") : page.index(end) + len(end)]


def three(kind: str) -> tuple[str, Mapping[str, str | bytes]]:
    """The head of a page with three.js, of trimesh or of npm, and the files that it needs."""
    if kind == "trimesh":
        imports = '{"imports": {"three": "./three.js", "three/addons/loaders/GLTFLoader.js": "./three.js"}}'
        head = f'<script src="three_global.js"></script><script type="importmap">{imports}</script>'
        return head, {"three_global.js": three_of_trimesh(), "three.js": _SHIM}
    folder = os.environ.get("MIXSEQ_THREE")
    if not folder:
        pytest.skip("MIXSEQ_THREE is not set to the folder of npm's three")
    imports = '{"imports": {"three": "./three/build/three.module.js", "three/addons/": "./three/examples/jsm/"}}'
    served = {
        f"three/{path.relative_to(folder).as_posix()}": path.read_bytes()
        for part in ("build/three.*.js", "examples/jsm/loaders/GLTFLoader.js", "examples/jsm/utils/*.js")
        for path in Path(folder).glob(part)
    } | {
        "three/examples/jsm/controls/OrbitControls.js": (
            Path(folder) / "examples/jsm/controls/OrbitControls.js"
        ).read_bytes()
    }
    return f'<script type="importmap">{imports}</script>', served


def serve(page: Page, added: Mapping[str, str | bytes]) -> None:
    """Let a page find what `mixseq web` writes, and more, at `ADDRESS`."""
    there = {**package_files(), **added}

    def answer(route: Route) -> None:
        name = route.request.url.removeprefix(ADDRESS).partition("?")[0]
        if name not in there:
            route.fulfill(status=404)
            return
        kind = _KINDS.get(Path(name).suffix, "application/octet-stream")
        route.fulfill(body=there[name], content_type=kind)

    page.route(f"{ADDRESS}**", answer)
