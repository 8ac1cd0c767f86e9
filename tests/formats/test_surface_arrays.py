"""Surfaces as arrays: there and back, and what is refused."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from mixseq.errors import InvalidSequenceError
from mixseq.mesh.surface import CornerValues, FaceSet, MeshObject, Origin, Surface
from mixseq_io.surfaces import SURFACE_ARRAYS, Arrays, surface_arrays, surface_of_arrays


def full() -> Surface:
    return Surface(
        uvs=CornerValues(np.random.default_rng(1).random((5, 2)), np.arange(7) % 5),
        colours=CornerValues(np.random.default_rng(2).random((3, 4)), np.arange(7) % 3),
        hard_edges=np.arange(7)[::-1],
        face_sets=(
            FaceSet("Hände", np.array([0, 1]), "/Looks/Haut 皮"),
            FaceSet("empty", np.array([], dtype=int)),
        ),
        objects=(MeshObject("a", "/w/a", 4, 1), MeshObject("ä", "/w/ä", 3, 1, subdivision="none")),
        subdivision="loop",
        origin=Origin("glTF", "/tmp/走る.glb"),
    )


def test_there_and_back() -> None:
    surface = full()
    arrays = surface_arrays(surface)
    assert set(arrays) == set(SURFACE_ARRAYS)
    got = surface_of_arrays(arrays)
    assert got.uvs is not None and surface.uvs is not None
    np.testing.assert_array_equal(got.uvs.values, surface.uvs.values)
    np.testing.assert_array_equal(got.uvs.indices, surface.uvs.indices)
    assert got.colours is not None and surface.colours is not None
    np.testing.assert_array_equal(got.colours.values, surface.colours.values)
    np.testing.assert_array_equal(got.colours.indices, surface.colours.indices)
    assert got.hard_edges is not None
    assert got.hard_edges.tolist() == [6, 5, 4, 3, 2, 1, 0]
    assert [(each.name, each.polygons.tolist(), each.material) for each in got.face_sets] == [
        ("Hände", [0, 1], "/Looks/Haut 皮"),
        ("empty", [], ""),
    ]
    assert got.objects == surface.objects
    assert (got.subdivision, got.origin) == (surface.subdivision, surface.origin)


def test_nothing_is_nothing() -> None:
    assert surface_arrays(Surface()) == {}
    bare = surface_of_arrays({})
    assert bare.colours is None
    assert (bare.uvs, bare.hard_edges, bare.face_sets, bare.objects) == (None, None, (), ())
    assert (bare.subdivision, bare.origin) == ("none", None)


def without(*names: str) -> Callable[[Arrays], Arrays]:
    return lambda arrays: {name: array for name, array in arrays.items() if name not in names}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (without("uv_indices"), "uv_indices of the surface are missing"),
        (without("colour_values"), "colour_values of the surface are missing"),
        (
            without("face_set_sizes", "face_set_names"),
            "face_set_names, face_set_sizes of the surface are missing",
        ),
        (lambda a: a | {"face_set_sizes": np.array([1, 2])}, "do not fit each other"),
        (lambda a: a | {"face_set_sizes": np.array([3, -1])}, "do not fit each other"),
        (lambda a: a | {"object_sizes": np.zeros((2, 3), dtype=int)}, "do not fit each other"),
        (lambda a: a | {"object_subdivisions": np.array(["loop"])}, "schemes of subdivision do not fit"),
        (lambda a: a | {"creases": np.zeros(7)}, "creases of the surface are float64; integers are expected"),
        (lambda a: a | {"origin": np.array(["USD"])}, "not a format and a path"),
    ],
    ids=["half", "no colours", "two", "sum", "negative", "columns", "schemes", "floats", "origin"],
)
def test_refusals(change: Callable[[Arrays], Arrays], message: str) -> None:
    with pytest.raises(InvalidSequenceError, match=message):
        surface_of_arrays(change(surface_arrays(full())))
