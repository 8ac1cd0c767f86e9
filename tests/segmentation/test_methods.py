"""What all segmentations have in common, whatever their method."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mixseq
from mixseq.choices import SegmentationName
from mixseq.errors import SettingsError
from mixseq.mesh.topology import Topology, face_patches
from mixseq.segmentation.elements import face_areas
from mixseq.segmentation.methods import METHODS, MethodSettings, adjusted_rand_index, segment
from mixseq.segmentation.motion import MotionSettings, segment_by_motion
from mixseq.segmentation.silhouettes import SilhouetteSettings, SpanningTreeSettings
from tests.meshes import SEQUENCES, bar, rotation
from tests.segmentation.bones import three_bones

pytestmark = pytest.mark.slow

methods = pytest.mark.parametrize("method", METHODS)


def assert_sound(topology: Topology, labels: np.ndarray) -> None:
    assert labels.shape == (len(topology.faces),)
    assert labels.dtype == np.int64
    np.testing.assert_array_equal(np.unique(labels), np.arange(labels.max() + 1))
    for part in range(labels.max() + 1):
        assert face_patches(topology, labels == part).max() == 0, "a part is connected across edges"


@methods
@pytest.mark.parametrize("name", SEQUENCES)
def test_awkward_meshes_have_sound_parts(name: str, method: SegmentationName) -> None:
    sequence = SEQUENCES[name]()
    topology = Topology(sequence.faces, sequence.vertex_count)
    assert_sound(topology, segment(sequence.points, topology, method))
    labels = segment(sequence.points, topology, method, 4)
    assert_sound(topology, labels)
    wanted = max(4, len(np.unique(topology.component_of_face)))
    assert labels.max() + 1 == wanted or (method == "motion" and labels.max() + 1 < wanted)


@methods
def test_three_bones_are_found(method: SegmentationName) -> None:
    sequence, bones = three_bones()
    topology = Topology(sequence.faces, sequence.vertex_count)
    for parts in (None, 3):
        labels = segment(sequence.points, topology, method, parts)
        assert labels.max() == 2
        assert adjusted_rand_index(labels, bones) > 0.85


@methods
@pytest.mark.parametrize("parts", [1, 2, 5, 9])
def test_as_many_parts_as_asked_for(method: SegmentationName, parts: int) -> None:
    sequence = bar()
    topology = Topology(sequence.faces, sequence.vertex_count)
    labels = segment(sequence.points, topology, method, parts)
    assert_sound(topology, labels)
    assert labels.max() + 1 == parts
    area = np.bincount(labels, face_areas(sequence.points[0], topology))
    assert (np.diff(area) <= 0).all(), "numbered by decreasing area"


@methods
def test_a_part_for_every_component_of_what_does_not_deform(method: SegmentationName) -> None:
    sequence = SEQUENCES["several components"]()
    topology = Topology(sequence.faces, sequence.vertex_count)
    still = np.stack([sequence.points[0], sequence.points[0] @ rotation((1, 2, 0.3)).T + 5.0])
    labels = segment(still, topology, method)
    assert adjusted_rand_index(labels, topology.component_of_face) == 1.0


@methods
def test_units_and_place_do_not_matter(method: SegmentationName) -> None:
    sequence, _ = three_bones()
    topology = Topology(sequence.faces, sequence.vertex_count)
    moved = 0.01 * sequence.points @ rotation((0, 0, 0.2)).T + 3.0
    one, other = segment(sequence.points, topology, method), segment(moved, topology, method)
    assert adjusted_rand_index(one, other) > 0.9  # views are other ones


@methods
def test_again_the_same(method: SegmentationName) -> None:
    sequence = bar(10, 31)
    topology = Topology(sequence.faces, sequence.vertex_count)
    np.testing.assert_array_equal(
        segment(sequence.points, topology, method), segment(sequence.points, topology, method)
    )


def test_motion_is_the_default() -> None:
    sequence = bar()
    topology = Topology(sequence.faces, sequence.vertex_count)
    np.testing.assert_array_equal(mixseq.segment(sequence), segment_by_motion(sequence.points, topology))


@methods
def test_of_a_sequence(method: SegmentationName) -> None:
    sequence = bar()
    settings = METHODS[method].settings(small_region=0.02)
    topology = Topology(sequence.faces, sequence.vertex_count)
    np.testing.assert_array_equal(
        mixseq.segment(sequence, method, parts=3, settings=settings),
        segment(sequence.points, topology, method, 3, settings),
    )


def test_fit_takes_them() -> None:
    sequence = bar(frames=3)
    labels = mixseq.segment(sequence, "spanning-tree", 3)
    model = mixseq.fit(sequence, exact=True, parts=labels)
    np.testing.assert_array_equal(model.decomposition.part_of_face, labels)
    np.testing.assert_allclose(model.sample().points, sequence.points, atol=1e-7)


@methods
@pytest.mark.parametrize("parts", [0, 10_000])
def test_impossible_numbers_of_parts(method: SegmentationName, parts: int) -> None:
    with pytest.raises(SettingsError, match=f"parts is {parts}; a whole number from 1 to"):
        mixseq.segment(bar(), method, parts)


@methods
@pytest.mark.parametrize(("parts", "told"), [(2.5, "float"), ("3", "str"), (np.zeros(150, dtype=int), "ndarray")])
def test_what_is_no_number_of_parts(method: SegmentationName, parts: Any, told: str) -> None:
    with pytest.raises(TypeError, match=f"segment: parts is of type {told}; whole number is expected"):
        mixseq.segment(bar(), method, parts)


@methods
@pytest.mark.parametrize("extent", [(0, 0, 0), (1, 0, 0), (0, 1, 1)])
def test_meshes_without_extent(method: SegmentationName, extent: tuple[int, int, int]) -> None:
    """All in a point, on a line, in a plane."""
    sequence = bar()
    topology = Topology(sequence.faces, sequence.vertex_count)
    assert_sound(topology, segment(sequence.points * np.array(extent, dtype=float), topology, method))


@methods
def test_a_first_frame_that_is_a_point(method: SegmentationName) -> None:
    sequence = bar()
    points = sequence.points.copy()
    points[0] = 0.0
    topology = Topology(sequence.faces, sequence.vertex_count)
    assert_sound(topology, segment(points, topology, method))


def test_unknown_methods() -> None:
    with pytest.raises(SettingsError, match="segmentation is 'magic'; one of motion, silhouettes, spanning-tree"):
        mixseq.segment(bar(), "magic")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("method", "settings", "message"),
    [
        ("motion", SilhouetteSettings(), "SilhouetteSettings; method 'motion' takes MotionSettings"),
        ("silhouettes", MotionSettings(), "MotionSettings; method 'silhouettes' takes SilhouetteSettings"),
        ("spanning-tree", MotionSettings(), "method 'spanning-tree' takes SpanningTreeSettings"),
    ],
)
def test_settings_of_another_method(method: SegmentationName, settings: MethodSettings, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        mixseq.segment(bar(), method, settings=settings)


@pytest.mark.parametrize(
    "settings",
    [{"frames": 0}, {"radius": -0.1}, {"radius": np.nan}, {"contrast": -1}, {"small_region": 1.0}, {"still": -1}],
)
@pytest.mark.parametrize("kind", [SilhouetteSettings, SpanningTreeSettings])
def test_settings_outside_their_range(
    kind: type[SilhouetteSettings] | type[SpanningTreeSettings], settings: dict[str, float]
) -> None:
    with pytest.raises(SettingsError, match=f"{next(iter(settings))}=.*expected"):
        kind(**settings)  # type: ignore[arg-type]


# Real animations ------------------------------------------------------------------------------------------

QUICK = ("cow", "fox_survey", "q_man_run", "robotexpressive_dance")
"""Animations for every run; one at least of a mesh that was scanned, and of several components."""

ARTICULATED = (
    "abc_dembones_bone",
    "camel_poses",
    "cat_poses",
    "cheburashka",
    "cow",
    "elephant_gallop",
    "fox_run",
    "fox_survey",
    "horse_gallop",
    "horse_poses",
    "lion_poses",
    "q_alpaca_gallop",
    "q_fox_gallopjump",
    "q_horse_eating",
    "q_horse_gallop",
    "q_man_run",
    "q_man_swordslash",
    "q_trex_run",
    "q_wolf_attack",
    "q_wolf_gallop",
    "q_woman_run",
    "robotexpressive_dance",
)

SMALLEST = 0.005
"""Parts have at least this share of the area, unless they are whole components."""


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("name", "method"),
    [
        pytest.param(name, method, marks=() if name in QUICK else pytest.mark.exhaustive)
        for number, name in enumerate(ARTICULATED)
        for method in ("silhouettes", "spanning-tree")
        if name.startswith("q_") or (method == "silhouettes") == bool(number % 2)  # both where that is quick
    ],
)
def test_parts_of_real_animations(data: Path, name: str, method: SegmentationName) -> None:
    sequence = mixseq.read(data / "npz" / f"{name}.npz")
    topology = Topology(sequence.faces, sequence.vertex_count)
    labels = mixseq.segment(sequence, method)
    assert_sound(topology, labels)
    component = topology.component_of_face
    components, parts = int(component.max()) + 1, int(labels.max()) + 1
    assert max(2, components) <= parts <= components + 40
    share = np.bincount(labels, face_areas(sequence.points[0] / sequence.diagonal, topology))
    share = share / share.sum()
    faces_of_component = np.bincount(component)[component[np.unique(labels, return_index=True)[1]]]
    assert ((share >= SMALLEST) | (np.bincount(labels) == faces_of_component)).all()


def test_what_is_no_sequence_is_refused() -> None:
    with pytest.raises(TypeError, match="segment: sequence is of type int; MeshSequence or Model is expected"):
        mixseq.segment(3)  # type: ignore[arg-type]
