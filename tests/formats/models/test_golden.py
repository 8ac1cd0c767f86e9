"""Golden models still decode to the same points."""

from __future__ import annotations

import h5py
import numpy as np
import pytest

import mixseq
from mixseq.spaces.base import VertexSpace
from mixseq.spaces.edge import EdgeSpace
from mixseq.spaces.gradient import GradientSpace
from mixseq.spaces.lri import LRISpace
from mixseq.spaces.mixed.mixed_space import MixedSpace
from tests.formats.models.model_cases import GOLDEN

BETWEEN = {
    "model-v1": 1e-9,
    "model-v1-bodies": 1e-9,
    "model-v1-vertex": 1e-9,
    "model-v1-gradient": 1e-9,
    "model-v1-lri": 1e-9,
    "model-v1-edge": 1e-3,  # steps between frames differ by rounding in other versions of libraries
}
"""How near points between frames are to what they were when the file was made; the bar is 4 units long."""


@pytest.mark.parametrize("name", BETWEEN)
def test_golden_files_still_decode_to_the_same_points(name: str) -> None:
    with np.load(GOLDEN / f"{name}.npz") as expected:
        points, times = expected["points"], expected["times"]
        between, between_times = expected["between"], expected["between_times"]
    model = mixseq.load(GOLDEN / f"{name}.h5")
    model = model.body(model.body_names[-1])
    np.testing.assert_array_equal(model.times, times)
    np.testing.assert_allclose(model.sample().points, points, atol=1e-9)
    np.testing.assert_allclose(model.sample(between_times).points, between, atol=BETWEEN[name])


@pytest.mark.parametrize(
    ("name", "kind", "frames", "knots"),
    [
        ("model-v1", MixedSpace, 6, 11),
        ("model-v1-bodies", MixedSpace, 6, 11),
        ("model-v1-vertex", VertexSpace, 7, 5),
        ("model-v1-gradient", GradientSpace, 5, 9),
        ("model-v1-lri", LRISpace, 5, 9),
        ("model-v1-edge", EdgeSpace, 5, 9),
    ],
)
def test_golden_files_hold_what_they_should(name: str, kind: type, frames: int, knots: int) -> None:
    with h5py.File(GOLDEN / f"{name}.h5") as file:
        assert file.attrs["version"] == 1
    model = mixseq.load(GOLDEN / f"{name}.h5")
    assert isinstance(model.space, kind)
    assert (len(model.times), len(model.time.times)) == (frames, knots)
    if isinstance(model.space, MixedSpace):
        assert len(model.decomposition.parts) == 2
        assert model.space.joint_faces.sum() > 10
        assert model.space.projection.share == 0.5
        assert (np.diff(model.space.skinning_weights.indptr) > 1).sum() > 10
        assert np.abs(model.correction.values).max() > 5e-5
    if name == "model-v1-bodies":
        assert [body.part_turns is None for body in model.bodies] == [True, False]
        assert model.bodies[1].header.vertex_count != model.header.vertex_count
    if isinstance(model.space, VertexSpace):
        assert len(model.shapes) == 3
    if isinstance(model.space, GradientSpace | LRISpace | EdgeSpace):
        assert len(model.shapes) == 5
        assert model.space.centre_count == 2  # a bar and a rigid part
        assert model.space.rotation_count == (0 if kind is GradientSpace else 2)
    if isinstance(model.space, EdgeSpace):
        assert (model.space.settings.projection, model.space.settings.volume) == ("dso", 0.5)
