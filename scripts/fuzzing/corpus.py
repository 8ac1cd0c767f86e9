"""Small sound files of every kind, a folder for each: what is damaged."""

from __future__ import annotations

import json
import shutil
import warnings
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import mixseq
from mixseq.cli import main
from mixseq.errors import MixseqWarning
from mixseq.sequence import MeshSequence, Polygons
from mixseq.surface import CornerValues, FaceSet, MeshObject, Surface

GOLDEN = Path(__file__).parents[2] / "tests" / "formats" / "golden"
PACKED = GOLDEN.parent / "gltf" / "packed"
"""Files of all versions."""

Maker = Callable[[Path], object]


def arm(frames: int = 4) -> MeshSequence:
    """A bent tube of quads and a tetrahedron beside it, with everything that a mesh can have."""
    ring, along = np.meshgrid(np.arange(4), np.arange(7))
    angle = ring.reshape(-1) * np.pi / 2
    tube = np.stack([along.reshape(-1), 0.4 * np.cos(angle), 0.4 * np.sin(angle)], axis=1)
    hat = np.array([[7.0, 0, 1], [8, 0, 1], [7, 1, 1], [7, 0, 2]])
    points = []
    for bend in np.linspace(0, 0.7, frames):
        turn = np.array([[np.cos(bend), -np.sin(bend), 0], [np.sin(bend), np.cos(bend), 0], [0, 0, 1]])
        far = tube[:, :1] > 3.2
        bent = np.where(far, (tube - [3.2, 0, 0]) @ turn.T + [3.2, 0, 0], tube)
        points.append(np.concatenate([bent, (hat - [3.2, 0, 0]) @ turn.T + [3.2, 0, 0]]))
    start = (np.arange(6)[:, None] * 4 + np.arange(4)).reshape(-1)
    following = (np.arange(6)[:, None] * 4 + (np.arange(4) + 1) % 4).reshape(-1)
    quads = np.stack([start, following, following + 4, start + 4], axis=1)
    faces = np.concatenate([quads.reshape(-1), [28, 30, 29, 28, 29, 31, 28, 31, 30, 29, 30, 31]])
    counts = np.array([4] * 24 + [3] * 4)
    corners = len(faces)
    surface = Surface(
        uvs=CornerValues(np.random.default_rng(1).random((9, 2)), np.arange(corners) % 9),
        hard_edges=np.arange(corners),
        face_sets=(FaceSet("skin", np.arange(20), "skin"), FaceSet("hat", np.arange(24, 28), "felt")),
        objects=(MeshObject("body", "", 28, 24), MeshObject("hat", "", 4, 4)),
    )
    plain = MeshSequence.from_arrays(np.array(points, np.float32), Polygons(counts, faces), name="arm")
    return replace(plain, surface=surface)


def _written(name: str, velocities: bool = False, **options: object) -> Maker:
    def make(folder: Path) -> None:
        sequence = arm()
        moving = replace(sequence, velocities=sequence.points) if velocities else sequence
        mixseq.write(folder / name, moving, **options)

    return make


def _model(**settings: Any) -> Maker:
    return lambda folder: mixseq.save(folder / "model.h5", mixseq.fit(arm(), **settings))


def _compressed(folder: Path) -> None:
    mixseq.save(folder / "model.h5", mixseq.compress(arm(6), max_error=1e-4))


def _compressed_glb(folder: Path) -> None:
    mixseq.save(folder / "model.glb", mixseq.compress(arm(6), max_error=1e-4), still="plain")


def _packed(name: str) -> Maker:
    return lambda folder: shutil.copy(PACKED / f"{name}.glb", folder / "walk.glb")


def _golden(folder: Path) -> None:
    shutil.copy(GOLDEN / f"{folder.name}.h5", folder / "model.h5")


def _usd_rig(folder: Path) -> None:
    shutil.copy(Path(__file__).with_name("rig.usda"), folder)


def _rig(kind: str) -> Maker:
    def make(folder: Path) -> None:
        rig = mixseq.fit_skin(arm(), 2) if kind == "skin" else mixseq.fit_morph(arm(), 0.01)
        mixseq.write_rig(folder / "rig.glb", rig)

    return make


def _stl(folder: Path) -> None:
    """STL of text, which mixseq does not write."""
    sequence = arm(3)
    for number, points in enumerate(sequence.points, start=1):
        lines = ["solid arm"]
        for face in sequence.faces:
            corners = "".join(f"      vertex {x} {y} {z}\n" for x, y, z in points[face])
            lines.append(f"  facet normal 0 0 1\n    outer loop\n{corners}    endloop\n  endfacet")
        (folder / f"walk_{number:04d}.stl").write_text("\n".join([*lines, "endsolid arm", ""]))


