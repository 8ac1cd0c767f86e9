"""Polygons, texture coordinates, materials and hard edges, as Blender's meshes take them."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.blender.motion import MeshParts
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import CornerValues, FaceSet, MeshObject, Surface
from mixseq.sequence.header import SequenceHeader
from mixseq.types import Index

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
def test_edges_are_hard_where_corners_beside_them_do_not_share_a_normal(
    groups: Index, hard: list[int]
) -> None:
    parts = MeshParts.of(roof(hard_edges=groups), "")
    assert np.flatnonzero(parts.sharp(EDGES)).tolist() == hard


def test_without_hard_edges_all_are_smooth() -> None:
    assert MeshParts.of(roof(), "").sharp(EDGES).tolist() == 7 * [False]


def test_colours_of_corners_of_one_mesh_of_two() -> None:
    values = np.random.default_rng(0).random((16, 4)).astype(np.float32)
    header = roof(
        2,
        colours=CornerValues(values, np.arange(16)),
        objects=(MeshObject("a", "/a", 6, 2), MeshObject("b", "/b", 6, 2)),
    )
    colours = MeshParts.of(header, "/b").colours
    assert colours is not None
    np.testing.assert_array_equal(colours, values[8:])
    assert MeshParts.of(roof(), "").colours is None


def test_polygons_begin_where_the_last_ended() -> None:
    parts = MeshParts.of(roof(), "")
    assert parts.starts.tolist() == [0, 4]
    assert parts.corners.tolist() == np.array(ROOF).reshape(-1).tolist()


def test_materials_are_those_of_the_face_sets() -> None:
    sets = (FaceSet("walls", np.array([1]), "/looks/brick"), FaceSet("floor", np.array([0])))
    parts = MeshParts.of(roof(face_sets=sets), "")
    assert [parts.materials[number] for number in parts.material_of_polygon] == ["floor", "brick"]


def test_polygons_in_no_face_set_have_the_material_of_none() -> None:
    parts = MeshParts.of(roof(face_sets=(FaceSet("walls", np.array([1])),)), "")
    assert [parts.materials[number] for number in parts.material_of_polygon] == ["", "walls"]


def test_one_of_several_meshes() -> None:
    objects = tuple(MeshObject(name, f"/{name}", 6, 2) for name in ("house", "barn"))
    values = CornerValues(np.arange(32.0).reshape(16, 2), np.arange(16))
    sets = (FaceSet("hay", np.array([3])), FaceSet("brick", np.array([0, 1])))
    parts = MeshParts.of(roof(2, objects=objects, uvs=values, face_sets=sets), "barn")
    assert parts.corners.tolist() == np.array(ROOF).reshape(-1).tolist()
    assert parts.uvs is not None
    assert parts.uvs[0].tolist() == [16, 17]
    assert parts.materials == ("", "hay")
    assert parts.material_of_polygon.tolist() == [0, 1]
