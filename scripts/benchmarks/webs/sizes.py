"""Bytes of a motion in the files in which the web is sent one."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from scripts.benchmarks.webs.shipping import DRACO_BITS, OURS, TITLES, shipped, texture_bytes

COLUMNS = (
    "sequence",
    "max error",
    *(f"{title}, kB" for title in TITLES),
    "gltfpack / GLB",
    "without textures",
)

_GLTFPACK = TITLES[3]


def rows(name: str) -> Iterator[tuple[str, ...]]:
    """Count an animation's, with either bound."""
    for bound in DRACO_BITS:
        with tempfile.TemporaryDirectory() as folder:
            found = {each.title: each for each in shipped(name, bound, Path(folder))}
            ours = found[OURS]
            textures = texture_bytes(ours.folder / "shot.glb")
            sizes = [f"{found[title].data / 1000:.1f}" if title in found else "" for title in TITLES]
            ratios = ["", ""]
            if _GLTFPACK in found:
                packed = found[_GLTFPACK].data
                ratios = [f"{packed / ours.data:.1f}", f"{(packed - textures) / (ours.data - textures):.1f}"]
            yield name, f"{bound:g}", *sizes, *ratios
