"""A model as Blender shows it: which time, which axes and units, which of its meshes."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.blender.motion import (
    FrameCache,
    MeshParts,
    ModelCache,
    Motion,
    Placement,
    find_placement,
    part_names,
    part_slices,
)
from mixseq.compression.compressed_model import CompressedModel
from mixseq.errors import FormatError, SettingsError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import CornerValues, FaceSet, MeshObject, Surface
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.model import Model
from mixseq.types import Index, Single


@pytest.fixture(scope="module")
def pair() -> Model:
    """Two triangles, one above the other, that go along x by 3 units in a second; centimetres, Y up."""
    rest = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1], [0, 5, 0], [1, 5, 0], [0, 5, 1.0]])
    header = SequenceHeader(
        polygons=Polygons.from_triangles([[0, 1, 2], [3, 4, 5]]),
        vertex_count=6,
        times=np.arange(4) / 3,
        fps=3,
        up_axis="Y",
        metres_per_unit=0.01,
        surface=Surface(objects=(MeshObject("body", "/rig/body", 3, 1), MeshObject("sword", "/rig/sword", 3, 1))),
    )
    sequence = MeshSequence.from_header(header, rest + np.arange(4)[:, None, None] * [1.0, 0, 0])
    return mixseq.fit(sequence, space="vertex", exact=True)


def test_points_are_turned_and_scaled(pair: Model) -> None:
    points = Motion(pair, Placement("Y", 0.01)).points(1 / 2)
    assert points.dtype == np.float32
    assert points.flags.c_contiguous
    np.testing.assert_allclose(points[2], [0.015, -0.01, 0], atol=1e-8)  # (1.5, 0, 1) cm, z down where y was up
    np.testing.assert_allclose(Motion(pair, Placement("Z", 1)).points(1 / 2)[2], [1.5, 0, 1], atol=1e-6)


@pytest.mark.parametrize(("time", "shown"), [(-1, 0), (0.25, 0.25), (7, 1)])
def test_ends_are_held(pair: Model, time: float, shown: float) -> None:
    motion = Motion(pair, Placement("Z", 1))
    assert motion.clamp_time(time) == shown
    assert motion.points(time)[0, 0] == pytest.approx(3 * shown, abs=1e-6)


def test_compressed_models_turn_between_frames(bent_bar: MeshSequence) -> None:
    """They show the fitted model, not the splines of vertices that players show without in-betweens."""
    model = CompressedModel.from_sequence(mixseq.compress(bent_bar, max_error=1e-4, inbetweens=False))
    time = float(model.times[1] * 3 + model.times[2]) / 4
    shown = Motion(model, Placement("Z", 1.0)).points(time)
    np.testing.assert_allclose(shown, model.fitted(time), atol=1e-6 * bent_bar.diagonal)
    assert np.abs(shown - model.playback(time)).max() > 1e-5 * bent_bar.diagonal


def test_parts_are_found_by_path_and_by_name(pair: Model) -> None:
    assert part_names(pair.header) == ["/rig/body", "/rig/sword"]
    assert part_slices(pair.header, "") == (slice(0, 6), slice(0, 2))
    assert part_slices(pair.header, "/rig/sword") == part_slices(pair.header, "sword") == (slice(3, 6), slice(1, 2))
    with pytest.raises(SettingsError, match=r"no mesh 'shield'; choose one of its meshes: /rig/body, /rig/sword"):
        part_slices(pair.header, "shield")


def test_one_mesh_needs_no_name(bar_model: Model) -> None:
    assert part_names(bar_model.header) == [""]


@pytest.mark.parametrize(
    "placement", [Placement("Y", 0.01), Placement("Z", 0.01), Placement("Y", 1), Placement("Z", 1)]
)
def test_a_mesh_is_found_as_importers_leave_it(pair: Model, placement: Placement) -> None:
    mesh = placement.conversion(pair.header).convert(pair(2 / 3))[3:]
    assert find_placement(pair, mesh.astype(np.float64)) == ("/rig/sword", placement)


def test_another_number_of_vertices_is_told(pair: Model) -> None:
    with pytest.raises(SettingsError, match=r"has 5 vertices, the model 6, 3, 3; import the model as a new object"):
        find_placement(pair, np.zeros((5, 3)))


def test_a_model_that_does_not_tell_more_stands_upright_in_metres(bar_model: Model) -> None:
    header = replace(bar_model.header, up_axis="Z", metres_per_unit=1)
    assert Placement.from_header(header) == Placement("Z", 1)
    assert not Placement.from_header(header).conversion(header).changes


# What is kept: frames up to a limit, models until their files change

SIZE = 12
"""Bytes of a frame of one vertex."""


class Counted:
    """Frames that are made, and how often."""

    def __init__(self) -> None:
        self.made: list[int] = []

    def __call__(self, number: int) -> Callable[[], Single]:
        def make() -> Single:
            self.made.append(number)
            return np.full((1, 3), number, dtype=np.float32)

        return make


def test_frames_are_made_once() -> None:
    frames, counted = FrameCache(), Counted()
    for _ in range(2):
        np.testing.assert_array_equal(frames.get("here", counted(7)), [[7, 7, 7]])
    assert counted.made == [7]
    assert frames.size == SIZE


def test_those_used_last_are_kept() -> None:
    frames, counted = FrameCache(2 * SIZE), Counted()
    for number in (0, 1, 0, 2, 0, 1):
        frames.get(number, counted(number))
    assert counted.made == [0, 1, 2, 1]
    assert frames.size == 2 * SIZE


def test_one_frame_is_kept_however_large_it_is() -> None:
    frames, counted = FrameCache(1), Counted()
    for number in (0, 0, 1, 1):
        frames.get(number, counted(number))
    assert counted.made == [0, 1]


def test_a_frame_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        FrameCache().get(0, Counted()(0))[0] = 1


def test_what_is_forgotten_is_made_again() -> None:
    frames, counted = FrameCache(), Counted()
    frames.get(0, counted(0))
    frames.clear()
    assert frames.size == 0
    frames.get(0, counted(0))
    assert counted.made == [0, 0]


def test_models_are_read_again_when_their_files_change(tmp_path: Path, bar_model: Model) -> None:
    path, read = tmp_path / "walk.h5", []

    def load(path: Path) -> Model:
        read.append(path.read_text())
        return bar_model

    models = ModelCache(load)
    for text in ("one", "three"):
        path.write_text(text)
        assert models.get(path) is models.get(path) is bar_model
    assert read == ["one", "three"]


def test_damage_is_read_once_and_told_every_time(tmp_path: Path) -> None:
    path, tries = tmp_path / "walk.h5", []

    def load(path: Path) -> Model:
        tries.append(path)
        raise FormatError(f"{path} is damaged")

    models = ModelCache(load)
    path.write_text("damage")
    for _ in range(2):
        with pytest.raises(FormatError, match="is damaged"):
            models.get(path)
    assert len(tries) == 1
    os.utime(path, ns=(1, 1))
    with pytest.raises(FormatError, match="is damaged"):
        models.get(path)
    assert len(tries) == 2


def test_a_missing_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"none\.h5: No such file or directory; choose the file again"):
        ModelCache(lambda path: pytest.fail("nothing to read")).get(tmp_path / "none.h5")


# Polygons, texture coordinates, materials and hard edges, as Blender's meshes take them

ROOF = [[0, 1, 2, 3], [3, 2, 4, 5]]
"""Two quads that share the edge from 2 to 3."""

EDGES = np.array([0, 1, 2, 3, 2, 4, 5, 6])
"""Edge from every corner of the roof to the next one; the shared one is number 2."""


def roof(meshes: int = 1, **surface: object) -> SequenceHeader:
    corners = np.concatenate([np.array(ROOF).reshape(-1) + 6 * mesh for mesh in range(meshes)])
    polygons = Polygons(np.full(2 * meshes, 4), corners)
    return SequenceHeader(
        polygons=polygons,
        vertex_count=6 * meshes,
        times=np.zeros(1),
        surface=Surface(**surface),  # type: ignore[arg-type]
    )


def corners(*groups: int) -> Index:
    return np.array(groups)


@pytest.mark.parametrize(
    ("groups", "hard"),
    [
        (corners(0, 0, 0, 0, 0, 0, 0, 0), []),
        (corners(0, 0, 0, 0, 1, 1, 1, 1), [2]),
        (corners(0, 0, 0, 0, 0, 1, 1, 1), [2]),  # the normal is split at one end only
        (corners(0, 1, 2, 3, 3, 2, 4, 5), []),  # every vertex has a number of its own
    ],
)
def test_edges_are_hard_where_corners_beside_them_do_not_share_a_normal(groups: Index, hard: list[int]) -> None:
    parts = MeshParts.from_header(roof(hard_edges=groups), "")
    assert np.flatnonzero(parts.sharp_edges(EDGES)).tolist() == hard


def test_without_hard_edges_all_are_smooth() -> None:
    assert MeshParts.from_header(roof(), "").sharp_edges(EDGES).tolist() == 7 * [False]


def test_colours_of_corners_of_one_mesh_of_two() -> None:
    values = np.random.default_rng(0).random((16, 4)).astype(np.float32)
    header = roof(
        2,
        colours=CornerValues(values, np.arange(16)),
        objects=(MeshObject("a", "/a", 6, 2), MeshObject("b", "/b", 6, 2)),
    )
    colours = MeshParts.from_header(header, "/b").colours
    assert colours is not None
    np.testing.assert_array_equal(colours, values[8:])
    assert MeshParts.from_header(roof(), "").colours is None


def test_polygons_begin_where_the_last_ended() -> None:
    parts = MeshParts.from_header(roof(), "")
    assert parts.starts.tolist() == [0, 4]
    assert parts.corners.tolist() == np.array(ROOF).reshape(-1).tolist()


def test_materials_are_those_of_the_face_sets() -> None:
    sets = (FaceSet("walls", np.array([1]), "/looks/brick"), FaceSet("floor", np.array([0])))
    parts = MeshParts.from_header(roof(face_sets=sets), "")
    assert [parts.materials[number] for number in parts.material_of_polygon] == ["floor", "brick"]


def test_polygons_in_no_face_set_have_the_material_of_none() -> None:
    parts = MeshParts.from_header(roof(face_sets=(FaceSet("walls", np.array([1])),)), "")
    assert [parts.materials[number] for number in parts.material_of_polygon] == ["", "walls"]


def test_one_of_several_meshes() -> None:
    objects = tuple(MeshObject(name, f"/{name}", 6, 2) for name in ("house", "barn"))
    values = CornerValues(np.arange(32.0).reshape(16, 2), np.arange(16))
    sets = (FaceSet("hay", np.array([3])), FaceSet("brick", np.array([0, 1])))
    parts = MeshParts.from_header(roof(2, objects=objects, uvs=values, face_sets=sets), "barn")
    assert parts.corners.tolist() == np.array(ROOF).reshape(-1).tolist()
    assert parts.uvs is not None
    assert parts.uvs[0].tolist() == [16, 17]
    assert parts.materials == ("", "hay")
    assert parts.material_of_polygon.tolist() == [0, 1]
