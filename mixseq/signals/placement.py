"""Placement curves that state all of their numbers.

A placement says where parts are. Some of its numbers, the *dependent* ones, follow from the others at the knots
(`ShapeSpace.complete_placement`) and are curves of their own in between. So they depend on which knots there are.
An edit that adds knots, but shall leave the motion next to them alone, states them instead.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.errors import SettingsError
from mixseq.signals.curve import Curve
from mixseq.spaces.base import ShapeSpace


@dataclass(frozen=True, eq=False)
class StatedPlacement(Curve):
    """A curve of the independent numbers of a placement, together with the dependent ones.

    Attributes
    ----------
    dependent : Curve
        The dependent numbers; same knots.

    Raises
    ------
    SettingsError
        If the knots differ.
    """

    dependent: Curve

    def __post_init__(self) -> None:
        super().__post_init__()
        if not np.array_equal(self.times, self.dependent.times):
            raise SettingsError("dependent numbers of a placement need the knots of the others")


def whole_placement(space: ShapeSpace, placement: Curve) -> Curve:
    """Return the curve of all `ShapeSpace.placement_dim` numbers of a placement: as stated, else as they follow."""
    if isinstance(placement, StatedPlacement):
        values = np.concatenate([placement.values, placement.dependent.values], axis=1)
    else:
        values = space.complete_placement(placement.values)
    return Curve(placement.times, values)


def stated_placement(space: ShapeSpace, whole: Curve) -> Curve:
    """Return the placement with given numbers, all of them; the inverse of `whole_placement`."""
    count = space.stored_placement_dim
    own = whole.values[:, :count]
    if whole.dim == count:
        return Curve(whole.times, own)
    return StatedPlacement(whole.times, own, Curve(whole.times, whole.values[:, count:]))
