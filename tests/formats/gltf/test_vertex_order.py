"""Packed glTF: neighbours side by side, and the same mesh as before."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mixseq_io.gltf.document import Document, load_document
from mixseq_io.gltf.meshopt import order_for_packing
from mixseq_io.gltf.vertex_order import neighbours_together
from tests.formats.gltf.turned import turned
from tests.formats.gltf_maker import Maker

pytest.importorskip("meshopt")

SIDE = 12
GRID = np.stack(np.meshgrid(np.arange(SIDE), np.arange(SIDE), [0.0]), axis=-1).reshape(-1, 3)


def shuffled_grid(seed: int = 0) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return points and triangles of a square, each in an order that says nothing."""
    random = np.random.default_rng(seed)
    corner = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    a, b, c, d = (
        each.reshape(-1) for each in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1])
    )
    triangles = random.permutation(np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))
    order = random.permutation(SIDE * SIDE)
    place = np.argsort(order)
    return GRID[order], place[triangles]


def steps(triangles: NDArray[Any], points: NDArray[Any]) -> float:
    """Return how far vertices are from those before them, on average."""
    assert triangles.max() < len(points)
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).mean())


def test_an_order_for_packing() -> None:
    """Vertices come in the order of their first use, unused ones last; triangles stay the same, and as they turn."""
    points, triangles = shuffled_grid()
    used = len(points)
    renumbered, order = order_for_packing(triangles + 1, used + 3)
    assert sorted(order) == list(range(used + 3))
    assert set(order[used:]) == {0, used + 1, used + 2}
    first = np.unique(renumbered, return_index=True)[1]
    assert (np.diff(first) > 0).all()
    assert sorted(turned(order[renumbered])) == sorted(turned(triangles + 1))
    assert steps(renumbered, points[order[:used] - 1]) < steps(triangles, points) / 2


def written(path: Path, *, told: bool = True, twice: bool = False) -> Document:
    points, triangles = shuffled_grid()
    maker = Maker()
    numbers = maker.add(np.arange(len(points), dtype="<f4")[:, None], "f4")
    on = {"_VERTEX" if told else "_OTHER": numbers}
    maker.node("grid", mesh=maker.mesh(points, triangles, on=on))
    if twice:
        maker.node("again", mesh=maker.mesh(points, triangles, on=on))
    return load_document(maker.glb(path))


def attributes(document: Document, mesh: int = 0) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return triangles, points and numbers."""
    (primitive,) = document.items("meshes")[mesh].objects("primitives")
    names = primitive.object("attributes")
    other = next(each for each in names.values if each.startswith("_"))
    triangles = document.accessor(primitive.integer("indices")).reshape(-1, 3)
    return triangles, document.accessor(names.integer("POSITION")), document.accessor(names.integer(other))


def test_numbers_tell_the_order_that_was(tmp_path: Path) -> None:
    before = written(tmp_path / "grid.glb")
    triangles, points, numbers = attributes(neighbours_together(before))
    old_triangles, old_points, _ = attributes(before)
    own = numbers.reshape(-1).astype(int)
    assert steps(triangles, points) < steps(old_triangles, old_points) / 2
    np.testing.assert_array_equal(points, old_points[own])
    assert sorted(turned(own[triangles])) == sorted(turned(old_triangles))


@pytest.mark.parametrize("options", [{"told": False}, {"twice": True}])
def test_an_order_that_could_not_be_restored_stays(options: dict[str, bool], tmp_path: Path) -> None:
    """Without numbers, or where two meshes have the same ones, and the reader's triangles would not be of them."""
    before = written(tmp_path / "grid.glb", **options)
    for one, other in zip(attributes(neighbours_together(before)), attributes(before), strict=True):
        np.testing.assert_array_equal(one, other)
