"""Residuals bring every vertex below the bound, and say nothing where nothing has to be said."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.compression.bitstream.residual_layer import FRAMES_PER_RUN, read_residuals, write_residuals
from mixseq.compression.bitstream.signal_graph import mesh_graph
from mixseq.compression.encoder.trial import quantise_residuals, residual_unit
from mixseq.errors import FormatError
from mixseq.types import Float, Index
from tests.meshes import seeds, torus

VERTICES = 70
GRAPH = mesh_graph(torus(10, 6)[1], VERTICES)  # the last ten have no faces


def decoded(stream: bytes, count: int) -> Index:
    """All frames of a stream, run by run, from the last to the first."""
    frames = np.zeros((count, VERTICES, 3), dtype=np.int64)
    for run in reversed(range(-(-count // FRAMES_PER_RUN))):
        for place, (vertices, numbers) in enumerate(read_residuals(stream, count, run, GRAPH)):
            frames[run * FRAMES_PER_RUN + place, vertices] = numbers
    return frames


def written(numbers: Index | list[Index]) -> bytes:
    return write_residuals(lambda frame: np.asarray(numbers[frame]), range(len(numbers)), GRAPH)


def errors(count: int, seed: int = 0, share: float = 0.2, size: float = 2.0) -> Float:
    """Errors of which about a share is above 1."""
    rng = np.random.default_rng(seed)
    apart = rng.normal(size=(count, VERTICES, 3))
    lengths = np.where(rng.random((count, VERTICES)) < share, 1 + rng.exponential(size, (count, VERTICES)), 0.5)
    return np.asarray(apart * (lengths / np.linalg.norm(apart, axis=2))[..., None])


@settings(max_examples=50, deadline=None)
@given(seed=seeds, bound=st.sampled_from([1e-9, 0.3, 1.0, 7e4]), size=st.sampled_from([0.01, 1.0, 1000.0]))
def test_nothing_is_left_above_the_bound(seed: int, bound: float, size: float) -> None:
    apart = bound * errors(3, seed, 0.5, size)
    numbers = quantise_residuals(apart, bound)
    left = np.linalg.norm(apart - residual_unit(bound) * numbers, axis=2)
    assert left.max() <= bound * (1 + 1e-12)


def test_only_what_is_above_the_bound_is_corrected() -> None:
    apart = errors(4)
    numbers = quantise_residuals(apart, 1.0)
    far = np.linalg.norm(apart, axis=2) > 1
    np.testing.assert_array_equal(numbers.any(axis=2), far)
    assert residual_unit(1.0) == pytest.approx(2 / np.sqrt(3))


@pytest.mark.parametrize(
    "count", [1, 2, FRAMES_PER_RUN - 1, FRAMES_PER_RUN, FRAMES_PER_RUN + 1, 3 * FRAMES_PER_RUN + 2]
)
@pytest.mark.parametrize("share", [0.01, 0.3, 1.0])
def test_residuals_come_back(count: int, share: float) -> None:
    numbers = quantise_residuals(errors(count, count, share), 1.0)
    np.testing.assert_array_equal(decoded(written(numbers), count), numbers)


@settings(max_examples=30, deadline=None)
@given(seed=seeds, power=st.integers(0, 60))
def test_residuals_of_any_size_come_back(seed: int, power: int) -> None:
    rng = np.random.default_rng(seed)
    numbers = rng.integers(-(1 << power), (1 << power) + 1, (3, VERTICES, 3)) * rng.integers(0, 2, (3, VERTICES, 1))
    np.testing.assert_array_equal(decoded(written(numbers), 3), numbers)


def test_nothing_to_correct_is_nothing() -> None:
    none = np.zeros((2 * FRAMES_PER_RUN, VERTICES, 3), dtype=np.int64)
    assert written(none) == b""
    assert not decoded(b"", 2 * FRAMES_PER_RUN + 1).any()


def test_runs_without_residuals_have_no_bytes() -> None:
    numbers = np.zeros((3 * FRAMES_PER_RUN, VERTICES, 3), dtype=np.int64)
    numbers[FRAMES_PER_RUN + 3, 5] = 1, -2, 0
    stream = written(numbers)
    lengths = np.frombuffer(stream[:12], dtype="<u4")
    assert lengths[[0, 2]].tolist() == [0, 0]
    assert 12 + lengths[1] == len(stream) <= 32
    np.testing.assert_array_equal(decoded(stream, 3 * FRAMES_PER_RUN), numbers)


def test_runs_are_decoded_by_themselves() -> None:
    """Bytes of other runs are not looked at."""
    numbers = quantise_residuals(errors(3 * FRAMES_PER_RUN), 1.0)
    stream = written(numbers)
    lengths = np.frombuffer(stream[:12], dtype="<u4")
    start = 12 + int(lengths[0])
    other = stream[:12] + bytes(int(lengths[0])) + stream[start : start + int(lengths[1])] + bytes(int(lengths[2]))
    for frame, (vertices, found) in zip(
        numbers[FRAMES_PER_RUN:], read_residuals(other, 3 * FRAMES_PER_RUN, 1, GRAPH), strict=False
    ):
        np.testing.assert_array_equal(found, frame[vertices])
        assert len(vertices) == frame.any(axis=1).sum()


def test_residuals_that_last_are_cheap() -> None:
    """The frame before tells where they are."""
    one = quantise_residuals(errors(1, share=0.2), 1.0)[0]
    lasting = written([one] * FRAMES_PER_RUN)
    changing = written(quantise_residuals(errors(FRAMES_PER_RUN, share=0.2), 1.0))
    assert len(lasting) < 0.7 * len(changing)


# Damage -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("length", [1, 2, 3, 4, 7, 8, 11, 12, 20])
def test_cut_streams_are_refused(length: int) -> None:
    stream = written(quantise_residuals(errors(3 * FRAMES_PER_RUN), 1.0))
    with pytest.raises(FormatError, match="its length is not the stated one"):
        read_residuals(stream[:length], 3 * FRAMES_PER_RUN, 0, GRAPH)


def test_flipped_bits_give_other_residuals_or_an_error() -> None:
    count = FRAMES_PER_RUN + 2
    stream = written(quantise_residuals(errors(count, share=0.1), 1.0))
    for place in range(0, len(stream), 7):
        damaged = bytearray(stream)
        damaged[place] ^= 1 << place % 8
        try:
            frames = [frame for run in range(2) for frame in read_residuals(bytes(damaged), count, run, GRAPH)]
        except FormatError as error:
            assert "damaged" in str(error)
            continue
        assert len(frames) == count
        for vertices, numbers in frames:
            assert numbers.shape == (len(vertices), 3)
            assert ((vertices >= 0) & (vertices < VERTICES)).all()
