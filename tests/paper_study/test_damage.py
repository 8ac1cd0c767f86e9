"""Damaged poses."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from scripts.paper_study.common.damage import placement_noise
from scripts.paper_study.common.poses import Poses
from tests.meshes import topology_of, tube


def test_noise_moves_what_a_face_places_more_than_what_is_registered() -> None:
    mesh = tube(8, 12)
    sequence = cast(Any, SimpleNamespace(faces=mesh[1]))
    poses = Poses("lion", (0, 1), np.stack([mesh[0], mesh[0]]), sequence, topology_of(mesh))
    assert placement_noise(poses, 0.0, 0) == pytest.approx((0, 0, 0), abs=1e-12)
    one, two = (np.array(placement_noise(poses, share, 0)) for share in (1e-5, 2e-5))
    np.testing.assert_allclose(two, 2 * one, rtol=1e-3)
    assert one[2] < one[1] / 5
