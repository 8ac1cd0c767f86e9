"""Which meshes of a scene are meant."""

from __future__ import annotations

from pathlib import Path

import pytest

from mixseq.errors import AmbiguousError, FormatError, MixseqWarning
from mixseq_io.scene_meshes import SceneObject, chosen, common_name, listed, moving

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
    assert chosen(FILE, MESHES, prim) == numbers


def test_other_objects_at_or_below_what_is_meant() -> None:
    others = scene("/man/body/button", "/house", "/hous", "/man")
    assert chosen(FILE, MESHES, "man", others) == [0, 3]
    assert chosen(FILE, MESHES, "house", others) == [1]
    assert chosen(FILE, MESHES, "dog", others) == chosen(FILE, MESHES, "/", []) == []
    assert chosen(FILE, MESHES, "/", others) == [0, 1, 2, 3]


def test_a_path_as_it_is_listed_comes_before_names() -> None:
    meshes = scene("fox", "den/fox")
    assert chosen(FILE, meshes, "fox") == [0]
    assert chosen(FILE, meshes, "den/fox") == [1]


def test_what_cannot_be_meant() -> None:
    with pytest.raises(
        AmbiguousError, match="'hat' is in several places, '/copy/hat', '/man/head/hat'; give"
    ):
        chosen(FILE, MESHES, "hat")
    for prim in ("/hat", "HEAD", "man/hat", "ma"):
        with pytest.raises(FormatError, match=r"no mesh at or below .*; its meshes are '/man/body', "):
            chosen(FILE, MESHES, prim)


def test_what_moves() -> None:
    with pytest.warns(
        MixseqWarning, match=r"prim='/' \(--prim / .*\) takes them, too: '/house', '/copy/hat'"
    ):
        assert moving(FILE, MESHES[:4], [True, True, False, False]) == [0, 1]
    assert moving(FILE, MESHES[:2], [False, False]) == moving(FILE, MESHES[:2], [True, True]) == [0, 1]


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
    assert listed([str(i) for i in range(22)]).endswith("'19' and 2 more")
