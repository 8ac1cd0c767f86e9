"""The numbers that a compressed file has are the cheapest of those that may be chosen, and the mesh is the same."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mixseq
from mixseq.choices import ORDERS, OrderName
from mixseq.compression.bitstream.connectivity import encode_polygons
from mixseq.compression.numbering import cheapest_numbering, find_numbering, object_vertex_counts
from mixseq.errors import SettingsError
from mixseq.mesh.polygons import Polygons, match_polygons
from mixseq.sequence.sequence import MeshSequence
from mixseq_io.model_files import read_compressed
from tests.compression.test_renumbering import partition, scrambled, seen
from tests.meshes import bar, grid

pytestmark = pytest.mark.slow

BOUND = 1e-3


def bits(sequence: MeshSequence, order: OrderName) -> float:
    """Bits of connectivity per triangle."""
    polygons = cheapest_numbering(sequence, order).renumber_polygons(sequence.polygons)
    return 8 * len(encode_polygons(polygons, sequence.vertex_count)) / len(sequence.faces)


def shuffled(sequence: MeshSequence, seed: int = 0) -> MeshSequence:
    """The same triangles on the same vertices, in no order."""
    random = np.random.default_rng(seed)
    vertices = random.permutation(sequence.vertex_count)
    rows = np.argsort(vertices)[sequence.faces[random.permutation(len(sequence.faces))]]
    points = sequence.points[:, vertices]
    return MeshSequence.from_arrays(points, Polygons.from_triangles(rows), times=sequence.times)


def test_each_order_takes_fewer_bits_than_the_one_before() -> None:
    tube = shuffled(bar(12, 60, 2))
    keep, vertices, free = (bits(tube, order) for order in ORDERS)
    assert keep > 15 > 10 > vertices > 4 > 1 > free


def test_numbers_that_are_no_worse_are_kept() -> None:
    points, faces = grid(30, 30)
    regular = MeshSequence.from_arrays(points[None], faces)
    for order in ORDERS:
        found = cheapest_numbering(regular, order)
        assert found.order == "keep"
        assert found.renumber_polygons(regular.polygons).same_as(regular.polygons)


def test_another_order_is_refused() -> None:
    with pytest.raises(SettingsError, match="order is 'any'; one of keep, vertices, free is expected"):
        cheapest_numbering(scrambled(), "any")  # type: ignore[arg-type]


@pytest.mark.parametrize("order", ORDERS)
def test_a_compressed_grid_is_the_same_mesh(order: OrderName, tmp_path: Path) -> None:
    """Polygons, texture coordinates, face sets, hard edges: everything is where it was."""
    original = scrambled()
    file = tmp_path / "grid.h5"
    without = replace(original, velocities=None)
    mixseq.save(file, mixseq.compress(without, max_error=BOUND, uv_error=0, order=order, inbetweens=False))
    coded = read_compressed(file)
    assert coded.order == order
    assert (match_polygons(original.polygons, coded.header.polygons) is None) == (order == "free")
    numbering = find_numbering(coded.header.polygons, original.polygons, object_vertex_counts(original))
    assert numbering is not None
    same = numbering.renumber_frames(original)
    assert isinstance(same, MeshSequence)
    # with the original's points, which were not rounded, everything is as it was, bit for bit
    decoded = MeshSequence.from_header(coded.header, same.points, same.velocities)
    assert seen(decoded) == seen(original)
    assert partition(decoded) == partition(original)
    assert mixseq.verify(file, original).holds
    again = mixseq.load(file).sample()
    for one, other in ((original, again), (again, original)):
        assert mixseq.compare(one, other).max_error <= 1.5 * BOUND  # diagonals differ


def test_a_size_counts_the_bytes_of_the_order() -> None:
    from mixseq_io.coded.sizes import static_size

    tube = shuffled(bar(8, 30, 4))
    keep, vertices, free = (static_size(tube, order=order).total for order in ORDERS)
    assert keep > vertices > free


@pytest.mark.realdata
@pytest.mark.parametrize(("name", "most"), [("horse_gallop", (3.4, 1.1)), ("cheburashka", (6.2, 1.1))])
def test_real_meshes_take_few_bits(data: Path, name: str, most: tuple[float, float]) -> None:
    sequence: Any = mixseq.read(data / "npz" / f"{name}.npz")
    assert bits(sequence, "vertices") < most[0]
    assert bits(sequence, "free") < most[1]
