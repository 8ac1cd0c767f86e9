"""Sequences in JavaScript are what they are in Python: mesh and fields bit for bit, frames up to float32."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.compression.bitstream.compressed_sequence import (
    CompressedSequence,
    TemporalInterpolation,
    decode,
    decode_basis,
)
from mixseq.compression.bitstream.predictor import UNITS_PER_STEP
from mixseq.compression.bitstream.signal_graph import mesh_graph
from mixseq.compression.encoder.compress import compress
from mixseq.mesh.measures import FAR_DIAGONALS
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import CornerValues, Surface, renumber_by_first_use
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float
from tests.compression.encoder.test_inbetweens import with_parts, with_random_inbetweens
from tests.compression.test_golden import stored
from tests.meshes import Mesh, bar, grid, joined, rotation, torus, tube
from tests.promises import distance
from tests.web.conftest import Node
from tests.web.played import Played, played

pytestmark = pytest.mark.slow

GOLDEN = ("bounded", "shapes", "long", "parts")

SHAPES: tuple[Callable[[int, int], Mesh], ...] = (torus, tube, grid)

NEAR = 1e-6
"""Diagonals that positions may be off by, which are float32 here."""


def plays_as_in_python(node: Node, folder: Path, coded: CompressedSequence) -> Played:
    """Compare a sequence at frames and between them."""
    model, header = decode(coded), coded.header
    rng = np.random.default_rng(0)
    times = np.unique(np.append(header.times, rng.uniform(header.times[0], header.times[-1], 20)))
    found = played(node, folder, coded, times)
    np.testing.assert_array_equal(found.counts, header.polygons.counts)
    np.testing.assert_array_equal(found.corners, header.polygons.indices)
    np.testing.assert_array_equal(found.triangles.reshape(-1, 3), header.faces)
    np.testing.assert_array_equal(found.times, header.times)
    if not coded.parameters.inbetween_parts:  # fields of parts are no whole numbers
        fields_are_exact(found, coded)
    apart = np.abs(found.positions - np.concatenate(list(model.blocks(times))))
    assert apart.max() < NEAR * coded.parameters.diagonal
    return found


def fields_are_exact(found: Played, coded: CompressedSequence) -> None:
    """Fields are the whole numbers of the basis vectors, exactly, and the constant vector is 1."""
    step = coded.parameters.step / UNITS_PER_STEP
    basis = decode_basis(coded, mesh_graph(coded.header.faces, coded.header.vertex_count))
    assert len(found.parts) == len(basis.part_bases)
    owners = np.repeat(basis.part_ids, basis.part_bases[0].vectors.shape[1])
    assert found.facts["count"] == len(owners)
    for part, (vertices, fields, values) in enumerate(found.parts):
        block = basis.part_bases[part]
        np.testing.assert_array_equal(vertices, block.vertices)
        np.testing.assert_array_equal(fields, np.flatnonzero(owners == part))
        expected = block.vectors.reshape(-1, len(vertices)).T / step
        if coded.parameters.factors == "trajectories":
            expected[:, 0] = 1
        np.testing.assert_array_equal(values.reshape(expected.shape), np.rint(expected))


@pytest.mark.parametrize("name", GOLDEN)
def test_golden_streams(node: Node, tmp_path: Path, name: str) -> None:
    coded = replace(stored(name)[0], between=TemporalInterpolation(2.0, (0.2, 0.9)))
    plays_as_in_python(node, tmp_path, coded)


@pytest.mark.parametrize(("name", "levels"), [("parts", 1), ("shapes", 2), ("long", 3)])
@pytest.mark.parametrize("of_parts", [False, True])
def test_inbetweens(node: Node, tmp_path: Path, name: str, levels: int, of_parts: bool) -> None:
    """Levels of in-betweens in JavaScript are those of Python, in several parts, in shapes, and across chunks."""
    plain = replace(stored(name)[0], between=TemporalInterpolation(2.0, (0.2, 0.9)))
    coded = with_random_inbetweens(with_parts(plain), levels, of_parts)
    header = coded.header
    moved = decode(coded).decode_points(header.times[:1] * 0.7 + header.times[1:2] * 0.3)
    still = decode(plain).decode_points(header.times[:1] * 0.7 + header.times[1:2] * 0.3)
    assert np.abs(moved - still).max() > 1e3 * NEAR * coded.parameters.diagonal
    plays_as_in_python(node, tmp_path, coded)


@pytest.mark.parametrize(("name", "cuts"), [("shapes", (7,)), ("shapes", (1, 2, 19)), ("long", (60, 100, 140))])
@pytest.mark.parametrize("levels", [0, 2])
def test_cuts(node: Node, tmp_path: Path, name: str, cuts: tuple[int, ...], levels: int) -> None:
    """Also of single frames, at both ends, and between chunks."""
    coded = replace(stored(name)[0], between=TemporalInterpolation(2.0, (0.2, 0.9), cuts))
    plays_as_in_python(node, tmp_path, with_random_inbetweens(coded, levels) if levels else coded)


def test_golden_file(node: Node, tmp_path: Path) -> None:
    path = Path(__file__).parents[1] / "formats/golden/compressed-v1-uvs.h5"
    model = mixseq.load(path)
    found = played(node, tmp_path, path, model.times)
    apart = np.abs(found.positions - model.sample().points)
    assert apart.max() < NEAR * found.facts["parameters"]["diagonal"]
    assert model.header.surface.uvs is not None
    assert found.uvs.tobytes() == model.header.surface.uvs.at_corners.tobytes()


@pytest.mark.parametrize("offset", [0.0, 1e3, 1e6])
def test_bounds_hold_far_from_the_origin(node: Node, tmp_path: Path, offset: float) -> None:
    """A point is the origin, in double precision, plus what the player draws, in single precision."""
    for precision in (np.float32, np.float64):
        for bound in (1e-3, 1e-5):
            sequence = bar(sides=5, rings=9, frames=6)
            sequence = sequence.with_points((sequence.points + offset).astype(precision))
            found = played(node, tmp_path, compress(sequence, bound, inbetweens=False), sequence.times)
            positions = np.array(found.facts["origin"]) + found.positions
            assert distance(sequence.points, positions) <= bound
            assert np.abs(found.positions).max() < 2 * FAR_DIAGONALS * sequence.diagonal


def test_double_precision_holds_bounds_that_single_precision_cannot(node: Node, tmp_path: Path) -> None:
    """A mesh that grows by 2^20 is played exactly in a Float64Array."""
    mesh = bar(sides=5, rings=9, frames=12)
    growing = mesh.with_points(mesh.points * 4.0 ** np.arange(12)[:, None, None])
    coded = compress(growing, max_error=1e-3, inbetweens=False)
    found = played(node, tmp_path, coded, growing.times)
    assert distance(growing.points, found.positions) > 1e-3
    assert distance(growing.points, found.exact) <= 1e-3


def test_facts(node: Node, tmp_path: Path) -> None:
    sequence = bar(sides=5, rings=9, frames=6)
    coded = compress(sequence, max_error=3e-3)
    facts = played(node, tmp_path, coded, sequence.times[:1]).facts
    told = coded.parameters
    assert facts["vertexCount"] == sequence.vertex_count
    assert facts["polygonCount"] == len(sequence.polygons.counts)
    assert facts["frameCount"] == 6
    assert (facts["fps"], facts["upAxis"], facts["name"]) == (sequence.fps, sequence.up_axis, sequence.name)
    assert facts["parameters"]["maxError"] == told.max_error
    assert facts["parameters"]["promised"] is True
    assert facts["parameters"]["diagonal"] == told.diagonal


def random_sequence(seed: int) -> MeshSequence:
    """Tori, tubes and sheets that turn and wobble, as triangles and quads, with what may be on them, at any times."""
    rng = np.random.default_rng(seed)
    count, bodies = int(rng.integers(1, 40)), []
    for number in range(int(rng.integers(1, 4))):
        sizes = rng.integers(3, 9, 2).tolist()
        points, faces = SHAPES[int(rng.integers(3))](*sizes)
        turns = np.cumsum(rng.normal(size=(count, 3)) * 0.2, axis=0)
        wobble = rng.normal(size=(count, 1, 3)) * np.sin(points) * rng.choice([0, 0.1])
        moved = [points @ rotation(tuple(turn)).T + [4.0 * number, 0, 0] for turn in turns]
        bodies.append((np.stack(moved) + wobble, faces))
    faces = joined(*((points[0], some) for points, some in bodies))[1]
    polygons = Polygons.from_triangles(faces)
    if rng.random() < 0.5:  # as quads, which these triangles come in pairs of, where they do
        polygons = Polygons(np.full(len(faces), 3), np.roll(faces, int(rng.integers(3)), axis=1).reshape(-1))
    times = rng.uniform(0, 3) + np.arange(count) / 30
    if rng.random() < 0.5:
        times = np.cumsum(rng.uniform(0.01, 0.1, count))
    sequence = MeshSequence.from_arrays(
        np.concatenate([points for points, _ in bodies], axis=1), polygons, times, fps=30
    )
    uvs = CornerValues(rng.integers(0, 64, (20, 2)).astype(np.float32) / 64, polygons.indices % 20)
    hard = rng.integers(0, 3, len(polygons.indices)) + 3 * polygons.indices
    of_vertices = CornerValues(rng.integers(0, 256, (len(polygons.indices), 4)) / 255, polygons.indices)
    of_corners = CornerValues(rng.random((9, 4)), np.arange(len(polygons.indices)) % 9)
    surface = Surface(
        uvs=uvs if seed % 2 else None,
        colours=(None, of_vertices, of_corners)[seed % 3],
        hard_edges=hard.astype(np.int32) if seed % 3 else None,
    )
    return MeshSequence.from_header(replace(sequence.header, surface=surface), sequence.points)


@pytest.mark.parametrize("seed", range(8))
def test_random_sequences(node: Node, tmp_path: Path, seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    sequence = random_sequence(seed)
    if seed % 5 == 0:
        monkeypatch.setattr("mixseq.compression.encoder.search.BASIS_KINDS", ("shapes",))
    max_error, kg = (2e-3, None) if seed % 4 else (None, 1.0)
    coded = compress(sequence, max_error, kg, chunk=16, inbetweens=seed % 4 == 1)
    found = plays_as_in_python(node, tmp_path, coded)
    if coded.header.surface.uvs is not None:
        assert found.uvs.tobytes() == coded.header.surface.uvs.at_corners.tobytes()
    else:
        assert not len(found.uvs)
    colours = coded.header.surface.colours
    assert found.colours.tobytes() == (b"" if colours is None else colours.at_corners.tobytes())
    if coded.header.surface.hard_edges is not None:
        np.testing.assert_array_equal(found.hard_edges, renumber_by_first_use(coded.header.surface.hard_edges))


def test_only_chunks_that_are_needed_are_decoded(node: Node, tmp_path: Path) -> None:
    points, faces = torus(6, 5)
    angles: Float = np.arange(400) / 40
    frames = [points @ rotation((0.2, angle, 0.0)).T for angle in angles]
    coded = compress(MeshSequence.from_arrays(np.stack(frames), faces), kg=1, chunk=100, inbetweens=False)
    assert len(coded.chunks) == 4
    times = coded.header.times
    wanted = np.array([times[0], times[3] / 2, times[99], times[250], (times[301] + times[300]) / 2])
    assert played(node, tmp_path, coded, wanted).facts["loaded"] == [1, 1, 1, 2, 3]
