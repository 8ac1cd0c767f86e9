"""Which colours meshes can have, and whether they can be compared."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import mixseq
from mixseq.compression.numbering import walk_numbering
from mixseq.errors import MixseqWarning, SettingsError
from mixseq.mesh.surface import CornerValues, Surface
from mixseq.pictures.colours import SceneColours, check_original
from mixseq.pictures.film import _colourings
from mixseq.pictures.scene import Scene, SceneItem
from mixseq.sequence.sequence import FrameStore, MeshSequence, bounding_diagonal, load_frames
from mixseq.signals.model import Model
from tests.meshes import bar, tetrahedron

ALL = ("clay", "parts", "error", "strain", "curvature")
"""Colours of meshes that bring none along."""


def item_of(sequence: MeshSequence, name: str = "sequence") -> SceneItem:
    return SceneItem(name, load_frames(sequence))


def original_of(sequence: MeshSequence) -> FrameStore:
    return load_frames(sequence)


def without(*names: str) -> tuple[str, ...]:
    return tuple(name for name in ALL if name not in names)


def grown(by: float) -> MeshSequence:
    """A tetrahedron that grows to so many times its size in a second."""
    points, faces = tetrahedron()
    scales = np.linspace(1, by, 11)[:, None, None]
    return MeshSequence.from_arrays(scales * points, faces, fps=10)


def test_names_of_what_there_is(bent_bar: MeshSequence, bar_model: Model) -> None:
    sequence, model = item_of(bent_bar), SceneItem("model", bar_model)
    original = original_of(bent_bar)
    assert SceneColours(Scene((sequence,))).names == without("parts", "error")
    assert SceneColours(Scene((model,))).names == without("error")
    assert SceneColours(Scene((sequence,)), original).names == without("parts")
    assert SceneColours(Scene((sequence, model)), original).names == ALL  # of one mesh at least
    assert SceneColours(Scene((item_of(grown(2)),)), original).names == without("parts", "error")


def test_a_model_without_parts(bent_bar: MeshSequence) -> None:
    model = mixseq.fit(bent_bar, space="vertex", rank=2)
    colours = SceneColours(Scene((SceneItem("model", model),)))
    assert colours.names == without("parts", "error")
    assert colours.on_one_scale("parts")[0].name == "clay"


def test_names_promise_what_there_is(bent_bar: MeshSequence, bar_model: Model) -> None:
    for items in ([item_of(bent_bar)], [SceneItem("model", bar_model)], [item_of(grown(2))]):
        colours = SceneColours(Scene(tuple(items)), original_of(bent_bar))
        assert colours.names == tuple(colours.of_mesh(0))


def test_own_colours_where_there_are_some(bent_bar: MeshSequence) -> None:
    values = np.tile([1.0, 0, 0, 1], (bent_bar.vertex_count, 1))
    surface = Surface(colours=CornerValues(values, bent_bar.polygons.indices))
    colours = SceneColours(Scene((item_of(bent_bar), item_of(replace(bent_bar, surface=surface)))))
    assert colours.names == ("clay", "own", "strain", "curvature")
    assert [each.name for each in colours.on_one_scale("own")] == ["clay", "own"]
    assert "own" not in colours.of_mesh(0)


def test_clay_where_a_mesh_has_no_such_colours(bent_bar: MeshSequence, bar_model: Model) -> None:
    colours = SceneColours(Scene((item_of(bent_bar), SceneItem("model", bar_model))))
    assert [each.name for each in colours.on_one_scale("parts")] == ["clay", "parts"]
    assert [each.name for each in colours.on_one_scale("error")] == ["clay", "clay"]


def test_colours_are_worked_out_once(bent_bar: MeshSequence) -> None:
    colours = SceneColours(Scene((item_of(bent_bar),)))
    assert colours.on_one_scale("clay")[0] is colours.on_one_scale("clay")[0]


def test_one_scale_for_all() -> None:
    colours = SceneColours(Scene((item_of(grown(1.5)), item_of(grown(2.0)))))
    tops = [colours.of_mesh(index)["strain"].top for index in range(2)]
    assert tops == pytest.approx([50.0, 100.0])  # percent
    shared = colours.on_one_scale("strain")
    assert [each.top for each in shared] == pytest.approx([100.0, 100.0])
    points = tetrahedron()[0]
    for each, by, entry in ((shared[0], 1.5, 128), (shared[1], 2.0, 255)):
        np.testing.assert_allclose(each.entries(by * points, 1.0).astype(float), entry, atol=1)


def test_strain_is_against_the_first_frame() -> None:
    colours = SceneColours(Scene((item_of(grown(2.0)),)))
    assert not colours.of_mesh(0)["strain"].entries(tetrahedron()[0], 0.0).any()


def test_errors_are_against_the_original_at_the_same_time() -> None:
    sequence = grown(2.0)
    shift = np.array([0.3, 0.0, 0.4])
    moved = sequence.with_points(sequence.points + shift)
    colours = SceneColours(Scene((item_of(moved),)), original_of(sequence))
    errors = colours.of_mesh(0)["error"]
    assert errors.measure is not None
    share = 0.5 / bounding_diagonal(sequence.points[0])
    for frame in (0, 4, 10):
        np.testing.assert_allclose(errors.measure(moved.points[frame], frame / 10), share)
        np.testing.assert_allclose(errors.measure(sequence.points[frame], frame / 10), 0, atol=1e-7)
    assert errors.top == pytest.approx(share)


def test_errors_from_an_original_that_grows_from_a_point_are_in_its_largest_diagonal() -> None:
    growing = grown(2.0).with_points(np.linspace(0, 2, 11)[:, None, None] * tetrahedron()[0])
    moved = growing.with_points(growing.points + np.array([0.3, 0.0, 0.4]))
    error = SceneColours(Scene((item_of(moved),)), original_of(growing)).of_mesh(0)["error"]
    assert error.measure is not None
    expected = 0.5 / (2 * bounding_diagonal(tetrahedron()[0]))
    np.testing.assert_allclose(error.measure(moved.points[4], 0.4), expected, rtol=1e-6)
    film_error = _colourings([item_of(moved)], [item_of(moved).decode(growing.times)], "error", item_of(growing))
    assert film_error[0].measure is not None
    np.testing.assert_allclose(film_error[0].measure(moved.points[4], 0.4), expected, rtol=1e-6)


def test_an_edited_model_has_the_scale_that_it_had(bar_model: Model) -> None:
    colours = SceneColours(Scene((SceneItem("model", bar_model),)))
    strain = colours.of_mesh(0)["strain"]
    assert not strain.entries(bar_model(bar_model.start), 0.0).any()
    assert strain.entries(bar_model(bar_model.end), 0.0).max() == 255


def test_an_original_of_some_of_the_meshes(bent_bar: MeshSequence) -> None:
    scene = Scene((item_of(grown(2)), item_of(bent_bar)))
    check_original(scene, original_of(bent_bar))


def test_errors_from_an_original_with_the_numbers_of_a_compressed_file(bent_bar: MeshSequence) -> None:
    free = walk_numbering(bent_bar.polygons, [bent_bar.vertex_count], vertices=True)
    assert free.order == "free"
    scene = Scene((item_of(bent_bar),))
    renumbered = load_frames(free.renumber_frames(bent_bar))
    with pytest.warns(MixseqWarning, match="^vertices of bar have other numbers in bar; they are matched$"):
        check_original(scene, renumbered)
    error = SceneColours(scene, renumbered).of_mesh(0)["error"]
    assert error.measure is not None
    assert np.max(error.measure(bent_bar.points[0], 0.0)) < 1e-7  # single precision


def test_another_mesh_is_no_original(bent_bar: MeshSequence) -> None:
    scene = Scene((item_of(bent_bar),))
    with pytest.raises(SettingsError, match=r"none .* 4 vertices and 4 triangles .* same topology"):
        check_original(scene, original_of(grown(2)))
    with_a_stray = MeshSequence.from_arrays(
        np.concatenate([bent_bar.points, bent_bar.points[:, :1]], axis=1), bent_bar.faces, fps=10
    )
    with pytest.raises(SettingsError, match="78 vertices"):
        check_original(scene, original_of(with_a_stray))


def test_an_original_begins_at_the_same_time() -> None:
    sequence = bar(frames=4)
    later = MeshSequence.from_arrays(sequence.points, sequence.faces, times=sequence.times + 0.5)
    with pytest.raises(SettingsError, match=r"late starts at 0.5 s, the original at 0 s"):
        check_original(Scene((item_of(later, "late"),)), original_of(sequence))
