"""What was asked for is kept: by every sequence, in every process, or it is refused."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mixseq
import mixseq.errors
from mixseq.compression.bitstream import spatial_basis
from mixseq.compression.bitstream.compressed_sequence import CompressedSequence, decode
from mixseq.compression.bitstream.signal_coder import Reader, Writer
from mixseq.compression.bitstream.signal_graph import mesh_graph
from mixseq.compression.bitstream.spatial_basis import read_labels, split_parts, write_labels
from mixseq.compression.encoder import components, trial
from mixseq.compression.encoder import compress as compressing
from mixseq.compression.encoder.components import initial_parts, merge_parts
from mixseq.compression.encoder.search import TARGET_TOLERANCE, _error_at_size
from mixseq.errors import FormatError, MixseqWarning, SettingsError, SizeError
from mixseq.runtime.parallel import thread_count
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import MeshSequence, load_frames
from mixseq.types import Float, FloatArray
from tests.meshes import SEQUENCES, bar, grid, joined, rotation, seeds, tetrahedron, torus, tube

pytestmark = pytest.mark.slow

compress = partial(compressing.compress, inbetweens=False)
"""Most of these tests look at frames, which in-betweens leave as they are."""


def size_of(coded: CompressedSequence) -> int:
    labels = 0 if coded.labels is None else len(coded.labels.data)
    return labels + sum(map(len, coded.basis)) + sum(len(c.coefficients) + len(c.residuals) for c in coded.chunks)


def largest(sequence: MeshSequence, points: FloatArray) -> float:
    """Largest distance of a vertex, in diagonals of the first frame, or of the largest, or in units."""
    original = sequence.points.astype(np.float64)
    diagonals = np.linalg.norm(np.ptp(original, axis=1), axis=1)
    diagonal = float(diagonals[0] or diagonals.max())
    return float(np.linalg.norm(points - original, axis=2).max()) / (diagonal or 1.0)


def kg_of(sequence: MeshSequence, points: FloatArray) -> float:
    return mixseq.compare(sequence, sequence.with_points(np.asarray(points, dtype=np.float64))).kg_percent


def check(sequence: MeshSequence, coded: CompressedSequence) -> Float:
    """Check what a compressed sequence says about itself, and return its points."""
    points = np.asarray(decode(coded).sample().points)
    assert np.isfinite(points).all()
    assert points.shape == sequence.points.shape
    error = largest(sequence, points)
    if coded.parameters.promised:
        assert error <= coded.parameters.max_error
    else:
        assert error == pytest.approx(coded.parameters.max_error, rel=1e-9, abs=1e-15)
    assert sum(chunk.count for chunk in coded.chunks) == coded.parameters.frame_count == sequence.frame_count
    return np.asarray(points, dtype=np.float64)


# What is kept -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SEQUENCES)
def test_kg_errors_are_kept(name: str) -> None:
    sequence = SEQUENCES[name]()
    coded = compress(sequence, kg=0.3)
    found = kg_of(sequence, check(sequence, coded))
    assert found <= 0.3
    assert found == pytest.approx(coded.parameters.kg_percent, rel=1e-6)
    assert not coded.parameters.promised
    assert not any(chunk.residuals for chunk in coded.chunks)


@pytest.mark.parametrize("name", SEQUENCES)
def test_bounds_are_kept(name: str) -> None:
    sequence = SEQUENCES[name]()
    coded = compress(sequence, max_error=2e-3)
    check(sequence, coded)
    assert coded.parameters.promised
    assert coded.parameters.max_error == 2e-3


@pytest.mark.parametrize("name", ["bar", "several components", "still", "one frame"])
def test_sizes_are_kept(name: str) -> None:
    sequence = SEQUENCES[name]()
    coded = compress(sequence, size=500)
    check(sequence, coded)
    assert 0.8 * 500 < size_of(coded) <= 500


@pytest.mark.parametrize("bound", [1e-2, 1e-3, 1e-4, 1e-5, 1e-8])
def test_bounds_of_all_sizes_are_kept(bound: float) -> None:
    sequence = bar(sides=5, rings=9)
    assert largest(sequence, check(sequence, compress(sequence, max_error=bound))) > 0.5 * bound


@pytest.mark.parametrize("kg", [5.0, 0.5, 0.05, 1e-4])
def test_kg_errors_are_nearly_used_up(kg: float) -> None:
    sequence = bar(sides=6, rings=15, frames=8)
    found = kg_of(sequence, check(sequence, compress(sequence, kg=kg)))
    assert (1 - 3 * TARGET_TOLERANCE) * kg < found <= kg


def test_more_bytes_are_more_accurate() -> None:
    sequence = bar()
    errors = [compress(sequence, size=size).parameters.kg_percent for size in (300, 800, 2400)]
    assert (np.diff(errors) < 0).all()
    sizes = [size_of(compress(sequence, max_error=bound)) for bound in (1e-2, 1e-3, 1e-4)]
    assert (np.diff(sizes) > 0).all()


@pytest.mark.filterwarnings("ignore:.*of the motion is left")
def test_the_error_never_grows_with_the_size() -> None:
    sequence = bar(sides=6, rings=15, frames=12)
    sizes = [120, 150, 190, 240, 310, 400, 520, 680]
    coded = [compress(sequence, size=size, inbetweens=False) for size in sizes]
    used = np.array([size_of(each) for each in coded]) / sizes
    assert (used <= 1).all() and (used[-4:] > 0.95).all()
    assert (np.diff([kg_of(sequence, check(sequence, each)) for each in coded]) < 0).all()


def test_errors_at_sizes_are_powers_between_trials() -> None:
    known = [(100.0, 8.0), (1000.0, 0.5), (400.0, 2.0)]
    assert _error_at_size(200, known) == pytest.approx(4)  # size^-1 from 100 to 400
    assert _error_at_size(100, known) == pytest.approx(8)
    assert _error_at_size(3200, known) == pytest.approx(0.5 * 3.2**-2.5)
    assert _error_at_size(50, known) == pytest.approx(8 * 2**2.5)


def test_little_motion_that_is_left_is_told() -> None:
    """A bar that turns by 3 degrees: at 10 % of its radius from the still mean, most of the motion is lost."""
    points, faces = tube(8, 12)
    angles = np.radians(3) * np.sin(np.arange(12))
    rows = [[np.cos(angles), -np.sin(angles)], [np.sin(angles), np.cos(angles)]]
    turned = np.repeat(points[None], 12, axis=0)
    turned[..., :2] = np.einsum("ijt,vj->tvi", np.array(rows), points[:, :2])
    sequence = MeshSequence.from_arrays(turned, faces)
    with pytest.warns(MixseqWarning, match=r"\d+ % of the motion is left in this size; give more"):
        rough = compress(sequence, size=120, inbetweens=False)
    still = kg_of(sequence, np.repeat(turned.mean(axis=0)[None], 12, axis=0))
    assert kg_of(sequence, check(sequence, rough)) > 0.5 * still
    finer = compress(sequence, size=600, inbetweens=False)  # without a warning
    assert kg_of(sequence, check(sequence, finer)) < 0.5 * still


@pytest.mark.parametrize("size", [1, 5, 12])
def test_sizes_without_any_motion_are_refused(size: int) -> None:
    with pytest.raises(SizeError, match="too few bytes for any motion; give more"):
        compress(bar(sides=6, rings=15), size=size)


@pytest.mark.parametrize("chunk", [16, 50])
def test_chunks_are_as_long_as_was_asked_for(chunk: int) -> None:
    sequence = bar(sides=5, rings=9, frames=100)
    coded = compress(sequence, kg=0.5, chunk=chunk)
    assert len(coded.chunks) == round(100 / chunk)
    assert kg_of(sequence, check(sequence, coded)) <= 0.5


@pytest.mark.parametrize("size", [300, 30_000])
def test_sizes_far_from_the_first_guess_are_used_up(size: int) -> None:
    rng = np.random.default_rng(5)
    body = bar(sides=10, rings=30, frames=20)
    sequence = body.with_points(body.points + rng.normal(scale=1e-3, size=body.points.shape))
    coded = compress(sequence, size=size)
    check(sequence, coded)
    assert 0.93 * size < size_of(coded) <= size


def test_smooth_motion_takes_few_bits() -> None:
    """A bar that bends: a hundred frames for half a bit per vertex and frame."""
    sequence = bar(sides=12, rings=40, frames=100)
    coded = compress(sequence, kg=0.5)
    assert 8 * size_of(coded) < 0.5 * sequence.points[..., 0].size


# Awkward sequences ------------------------------------------------------------------------------------------


RNG = np.random.default_rng(7)
TRIANGLES = [[0, 1, 2], [2, 3, 4]]


def mirrored() -> MeshSequence:
    """A mean that is zero, but for one frame."""
    points, faces = tube(6, 9)
    return MeshSequence.from_arrays(points * np.array([1.0, -1, 2, -2])[:, None, None], faces)


AWKWARD = {
    "three vertices": MeshSequence.from_arrays(np.cumsum(RNG.normal(size=(9, 3, 3)), axis=0), [[0, 1, 2]]),
    "one frame of three vertices": MeshSequence.from_arrays(RNG.normal(size=(1, 3, 3)), [[0, 1, 2]]),
    "two frames": bar(sides=4, rings=5, frames=2),
    "starts in one place": MeshSequence.from_arrays(
        RNG.normal(size=(4, 5, 3)) * np.arange(4)[:, None, None], TRIANGLES
    ),
    "four vertices, many frames": MeshSequence.from_arrays(RNG.normal(size=(100, 4, 3)), tetrahedron()[1]),
    "noise": MeshSequence.from_arrays(RNG.normal(size=(12, 22, 3)), tube(4, 5)[1]),
    "mirrored": mirrored(),
    "far away": bar(sides=5, rings=9).with_points(0.1 * bar(sides=5, rings=9).points + 1000.0),
}


@pytest.mark.filterwarnings("ignore:there are no in-betweens", "ignore:.*of the motion is left")
@pytest.mark.parametrize("name", AWKWARD)
def test_awkward_sequences(name: str) -> None:
    sequence = AWKWARD[name]
    check(sequence, compressing.compress(sequence, max_error=1e-4))
    assert kg_of(sequence, check(sequence, compress(sequence, kg=0.01))) <= 0.01
    coded = compress(sequence, size=150)
    check(sequence, coded)
    assert size_of(coded) <= 150


@pytest.mark.parametrize("place", [0.0, 1.0, 1e4])
def test_all_vertices_in_one_place(place: float) -> None:
    points = np.repeat(place * RNG.normal(size=(4, 1, 3)), 5, axis=1)
    sequence = MeshSequence.from_arrays(points, TRIANGLES)
    check(sequence, compress(sequence, max_error=1e-3))
    with pytest.raises(SettingsError, match=r"give max_error|larger one"):
        compress(sequence, kg=1)


def test_single_precision_far_from_the_origin() -> None:
    """Coordinates of 1000 have steps of 6e-5: the bound also holds for what is written as float32."""
    near = bar(sides=5, rings=9)
    sequence = near.with_points((0.1 * near.points + 1000).astype(np.float32))
    coded = compress(sequence, max_error=1e-3)
    points = check(sequence, coded)
    assert largest(sequence, points.astype(np.float32).astype(np.float64)) <= 1e-3


def test_frames_that_are_left_out_of_the_factors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of long sequences only some frames make the components; residuals see to errors that are too small."""
    monkeypatch.setattr("mixseq.compression.encoder.components.MAX_TABLE_SIDE", 30)
    body = bar(6, 40, 40)
    noise = np.random.default_rng(3).normal(scale=0.05, size=body.points.shape)
    sequence = body.with_points(body.points + noise)
    coded = compress(sequence, kg=0.05)
    assert coded.parameters.correction > 0
    assert not coded.parameters.promised
    assert kg_of(sequence, check(sequence, coded)) <= 0.05


