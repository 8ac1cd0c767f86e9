"""All readers: what is done with their files, small sound samples of these, and how they are damaged."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np
import trimesh

import mixseq
from mixseq.choices import SPACES
from mixseq.cli import main
from mixseq.cli.batch_report import read_report, rows
from mixseq.cli.group import exit_code
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import CornerValues, FaceSet, MeshObject, Surface
from mixseq.operations import key_poses, with_body
from mixseq.operations.retiming import read_retiming
from mixseq.sequence.sequence import MeshSequence
from mixseq_io.model_files import read_compressed
from mixseq_io.text.maps import read_map, to_correspondence
from mixseq_io.text.markers import read_contacts, read_markers
from scripts.fuzzing.coding import damage_coding, decode_twice
from scripts.fuzzing.damage import Damage, damage_archive, damage_bytes, damage_h5, damage_json, damage_text

FORMATS = Path(__file__).parents[2] / "tests" / "formats"
OUT = "out.npz"
"""What a use writes into the folder of the file: an archive of arrays, or what the file said, as text."""

Use = Callable[[Path], int]
"""Uses a file as users do, and returns the exit code."""


@dataclass(frozen=True)
class Sample:
    """A file that is given to commands, what writes it, and which files of its folder are damaged, one at a time."""

    argument: str
    make: Callable[[Path], object]
    damaged: str = "*"


@dataclass(frozen=True)
class Reader:
    """What is done with a file, ways to damage it, and samples."""

    use: Use
    damages: tuple[Damage, ...]
    samples: Sequence[Sample]


def arm(frames: int) -> MeshSequence:
    """Return a bent tube of quads and a tetrahedron beside it, with everything that a mesh can have."""
    ring, along = np.meshgrid(np.arange(4), np.arange(7))
    angle = ring.reshape(-1) * np.pi / 2
    tube = np.stack([along.reshape(-1), 0.4 * np.cos(angle), 0.4 * np.sin(angle)], axis=1)
    hat = np.array([[7.0, 0, 1], [8, 0, 1], [7, 1, 1], [7, 0, 2]])
    rest, far = np.concatenate([tube, hat]) - [3.2, 0, 0], np.append(tube[:, 0] > 3.2, [True] * 4)
    points = []
    for bend in np.linspace(0, 0.7, frames):
        turn = np.array([[np.cos(bend), -np.sin(bend), 0], [np.sin(bend), np.cos(bend), 0], [0, 0, 1]])
        points.append(np.where(far[:, None], rest @ turn.T, rest))
    start = np.arange(24)
    following = start // 4 * 4 + (start + 1) % 4
    quads = np.stack([start, following, following + 4, start + 4], axis=1)
    faces = np.concatenate([quads.reshape(-1), [28, 30, 29, 28, 29, 31, 28, 31, 30, 29, 30, 31]])
    surface = Surface(
        uvs=CornerValues(np.random.default_rng(1).random((9, 2)), np.arange(len(faces)) % 9),
        hard_edges=np.arange(len(faces)),
        face_sets=(FaceSet("skin", np.arange(20), "skin"), FaceSet("hat", np.arange(24, 28), "felt")),
        objects=(MeshObject("body", "", 28, 24), MeshObject("hat", "", 4, 4)),
    )
    polygons = Polygons(np.array([4] * 24 + [3] * 4), faces)
    return replace(MeshSequence.from_arrays(np.array(points, np.float32), polygons, name="arm"), surface=surface)


ARM = arm(4)


def written(name: str, damaged: str = "*", velocities: bool = False, **options: object) -> Sample:
    """Return a sample of a sequence."""
    sequence = replace(ARM, velocities=ARM.points) if velocities else ARM
    return Sample(name, lambda file: mixseq.write(file, sequence, **options), damaged)


def saved(name: str, fit: Callable[[], Any], **options: Any) -> Sample:
    """Return a sample of a model."""
    return Sample(name, lambda file: mixseq.save(file, fit(), **options))


def two_bodies() -> Any:
    model = mixseq.fit(ARM, exact=True)
    return with_body(model, key_poses(model), "another")


def rig(name: str, fit: Callable[..., Any], *settings: float) -> Sample:
    """Return a sample of a skin or a morph."""
    return Sample(name, lambda file: mixseq.write_rig(file, fit(ARM, *settings)))


def text(name: str, content: str) -> Sample:
    return Sample(name, lambda file: file.write_text(content, encoding="utf-8"))


def array(name: str, **arrays: Any) -> Sample:
    return Sample(name, lambda file: np.savez(file, **arrays))


def beside(sample: Sample, *others: Sample) -> Sample:
    """Return a sample with other files in its folder, which stay sound."""

    def make(file: Path) -> None:
        for each in (sample, *others):
            each.make(file.with_name(each.argument))

    return replace(sample, make=make, damaged=sample.argument)


def write_stl_text(file: Path) -> None:
    """Write STL as text, which mixseq does not."""
    trimesh.Trimesh(ARM.points[0], ARM.faces, process=False).export(file, file_type="stl_ascii")


def write_report(file: Path) -> None:
    """Write the report of a batch."""
    models = file.parent
    mesh = models.with_name("mesh.npz")
    mixseq.write(mesh, ARM)
    main(["batch", "encode", str(mesh), "--out", str(models), "-q"], standalone_mode=False)


def commands(*lines: str) -> Use:
    """Return a use that runs commands until one fails, with the file for {}."""

    def use(file: Path) -> int:
        return next(filter(None, (_run(line.format(file).split()) for line in lines)), 0)

    return use


def _run(words: Sequence[str]) -> int:
    try:
        main(words, prog_name="mixseq")
    except SystemExit as left:
        return left.code if isinstance(left.code, int) else int(left.code is not None)
    return 0


def calling(function: Callable[[Path], Any]) -> Use:
    """Return a use that calls a function with the file; its errors are reported as those of commands are."""

    def use(file: Path) -> int:
        def call() -> None:
            found = repr(function(file))
            Path(OUT).write_text(found)
            click.echo(found[:500])

        return exit_code(call)

    return use


convert = commands("info {}", f"convert {{}} {OUT} -q")
decode = commands("info {}", f"decode {{}} {OUT} -q")
edit = commands(f"edit model.h5 {OUT} --script edits.toml -q")
segment = commands(f"segment mesh.npz {OUT} --labels {{}} --no-picture -q")
verify = commands("verify {}")


def decode_compressed(file: Path) -> int:
    """Decode, and verify what can be decoded, which may find damage."""
    code = decode(file)
    verified = 0 if code else verify(file)
    return code if verified in (0, 1, 2) else verified


def map_of_arms(file: Path) -> Any:
    return to_correspondence(read_map(file), *[(ARM.points[0], ARM.faces)] * 2)


def report_rows(file: Path) -> Any:
    return list(rows(read_report(file.parent).without_lost().entries.values()))


_BYTES = (damage_bytes,)
_H5 = (damage_bytes, damage_h5)
_ARCHIVE = (damage_bytes, damage_archive, damage_archive)
_TEXT = (damage_text, damage_text, damage_bytes)
_JSON = (*_TEXT, damage_json, damage_json)

_MESH = written("mesh.npz")
_MODEL = saved("model.h5", partial(mixseq.fit, ARM))
_SPACES = [saved("model.h5", partial(mixseq.fit, ARM, space=space)) for space in SPACES if space != "mixed"]
_COMPRESS = partial(mixseq.compress, max_error=1e-4)
_COMPRESSED = [saved("model.h5", lambda: _COMPRESS(arm(6))), saved("model.h5", lambda: _COMPRESS(two_bodies()))]
_COMPRESSED_GLB = [saved("model.glb", lambda: _COMPRESS(arm(6)), still="plain")]
_GOLDEN = [
    saved("model.glb", partial(read_compressed, FORMATS / "golden" / f"compressed-v1{name}.h5"), still="none")
    for name in ("", "-between", "-inbetweens", "-parts", "-uvs")
]
_USD = [
    written("walk.usda", velocities=True, flatten=True),
    written("walk.usd", flatten=True, clips=2),
    rig("rig.usda", mixseq.fit_skin, 2),
]
_GLTF = [
    written("walk.gltf", flatten=True),
    written("walk.glb", flatten=True),
    Sample("walk.glb", partial(shutil.copy, FORMATS / "gltf" / "packed" / "gltfpack-ext.glb")),
    Sample("walk.glb", partial(shutil.copy, FORMATS / "gltf" / "packed" / "draco.glb")),
    rig("rig.glb", mixseq.fit_skin, 2),
    rig("rig.glb", mixseq.fit_morph, 0.01),
]
_PARTS = array("parts.npz", labels=np.arange(28) // 9, names=np.array(["arm", "bow", "hat", "cap"]))
_LABELS = [beside(_PARTS, _MESH), beside(written("parts.usda", flatten=True), _MESH)]
_PAIRS = [(5, 6), (1, 2), (3, 3), (10, 11)]
_MARKERS = (
    text("markers.txt", "".join(f"{a} {b}  # place {a}\n" for a, b in _PAIRS)),
    text("markers.json", json.dumps({"markers": [{"source": a, "target": b, "name": "n"} for a, b in _PAIRS]})),
    text("markers.yaml", "markers:\n" + "".join(f"- source: {a}\n  target: {b}\n  name: n{a}\n" for a, b in _PAIRS)),
)
_CONTACTS = text("contacts.json", json.dumps({"left foot": [1, 2, 3], "right foot": [5, 6]}))
_ROWS = [[number, number] for number in range(32)]
_MAPS = (
    text("map.txt", "vertices\n" + "".join(f"{a} {b}\n" for a, b in _ROWS)),
    text("map.json", json.dumps({"vertices": _ROWS})),
    array("map.npz", vertices=np.arange(32)),
)
_KEYS = text("keys.csv", "output,source\n0,0\n0.05,0.1\n0.2,0.15\n")
_KEYS_TOML = text("keys.toml", "output = [0.0, 0.1, 0.2]\nsource = [0.0, 0.05, 0.2]\n")
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
operation = "exaggerate"
gain = 1.2
"""
_REPORT = Sample("models/report.json", write_report, "models/report.json")
_EDITED = beside(text("edits.toml", _EDITS), _KEYS, _MODEL)

