"""All readers: what is done with their files, samples of these, and how they are damaged."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from mixseq.choices import SPACES
from mixseq.cli import main
from mixseq.cli.batch_report import read_report, rows
from mixseq.cli.group import exit_code
from mixseq.operations.retiming import read_retiming
from mixseq_io.text.maps import read_map, to_correspondence
from mixseq_io.text.markers import read_contacts, read_markers
from scripts.fuzzing import samples
from scripts.fuzzing.coding import damage_coding, decode_twice
from scripts.fuzzing.damage import Damage, damage_archive, damage_bytes, damage_h5, damage_json, damage_text
from scripts.fuzzing.samples import Sample, written

OUT = "out.npz"
"""What a use writes into the folder of the file: an archive of arrays, or what the file said, as text."""

Use = Callable[[Path], int]
"""Uses a file as users do, and returns the exit code."""


@dataclass(frozen=True)
class Reader:
    """What is done with a file, samples, ways to damage them, and whether all damaged bytes must be noticed."""

    use: Use
    samples: tuple[Sample, ...]
    damages: tuple[Damage, ...]
    has_checksums: bool = False


def _command(*words: object) -> int:
    try:
        main([os.fspath(word) if isinstance(word, Path) else str(word) for word in words], prog_name="mixseq")
    except SystemExit as left:
        return left.code if isinstance(left.code, int) else int(left.code is not None)
    return 0


def convert(file: Path) -> int:
    return _command("info", file) or _command("convert", file, OUT, "-q")


def decode(file: Path) -> int:
    return _command("info", file) or _command("decode", file, OUT, "-q")


def decode_compressed(file: Path) -> int:
    """Decode, and verify what can be decoded, which may end as it likes."""
    code = decode(file)
    other = 0 if code else _command("verify", file)
    return code if other in (0, 1, 2) else other


def segment(file: Path) -> int:
    return _command("segment", "mesh.npz", OUT, "--labels", file, "--no-picture", "-q")


def edit(file: Path) -> int:
    return _command("edit", "model.h5", OUT, "--script", "edits.toml", "-q")


def calling(function: Callable[[Path], Any]) -> Use:
    """Return a use that calls a function with the file; its errors are reported as those of commands are."""

    def use(file: Path) -> int:
        def call() -> None:
            found = repr(function(file))
            Path(OUT).write_text(found)
            click.echo(found[:500])

        return exit_code(call)

    return use


def map_of_arms(file: Path) -> Any:
    mesh = samples.arm(1)
    return to_correspondence(read_map(file), *[(mesh.points[0], mesh.faces)] * 2)


def report_rows(file: Path) -> Any:
    return list(rows(read_report(file.parent).without_lost().entries.values()))


def _reader(use: Use, damages: tuple[Damage, ...], *made: Sample, has_checksums: bool = False) -> Reader:
    return Reader(use, made, damages, has_checksums)


_BYTES = (damage_bytes,)
_H5 = (damage_bytes, damage_h5)
_ARCHIVE = (damage_bytes, damage_archive, damage_archive)
_TEXT = (damage_text, damage_text, damage_bytes)
_JSON = (*_TEXT, damage_json, damage_json)
_MESH, _ARM = written("mesh.npz"), samples.model()
_SPACES = [samples.model(space=each) for each in SPACES if each != "mixed"]
_NAMED = samples.array("parts.npz", labels=np.arange(28) // 9, names=np.array(["arm", "bow", "hat", "cap"]))
_ROWS = [[number, number] for number in range(32)]
_EDITED = samples.beside(samples.EDITS, samples.KEYS, _ARM)

READERS: Mapping[str, Reader] = {
    "h5": _reader(convert, _H5, written("walk.h5", velocities=True), has_checksums=True),
    "model": _reader(decode, _H5, _ARM, *_SPACES, samples.herd(), has_checksums=True),
    "compressed": _reader(
        decode_compressed, _H5, samples.compressed("model.h5"), samples.herd(is_compressed=True), has_checksums=True
    ),
    "compressed-glb": _reader(
        decode_compressed,
        (damage_bytes, damage_json),
        samples.compressed("model.glb", still="plain"),
        has_checksums=True,
    ),
    "coding": _reader(
        calling(decode_twice), (damage_coding,), *map(samples.golden, ("", "-between", "-inbetweens", "-parts", "-uvs"))
    ),
    "usd": _reader(
        convert,
        _TEXT,
        written("walk.usda", velocities=True, flatten=True),
        written("walk.usd", flatten=True, clips=2),
        samples.rig("rig.usda", "skin"),
    ),
    "usdc": _reader(convert, _BYTES, written("walk.usdc", flatten=True)),
    "usdz": _reader(convert, _ARCHIVE, written("walk.usdz", flatten=True)),
    "abc": _reader(convert, _BYTES, written("walk.abc", velocities=True)),
    "gltf": _reader(
        convert,
        (damage_bytes, damage_json, damage_json),
        written("walk.gltf", flatten=True),
        written("walk.glb", flatten=True),
        samples.packed("gltfpack-ext"),
        samples.packed("draco"),
        samples.rig("rig.glb", "skin"),
        samples.rig("rig.glb", "morph"),
    ),
    "npz": _reader(convert, _ARCHIVE, written("walk.npz", velocities=True), written("walk.npz", compress=True)),
    "pc2": _reader(convert, _BYTES, written("walk.pc2", "*.pc2"), written("walk.pc2")),
    "mdd": _reader(convert, _BYTES, written("walk.mdd", "*.mdd"), written("walk.mdd")),
    "obj": _reader(convert, _TEXT, written("walk_####.obj", "*1.obj"), written("walk_####.obj")),
    "ply": _reader(convert, (damage_bytes, damage_text), written("walk_####.ply")),
    "stl": _reader(convert, _TEXT, written("walk_####.stl"), samples.text("walk.stl", samples.stl_text())),
    "off": _reader(convert, _TEXT, written("walk_####.off")),
    "labels": _reader(
        segment,
        (*_ARCHIVE, damage_text),
        *(samples.beside(each, _MESH) for each in (_NAMED, written("parts.usda", flatten=True))),
    ),
    "markers": _reader(calling(read_markers), _JSON, *samples.MARKERS),
    "maps": _reader(
        calling(map_of_arms),
        (*_JSON, damage_archive),
        samples.text("map.txt", "vertices\n" + "".join(f"{a} {b}\n" for a, b in _ROWS)),
        samples.text("map.json", json.dumps({"vertices": _ROWS})),
        samples.array("map.npz", vertices=np.arange(32)),
    ),
    "contacts": _reader(calling(read_contacts), _JSON, samples.CONTACTS),
    "edits": _reader(edit, _TEXT, *(replace(_EDITED, damaged=each) for each in ("edits.toml", "keys.csv"))),
    "retiming": _reader(calling(read_retiming), _TEXT, samples.KEYS, samples.KEYS_TOML),
    "report": _reader(
        calling(report_rows),
        (damage_json, damage_text),
        Sample("models/report.json", samples.report, "models/report.json"),
    ),
}
"""Readers by their names."""
