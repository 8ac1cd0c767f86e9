"""Hinges that close are no joints: nothing says by how many turns their angles are apart."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.mesh.topology import Topology
from mixseq.spaces.mixed.construction import at_winding_hinges


@pytest.mark.parametrize(("turn", "winding"), [(80.0, False), (100.0, True)])
def test_faces_at_hinges_that_turn_by_more_than_half_a_turn_are_marked(turn: float, winding: bool) -> None:
    """A flap beside two faces that lie still."""
    topology = Topology(np.array([[0, 1, 2], [1, 0, 3], [2, 1, 4]]), 5)
    frames = []
    for angle in np.radians([-turn, 0.0, turn]):
        flap = [0.5, -np.cos(angle), np.sin(angle)]
        frames.append([[0, 0, 0], [1, 0, 0], [0.5, 1, 0], flap, [1.5, 1, 0]])
    marked = at_winding_hinges(topology, np.array(frames, dtype=np.float32))
    np.testing.assert_array_equal(marked, [winding, winding, False])
