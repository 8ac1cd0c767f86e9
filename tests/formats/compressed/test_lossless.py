"""Compressed sequences in HDF5: times and surfaces keep every bit, and take few."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mixseq
from mixseq.compression.bitstream.compressed_sequence import CompressedSequence
from mixseq.errors import FormatError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import CornerValues, FaceSet, MeshObject, Origin, Surface, renumber_by_first_use
from mixseq.sequence.header import SequenceHeader
from mixseq_io.coded.streams import pack_leb128, pack_surface, pack_times, unpack_leb128, unpack_surface, unpack_times
from mixseq_io.model_files import compressed_sizes, read_compressed
from tests.formats.compressed.stream_cases import any_bytes
from tests.meshes import tube


def test_regular_times_take_nothing() -> None:
    assert pack_times(2.5 + np.arange(1000) / 23.976, 23.976) == b""


def test_nearly_regular_times_take_little() -> None:
    times = np.arange(1000, dtype=np.float64) * (1 / 24)  # not the same bits as n / 24
    assert 0 < len(pack_times(times, 24)) < 600


@given(st.lists(st.floats(-1e9, 1e9), min_size=1, max_size=20, unique=True), st.floats(1e-3, 1e5))
def test_times_keep_every_bit(values: list[float], fps: float) -> None:
    times = np.sort(np.array(values))
    packed = pack_times(times, fps)
    got = unpack_times(packed, float(times[0]), len(times), fps)
    assert got.tobytes() == times.tobytes()


@pytest.mark.parametrize("count", [3, 5])
def test_another_number_of_times_is_refused(count: int) -> None:
    packed = pack_times(np.array([0.0, 0.3, 0.31, 0.5]), 24)
    with pytest.raises(FormatError, match=f"{8 * count} are expected"):
        unpack_times(packed, 0.0, count, 24)
    with pytest.raises(FormatError):
        unpack_times(packed[:-9] + b"123456789", 0.0, 4, 24)


@given(st.lists(st.integers(0, 2**70)))
def test_whole_numbers(numbers: list[int]) -> None:
    assert list(unpack_leb128(pack_leb128(numbers))) == numbers


MESH = Polygons(np.array([4, 3]), np.arange(7)), 7


def full() -> Surface:
    return Surface(
        uvs=CornerValues(np.random.default_rng(1).random((5, 2)), np.arange(7) % 5),
        hard_edges=np.arange(7)[::-1],
        face_sets=(FaceSet("Hände", np.array([0, 1]), "/Looks/Haut 皮"), FaceSet("empty", np.zeros(0, int))),
        objects=(MeshObject("a", "/w/a", 4, 1), MeshObject("ä", "/w/ä", 3, 1)),
        subdivision="loop",
        origin=Origin("glTF", "/tmp/走る.glb"),
    )


def test_surfaces_come_back(tmp_path: Path, coded: CompressedSequence) -> None:
    polygons = Polygons(np.array([4, 3]), np.array([0, 1, 2, 3, 4, 5, 6]))
    header = SequenceHeader(polygons=polygons, vertex_count=7, times=coded.header.times, surface=full())
    file = tmp_path / "surface.h5"
    mixseq.save(file, replace(coded, header=header))
    got, expected = read_compressed(file).header.surface, full()
    assert got.uvs is not None and expected.uvs is not None
    np.testing.assert_array_equal(got.uvs.values, expected.uvs.values)
    np.testing.assert_array_equal(got.uvs.indices, expected.uvs.indices)
    assert got.hard_edges is not None
    assert got.hard_edges.tolist() == list(range(7))  # numbered as they come
    assert [(each.name, each.polygons.tolist(), each.material) for each in got.face_sets] == [
        ("Hände", [0, 1], "/Looks/Haut 皮"),
        ("empty", [], ""),
    ]
    assert (got.objects, got.subdivision, got.origin) == (expected.objects, "loop", expected.origin)
    assert 0 < compressed_sizes(file)["surface"] < 600
    assert read_compressed(file).header.polygons.same_as(polygons)


def test_no_surface_takes_nothing(tmp_path: Path) -> None:
    assert pack_surface(Surface(), MESH) == b""
    bare = unpack_surface(b"", tmp_path, MESH)
    assert (bare.uvs, bare.hard_edges, bare.face_sets, bare.objects) == (None, None, (), ())


def test_texture_coordinates_of_a_grid_take_little(tmp_path: Path) -> None:
    count = 2500
    u, v = np.meshgrid(np.linspace(0, 1, 50), np.linspace(0, 1, 50))
    uvs = CornerValues(np.stack([u.reshape(-1), v.reshape(-1)], axis=1), np.arange(count))
    packed = pack_surface(Surface(uvs=uvs), MESH)
    assert len(packed) < 3 * count
    got = unpack_surface(packed, tmp_path, MESH).uvs
    assert got is not None
    np.testing.assert_array_equal(got.at_corners, uvs.at_corners)


def test_hard_edges_are_coded_on_their_mesh(tmp_path: Path) -> None:
    """As numbers of normals they take some bytes for each vertex; those that vertices share stay so."""
    polygons = Polygons.from_triangles(tube(12, 40)[1])
    mesh = polygons, int(polygons.indices.max()) + 1
    shuffled = np.random.default_rng(0).permutation(mesh[1])[polygons.indices]
    sizes = []
    for numbers in (shuffled, shuffled // 2):
        packed = pack_surface(Surface(hard_edges=numbers), mesh)
        found = unpack_surface(packed, tmp_path, mesh).hard_edges
        assert found is not None
        np.testing.assert_array_equal(renumber_by_first_use(found), renumber_by_first_use(numbers))
        sizes.append(len(packed))
    assert sizes[0] < 0.1 * sizes[1]
    with pytest.raises(FormatError, match="hard edges at 21 corners"):
        other = Polygons.from_triangles(np.arange(21).reshape(7, 3)), 21
        unpack_surface(pack_surface(Surface(hard_edges=shuffled), mesh), tmp_path, other)


@pytest.mark.parametrize("size", [1, 20, 100])
def test_damaged_surfaces_are_refused(size: int, tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="the surface is damaged"):
        unpack_surface(pack_surface(full(), MESH)[:size], tmp_path, MESH)
    with pytest.raises(FormatError, match="the surface is damaged"):
        unpack_surface(any_bytes(size), tmp_path, MESH)
