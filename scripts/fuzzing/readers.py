"""All readers: their samples, how these are damaged, and what is done with them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from scripts.fuzzing import uses
from scripts.fuzzing.case import Damage
from scripts.fuzzing.damage.of_archives import damage_archive
from scripts.fuzzing.damage.of_bytes import damage_bytes
from scripts.fuzzing.damage.of_h5 import damage_h5
from scripts.fuzzing.damage.of_json import damage_gltf, damage_json
from scripts.fuzzing.damage.of_text import damage_text
from scripts.fuzzing.damage.of_usd import damage_usd
from scripts.fuzzing.uses import Use

Damages = tuple[tuple[Damage, int], ...]


@dataclass(frozen=True)
class Sample:
    """A folder of the corpus.

    Attributes
    ----------
    folder : str
        Its name.
    argument : str
        What is given to the commands, a file or a pattern in it.
    damaged : str
        Pattern of the files that are damaged, one at a time.
    """

    folder: str
    argument: str
    damaged: str = "*"


@dataclass(frozen=True)
class Reader:
    """A reader.

    Attributes
    ----------
    use : callable
        What is done with a sample.
    samples : tuple of Sample
        What there is of it.
    damages : tuple of callable and number
        What is done to a file, and how often.
    checksums : bool
        Whether damage to the bytes must be noticed if it changes anything.
    follows : bool
        Whether files may name others, anywhere, that are read with them.
    """

    use: Use
    samples: tuple[Sample, ...]
    damages: Damages
    checksums: bool = False
    follows: bool = False


def _models(*folders: str) -> tuple[Sample, ...]:
    return tuple(Sample(folder, "model.h5") for folder in folders)


_H5: Damages = ((damage_bytes, 1), (damage_h5, 1))
_BYTES: Damages = ((damage_bytes, 1),)
_TEXT: Damages = ((damage_text, 3), (damage_bytes, 1))
_ARCHIVE: Damages = ((damage_bytes, 1), (damage_archive, 2))
_NUMBERED = "*_0001.*"

READERS: Mapping[str, Reader] = {
    "h5": Reader(
        uses.convert, (Sample("h5", "walk.h5"), Sample("sequence-v2", "model.h5")), _H5, checksums=True
    ),
    "model": Reader(
        uses.decode,
        _models(
            "model-mixed",
            "model-free",
            "model-vertex",
            "model-gradient",
            "model-lri",
            "model-edge",
            "model-v6",
        ),
        _H5,
        checksums=True,
    ),
    # before version 2, and 6 of models, names and axes had no checksum
    "older": Reader(
        uses.convert,
        (
            Sample("sequence-v1", "model.h5"),
            *_models(
                "model-v1",
                "model-v2",
                "model-v2-rank",
                "model-v2-vertex",
                "model-v3-edge",
                "model-v3-gradient",
            ),
            *_models("model-v3-lri", "model-v5", "model-v5-edge", "model-v5-free", "model-v5-lri"),
        ),
        _H5,
    ),
    "compressed": Reader(
        uses.decode_compressed,
        _models("compressed", "compressed", "compressed-v1", "compressed-v1-uvs"),
        _H5,
        checksums=True,
    ),
    "compressed-glb": Reader(
        uses.decode_compressed,
        (Sample("compressed-glb", "model.glb"),),
        ((damage_bytes, 1), (damage_gltf, 2)),
        checksums=True,
    ),
    "usd": Reader(
        uses.convert_usd,
        (
            Sample("usda", "walk.usda"),
            Sample("usdc", "walk.usdc"),
            Sample("usd-rig", "rig.usda"),
            Sample("usd-clips", "walk.usd"),
        ),
        ((damage_bytes, 1), (damage_usd, 2)),
        follows=True,
    ),
    "usdz": Reader(uses.convert_usd, (Sample("usdz", "walk.usdz"),), _ARCHIVE, follows=True),
    "abc": Reader(uses.convert, (Sample("abc", "walk.abc"),), _BYTES),
    "gltf": Reader(
        uses.convert,
        (
            Sample("gltf", "walk.gltf"),
            Sample("glb", "walk.glb"),
            Sample("packed", "walk.glb"),
            Sample("draco", "walk.glb"),
            Sample("skin", "rig.glb"),
            Sample("morph", "rig.glb"),
        ),
        ((damage_bytes, 1), (damage_gltf, 3)),
    ),
    "npz": Reader(uses.convert, (Sample("npz", "walk.npz"), Sample("npz-deflated", "walk.npz")), _ARCHIVE),
    "pc2": Reader(uses.convert, (Sample("pc2", "walk.pc2", "*.pc2"), Sample("pc2", "walk.pc2")), _BYTES),
    "mdd": Reader(uses.convert, (Sample("mdd", "walk.mdd", "*.mdd"), Sample("mdd", "walk.mdd")), _BYTES),
    "obj": Reader(
        uses.convert, (Sample("obj", "walk_####.obj", _NUMBERED), Sample("obj", "walk_####.obj")), _TEXT
    ),
    "ply": Reader(uses.convert, (Sample("ply", "walk_####.ply"),), ((damage_bytes, 1), (damage_text, 1))),
    "stl": Reader(uses.convert, (Sample("stl", "walk_####.stl"), Sample("stl-text", "walk_####.stl")), _TEXT),
    "off": Reader(uses.convert, (Sample("off", "walk_####.off"),), _TEXT),
    "labels": Reader(
        uses.segment,
        (Sample("labels-npz", "parts.npz", "parts.npz"), Sample("labels-npz", "mesh.npz")),
        _ARCHIVE,
    ),
    "labels-mesh": Reader(
        uses.segment,
        (Sample("labels-obj", "parts.obj", "parts.obj"), Sample("labels-usda", "parts.usda", "parts.usda")),
        _TEXT,
        follows=True,
    ),
    "markers": Reader(
        uses.markers,
        tuple(Sample("markers", f"markers.{kind}", f"markers.{kind}") for kind in ("txt", "json", "yaml")),
        (*_TEXT, (damage_json, 1)),
    ),
    "maps": Reader(
        uses.maps,
        tuple(Sample("maps", f"map.{kind}", f"map.{kind}") for kind in ("txt", "json", "npz")),
        (*_TEXT, (damage_json, 1), (damage_archive, 2)),
    ),
    "contacts": Reader(uses.contacts, (Sample("contacts", "contacts.json"),), (*_TEXT, (damage_json, 2))),
    "edits": Reader(
        uses.edit,
        (Sample("edits", "edits.toml", "edits.toml"), Sample("edits", "edits.toml", "*.csv")),
        _TEXT,
    ),
    "retiming": Reader(
        uses.retiming,
        (Sample("retiming", "keys.csv", "keys.csv"), Sample("retiming", "keys.toml", "keys.toml")),
        _TEXT,
    ),
    "report": Reader(
        uses.report,
        (Sample("report", "models/report.json", "models/report.json"),),
        ((damage_json, 3), (damage_text, 1)),
    ),
}
"""Readers by their names. The order and the samples decide what a case is, so append to them."""
