"""Bounds hold in all that users get (JavaScript, all formats, textures, skins and morphs), or are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.types import FloatArray, Index
from tests.adversarial import FRAMES, SEQUENCES, sheet, waving
from tests.promises import DELIVERIES, deliveries
from tests.web.conftest import Node

pytestmark = pytest.mark.slow

BOUNDS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
SCALES = (1e36, 1e37, 1e38)
"""Around 2^127, where basis vectors are beyond the single precision of players."""


def check(points: FloatArray, faces: Index, node: Node) -> None:
    found = [each for bound in BOUNDS for each in deliveries(points, faces, bound, node)]
    assert len(found) == len(BOUNDS) * len(DELIVERIES)
    assert not [each for each in found if each.kind not in ("kept", "refused")]
    assert all(each.words for each in found if each.kind == "refused")


@pytest.mark.parametrize("scale", SCALES)
def test_players_read_what_is_written(scale: float, node: Node) -> None:
    found = list(deliveries(waving() * scale, sheet()[1], 1e-3, node, ("python", "javascript")))
    assert {each.kind for each in found} == {"kept" if scale < 1e38 else "refused"}


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", SEQUENCES)
def test_what_arrives_keeps_the_bound(name: str, node: Node) -> None:
    check(*SEQUENCES[name](), node)


@pytest.mark.realdata
@pytest.mark.exhaustive
def test_what_arrives_of_an_animation_keeps_the_bound(data: Path, node: Node) -> None:
    for path in sorted(file for folder in ("npz", "gltf", "alembic", "usd") for file in (data / folder).iterdir()):
        animation = mixseq.read(path)
        frames = np.linspace(0, animation.frame_count - 1, min(FRAMES, animation.frame_count)).astype(int)
        check(animation.points[frames], animation.faces.astype(np.intp), node)
