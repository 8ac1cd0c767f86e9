"""Damage follows from the seed, and changes files."""

from __future__ import annotations

import random
from contextlib import suppress
from pathlib import Path

import pytest

import mixseq
from scripts.fuzzing.damage import (
    NOT_POSSIBLE,
    Damage,
    damage_archive,
    damage_bytes,
    damage_h5,
    damage_json,
    damage_text,
)
from tests.meshes import coarse_walk

JSON = b'{"asset": {"version": "2.0"}, "buffers": [{"uri": "walk.bin", "byteLength": 12}]}'


@pytest.mark.parametrize(
    ("damage", "name"),
    [
        (damage_bytes, "walk.h5"),
        (damage_h5, "walk.h5"),
        (damage_archive, "walk.npz"),
        (damage_json, "walk.gltf"),
        (damage_json, "walk.glb"),
        (damage_text, "walk.gltf"),
    ],
)
@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_damage_follows_from_the_seed(damage: Damage, name: str, tmp_path: Path) -> None:
    file = tmp_path / name
    if name == "walk.gltf":
        file.write_bytes(JSON)
    else:
        mixseq.write(file, coarse_walk(frames=2))
    sound = file.read_bytes()

    def damaged() -> list[str]:
        labels = []
        for seed in range(15):
            with suppress(*NOT_POSSIBLE):
                label, changed = damage(random.Random(seed), sound)
                if changed != sound:  # a word may be replaced by itself
                    labels.append(label)
        return labels

    once = damaged()
    assert len(set(once)) > 7
    assert once == damaged()
