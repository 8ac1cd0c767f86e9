"""Markers are pairs of whole numbers, with names for messages."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mixseq
from mixseq.compression.numbering import mesh_of, walk_numbering
from mixseq.errors import MixseqWarning, SettingsError
from mixseq.retargeting.markers import Correspondence, Markers
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Index
from tests.meshes import bar


def test_pairs_become_columns() -> None:
    markers = Markers.from_pairs(np.array([[1.0, 2], [3, 4], [5, 6]]))
    assert markers.source.tolist() == [1, 3, 5]
    assert markers.target.tolist() == [2, 4, 6]
    assert len(markers) == 3
    assert markers.source.dtype == np.int64


def test_empty_pairs_give_no_markers() -> None:
    assert len(Markers.from_pairs([])) == 0


@pytest.mark.parametrize("pairs", [[1, 2, 3], [[1, 2, 3]], [[1.5, 2]], [["a", "b"]], [[1, 2], [3]], [[[1, 2]]], None])
def test_invalid_pairs_are_refused(pairs: Any) -> None:
    with pytest.raises(SettingsError, match=r"\(n, 2\) whole numbers"):
        Markers.from_pairs(pairs)


@pytest.mark.parametrize(
    ("names", "called"), [((), "2 (3 -> 4)"), (("nose", "tail"), "'tail' (3 -> 4)"), (("nose", ""), "2 (3 -> 4)")]
)
def test_names_default_to_numbers(names: tuple[str, ...], called: str) -> None:
    assert Markers.from_pairs([[1, 2], [3, 4]], names).name(1) == called


def test_wrong_numbers_of_names_are_refused() -> None:
    with pytest.raises(SettingsError, match="2 markers and 1 names"):
        Markers.from_pairs([[1, 2], [3, 4]], ("nose",))


# A dense correspondence carries values from a source to a target


def renumber(mesh: MeshSequence) -> tuple[MeshSequence, Index]:
    """A mesh as a compressed file of order "free" decodes to it, and the old number of every vertex."""
    walk = walk_numbering(*mesh_of(mesh), vertices=True)
    assert walk.order == "free"
    return walk.renumber_frames(mesh), walk.vertices


def check_markers_of_renumbered_meshes(mesh: MeshSequence, vertices: Index) -> None:
    free, old = renumber(mesh)
    shuffled = MeshSequence.from_arrays(mesh.points, np.roll(mesh.faces[::-1], 1, axis=1))
    markers = Markers.from_pairs(np.stack([vertices, vertices], axis=1)).with_meshes(mesh, mesh)
    with pytest.warns(MixseqWarning, match="^vertices of markers of the target have other numbers in .*; they are"):
        found = markers.renumbered(shuffled, free)
    assert found.source.tolist() == vertices.tolist()
    assert old[found.target].tolist() == vertices.tolist()
    with pytest.warns(MixseqWarning, match="^vertices of markers of the source"):
        back = replace(found, source=found.target).with_meshes(free, free).renumbered(mesh, free)
    assert back.source.tolist() == vertices.tolist()
    assert back.target.tolist() == found.target.tolist()


def test_markers_are_found_in_renumbered_meshes() -> None:
    walk = bar(5, 15)
    mesh = MeshSequence.from_arrays(walk.points[:, ::-1], walk.vertex_count - 1 - walk.faces)
    check_markers_of_renumbered_meshes(mesh, np.array([0, 10, 33, 70]))


def test_markers_of_other_meshes_are_refused() -> None:
    walk, other = bar(5, 15), bar(5, 16)
    markers = Markers.from_pairs([[0, 0], [3, 5]]).with_meshes(walk, walk)
    mixed = np.random.default_rng(0).permutation(walk.vertex_count)
    random = MeshSequence.from_arrays(walk.points[:, np.argsort(mixed)], mixed[walk.faces])
    for mesh in (other, random):
        with pytest.raises(SettingsError, match=r"markers of the target are of another mesh than .*; set them"):
            markers.renumbered(walk, mesh)
    added = replace(markers, target=np.array([0, 6]))  # by hand
    free = MeshSequence.from_arrays(walk.points[:, ::-1], walk.vertex_count - 1 - walk.faces)
    with pytest.raises(SettingsError, match="markers of the target are of another mesh"):
        added.renumbered(walk, renumber(free)[0])


@pytest.mark.realdata
def test_markers_of_a_character_with_seven_components(data: Path) -> None:
    mesh = mixseq.read(data / "npz/q_man_swordslash.npz")
    check_markers_of_renumbered_meshes(mesh, np.arange(0, mesh.vertex_count, 97))


def mixed() -> Correspondence:
    """Vertex 0 is in the middle of three, vertex 1 is the third, vertex 2 follows vertex 1."""
    return Correspondence(
        (3, 1),
        (3, 1),
        np.array([[0, 1, 2], [2, 2, 2], [-1, -1, -1]]),
        np.array([[0.5, 0.25, 0.25], [1, 0, 0], [0, 0, 0]]),
        np.array([-1]),
        np.array([0, 1, 1]),
    )


def test_identity_interpolates_values_unchanged() -> None:
    values = np.random.default_rng(0).normal(size=(4, 7, 2))
    same = Correspondence.identity(7, 5)
    assert np.array_equal(same.interpolate(values), values)
    assert same.matched.all()
    assert same.faces.tolist() == [0, 1, 2, 3, 4]
    same.check((7, 5), (7, 5))


def test_values_are_mixed_by_weights_and_followers_take_their_leaders() -> None:
    values = np.array([[[4.0], [8.0], [16.0]]])
    assert mixed().interpolate(values)[0, :, 0].tolist() == [8.0, 16.0, 16.0]
    assert mixed().matched.tolist() == [True, True, False]


@pytest.mark.parametrize(("source", "target", "wrong"), [((4, 1), (3, 1), "source"), ((3, 1), (3, 2), "target")])
def test_other_meshes_are_refused(source: tuple[int, int], target: tuple[int, int], wrong: str) -> None:
    with pytest.raises(SettingsError, match=f"the map is of a {wrong} with 3 vertices and 1 triangles"):
        mixed().check(source, target)
