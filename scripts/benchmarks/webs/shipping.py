"""A motion in the files in which the web is sent one, each in a folder of its own with the page that shows it.

gltfpack and three.js are npm's: MIXSEQ_NODE_MODULES names the folder that they are in; without it the rows that need
them are left out.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from click.testing import CliRunner

import mixseq
from mixseq.cli import main as command_line
from mixseq.web import package_files
from scripts.benchmarks.common.node import node_executable

DRACO_BITS = {1e-3: 10, 1e-4: 14}
"""Bits of a coordinate that keep a bound, in diagonals, with room to spare."""

OURS, _PLUGIN, _EXPORTED = "GLB of mixseq", "GLB of mixseq, three.js", "exported page"
_MORPHS, _PACKED, _FRAMES = "GLB with morph targets", "gltfpack -cc", "Draco, frame by frame"

TITLES = (OURS, _EXPORTED, _MORPHS, _PACKED, _FRAMES)
"""What files are called, each kind once."""

_PAGE = """<!doctype html><link rel="icon" href="data:,"><canvas></canvas>
<script type="importmap">{ "imports": {
  "three": "./three/build/three.module.js", "three/addons/": "./three/examples/jsm/"
} }</script>
<script type="module">
  import * as THREE from "three";
  const scene = new THREE.Scene(), camera = new THREE.PerspectiveCamera(40, 1, 0.001, 1e5);
  const renderer = new THREE.WebGLRenderer({ canvas: document.querySelector("canvas") }), gl = renderer.getContext();
  const show = (object) => {
    scene.add(new THREE.HemisphereLight(), object);
    const { center, radius } = new THREE.Box3().setFromObject(object).getBoundingSphere(new THREE.Sphere());
    camera.position.copy(center).add(new THREE.Vector3(0, 0, 4 * radius));
    renderer.render(scene, camera);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    globalThis.shown ??= performance.now();
  };
  LOAD
</script>"""

_GLTF = """
  import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
  const loader = new GLTFLoader();
  MORE
  show((await loader.loadAsync("shot.glb")).scene);
"""

_SEQUENCE = """
  import { MeshSequencePlugin } from "./mesh_sequence.js";
  loader.register((parser) => new MeshSequencePlugin(parser));
"""

_MESHOPT = """
  import { MeshoptDecoder } from "three/addons/libs/meshopt_decoder.module.js";
  loader.setMeshoptDecoder(MeshoptDecoder);
"""

_DRACO = """
  import { DRACOLoader } from "three/addons/loaders/DRACOLoader.js";
  const loader = new DRACOLoader().setDecoderPath("./three/examples/jsm/libs/draco/");
  show(new THREE.Mesh(await loader.loadAsync("frame0.drc"), new THREE.MeshStandardMaterial()));
"""


@dataclass(frozen=True)
class Shipped:
    """A folder with a page and its files; `data` are the bytes of the motion, without what shows it.

    `bounded` says whether the files follow from the bound.
    """

    title: str
    folder: Path
    page: str
    data: int
    bounded: bool


def original(name: str) -> Path:
    """Where an animation of $MIXSEQ_DATA is."""
    data = Path(os.environ.get("MIXSEQ_DATA", ""))
    return next(path for path in (data / f"npz/{name}.npz", data / f"gltf/{name}.glb") if path.is_file())


def modules() -> Path | None:
    """The folder node_modules."""
    named = os.environ.get("MIXSEQ_NODE_MODULES")
    return Path(named) if named else None


def shipped(name: str, bound: float, folder: Path) -> Iterator[Shipped]:
    """Make all files of an animation below a folder."""
    sequence = mixseq.read(original(name))
    coded = mixseq.compress(sequence, max_error=bound)
    yield _sequence(folder / "player", coded, "player.html")
    yield _page(folder / "page", name, bound)
    if modules() is None:
        return
    yield _sequence(folder / "plugin", coded, "index.html")
    yield from _morphs(folder, sequence)
    yield _draco(folder / "draco", sequence, bound)


def texture_bytes(file: Path) -> int:
    """Return the bytes of the images in a .glb."""
    data = file.read_bytes()
    content = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    views = (each["bufferView"] for each in content.get("images", ()))
    return sum(int(content["bufferViews"][view]["byteLength"]) for view in views)


def _sequence(folder: Path, coded: object, page: str) -> Shipped:
    folder.mkdir()
    file = folder / "shot.glb"
    mixseq.save(file, coded)  # type: ignore[arg-type]
    for each, text in package_files().items():
        (folder / each).write_text(text, encoding="utf-8")
    title = OURS if page == "player.html" else _PLUGIN
    if title == _PLUGIN:
        _write_page(folder, _GLTF.replace("MORE", _SEQUENCE))
    return Shipped(title, folder, page, file.stat().st_size, True)


def _page(folder: Path, name: str, bound: float) -> Shipped:
    folder.mkdir()
    file = folder / "index.html"
    told = ["view", str(original(name)), "--export", str(file), "-q", "--max-error", f"{bound:g}"]
    result = CliRunner().invoke(command_line, told)
    assert result.exit_code == 0, result.output
    return Shipped(_EXPORTED, folder, "index.html", file.stat().st_size, True)


def _morphs(folder: Path, sequence: mixseq.MeshSequence) -> Iterator[Shipped]:
    plain, packed = folder / "morphs", folder / "gltfpack"
    for each in (plain, packed):
        each.mkdir()
    mixseq.write(plain / "shot.glb", sequence)
    tool = modules()
    assert tool is not None
    command = [node_executable() or "node", tool / "gltfpack/cli.js", "-cc", "-i", plain / "shot.glb"]
    subprocess.run([*map(str, command), "-o", str(packed / "shot.glb")], check=True, capture_output=True)
    _write_page(plain, _GLTF.replace("MORE", ""))
    _write_page(packed, _GLTF.replace("MORE", _MESHOPT))
    for title, each in ((_MORPHS, plain), (_PACKED, packed)):
        yield Shipped(title, each, "index.html", (each / "shot.glb").stat().st_size, False)


def _draco(folder: Path, sequence: mixseq.MeshSequence, bound: float) -> Shipped:
    import DracoPy

    folder.mkdir()
    size = 0
    for number, points in enumerate(sequence.points):
        bits = DRACO_BITS[bound]
        frame = DracoPy.encode(
            points.astype(np.float32),
            sequence.faces.astype(np.uint32),
            quantization_bits=bits,
            compression_level=10,
        )
        (folder / f"frame{number}.drc").write_bytes(frame)
        size += len(frame)
    _write_page(folder, _DRACO)
    return Shipped(_FRAMES, folder, "index.html", size, True)


def _write_page(folder: Path, load: str) -> None:
    (folder / "index.html").write_text(_PAGE.replace("LOAD", load), encoding="utf-8")
    tool = modules()
    assert tool is not None
    for part in ("build", "examples/jsm/loaders", "examples/jsm/utils", "examples/jsm/libs"):
        shutil.copytree(tool / "three" / part, folder / "three" / part, symlinks=True)
