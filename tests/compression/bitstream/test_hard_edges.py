"""Which corners share a normal comes back, in few bytes, or is told not to be coded."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.compression.bitstream.corners import decode_hard_edges, encode_hard_edges
from mixseq.errors import FormatError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import renumber_by_first_use
from mixseq.types import IntArray
from tests.compression.bitstream.test_polygon_walk import MESHES
from tests.meshes import grid, tube

pytestmark = pytest.mark.slow


def there_and_back(polygons: Polygons, numbers: IntArray) -> bytes:
    count = int(polygons.indices.max()) + 1
    data = encode_hard_edges(polygons, count, numbers)
    assert data is not None
    np.testing.assert_array_equal(decode_hard_edges(data, polygons, count), renumber_by_first_use(numbers))
    return data


@pytest.mark.parametrize("name", MESHES)
@settings(max_examples=15)
@given(st.integers(0, 2**32), st.integers(1, 5))
def test_any_hard_edges_come_back(name: str, seed: int, most: int) -> None:
    polygons = MESHES[name]
    of_vertex = np.random.default_rng(seed).integers(0, most, polygons.indices.size)
    there_and_back(polygons, polygons.indices * most + of_vertex)


def test_smooth_and_flat_meshes_cost_nearly_nothing() -> None:
    polygons = Polygons.from_triangles(tube(12, 60)[1])
    corners = polygons.indices.size
    assert len(there_and_back(polygons, polygons.indices)) < 40
    assert len(there_and_back(polygons, np.arange(corners))) < 40


def test_a_sharp_edge_costs_little() -> None:
    """A sheet with a fold: twice as many normals along one line."""
    polygons = Polygons.from_triangles(grid(20, 20)[1])
    upper = np.repeat(polygons.indices.reshape(-1, 3).min(axis=1) >= 200, 3)
    numbers = polygons.indices + np.where(upper, 400, 0)
    folded = there_and_back(polygons, np.where(polygons.indices // 20 == 10, numbers, polygons.indices))
    assert len(folded) < 80


def test_normals_that_vertices_share_are_not_coded() -> None:
    polygons = MESHES["grid"]
    count = int(polygons.indices.max()) + 1
    assert encode_hard_edges(polygons, count, np.zeros(polygons.indices.size, dtype=np.int64)) is None


def test_damage_is_refused() -> None:
    polygons = MESHES["torus"]
    count = int(polygons.indices.max()) + 1
    data = encode_hard_edges(polygons, count, np.arange(polygons.indices.size))
    assert data is not None
    with pytest.raises(FormatError, match=r"hard edges at \d+ corners"):
        decode_hard_edges(data[:-8], polygons, count)
    with pytest.raises(FormatError, match=r"hard edges at \d+ corners"):
        decode_hard_edges(data, MESHES["tetrahedron"], 4)


def test_bytes_stay_the_same() -> None:
    digest = hashlib.sha256()
    for polygons in MESHES.values():
        numbers = polygons.indices * 3 + np.random.default_rng(5).integers(0, 3, polygons.indices.size)
        digest.update(there_and_back(polygons, numbers))
    assert digest.hexdigest()[:16] == "53ca9aa89268522b"
