"""Old names of parameters work, and tell their new ones."""

from __future__ import annotations

import inspect

import numpy as np
import pytest

import mixseq
from mixseq.creature import walk_cycle
from mixseq.errors import SettingsError
from mixseq.renamed import renamed
from mixseq.segmentation import MotionSettings
from mixseq.surface import Surface

WALK = walk_cycle(frames=3)


@renamed(breadth="width")
def area(height: float, width: float = 2.0) -> float:
    """Return an area."""
    return height * width


def test_old_names_are_told() -> None:
    with pytest.warns(DeprecationWarning, match="area: breadth is now width") as told:
        assert area(3.0, breadth=4.0) == 12.0  # type: ignore[call-arg]
    assert told[0].filename == __file__
    assert (area(3.0), area(3.0, width=5.0)) == (6.0, 15.0)


def test_both_names_are_refused() -> None:
    with pytest.raises(SettingsError, match="breadth is now width; leave out breadth"):
        area(3.0, width=1.0, breadth=4.0)  # type: ignore[call-arg]


def test_signatures_and_help_are_those_of_the_function() -> None:
    assert list(inspect.signature(area).parameters) == ["height", "width"]
    assert area.__doc__ == "Return an area."


def test_what_was_motion_is_segmentation() -> None:
    settings = MotionSettings(bend=60.0)
    with pytest.warns(DeprecationWarning, match="fit: motion is now segmentation"):
        old = mixseq.fit(WALK, rank=1, motion=settings)  # type: ignore[call-arg]
    new = mixseq.fit(WALK, rank=1, segmentation=settings)
    np.testing.assert_array_equal(old(0.0), new(0.0))
    with pytest.warns(DeprecationWarning, match="interpolate: motion is now segmentation"):
        mixseq.interpolate(WALK, [0.5, 0.5, 0], motion=settings)  # type: ignore[call-arg]


def test_what_were_creases_are_hard_edges() -> None:
    with pytest.warns(DeprecationWarning, match="Surface: creases is now hard_edges") as told:
        surface = Surface(creases=np.arange(3))  # type: ignore[call-arg]
    assert told[0].filename == __file__
    assert surface.hard_edges is not None
    with pytest.warns(DeprecationWarning, match="Surface: creases is now hard_edges") as told:
        assert surface.creases is surface.hard_edges  # type: ignore[attr-defined]
    assert told[0].filename == __file__
