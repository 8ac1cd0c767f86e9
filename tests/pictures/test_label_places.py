"""Labels beside dots: outward, inside the picture, not on top of each other."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.pictures.charts import LABEL_DISTANCE_POINTS, POINTS_PER_INCH, label_offsets

ANGLES = np.linspace(0, 2 * np.pi, 400)
CIRCLE = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)
WIDE = (-2.0, 2.0, -2.0, 2.0)


@pytest.mark.parametrize("angle", np.linspace(0, 6, 7))
def test_labels_are_outward_of_a_circle(angle: float) -> None:
    dot = np.array([[np.cos(angle), np.sin(angle)]])
    (place,) = label_offsets(dot, ["7"], CIRCLE, WIDE, 0.5)
    assert np.hypot(*place) == pytest.approx(LABEL_DISTANCE_POINTS)
    assert np.dot(place, dot[0]) > 0.9 * LABEL_DISTANCE_POINTS


def test_labels_stay_inside() -> None:
    (place,) = label_offsets(np.array([[1.0, 0.0]]), ["12 end"], CIRCLE, (-1.1, 1.1, -1.1, 1.1), 0.5)
    assert 1.0 + place[0] * 0.5 / POINTS_PER_INCH < 1.1


def test_labels_of_one_place_are_apart() -> None:
    dots = np.array([[1.0, 0.0], [1.0, 0.0], [1.0, 0.01]])
    places = np.array(label_offsets(dots, ["0 start", "8 end", "5"], CIRCLE, WIDE, 0.5))
    for first, second in ((0, 1), (0, 2), (1, 2)):
        assert np.abs(places[first] - places[second]).max() > 9


def test_a_label_at_the_centre_of_all() -> None:
    (place,) = label_offsets(np.zeros((1, 2)), ["0"], np.zeros((5, 2)), WIDE, 0.5)
    assert np.isfinite(place).all()
