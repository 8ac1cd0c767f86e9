"""glTF files in: nodes, their names and transforms, and which of them are read."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from mixseq.errors import AmbiguousError, FormatError, InvalidSequenceError, MixseqWarning
from mixseq.sequence.sequence import MeshSequence
from tests.formats.gltf_maker import SQUARE, TRIANGLE, Maker, moving


def test_transforms_above_a_mesh(made: Callable[..., MeshSequence]) -> None:
    """Scale, then rotate, then translate, then the parent's matrix, which is column by column."""
    maker = Maker()
    child = maker.node(
        "child",
        mesh=maker.mesh(TRIANGLE),
        scale=[2, 3, 1],
        rotation=[0, 0, np.sqrt(0.5), np.sqrt(0.5)],
        translation=[0, 0, 5],
    )
    maker.node("parent", children=[child], matrix=[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 10, 20, 30, 1])
    maker.animate(1 - child, "translation", [0], [[0, 0, 0]])
    del maker.json["animations"]
    got = made(maker)
    np.testing.assert_allclose(got.points[0], [[10, 20, 35], [10, 22, 35], [7, 20, 35]], atol=1e-6)
    assert got.objects[0].path == "parent/child"


def test_a_mirroring_node_keeps_faces_outwards(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    uvs = maker.add([[0, 0], [1, 0], [0, 1]])
    maker.node(mesh=maker.mesh(TRIANGLE, on={"TEXCOORD_0": uvs}), scale=[-1, 1, 1])
    got = made(maker)
    assert got.faces.tolist() == [[0, 2, 1]]
    assert got.surface.uvs is not None
    assert got.surface.uvs.at_corners.tolist() == [[0, 1], [0, 0], [1, 1]]


def test_mirroring_that_changes_is_refused(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    node = maker.node("body", mesh=maker.mesh(TRIANGLE))
    maker.animate(node, "scale", [0, 1], [[1, 1, 1], [-1, 1, 1]])
    with pytest.raises(
        InvalidSequenceError, match="frame 13: 'body' is mirrored relative to the first frame"
    ):
        made(maker)


def test_a_scale_of_nothing_is_none_of_that(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    maker.animate(maker.node(mesh=maker.mesh(TRIANGLE)), "scale", [0, 1], [[1, 1, 1], [0, 0, 0]])
    assert not made(maker).points[-1].any()


def test_instances_are_objects_of_their_own(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    mesh = maker.mesh(TRIANGLE)
    first, second = maker.node("leaf", mesh=mesh), maker.node("leaf", mesh=mesh, translation=[5, 0, 0])
    maker.node("tree", children=[first, second])
    got = made(maker)
    assert [each.path for each in got.objects] == ["tree/leaf", f"tree/leaf (node {second})"]
    assert got.faces.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert got.points[0, 3:, 0].tolist() == [5, 6, 5]
    assert got.name == "tree"
    assert made(maker, prim=f"tree/leaf (node {second})").vertex_count == 3


def test_what_stands_still_is_left_out_unless_named(made: Callable[..., MeshSequence]) -> None:
    maker = moving()
    maker.json["meshes"][0]["name"] = "skinny"
    floor = maker.node("floor", mesh=maker.mesh(SQUARE, [0, 1, 2]))
    maker.node("room", children=[floor])
    with pytest.warns(
        MixseqWarning, match=r"stand still are left out; prim='/' .* takes them, too: 'room/floor'"
    ):
        got = made(maker)
    assert (got.name, got.vertex_count, got.frame_count) == ("body", 3, 2)
    assert made(maker, prim="/").vertex_count == 7
    for prim in ("room", "/room/floor", "floor"):
        got = made(maker, prim=prim)
        assert (got.name, got.vertex_count, got.frame_count) == ("floor", 4, 1)
    assert made(maker, prim="skinny").vertex_count == 3
    with pytest.raises(
        FormatError, match="no mesh at or below 'cellar'; its meshes are 'body', 'room/floor'"
    ):
        made(maker, prim="cellar")


def test_a_name_of_several_nodes_is_ambiguous(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    for parent in ("left", "right"):
        maker.node(parent, children=[maker.node("hand", mesh=maker.mesh(TRIANGLE))])
    with pytest.raises(
        AmbiguousError, match="'hand' is in several places, 'left/hand', 'right/hand'; give its path"
    ):
        made(maker, prim="hand")
    assert made(maker, prim="right/hand").vertex_count == 3


def test_only_the_default_scene_is_read(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    shown, _ = (
        maker.node("shown", mesh=maker.mesh(TRIANGLE)),
        maker.node("hidden", mesh=maker.mesh(SQUARE, [0, 1, 2])),
    )
    maker.json.update(scenes=[{"nodes": []}, {"nodes": [shown]}], scene=1)
    assert [each.name for each in made(maker).objects] == ["shown"]


def test_the_name_of_several_meshes_is_that_of_a_node(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    mesh = maker.mesh(TRIANGLE)
    maker.node("pair")
    nameless = maker.node(children=[maker.node("left", mesh=mesh), maker.node("right", mesh=mesh)])
    maker.node("pair", children=[nameless])
    got = made(maker)
    assert [each.path for each in got.objects] == [
        f"pair (node 4)/node {nameless}/left",
        f"pair (node 4)/node {nameless}/right",
    ]
    assert got.name == "pair"


def test_hidden_nodes_are_read_only_if_named(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    ghost = maker.node("ghost", mesh=maker.mesh(TRIANGLE))
    maker.node("attic", children=[ghost], extensions={"KHR_node_visibility": {"visible": False}})
    assert made(maker).vertex_count == 3  # there is nothing else
    maker.node("body", mesh=maker.mesh(SQUARE, [0, 1, 2]), extensions={"KHR_node_visibility": {}})
    assert [each.name for each in made(maker).objects] == ["body"]
    assert [each.name for each in made(maker, prim="/").objects] == ["body"]
    assert [each.name for each in made(maker, prim="ghost").objects] == ["ghost"]


def test_meshes_deep_in_each_other_take_no_time(made: Callable[..., MeshSequence]) -> None:
    """What is above them is computed once, not once per mesh: that would take a minute."""
    maker = Maker()
    mesh = maker.mesh(TRIANGLE)
    for number in range(700):
        maker.node("a", mesh=mesh, translation=[1, 0, 0], children=[number + 1])
    maker.node("end")
    got = made(maker)
    assert got.points[0, ::3, 0].tolist() == list(range(1, 701))
