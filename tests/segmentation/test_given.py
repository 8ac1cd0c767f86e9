from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mixseq.errors import SegmentationError
from mixseq.segmentation.methods import segment_by_labels
from tests.meshes import grid, joined, tetrahedron, topology_of


def test_labels_are_numbered_densely() -> None:
    topology = topology_of(tetrahedron())
    assert segment_by_labels([9, 9, -4, 9], topology).tolist() == [1, 1, 0, 1]
    assert segment_by_labels(np.array([9, 9, 200, 9], dtype=np.uint8), topology).tolist() == [0, 0, 1, 0]


def test_equal_labels_that_are_not_connected_are_several_parts() -> None:
    topology = topology_of(joined(grid(1, 3), tetrahedron()))
    # Six triangles in a row: the two ends have the same label, the tetrahedron has it, too.
    assert segment_by_labels([1, 1, 2, 2, 1, 1, 1, 1, 1, 1], topology).tolist() == [
        0,
        0,
        3,
        3,
        1,
        1,
        2,
        2,
        2,
        2,
    ]


def test_parts_that_touch_in_a_vertex_only_are_not_connected() -> None:
    topology = topology_of(grid(2, 2))
    checkers = np.array([0, 0, 1, 1, 1, 1, 0, 0])
    assert segment_by_labels(checkers, topology).max() == 3


@pytest.mark.parametrize(
    "labels", [[0, 1, 2], [0.0, 1.0, 2.0, 3.0], [[0, 1, 2, 3]], [True, False, True, True], 3, ["a"] * 4]
)
def test_what_is_not_one_whole_number_per_face_is_refused(labels: Any) -> None:
    with pytest.raises(SegmentationError, match="one whole number for each of the 4 triangles is expected"):
        segment_by_labels(labels, topology_of(tetrahedron()))