READERS: Mapping[str, Reader] = {
    "h5": Reader(convert, _H5, [written("walk.h5", velocities=True)]),
    "model": Reader(decode, _H5, [_MODEL, *_SPACES, saved("model.h5", two_bodies)]),
    "compressed": Reader(decode_compressed, _H5, _COMPRESSED),
    "compressed-glb": Reader(decode_compressed, (damage_bytes, damage_json), _COMPRESSED_GLB),
    "coding": Reader(calling(decode_twice), (damage_coding,), _GOLDEN),
    "usd": Reader(convert, _TEXT, _USD),
    "usdc": Reader(convert, _BYTES, [written("walk.usdc", flatten=True)]),
    "usdz": Reader(convert, _ARCHIVE, [written("walk.usdz", flatten=True)]),
    "abc": Reader(convert, _BYTES, [written("walk.abc", velocities=True)]),
    "gltf": Reader(convert, (damage_bytes, damage_json, damage_json), _GLTF),
    "npz": Reader(convert, _ARCHIVE, [written("walk.npz", velocities=True), written("walk.npz", compress=True)]),
    "pc2": Reader(convert, _BYTES, [written("walk.pc2", "*.pc2"), written("walk.pc2")]),
    "mdd": Reader(convert, _BYTES, [written("walk.mdd", "*.mdd"), written("walk.mdd")]),
    "obj": Reader(convert, _TEXT, [written("walk_####.obj", "*1.obj"), written("walk_####.obj")]),
    "ply": Reader(convert, (damage_bytes, damage_text), [written("walk_####.ply")]),
    "stl": Reader(convert, _TEXT, [written("walk_####.stl"), Sample("walk.stl", write_stl_text)]),
    "off": Reader(convert, _TEXT, [written("walk_####.off")]),
    "labels": Reader(segment, (*_ARCHIVE, damage_text), _LABELS),
    "markers": Reader(calling(read_markers), _JSON, _MARKERS),
    "maps": Reader(calling(map_of_arms), (*_JSON, damage_archive), _MAPS),
    "contacts": Reader(calling(read_contacts), _JSON, [_CONTACTS]),
    "edits": Reader(edit, _TEXT, [_EDITED, replace(_EDITED, damaged="keys.csv")]),
    "retiming": Reader(calling(read_retiming), _TEXT, [_KEYS, _KEYS_TOML]),
    "report": Reader(calling(report_rows), (damage_json, damage_text), [_REPORT]),
}
"""Readers by their names."""

CHECKED = ("h5", "model", "compressed", "compressed-glb")
"""Readers of files with checksums, where all damaged bytes must be noticed."""