def test_very_many_steps_are_no_harm() -> None:
    """More bytes than rounding errors are worth: the sequence comes back to rounding."""
    sequence = AWKWARD["far away"]
    points = check(sequence, compress(sequence, size=100_000))
    assert np.abs(points - sequence.points).max() < 1e-8


# What is refused --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({}, "nothing is given; give one of max_error, kg and size"),
        ({"kg": 1, "size": 100}, "kg and size is given; give one"),
        ({"max_error": 1e-3, "kg": 1, "size": 100}, "give one of"),
        ({"kg": 0}, "kg is 0"),
        ({"kg": -1}, "a positive number is expected"),
        ({"kg": np.nan}, "kg is nan"),
        ({"max_error": np.inf}, "max_error is inf"),
        ({"size": 0}, "size is 0"),
        ({"kg": 1, "chunk": 15}, "chunk is 15; 16 to 4096 frames"),
        ({"kg": 1, "chunk": 4097}, "chunk is 4097; 16 to 4096 frames"),
        ({"max_error": 1e-14}, "beyond the digits of coordinates.*give at least"),
    ],
)
def test_refusals(asked: dict[str, float], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        compress(bar(sides=3, rings=4), **asked)  # type: ignore[arg-type]


@pytest.mark.parametrize(("scale", "cure"), [((1, 1), True), ((1, 1e13), False)])
def test_only_what_is_far_away_is_to_be_moved(scale: tuple[float, float], cure: bool) -> None:
    still = bar(sides=3, rings=4, frames=2)
    points = still.points * np.array(scale)[:, None, None] + (1e13 if cure else 0)
    with pytest.raises(SettingsError, match="beyond the digits") as refused:
        compress(MeshSequence.from_arrays(points, still.faces), max_error=1e-3)
    assert ("move the sequence to the origin" in str(refused.value)) == cure


# The same everywhere ----------------------------------------------------------------------------------------


def digest(sequence: MeshSequence) -> str:
    """Of all bytes, and of the points that come of them."""
    hashed = hashlib.sha256()
    for asked in ({"kg": 0.2}, {"max_error": 1e-3}):
        coded = compressing.compress(sequence, **asked)  # type: ignore[arg-type]
        for stream in (
            *coded.basis,
            *(part for c in coded.chunks for part in (c.coefficients, c.residuals, c.inbetweens)),
        ):
            hashed.update(stream)
        hashed.update(decode(coded).sample().points.tobytes())
        hashed.update(repr(coded.parameters).encode())
    return hashed.hexdigest()


@cache
def digest_here() -> str:
    return digest(bar(sides=14, rings=25, frames=9))


_SCRIPT = """
from tests.compression.encoder.test_compress import digest
from tests.meshes import bar
print(digest(bar(sides=14, rings=25, frames=9)))
"""


def test_bytes_are_the_same_in_a_process_with_another_number_of_threads() -> None:
    names = [f"{each}_NUM_THREADS" for each in ("OMP", "OPENBLAS", "MKL", "NUMBA")] + ["MIXSEQ_THREADS"]
    threads = "1" if thread_count() > 1 else "3"
    environment = {**os.environ, **dict.fromkeys(names, threads), "PYTHONHASHSEED": threads}
    command, folder = [sys.executable, "-c", _SCRIPT], Path(__file__).parents[2]
    run = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=True)
    assert run.stdout.strip() == digest_here()


