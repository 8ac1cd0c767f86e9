"""Meshes joined and split."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mixseq.errors import AmbiguousError, FormatError, MixseqWarning
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import CornerValues, FaceSet, Origin
from mixseq.sequence.header import SequenceHeader
from mixseq_io.scene_meshes import (
    SceneMesh,
    SceneObject,
    common_name,
    format_names,
    join_meshes,
    read_valid_meshes,
    select_meshes,
    split_meshes,
)
from mixseq_io.surfaces import surface_from_arrays, surface_to_arrays

QUAD = SceneMesh(
    name="quad",
    path="/a/quad",
    vertices=slice(0, 4),
    polygons=Polygons(np.array([4]), np.array([0, 1, 2, 3])),
    uvs=CornerValues(np.array([[0.0, 1.0], [1.0, 0.5]]), np.array([0, 1, 0, 1])),
    face_sets=(FaceSet("skin", np.array([0]), "/looks/skin"),),
)
PAIR = SceneMesh(
    name="pair",
    path="/a/pair",
    vertices=slice(4, 8),
    polygons=Polygons(np.array([3, 3]), np.array([0, 1, 2, 2, 1, 3])),
    hard_edges=np.array([0, 1, 2, 3, 4, 5]),
    face_sets=(FaceSet("left", np.array([1])),),
)


def joined_header() -> SequenceHeader:
    polygons, surface = join_meshes([QUAD, PAIR], Origin("USD", "/walk.usd"))
    return SequenceHeader(polygons=polygons, vertex_count=8, times=np.zeros(1), surface=surface)


def test_joining() -> None:
    header = joined_header()
    assert header.polygons.counts.tolist() == [4, 3, 3]
    assert header.polygons.indices.tolist() == [0, 1, 2, 3, 4, 5, 6, 6, 5, 7]
    assert [(each.name, each.path, each.vertex_count, each.polygon_count) for each in header.objects] == [
        ("quad", "/a/quad", 4, 1),
        ("pair", "/a/pair", 4, 2),
    ]
    surface = header.surface
    assert [(each.name, each.polygons.tolist(), each.material) for each in surface.face_sets] == [
        ("skin", [0], "/looks/skin"),
        ("left", [2], ""),
    ]
    assert surface.uvs is not None and surface.hard_edges is not None
    assert surface.uvs.at_corners.tolist() == [[0, 1], [1, 0.5]] * 2 + [[0, 0]] * 6
    assert surface.hard_edges.tolist() == [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]


def test_splitting_gives_the_pieces_back() -> None:
    quad, pair = split_meshes(joined_header())
    for got, mesh in ((quad, QUAD), (pair, PAIR)):
        assert (got.name, got.path, got.vertices) == (mesh.name, mesh.path, mesh.vertices)
        assert got.polygons.same_as(mesh.polygons)
        assert [(each.name, each.polygons.tolist(), each.material) for each in got.face_sets] == [
            (each.name, each.polygons.tolist(), each.material) for each in mesh.face_sets
        ]
    assert quad.uvs is not None and QUAD.uvs is not None and pair.hard_edges is not None
    assert quad.uvs.at_corners.tolist() == QUAD.uvs.at_corners.tolist()
    assert pair.hard_edges.tolist() == [0, 1, 2, 3, 4, 5]


def test_a_sequence_without_objects_is_one_piece() -> None:
    header = SequenceHeader(polygons=QUAD.polygons, vertex_count=4, times=np.zeros(1), name="walk")
    (mesh,) = split_meshes(header)
    assert (mesh.name, mesh.path, mesh.vertices) == ("walk", "", slice(0, 4))
    assert mesh.polygons.same_as(QUAD.polygons)
    assert mesh.uvs is None and mesh.hard_edges is None and mesh.face_sets == ()


def test_meshes_keep_what_they_had() -> None:
    """A body that is subdivided, with texture coordinates, and a sword with hard edges."""
    body = replace(QUAD, subdivision="catmullClark")
    polygons, surface = join_meshes([body, PAIR], None)
    assert surface.subdivisions == ("catmullClark", "none")
    header = SequenceHeader(polygons=polygons, vertex_count=8, times=np.zeros(1), surface=surface)
    first, second = split_meshes(header)
    assert (first.subdivision, second.subdivision) == ("catmullClark", "none")
    assert first.uvs is not None and second.uvs is None
    assert first.hard_edges is None and second.hard_edges is not None


def test_meshes_without_colours_are_white_beside_others() -> None:
    red = CornerValues(np.array([[1, 0, 0, 1]]), np.zeros(4, int))
    polygons, surface = join_meshes([replace(QUAD, colours=red), PAIR], None)
    assert surface.colours is not None
    assert surface.colours.at_corners.tolist() == [[1, 0, 0, 1]] * 4 + [[1, 1, 1, 1]] * 6
    header = SequenceHeader(polygons=polygons, vertex_count=8, times=np.zeros(1), surface=surface)
    first, second = split_meshes(header)
    assert first.colours is not None and second.colours is None
    assert first.colours.at_corners.tolist() == red.at_corners.tolist()
    alone = SequenceHeader(
        polygons=QUAD.polygons,
        vertex_count=4,
        times=np.zeros(1),
        surface=replace(
            surface,
            objects=(),
            face_sets=(),
            uvs=None,
            hard_edges=None,
            colours=CornerValues(np.ones((1, 4)), red.indices),
        ),
    )
    assert split_meshes(alone)[0].colours is not None  # an only mesh keeps even white


@pytest.mark.parametrize(("body", "sword"), [("none", "loop"), ("loop", "none"), ("loop", "bilinear")])
def test_subdivision_through_arrays(body: str, sword: str) -> None:
    _, surface = join_meshes([replace(QUAD, subdivision=body), replace(PAIR, subdivision=sword)], None)
    assert surface_from_arrays(surface_to_arrays(surface)).subdivisions == (body, sword)


def test_meshes_that_are_subdivided_alike_are_stored_as_before() -> None:
    _, surface = join_meshes([replace(mesh, subdivision="loop") for mesh in (QUAD, PAIR)], None)
    assert surface.subdivision == "loop" and {each.subdivision for each in surface.objects} == {None}
    assert "object_subdivisions" not in surface_to_arrays(surface)


# Which meshes of a scene are meant

FILE = Path("walk.abc")


def scene(*paths: str) -> list[SceneObject]:
    """Return the objects at some paths, named by their last part; a path in capitals has no names."""
    objects: dict[str, SceneObject] = {}
    for path in paths:
        above = None
        parts = path.split("/")
        for end in range(1, len(parts) + 1):
            here, name = "/".join(parts[:end]), parts[end - 1]
            names = () if not name or name.isupper() else (name, f"{name} mesh")
            above = objects.setdefault(here, SceneObject(here or "/", names, above))
    return [objects[path] for path in paths]


MESHES = scene("/man/body", "/man/head/hat", "/house", "/copy/hat", "/dog/dog/ear", "/dog/tail")


@pytest.mark.parametrize(
    ("prim", "numbers"),
    [
        ("/", [0, 1, 2, 3, 4, 5]),
        ("", [0, 1, 2, 3, 4, 5]),
        ("/man", [0, 1]),
        ("man/", [0, 1]),
        ("man", [0, 1]),
        ("/man/head/hat", [1]),
        ("copy/hat", [3]),
        ("head", [1]),
        ("house mesh", [2]),
        ("dog", [4, 5]),  # one is in the other: the outer one is meant
    ],
)
def test_what_is_meant(prim: str, numbers: list[int]) -> None:
    assert select_meshes(FILE, MESHES, prim) == numbers


def test_other_objects_at_or_below_what_is_meant() -> None:
    others = scene("/man/body/button", "/house", "/hous", "/man")
    assert select_meshes(FILE, MESHES, "man", others) == [0, 3]
    assert select_meshes(FILE, MESHES, "house", others) == [1]
    assert select_meshes(FILE, MESHES, "dog", others) == select_meshes(FILE, MESHES, "/", []) == []
    assert select_meshes(FILE, MESHES, "/", others) == [0, 1, 2, 3]


def test_a_path_as_it_is_listed_comes_before_names() -> None:
    meshes = scene("fox", "den/fox")
    assert select_meshes(FILE, meshes, "fox") == [0]
    assert select_meshes(FILE, meshes, "den/fox") == [1]


def test_what_cannot_be_meant() -> None:
    with pytest.raises(AmbiguousError, match="'hat' is in several places, '/copy/hat', '/man/head/hat'; give"):
        select_meshes(FILE, MESHES, "hat")
    for prim in ("/hat", "HEAD", "man/hat", "ma"):
        with pytest.raises(FormatError, match=r"no mesh at or below .*; its meshes are '/man/body', "):
            select_meshes(FILE, MESHES, prim)


def moving(is_moving: list[bool]) -> list[int]:
    return read_valid_meshes(FILE, MESHES[: len(is_moving)], is_moving, lambda _: lambda index: index)


def test_what_moves() -> None:
    with pytest.warns(MixseqWarning, match=r"prim='/' \(--prim / .*\) takes them, too: '/house', '/copy/hat'"):
        assert moving([True, True, False, False]) == [0, 1]
    assert moving([False, False]) == [0, 1]
    assert moving([True, True]) == [0, 1]


@pytest.mark.parametrize(
    ("paths", "name"),
    [
        (["/man/body"], "body"),
        (["/man/body", "/man/head/hat"], "man"),
        (["/man/GROUP/body", "/man/GROUP/hat"], "man"),
        (["/man", "/man/body"], "man"),
        (["/man/body", "/house"], ""),
        (["man/body", "house"], ""),
    ],
)
def test_common_names(paths: list[str], name: str) -> None:
    assert common_name(scene(*paths)) == name


def test_long_lists_are_cut() -> None:
    assert format_names([str(i) for i in range(22)]).endswith("'19' and 2 more")
