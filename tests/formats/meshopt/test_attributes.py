"""Vertices as meshoptimizer packs them: what it packed itself, what comes back, what is damaged."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from mixseq.errors import FormatError
from mixseq_io.meshopt.attributes import decode_attributes, encode_attributes

pytestmark = pytest.mark.slow

# By MeshoptEncoder.encodeVertexBufferLevel of meshoptimizer 1.3, in versions 0 and 1: 20 vertices.
VERSION_0 = (
    "a00700585858585858585858585858585858ff00000058585858052aaeaaea0404ae00000004000007004a484a484a484adbd9dbdbdbd9dbdbff"
    "000000d9dbdbdb070092929292929294484a484a484a4a48ff0000004a484a480700242424262424261212121212121412ff0000001212121201"
    "00020000000000000000000000000000000000000000000000000000000007000000803f"
)
VERSION_1 = (
    "a1a7bf0058585858585858585858585858585858585858052aaaaaaaaa000000004a484a484a484a242624242426242426242424009292929292"
    "929249494949494949494949494900242424262424261212121212121412121212120000000000000000000000000000000007000000803f0101"
)


def vertices() -> NDArray[np.uint8]:
    number = np.arange(20)
    rows = np.zeros(20, [("a", "<u2"), ("b", "<u2"), ("c", "<f4")])
    rows["a"], rows["b"], rows["c"] = number * 300 % 65536, 7, 1 + number / 7
    return rows.view(np.uint8).reshape(20, 8)


@pytest.mark.parametrize("packed", [VERSION_0, VERSION_1], ids=["version 0", "version 1"])
def test_what_meshoptimizer_packed(packed: str) -> None:
    np.testing.assert_array_equal(decode_attributes(bytes.fromhex(packed), 20, 8), vertices())


def test_version_0_is_as_short_as_that_of_meshoptimizer() -> None:
    assert len(encode_attributes(vertices())) == len(bytes.fromhex(VERSION_0))


@pytest.mark.parametrize("stride", [4, 12, 256])
@pytest.mark.parametrize("count", [1, 15, 16, 17, 256, 257, 3000])
@pytest.mark.parametrize("largest", [1, 2, 4, 15, 256])
def test_they_come_back(count: int, stride: int, largest: int) -> None:
    numbers = np.random.default_rng(count).integers(0, largest, (count, stride))
    for rows in (numbers.astype(np.uint8), numbers.cumsum(axis=0).astype(np.uint8)):
        np.testing.assert_array_equal(decode_attributes(encode_attributes(rows), count, stride), rows)


def test_nothing_that_changes_takes_next_to_nothing() -> None:
    """Of 256 vertices, each of 16 bytes takes 16 groups of 2 bits; the tail has 32."""
    rows = np.tile(np.arange(16, dtype=np.uint8), (256, 1))
    assert len(encode_attributes(rows)) == 1 + 16 * 4 + 32


@pytest.mark.parametrize(
    ("data", "stride"),
    [
        (b"", 4),
        (b"\xa2" + bytes(40), 4),
        (b"\xa0" + bytes(40), 6),
        (b"\xa0" + bytes(400), 260),
        (b"\xa0" * 20, 4),
    ],
    ids=["empty", "unknown version", "odd stride", "long stride", "cut"],
)
def test_what_cannot_be_right(data: bytes, stride: int) -> None:
    with pytest.raises(FormatError, match="packed"):
        decode_attributes(data, 1, stride)


@pytest.mark.parametrize("packed", [VERSION_0, VERSION_1], ids=["version 0", "version 1"])
@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_damage_is_an_error_or_other_numbers(packed: str, data: st.DataObject) -> None:
    damaged = bytearray(bytes.fromhex(packed))
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(damaged)))
    for bad in (bytes(damaged), bytes(damaged[:cut])):
        for count in (20, 300):
            try:
                assert decode_attributes(bad, count, 8).shape == (count, 8)
            except FormatError as error:
                assert "packed" in str(error)