def test_bytes_are_the_same_however_much_is_done_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    expected = digest_here()
    monkeypatch.setenv("MIXSEQ_THREADS", "3")
    assert digest(bar(sides=14, rings=25, frames=9)) == expected


@pytest.mark.parametrize(
    ("module", "name"), [(components, "_code_lengths"), (trial, "_round_part"), (spatial_basis, "build_part_graph")]
)
def test_more_than_two_cores_take_no_more_memory(
    module: ModuleType, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Parts are worked on two at a time: on each thread arrays are as long as the whole mesh."""
    original, lock, under_way, most = getattr(module, name), threading.Lock(), 0, 0

    def counted(*arguments: Any) -> Any:
        nonlocal under_way, most
        with lock:
            under_way += 1
            most = max(most, under_way)
        time.sleep(0.005)
        try:
            return original(*arguments)
        finally:
            with lock:
                under_way -= 1

    monkeypatch.setenv("MIXSEQ_THREADS", "16")
    monkeypatch.setattr(module, name, counted)
    compress(bar(sides=14, rings=25, frames=9), max_error=1e-3)
    assert most == 2


@dataclass(frozen=True)
class _Streamed:
    """A sequence that can be read once, from its first frame to its last."""

    sequence: MeshSequence

    @property
    def header(self) -> SequenceHeader:
        return self.sequence.header

    def blocks(self, size: int = 4) -> Iterator[FloatArray]:
        return self.sequence.blocks(size)


def test_a_sequence_that_streams_is_the_same() -> None:
    sequence = bar(sides=5, rings=9)
    assert compress(_Streamed(sequence), kg=0.5).basis == compress(sequence, kg=0.5).basis


def test_progress_only_grows() -> None:
    told: list[float] = []

    def progress(done: int, total: int, stage: str) -> None:
        assert stage
        told.append(done / total)

    compressing.compress(bar(sides=5, rings=9), max_error=1e-3, progress=progress)
    assert told == sorted(told)
    assert len(told) > 3
    assert told[-1] <= 1


# Any sequence -----------------------------------------------------------------------------------------------

MESHES = (tetrahedron(), grid(3, 2), tube(4, 4), torus(5, 4), joined(tetrahedron(), tube(3, 3), grid(1, 1)))


@st.composite
def sequences(draw: st.DrawFn) -> MeshSequence:
    """Smooth motion and noise, each of any size, maybe isolated vertices, maybe far away, maybe in single precision."""
    points, faces = draw(st.sampled_from(MESHES))
    rng = np.random.default_rng(draw(seeds))
    stray = rng.normal(size=(draw(st.integers(0, 3)), 3))
    points = np.concatenate([points, stray])
    times = np.linspace(0, 1, draw(st.integers(1, 12)))[:, None, None]
    waves = sum(rng.normal(size=(1, *points.shape)) * np.sin(k * times + rng.normal()) for k in (1, 3))
    moving = points + draw(st.sampled_from([0.0, 1e-3, 1.0, 30.0])) * np.asarray(waves)
    moving = moving + draw(st.sampled_from([0.0, 1e-9, 1e-2, 1.0])) * rng.normal(size=moving.shape)
    moving = draw(st.sampled_from([1.0, 1e-4, 1e5])) * (moving + draw(st.sampled_from([0.0, 50.0])))
    return MeshSequence.from_arrays(moving.astype(draw(st.sampled_from([np.float32, np.float64]))), faces)


@pytest.mark.filterwarnings("ignore:there are no in-betweens")
@settings(max_examples=20, deadline=None)
@given(sequence=sequences(), bound=st.floats(-5, -0.5).map(lambda power: float(10.0**power)))
def test_no_bound_is_exceeded(sequence: MeshSequence, bound: float) -> None:
    check(sequence, compressing.compress(sequence, max_error=bound))


@settings(max_examples=15, deadline=None)
@given(sequence=sequences(), kg=st.floats(-3, 1.5).map(lambda power: float(10.0**power)))
def test_no_kg_error_is_exceeded(sequence: MeshSequence, kg: float) -> None:
    assert kg_of(sequence, check(sequence, compress(sequence, kg=kg))) <= kg * (1 + 1e-9)


# Animations -------------------------------------------------------------------------------------------------


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["q_wolf_gallop", "fox_run"])
def test_animations_take_few_bits(data: Path, name: str) -> None:
    """At a KG error of 0.5 %: 1.71 and 1.79 bits per vertex and frame were measured."""
    sequence = mixseq.read(data / "npz" / f"{name}.npz")
    coded = compress(sequence, kg=0.5)
    assert kg_of(sequence, check(sequence, coded)) <= 0.5
    assert 8 * size_of(coded) < 1.9 * sequence.points[..., 0].size


@pytest.mark.realdata
@pytest.mark.parametrize(("name", "bound"), [("q_wolf_gallop", 1e-4), ("fox_run", 1e-2)])
def test_bounds_of_animations_are_kept(data: Path, name: str, bound: float) -> None:
    sequence = mixseq.read(data / "npz" / f"{name}.npz")
    check(sequence, compress(sequence, max_error=bound))


# Meshes that are cut into parts, each with a basis of its own


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
    with pytest.raises(FormatError, match="2 parts are expected"):
        read_labels(Reader(writer.finish()), 2, graph)


def test_parts_are_all_vertices_once() -> None:
    sequence = bar(6, 12, 2)
    labels = (np.arange(sequence.vertex_count) % 3).astype(np.int64)
    parts = split_parts(labels, sequence.faces)
    for number, part in enumerate(parts):
        np.testing.assert_array_equal(part.vertices, np.flatnonzero(labels == number))
        assert part.graph.size == len(part.vertices)


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
    found = merge_parts(points, labels, (3,))[3]
    np.testing.assert_array_equal(found, np.repeat([0, 1, 2, 0, 1, 2], ring))


def test_a_mesh_that_cannot_be_cut_is_one_part() -> None:
    assert initial_parts(load_frames(bar(3, 4, 3)), (3, 6, 12)) == {}


def test_rigid_bodies_are_parts() -> None:
    sequence = bodies()
    found = initial_parts(load_frames(sequence), (3, 6, 12))
    ring = sequence.vertex_count // 6
    assert list(found) == [3, 6]
    assert len(np.unique(found[6].reshape(6, ring)[:, 0])) == 6
    assert (found[6].reshape(6, ring) == found[6].reshape(6, ring)[:, :1]).all()


# Coding -----------------------------------------------------------------------------------------------------


def test_bodies_get_bases_of_their_own(flying: tuple[MeshSequence, CompressedSequence]) -> None:
    sequence, coded = flying
    assert len(coded.parameters.ranks) == 6
    assert sum(coded.parameters.ranks) == coded.parameters.rank
    assert mixseq.compare(sequence, decode(coded).sample()).kg_percent <= 0.1
    # A rigid motion has a constant vector, and three that are affine; a little noise of rounding.
    assert max(coded.parameters.ranks) <= 6


def test_parts_are_chosen_only_if_they_pay(
    flying: tuple[MeshSequence, CompressedSequence], monkeypatch: pytest.MonkeyPatch
) -> None:
    sequence, coded = flying
    monkeypatch.setattr("mixseq.compression.encoder.search.PART_COUNTS", (10_000,))
    one = compress(sequence, kg=0.1)
    assert one.parameters.ranks == ()
    sizes = [sum(map(len, each.basis)) + sum(len(c.coefficients) for c in each.chunks) for each in (one, coded)]
    assert sizes[1] < 0.8 * sizes[0]


@pytest.mark.parametrize("bound", [1e-2, 1e-4])
def test_bounds_are_kept_by_parts(bound: float) -> None:
    sequence = bodies(12, noise=1e-3)
    coded = compress(sequence, max_error=bound)
    assert mixseq.compare(sequence, decode(coded).sample()).max_error <= bound


def test_the_file_holds_parts(flying: tuple[MeshSequence, CompressedSequence], tmp_path: object) -> None:
    sequence, coded = flying
    path = f"{tmp_path}/bodies.h5"
    mixseq.save(path, coded)
    np.testing.assert_array_equal(mixseq.load(path).sample().points, decode(coded).sample().points)
    assert mixseq.verify(path, sequence).holds


def test_ranks_that_contradict_are_refused(flying: tuple[MeshSequence, CompressedSequence]) -> None:
    _, coded = flying
    with pytest.raises(mixseq.errors.SettingsError, match="basis vectors"):
        replace(coded.parameters, ranks=(1, 1))
    with pytest.raises(mixseq.errors.SettingsError, match="above zero"):
        replace(coded.parameters, rank=2, ranks=(3, -1))
    with pytest.raises(mixseq.errors.SettingsError, match="whole mesh"):
        replace(coded.parameters, factors="shapes")