def _labels(folder: Path) -> None:
    _written("mesh.npz")(folder)
    np.savez(folder / "parts.npz", labels=np.arange(28) // 9, names=np.array(["arm", "bow", "hat", "cap"]))


def _labels_obj(folder: Path) -> None:
    _written("mesh.npz")(folder)
    mixseq.write(folder / "parts.obj", arm(1))


def _labels_usda(folder: Path) -> None:
    _written("mesh.npz")(folder)
    mixseq.write(folder / "parts.usda", arm(1), flatten=True)


def _texts(**files: str) -> Maker:
    def make(folder: Path) -> None:
        for name, text in files.items():
            (folder / name.replace("_", ".")).write_text(text, encoding="utf-8")

    return make


_PAIRS = [(5, 6), (1, 2), (3, 3), (10, 11)]

_markers = _texts(
    markers_txt="".join(f"{a} {b}  # place {a}\n" for a, b in _PAIRS),
    markers_json=json.dumps({"markers": [{"source": a, "target": b, "name": "n"} for a, b in _PAIRS]}),
    markers_yaml="markers:\n" + "".join(f"- source: {a}\n  target: {b}\n  name: n{a}\n" for a, b in _PAIRS),
)


def _maps(folder: Path) -> None:
    rows = [[number, number] for number in range(32)]
    (folder / "map.txt").write_text("vertices\n" + "".join(f"{a} {b}\n" for a, b in rows))
    (folder / "map.json").write_text(json.dumps({"vertices": rows}))
    np.savez(folder / "map.npz", vertices=np.arange(32))


_KEYS = "output,source\n0,0\n0.05,0.1\n0.2,0.15\n"
_EDITS = """
[[edit]]
operation = "repeat"
start = 0.0
end = 0.1
times = 2

[[edit]]
operation = "retime"
keys = "keys.csv"

[[edit]]
operation = "transition"
b = "other.h5"
at = 0.1
duration = 0.02

[[edit]]
operation = "exaggerate"
gain = 1.2
"""


def _edits(folder: Path) -> None:
    _model()(folder)
    shutil.copy(folder / "model.h5", folder / "other.h5")
    _texts(edits_toml=_EDITS, keys_csv=_KEYS)(folder)


def _report(folder: Path) -> None:
    _written("mesh.npz")(folder)
    main(["batch", str(folder / "mesh.npz"), "--out", str(folder / "models"), "-q"], standalone_mode=False)


MAKERS: dict[str, Maker] = {
    "usda": _written("walk.usda", velocities=True, flatten=True),
    "usdc": _written("walk.usdc", flatten=True),
    "usdz": _written("walk.usdz", flatten=True),
    "usd-clips": _written("walk.usd", flatten=True, clips=2),
    "usd-rig": _usd_rig,
    "h5": _written("walk.h5", velocities=True),
    "model-mixed": _model(),
    "model-free": _model(placement="free"),
    "model-vertex": _model(space="vertex"),
    "model-gradient": _model(space="gradient"),
    "model-lri": _model(space="lri"),
    "model-edge": _model(space="edge"),
    **{file.stem: _golden for file in sorted(GOLDEN.glob("*.h5"))},
    "compressed": _compressed,
    "compressed-glb": _compressed_glb,
    "abc": _written("walk.abc", velocities=True),
    "glb": _written("walk.glb", flatten=True),
    "gltf": _written("walk.gltf", flatten=True),
    "packed": _packed("gltfpack-ext"),
    "draco": _packed("draco"),
    "skin": _rig("skin"),
    "morph": _rig("morph"),
    "npz": _written("walk.npz", velocities=True),
    "npz-deflated": _written("walk.npz", compress=True),
    "pc2": _written("walk.pc2"),
    "mdd": _written("walk.mdd"),
    "obj": _written("walk_####.obj"),
    "ply": _written("walk_####.ply"),
    "stl": _written("walk_####.stl"),
    "stl-text": _stl,
    "off": _written("walk_####.off"),
    "labels-npz": _labels,
    "labels-obj": _labels_obj,
    "labels-usda": _labels_usda,
    "markers": _markers,
    "maps": _maps,
    "contacts": _texts(contacts_json=json.dumps({"left foot": [1, 2, 3], "right foot": [5, 6]})),
    "edits": _edits,
    "retiming": _texts(keys_csv=_KEYS, keys_toml="output = [0.0, 0.1, 0.2]\nsource = [0.0, 0.05, 0.2]\n"),
    "report": _report,
}
"""What makes a sample, by its name; it gets the sample's folder, which is empty."""


def make(corpus: Path, names: Iterable[str]) -> int:
    """Make the samples that are not there yet; a folder gets its name when it is complete."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MixseqWarning)
        for name in names:
            if not (corpus / name).is_dir():
                unfinished = corpus / ".unfinished" / name
                shutil.rmtree(unfinished, ignore_errors=True)
                unfinished.mkdir(parents=True)
                MAKERS[name](unfinished)
                unfinished.rename(corpus / name)
    return 0
