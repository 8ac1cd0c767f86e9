"""Triangles and indices as meshoptimizer packs them: what it packed itself, what comes back, what is damaged."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from mixseq.errors import FormatError
from mixseq_io.meshopt.indices import decode_sequence, decode_triangles, encode_triangles

pytestmark = pytest.mark.slow

# By MeshoptEncoder.encodeIndexBuffer and encodeIndexSequence of meshoptimizer 1.3.
TRIANGLES = "e1f010feff1efefff00cff02020200ffd407c801c801007687566778a9866589689801690000"
TRIANGLES_ARE = [[0, 1, 2], [2, 1, 3], [4, 6, 5], [7, 8, 9], [9, 8, 10], [0, 1, 2], [500, 600, 700]]
SEQUENCE = "d10004cd010407981fb701a0ec1000000000"


def turned(triangles: NDArray[np.integer]) -> list[tuple[int, int, int]]:
    """Let every triangle begin with the corner with which it is the smallest triple."""
    return [min((a, b, c), (b, c, a), (c, a, b)) for a, b, c in triangles.tolist()]


def test_what_meshoptimizer_packed() -> None:
    found = decode_triangles(bytes.fromhex(TRIANGLES), 21).reshape(-1, 3)
    assert turned(found) == turned(np.array(TRIANGLES_ARE))
    indices = decode_sequence(bytes.fromhex(SEQUENCE), 8)
    assert indices.tolist() == [0, 1, 51, 2, 49, 1000, 3, 70000]


def test_what_is_packed_is_what_meshoptimizer_packs() -> None:
    assert encode_triangles(np.array(TRIANGLES_ARE)).hex() == TRIANGLES


@settings(max_examples=200, deadline=None)
@given(st.lists(st.lists(st.integers(0, 40), min_size=3, max_size=3), max_size=60), st.integers(0, 2**30))
def test_triangles_come_back_in_order(corners: list[list[int]], first: int) -> None:
    triangles = np.array(corners, dtype=np.int64).reshape(-1, 3) + first
    found = decode_triangles(encode_triangles(triangles), triangles.size).reshape(-1, 3)
    assert turned(found) == turned(triangles)


def test_a_walked_grid_takes_about_a_byte_per_triangle() -> None:
    vertex = np.arange(10_000).reshape(100, 100)
    a, b, c, d = vertex[:-1, :-1], vertex[1:, :-1], vertex[1:, 1:], vertex[:-1, 1:]
    triangles = np.stack([a, b, c, a, c, d], axis=2).reshape(-1, 3)
    assert len(encode_triangles(triangles)) < 1.05 * len(triangles)


@pytest.mark.parametrize("decode", [decode_triangles, decode_sequence])
@pytest.mark.parametrize("data", [b"", b"\xe0" + bytes(40), b"\xe1" + bytes(3), b"\xd1" + bytes(2)])
def test_what_cannot_be_right(decode: object, data: bytes) -> None:
    assert callable(decode)
    with pytest.raises(FormatError, match="packed"):
        decode(data, 21)


def test_corners_that_are_no_triangles() -> None:
    with pytest.raises(FormatError, match="packed"):
        decode_triangles(bytes.fromhex(TRIANGLES), 20)


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_damage_is_an_error_or_other_numbers(data: st.DataObject) -> None:
    for packed, decode, count in ((TRIANGLES, decode_triangles, 21), (SEQUENCE, decode_sequence, 8)):
        damaged = bytearray(bytes.fromhex(packed))
        for _ in range(data.draw(st.integers(1, 4))):
            damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
        for bad in (bytes(damaged), bytes(damaged[: data.draw(st.integers(0, len(damaged)))])):
            try:
                found = decode(bad, count)
            except FormatError as error:
                assert "packed" in str(error)
            else:
                assert found.shape == (count,)
                assert (found >= 0).all()
                assert (found < 2**32).all()
