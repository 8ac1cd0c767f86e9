"""Meshes that are cut into parts, each with a basis of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import mixseq
import mixseq.errors
from mixseq.compression.bitstream.compressed_sequence import CompressedSequence, to_model
from mixseq.compression.bitstream.signal_coder import Reader, Writer
from mixseq.compression.bitstream.signal_graph import mesh_graph
from mixseq.compression.bitstream.spatial_basis import parts_of, read_labels, whole, write_labels
from mixseq.compression.encoder.compress import compress
from mixseq.compression.encoder.parts import merged, vertex_parts
from mixseq.errors import FormatError
from mixseq.sequence.sequence import MeshSequence, frame_store
from tests.meshes import bar, rotation, torus

pytestmark = pytest.mark.slow

RNG = np.random.default_rng(7)


def bodies(frames: int = 30, noise: float = 0.0) -> MeshSequence:
    """Six rings that fly about, each with a random rigid motion of its own."""
    points, faces = torus(24, 16)
    rings, count = [], len(points)
    for number in range(6):
        steps = RNG.normal(size=(frames, 6)).cumsum(axis=0) * 0.3
        turned = np.stack([points @ rotation(tuple(step[:3])).T + step[3:] for step in steps])
        rings.append(turned + np.array([6.0 * number, 0, 0]))
    together = np.concatenate(rings, axis=1)
    together = together + noise * RNG.normal(size=together.shape)
    all_faces = np.concatenate([faces + count * number for number in range(6)])
    return MeshSequence.from_arrays(together, all_faces)


@pytest.fixture(scope="module")
def flying() -> tuple[MeshSequence, CompressedSequence]:
    sequence = bodies()
    return sequence, compress(sequence, kg=0.1)


# Labels -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [2, 5, 100])
def test_labels_come_back(number: int) -> None:
    points, faces = torus(24, 16)
    graph = mesh_graph(faces, len(points))
    labels = np.sort(RNG.integers(0, number, len(points)))
    labels = np.unique(labels, return_inverse=True)[1]
    writer = Writer()
    write_labels(writer, labels, graph)
    found = read_labels(Reader(writer.finish()), int(labels.max()) + 1, graph)
    np.testing.assert_array_equal(found, labels)


def test_labels_of_connected_parts_take_few_bits() -> None:
    points, faces = torus(60, 40)
    graph = mesh_graph(faces, len(points))
    writer = Writer()
    write_labels(writer, (np.arctan2(points[:, 1], points[:, 0]) > 0).astype(np.int64), graph)
    assert 8 * len(writer.finish()) < 0.4 * len(points)


def test_missing_parts_are_refused() -> None:
    points, faces = torus(8, 6)
    graph = mesh_graph(faces, len(points))
    writer = Writer()
    write_labels(writer, np.zeros(len(points), dtype=np.int64), graph)
    with pytest.raises(FormatError, match="not those of 2 parts"):
        read_labels(Reader(writer.finish()), 2, graph)


def test_parts_are_all_vertices_once() -> None:
    sequence = bar(6, 12, 2)
    labels = (np.arange(sequence.vertex_count) % 3).astype(np.int64)
    parts = parts_of(labels, sequence.faces)
    for number, part in enumerate(parts):
        np.testing.assert_array_equal(part.vertices, np.flatnonzero(labels == number))
        assert part.graph.size == len(part.vertices)
    [one] = whole(mesh_graph(sequence.faces, sequence.vertex_count))
    np.testing.assert_array_equal(one.vertices, np.arange(sequence.vertex_count))


# Joining ----------------------------------------------------------------------------------------------------


def test_what_moves_together_is_joined() -> None:
    """Three bodies in two pieces each: three parts are the bodies, though pieces of a body do not touch."""
    sequence = bodies(20)
    ring = sequence.vertex_count // 6
    points = np.array(sequence.points)
    for number in range(3):  # rings 3, 4, 5 move like 0, 1, 2
        place = slice(ring * (number + 3), ring * (number + 4))
        offset = points[0, place].mean(axis=0) - points[0, ring * number : ring * (number + 1)].mean(axis=0)
        first = points[0, ring * number : ring * (number + 1)]
        for frame in range(len(points)):
            body = points[frame, ring * number : ring * (number + 1)]
            a, b = first - first.mean(axis=0), body - body.mean(axis=0)
            u, _, v = np.linalg.svd(a.T @ b)
            turn = (u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v).T
            points[frame, place] = body + offset @ turn.T
    labels = np.repeat(np.arange(6), ring)
    found = merged(points, labels, (3,))[3]
    np.testing.assert_array_equal(found, np.repeat([0, 1, 2, 0, 1, 2], ring))


def test_a_mesh_that_cannot_be_cut_is_one_part() -> None:
    assert vertex_parts(frame_store(bar(3, 4, 3)), (3, 6, 12)) == {}


def test_rigid_bodies_are_parts() -> None:
    sequence = bodies()
    found = vertex_parts(frame_store(sequence), (3, 6, 12))
    ring = sequence.vertex_count // 6
    assert list(found) == [3, 6]
    assert len(np.unique(found[6].reshape(6, ring)[:, 0])) == 6
    assert (found[6].reshape(6, ring) == found[6].reshape(6, ring)[:, :1]).all()


# Coding -----------------------------------------------------------------------------------------------------


def test_bodies_get_bases_of_their_own(flying: tuple[MeshSequence, CompressedSequence]) -> None:
    sequence, coded = flying
    assert len(coded.parameters.ranks) == 6
    assert sum(coded.parameters.ranks) == coded.parameters.rank
    assert mixseq.compare(sequence, to_model(coded).sample()).kg_percent <= 0.1
    # A rigid motion has a constant vector, and three that are affine; a little noise of rounding.
    assert max(coded.parameters.ranks) <= 6


def test_parts_are_chosen_only_if_they_pay(
    flying: tuple[MeshSequence, CompressedSequence], monkeypatch: pytest.MonkeyPatch
) -> None:
    sequence, coded = flying
    monkeypatch.setattr("mixseq.compression.encoder.search.PARTS", (10_000,))
    one = compress(sequence, kg=0.1)
    assert one.parameters.ranks == ()
    sizes = [
        sum(map(len, each.basis)) + sum(len(c.coefficients) for c in each.chunks) for each in (one, coded)
    ]
    assert sizes[1] < 0.8 * sizes[0]


@pytest.mark.parametrize("bound", [1e-2, 1e-4])
def test_bounds_are_kept(bound: float) -> None:
    sequence = bodies(12, noise=1e-3)
    coded = compress(sequence, max_error=bound)
    assert mixseq.compare(sequence, to_model(coded).sample()).max_error <= bound


def test_the_file_holds_parts(flying: tuple[MeshSequence, CompressedSequence], tmp_path: object) -> None:
    sequence, coded = flying
    path = f"{tmp_path}/bodies.h5"
    mixseq.save(path, coded)
    np.testing.assert_array_equal(mixseq.load(path).sample().points, to_model(coded).sample().points)
    assert mixseq.verify(path, sequence).holds


def test_ranks_that_contradict_are_refused(flying: tuple[MeshSequence, CompressedSequence]) -> None:
    _, coded = flying
    with pytest.raises(mixseq.errors.SettingsError, match="basis vectors"):
        replace(coded.parameters, ranks=(1, 1))
    with pytest.raises(mixseq.errors.SettingsError, match="above zero"):
        replace(coded.parameters, rank=2, ranks=(3, -1))
    with pytest.raises(mixseq.errors.SettingsError, match="whole mesh"):
        replace(coded.parameters, factors="shapes")
