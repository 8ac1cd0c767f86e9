"""Labels of faces: what sets, colours and skins make of polygons."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mixseq.errors import FormatError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import FaceSet
from mixseq_io.text.labels import (
    Skinning,
    concatenate_skinning,
    labels_from_colours,
    labels_from_sets,
    labels_from_skinning,
    merge_small_regions,
    polygon_labels,
    triangle_labels,
)
from tests.formats.labels.labelled_files import FACES, told
from tests.meshes import grid

FILE = Path("body.ply")


def test_triangles_have_the_labels_of_their_polygons_and_polygons_those_of_most_triangles() -> None:
    pentagon = Polygons(np.array([5, 3]), np.array([0, 1, 2, 3, 4, 0, 2, 1]))
    assert triangle_labels([4, 7], pentagon).tolist() == [4, 4, 4, 7]
    assert polygon_labels(np.array([1, 2, 2, 0]), pentagon).tolist() == [2, 0]
    assert polygon_labels(np.array([3, 2, 1, 9]), pentagon).tolist() == [1, 9]  # of a tie the lowest


def test_polygons_in_several_sets_or_in_none() -> None:
    strip = Polygons.from_triangles(grid(1, 2)[1])
    sets = [FaceSet("arm", np.array([0, 1])), FaceSet("skin", np.array([1, 2])), FaceSet("arm", np.array([2]))]
    assert told(labels_from_sets(sets, strip)) == ["arm", "arm+skin", "arm+skin", "(none)"]
    assert labels_from_sets(sets, strip).names == ("arm", "arm+skin", "(none)")


def test_a_polygon_takes_the_colour_of_most_of_its_corners() -> None:
    red, blue = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    colours = np.array([red, red, blue, red, blue, blue, red])
    assert told(labels_from_colours(FILE, colours, FACES)) == ["#ff0000", "#ff0000", "#0000ff"]
    tie = np.array([red, red, blue, blue, red, red, blue])
    assert told(labels_from_colours(FILE, tie, FACES)) == ["#0000ff", "#0000ff", "#ff0000"]
    assert told(labels_from_colours(FILE, colours + 0.001, FACES)) == told(labels_from_colours(FILE, colours, FACES))


def test_colours_that_differ_in_alpha_are_two_labels() -> None:
    colours = np.array([(1.0, 0.0, 0.0, 1.0)] * 4 + [(1.0, 0.0, 0.0, 0.5)] * 3)
    assert told(labels_from_colours(FILE, colours, FACES)) == ["#ff0000", "#ff0000", "#ff000080"]


def test_more_than_256_colours_are_no_segmentation() -> None:
    triangles = Polygons.from_triangles(np.arange(300).reshape(-1, 3))
    colours = np.zeros((300, 3))
    colours[:256, 0] = np.arange(256) / 255
    assert len(labels_from_colours(FILE, colours, triangles).names) > 1
    colours[256:, 1] = 1
    with pytest.raises(FormatError, match=r"body\.ply has 257 vertex colours, too many for a segmentation"):
        labels_from_colours(FILE, colours, triangles)


def chain(weights: Any, parents: tuple[str, ...] = ("", "a", "a/b")) -> Skinning:
    from scipy.sparse import csr_array

    return Skinning(csr_array(np.array(weights, dtype=float)), ("a", "a/b", "a/b/c"), parents)


def test_a_face_follows_the_joint_with_the_largest_sum_of_weights() -> None:
    # Quad: a 1.4, b 1.6, c 1; triangle: a 0.4, b 1, c 1.6.
    weights = [[1, 0, 0], [0.4, 0.6, 0], [0, 0.4, 0.6], [0, 0.6, 0.4], [0, 0, 1]]
    assert told(labels_from_skinning(chain(weights), FACES, min_ratio=0)) == ["b", "b", "c"]
    tie = [[1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0], [0, 1, 0]]
    assert told(labels_from_skinning(chain(tie), FACES, min_ratio=0)) == ["a", "a", "b"]


def test_small_joints_join_those_above_the_lowest_first() -> None:
    """Of 12 quads in a row joint a has 6, b has 1 and c has 5, which make 6 for b."""
    points, triangles = grid(1, 12)
    quads = Polygons(np.full(12, 4), quads_of(triangles))
    joint = np.repeat([0, 1, 2], [6, 1, 5])
    weights = np.zeros((len(points), 3))
    for quad, corners in enumerate(quads.indices.reshape(-1, 4)):
        weights[corners, joint[quad]] += 1
    skinning = chain(weights)
    names = {share: labels_from_skinning(skinning, quads, share).names for share in (0, 0.2, 0.5)}
    assert names == {0: ("a", "b", "c"), 0.2: ("a", "c"), 0.5: ("a", "b")}


def quads_of(triangles: Any) -> Any:
    """Return the corners of quads, of which every two triangles are the halves."""
    pairs = np.asarray(triangles).reshape(-1, 6)
    return np.stack([pairs[:, 0], pairs[:, 1], pairs[:, 2], pairs[:, 5]], axis=1).reshape(-1)


def test_meshes_share_joints_and_those_without_a_skin_follow_themselves() -> None:
    whole = concatenate_skinning([chain(np.eye(3)), Skinning.rigid("/hat", 2), chain(np.eye(3)[::-1])])
    assert whole.joints == ("a", "a/b", "a/b/c", "/hat")
    assert whole.weights.toarray().argmax(axis=1).tolist() == [0, 1, 2, 3, 3, 2, 1, 0]


def test_small_regions_join_the_neighbour_with_most_edges_in_common() -> None:
    points, triangles = grid(4, 4)
    polygons = Polygons.from_triangles(triangles)
    labels = np.repeat([0, 1], 16)
    labels[2] = 1  # one astray, amidst of zeros
    tidy = merge_small_regions(labels, polygons, len(points), min_count=2)
    assert tidy.tolist() == [0] * 16 + [1] * 16
    np.testing.assert_array_equal(merge_small_regions(labels, polygons, len(points), min_count=0), labels)
    assert len(set(merge_small_regions(labels, polygons, len(points), min_count=99).tolist())) == 1
