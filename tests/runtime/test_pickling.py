"""Pickles of models: the same model, without what it computed."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from mixseq.choices import SPACES, PlacementName, SpaceName
from mixseq.mesh.topology import Topology
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.fitting import fit
from tests.meshes import tetrahedron, topology_of


def again(made: object) -> object:
    return pickle.loads(pickle.dumps(made))


def test_what_was_computed_stays_behind() -> None:
    topology = topology_of(tetrahedron())
    before = len(pickle.dumps(topology))
    assert len(topology.edges) == 6
    assert len(pickle.dumps(topology)) == before
    copy = again(topology)
    assert isinstance(copy, Topology)
    assert copy.edges.tolist() == topology.edges.tolist()
    assert copy.vertex_count == 4


@pytest.mark.parametrize(
    ("space", "placement"),
    [("mixed", "anchored"), ("mixed", "free"), *((name, "anchored") for name in SPACES if name != "mixed")],
)
def test_models_decode_to_the_same_bits(bent_bar: MeshSequence, space: SpaceName, placement: PlacementName) -> None:
    model = fit(bent_bar, space=space, placement=placement)
    times = np.linspace(model.start, model.end, 5)
    expected = model.sample(times, velocities=True)
    copy = pickle.loads(pickle.dumps(model))  # after decoding: its factored matrices cannot be pickled
    found = copy.sample(times, velocities=True)
    assert found.points.tobytes() == expected.points.tobytes()
    np.testing.assert_array_equal(found.velocities, expected.velocities)
    assert not copy.shapes.flags.writeable
