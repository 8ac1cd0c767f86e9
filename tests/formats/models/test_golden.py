"""Golden models of every version still decode to the same points."""

from __future__ import annotations

import h5py
import numpy as np
import pytest

import mixseq
from mixseq.spaces import (
    AnchoredSpace,
    EdgeSpace,
    FreeSpace,
    GradientSpace,
    LRISpace,
    MixedSpace,
    VertexSpace,
)
from tests.formats.models.model_cases import GOLDEN

# Golden files ---------------------------------------------------------------------------------------------


GOLDEN_FILES = {
    # Anchored and free mixed models of old versions have other curves now: frames are encoded again, and predicted
    # as poses that agree with each other. The bar is 4 units long.
    "model-v1": 1e-2,
    "model-v2": 5e-3,
    "model-v2-vertex": 1e-9,
    "model-v3-gradient": 1e-9,
    # Their rotations were splines of rotation vectors, and are splines of quaternions now.
    "model-v3-lri": 1e-3,
    "model-v3-edge": 1e-3,
    "model-v5": 1e-9,
    # Steps between frames differ by rounding in other versions.
    "model-v5-free": 1e-3,
    "model-v5-lri": 1e-9,
    "model-v5-edge": 1e-3,
    "model-v6": 1e-9,
    "model-v6-edge": 1e-3,
}
"""How near points between frames are to what they were when the file was made."""


@pytest.mark.parametrize("name", GOLDEN_FILES)
def test_golden_files_still_decode_to_the_same_points(name: str) -> None:
    with np.load(GOLDEN / f"{name}.npz") as expected:
        points, times = expected["points"], expected["times"]
        between, between_times = expected["between"], expected["between_times"]
    model = mixseq.load(GOLDEN / f"{name}.h5")
    np.testing.assert_array_equal(model.times, times)
    np.testing.assert_allclose(model.sample().points, points, atol=1e-9)
    np.testing.assert_allclose(model.sample(between_times).points, between, atol=GOLDEN_FILES[name])


@pytest.mark.parametrize(
    ("name", "kind", "frames", "knots"),
    [
        ("model-v1", FreeSpace, 4, 7),
        ("model-v2", AnchoredSpace, 6, 11),
        ("model-v2-rank", AnchoredSpace, 7, 17),
        ("model-v2-vertex", VertexSpace, 7, 5),
        ("model-v3-gradient", GradientSpace, 5, 5),
        ("model-v3-lri", LRISpace, 5, 5),
        ("model-v3-edge", EdgeSpace, 5, 5),
        ("model-v5", AnchoredSpace, 6, 11),
        ("model-v5-free", FreeSpace, 4, 7),
        ("model-v5-lri", LRISpace, 5, 9),
        ("model-v5-edge", EdgeSpace, 5, 9),
        ("model-v6", AnchoredSpace, 6, 11),
        ("model-v6-edge", EdgeSpace, 5, 9),
    ],
)
def test_golden_files_hold_what_they_should(name: str, kind: type, frames: int, knots: int) -> None:
    with h5py.File(GOLDEN / f"{name}.h5") as file:
        assert file.attrs["version"] == int(name[7])
    model = mixseq.load(GOLDEN / f"{name}.h5")
    assert isinstance(model.space, kind)
    assert (len(model.times), len(model.time.times)) == (frames, knots)
    if isinstance(model.space, MixedSpace):
        assert len(model.decomposition.parts) == 2
        assert any(joint.free.any() for joint in model.decomposition.joints)
    if isinstance(model.space, AnchoredSpace):
        assert len(model.space.seams.faces) > 10
        assert (np.diff(model.space.shares.indptr) > 1).sum() > 10
    if isinstance(model.space, VertexSpace):
        assert len(model.shapes) == 3
    if isinstance(model.space, GradientSpace | LRISpace | EdgeSpace):
        assert len(model.shapes) == 5
        assert model.space.centre_count == 2  # a bar and a rigid part
        assert model.space.rotation_count == (0 if kind is GradientSpace else 2)
    if isinstance(model.space, EdgeSpace):
        assert (model.space.settings.projection, model.space.settings.volume) == ("dso", 0.5)
