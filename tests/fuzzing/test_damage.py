"""Damage follows from the seed, and changes files."""

from __future__ import annotations

import random
import zipfile
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from scripts.fuzzing.canary import lay_out
from scripts.fuzzing.case import Case, Damage, NotMadeError
from scripts.fuzzing.damage.of_archives import _BOMB, _BOMB_CHECKSUM, _bomb, damage_archive
from scripts.fuzzing.damage.of_bytes import damage_bytes
from scripts.fuzzing.damage.of_h5 import damage_h5
from scripts.fuzzing.damage.of_json import damage_gltf, damage_json
from scripts.fuzzing.damage.of_text import damage_text
from scripts.fuzzing.damage.of_usd import damage_usd

GOLDEN = Path(__file__).parents[1] / "formats" / "golden"
RIG = Path(__file__).parents[2] / "scripts" / "fuzzing" / "rig.usda"
JSON = b'{"asset": {"version": "2.0"}, "buffers": [{"uri": "walk.bin", "byteLength": 12}]}'


def sound(name: str) -> bytes:
    if name == "rig.usda":
        return RIG.read_bytes()
    return JSON if name == "walk.gltf" else (GOLDEN / f"sequence-v1{Path(name).suffix}").read_bytes()


@pytest.mark.parametrize(
    ("damage", "name"),
    [
        (damage_bytes, "walk.h5"),
        (damage_h5, "walk.h5"),
        (damage_archive, "walk.npz"),
        (damage_json, "walk.gltf"),
        (damage_gltf, "walk.gltf"),
        (damage_text, "walk.gltf"),
        (damage_usd, "rig.usda"),
    ],
)
def test_damage_follows_from_the_seed(damage: Damage, name: str, tmp_path: Path) -> None:
    def damaged(folder: str) -> list[str]:
        (tmp_path / folder).mkdir()
        labels = []
        for seed in range(15):
            file = tmp_path / folder / name
            file.write_bytes(sound(name))
            (file.parent / "pipe.usda").unlink(missing_ok=True)
            with suppress(NotMadeError):
                label = damage(Case(random.Random(seed), file, (), ("/canary/secret.h5",)))
                if file.read_bytes() != sound(name):  # a word may be replaced by itself
                    labels.append(label)
        return labels

    once, again = damaged("a"), damaged("b")
    assert len(set(once)) > 7
    # a file's own path is among what links lead to
    assert [each.replace("/a/", "/b/") for each in once] == again


def test_a_bomb_is_what_it_says(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w") as archive:
        info = zipfile.ZipInfo("points.npy")
        archive.writestr(info, _bomb())
        info.compress_type, info.CRC, info.file_size = zipfile.ZIP_DEFLATED, _BOMB_CHECKSUM, _BOMB
    assert (tmp_path / "bomb.npz").stat().st_size < _BOMB / 500
    with np.load(tmp_path / "bomb.npz") as archive, archive.zip.open("points.npy") as entry:
        assert np.lib.format.read_magic(entry) == (1, 0)
        shape, _, dtype = np.lib.format.read_array_header_1_0(entry)
        assert (shape[0] + 128, dtype) == (_BOMB, np.dtype("u1"))


def test_files_outside_are_watched(tmp_path: Path) -> None:
    canary = lay_out(tmp_path)
    assert canary.opened() == []
    (tmp_path / "secret.txt").read_text()
    assert canary.opened() == ["secret.txt"]
    assert canary.opened() == []
