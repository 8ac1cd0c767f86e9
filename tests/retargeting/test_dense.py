"""A dense correspondence carries values from a source to a target."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.errors import SettingsError
from mixseq.retargeting.markers import Correspondence


def mixed() -> Correspondence:
    """Vertex 0 is in the middle of three, vertex 1 is the third, vertex 2 follows vertex 1."""
    return Correspondence(
        (3, 1),
        (3, 1),
        np.array([[0, 1, 2], [2, 2, 2], [-1, -1, -1]]),
        np.array([[0.5, 0.25, 0.25], [1, 0, 0], [0, 0, 0]]),
        np.array([-1]),
        np.array([0, 1, 1]),
    )


def test_identity_carries_everything_as_it_is() -> None:
    values = np.random.default_rng(0).normal(size=(4, 7, 2))
    same = Correspondence.identity(7, 5)
    assert np.array_equal(same.carry(values), values)
    assert same.matched.all()
    assert same.faces.tolist() == [0, 1, 2, 3, 4]
    same.check((7, 5), (7, 5))


def test_values_are_mixed_by_weights_and_followers_take_their_leaders() -> None:
    values = np.array([[[4.0], [8.0], [16.0]]])
    assert mixed().carry(values)[0, :, 0].tolist() == [8.0, 16.0, 16.0]
    assert mixed().matched.tolist() == [True, True, False]


@pytest.mark.parametrize(
    ("source", "target", "wrong"), [((4, 1), (3, 1), "source"), ((3, 1), (3, 2), "target")]
)
def test_other_meshes_are_refused(source: tuple[int, int], target: tuple[int, int], wrong: str) -> None:
    with pytest.raises(SettingsError, match=f"the map is of a {wrong} with 3 vertices and 1 triangles"):
        mixed().check(source, target)
