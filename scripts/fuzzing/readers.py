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

from mixseq.cli import main
from mixseq.cli.batch import read_report, rows
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


_H5 = (damage_bytes, damage_h5)
_ARCHIVE = (damage_bytes, damage_archive, damage_archive)
_TEXT = (damage_text, damage_text, damage_bytes)
_JSON = (*_TEXT, damage_json, damage_json)
_MESH, _ARM = written("mesh.npz"), samples.model()
_ROWS = [[number, number] for number in range(32)]

READERS: Mapping[str, Reader] = {
    "h5": Reader(convert, (written("walk.h5", velocities=True),), _H5, has_checksums=True),
    "model": Reader(
        decode,
        (_ARM, *(samples.model(space=each) for each in ("vertex", "gradient", "lri", "edge"))),
        _H5,
        has_checksums=True,
    ),
    "compressed": Reader(decode_compressed, (samples.compressed("model.h5"),), _H5, has_checksums=True),
    "compressed-glb": Reader(
        decode_compressed,
        (samples.compressed("model.glb", still="plain"),),
        (damage_bytes, damage_json),
        has_checksums=True,
    ),
    "coding": Reader(
        calling(decode_twice),
        tuple(map(samples.golden, ("", "-between", "-inbetweens", "-parts", "-uvs"))),
        (damage_coding,),
    ),
    "usd": Reader(
        convert,
        (
            written("walk.usda", velocities=True, flatten=True),
            written("walk.usd", flatten=True, clips=2),
            samples.rig("rig.usda", "skin"),
        ),
        _TEXT,
    ),
    "usdc": Reader(convert, (written("walk.usdc", flatten=True),), (damage_bytes,)),
    "usdz": Reader(convert, (written("walk.usdz", flatten=True),), _ARCHIVE),
    "abc": Reader(convert, (written("walk.abc", velocities=True),), (damage_bytes,)),
    "gltf": Reader(
        convert,
        (
            written("walk.gltf", flatten=True),
            written("walk.glb", flatten=True),
            samples.packed("gltfpack-ext"),
            samples.packed("draco"),
            samples.rig("rig.glb", "skin"),
            samples.rig("rig.glb", "morph"),
        ),
        (damage_bytes, damage_json, damage_json),
    ),
    "npz": Reader(convert, (written("walk.npz", velocities=True), written("walk.npz", compress=True)), _ARCHIVE),
    "pc2": Reader(convert, (written("walk.pc2", "*.pc2"), written("walk.pc2")), (damage_bytes,)),
    "mdd": Reader(convert, (written("walk.mdd", "*.mdd"), written("walk.mdd")), (damage_bytes,)),
    "obj": Reader(convert, (written("walk_####.obj", "*1.obj"), written("walk_####.obj")), _TEXT),
    "ply": Reader(convert, (written("walk_####.ply"),), (damage_bytes, damage_text)),
    "stl": Reader(convert, (written("walk_####.stl"), samples.text("walk.stl", samples.stl_text())), _TEXT),
    "off": Reader(convert, (written("walk_####.off"),), _TEXT),
    "labels": Reader(
        segment,
        tuple(
            samples.beside(each, _MESH)
            for each in (
                samples.array("parts.npz", labels=np.arange(28) // 9, names=np.array(["arm", "bow", "hat", "cap"])),
                written("parts.usda", flatten=True),
            )
        ),
        (*_ARCHIVE, damage_text),
    ),
    "markers": Reader(calling(read_markers), samples.MARKERS, _JSON),
    "maps": Reader(
        calling(map_of_arms),
        (
            samples.text("map.txt", "vertices\n" + "".join(f"{a} {b}\n" for a, b in _ROWS)),
            samples.text("map.json", json.dumps({"vertices": _ROWS})),
            samples.array("map.npz", vertices=np.arange(32)),
        ),
        (*_JSON, damage_archive),
    ),
    "contacts": Reader(
        calling(read_contacts),
        (samples.text("contacts.json", json.dumps({"left foot": [1, 2, 3], "right foot": [5, 6]})),),
        _JSON,
    ),
    "edits": Reader(
        edit,
        tuple(
            replace(samples.beside(samples.EDITS, samples.KEYS, _ARM), damaged=each)
            for each in ("edits.toml", "keys.csv")
        ),
        _TEXT,
    ),
    "retiming": Reader(calling(read_retiming), (samples.KEYS, samples.KEYS_TOML), _TEXT),
    "report": Reader(
        calling(report_rows),
        (Sample("models/report.json", samples.report, "models/report.json"),),
        (damage_json, damage_text),
    ),
}
"""Readers by their names."""
