"""Small sound files of every kind, which are damaged."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

import mixseq
from mixseq.cli import main
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import CornerValues, FaceSet, MeshObject, Surface
from mixseq.operations import key_poses, with_body
from mixseq.sequence.sequence import MeshSequence
from mixseq_io.verification import read_compressed

FORMATS = Path(__file__).parents[2] / "tests" / "formats"

Maker = Callable[[Path], object]
"""Writes files into a folder."""


@dataclass(frozen=True)
class Sample:
    """A folder of files: what is given to commands, who writes it, and which files are damaged, one at a time."""

    argument: str
    make: Maker
    damaged: str = "*"


def arm(frames: int = 4) -> MeshSequence:
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
    start = (np.arange(6)[:, None] * 4 + np.arange(4)).reshape(-1)
    following = (np.arange(6)[:, None] * 4 + (np.arange(4) + 1) % 4).reshape(-1)
    quads = np.stack([start, following, following + 4, start + 4], axis=1)
    faces = np.concatenate([quads.reshape(-1), [28, 30, 29, 28, 29, 31, 28, 31, 30, 29, 30, 31]])
    surface = Surface(
        uvs=CornerValues(np.random.default_rng(1).random((9, 2)), np.arange(len(faces)) % 9),
        hard_edges=np.arange(len(faces)),
        face_sets=(FaceSet("skin", np.arange(20), "skin"), FaceSet("hat", np.arange(24, 28), "felt")),
        objects=(MeshObject("body", "", 28, 24), MeshObject("hat", "", 4, 4)),
    )
    polygons = Polygons(np.array([4] * 24 + [3] * 4), faces)
    plain = MeshSequence.from_arrays(np.array(points, np.float32), polygons, name="arm")
    return replace(plain, surface=surface)


def written(name: str, damaged: str = "*", velocities: bool = False, **options: object) -> Sample:
    """Return a sample of a sequence."""

    def make(folder: Path) -> None:
        sequence = arm()
        moving = replace(sequence, velocities=sequence.points) if velocities else sequence
        mixseq.write(folder / name, moving, **options)

    return Sample(name, make, damaged)


def model(**settings: Any) -> Sample:
    """Return a sample of a fitted model."""
    return Sample("model.h5", lambda folder: mixseq.save(folder / "model.h5", mixseq.fit(arm(), **settings)))


def herd(is_compressed: bool = False) -> Sample:
    """Return a sample of a model of two bodies."""

    def save(folder: Path) -> None:
        fitted = mixseq.fit(arm(), exact=True)
        both = with_body(fitted, key_poses(fitted), "another")
        mixseq.save(folder / "model.h5", mixseq.compress(both, max_error=1e-4) if is_compressed else both)

    return Sample("model.h5", save)


def compressed(name: str, **options: Any) -> Sample:
    """Return a sample of a compressed model."""
    return Sample(name, lambda folder: mixseq.save(folder / name, mixseq.compress(arm(6), max_error=1e-4), **options))


def golden(name: str) -> Sample:
    """Return a sample of a compressed model of the golden files, as .glb."""
    stored = FORMATS / "golden" / f"compressed-v1{name}.h5"

    def make(folder: Path) -> None:
        mixseq.save(folder / "model.glb", read_compressed(stored), still="none")

    return Sample("model.glb", make)


def packed(name: str) -> Sample:
    """Return a sample of glTF that another program compressed."""
    return Sample(
        "walk.glb", lambda folder: shutil.copy(FORMATS / "gltf" / "packed" / f"{name}.glb", folder / "walk.glb")
    )


def rig(name: str, kind: str) -> Sample:
    """Return a sample of a skin or a morph."""

    def make(folder: Path) -> None:
        fitted = mixseq.fit_skin(arm(), 2) if kind == "skin" else mixseq.fit_morph(arm(), 0.01)
        mixseq.write_rig(folder / name, fitted)

    return Sample(name, make)


def text(name: str, content: str) -> Sample:
    """Return a sample of text."""
    return Sample(name, lambda folder: (folder / name).write_text(content, encoding="utf-8"))


def array(name: str, **arrays: Any) -> Sample:
    """Return a sample of an npz file."""
    return Sample(name, lambda folder: np.savez(folder / name, **arrays))


def beside(sample: Sample, *others: Sample) -> Sample:
    """Return a sample with other files in its folder, which stay sound."""

    def make(folder: Path) -> None:
        for each in (sample, *others):
            each.make(folder)

    return replace(sample, make=make, damaged=sample.argument)


def stl_text() -> str:
    """Return an STL file of text, which mixseq does not write."""
    still = arm(1)
    return str(trimesh.Trimesh(still.points[0], still.faces, process=False).export(file_type="stl_ascii"))


def report(folder: Path) -> None:
    """Write the report of a batch."""
    mixseq.write(folder / "mesh.npz", arm())
    main(["batch", "encode", str(folder / "mesh.npz"), "--out", str(folder / "models"), "-q"], standalone_mode=False)


PAIRS = [(5, 6), (1, 2), (3, 3), (10, 11)]
MARKERS = (
    text("markers.txt", "".join(f"{a} {b}  # place {a}\n" for a, b in PAIRS)),
    text("markers.json", json.dumps({"markers": [{"source": a, "target": b, "name": "n"} for a, b in PAIRS]})),
    text("markers.yaml", "markers:\n" + "".join(f"- source: {a}\n  target: {b}\n  name: n{a}\n" for a, b in PAIRS)),
)
CONTACTS = text("contacts.json", json.dumps({"left foot": [1, 2, 3], "right foot": [5, 6]}))
KEYS = text("keys.csv", "output,source\n0,0\n0.05,0.1\n0.2,0.15\n")
KEYS_TOML = text("keys.toml", "output = [0.0, 0.1, 0.2]\nsource = [0.0, 0.05, 0.2]\n")
EDITS = text(
    "edits.toml",
    """
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
""",
)
