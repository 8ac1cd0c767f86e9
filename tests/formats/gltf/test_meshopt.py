"""Views that meshoptimizer packs: what its own JavaScript packed, what comes back, what is damaged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from mixseq.errors import FormatError, MissingExtraError
from mixseq_io.gltf import codecs
from mixseq_io.gltf.codecs import unpack_meshopt
from tests.formats.gltf.packed_files import FOLDER
from tests.formats.gltf_maker import load

pytest.importorskip("meshopt")
pytestmark = pytest.mark.slow

PATH = Path("walk.glb")

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
# By MeshoptEncoder.encodeIndexBuffer and encodeIndexSequence of meshoptimizer 1.3.
TRIANGLES = "e1f010feff1efefff00cff02020200ffd407c801c801007687566778a9866589689801690000"
TRIANGLES_ARE = np.array([[0, 1, 2], [2, 1, 3], [4, 6, 5], [7, 8, 9], [9, 8, 10], [0, 1, 2], [500, 600, 700]])
SEQUENCE = "d10004cd010407981fb701a0ec1000000000"


def view(data: bytes, count: int, stride: int, mode: str, name: str = "NONE") -> NDArray[np.uint8]:
    return unpack_meshopt(PATH, data, "bufferViews[0]", count, stride, mode, name).reshape(count, stride)


def vertices() -> NDArray[np.uint8]:
    number = np.arange(20)
    rows = np.zeros(20, [("a", "<u2"), ("b", "<u2"), ("c", "<f4")])
    rows["a"], rows["b"], rows["c"] = number * 300 % 65536, 7, 1 + number / 7
    return rows.view(np.uint8).reshape(20, 8)


@pytest.mark.parametrize("data", [VERSION_0, VERSION_1], ids=["version 0", "version 1"])
def test_vertices(data: str) -> None:
    np.testing.assert_array_equal(view(bytes.fromhex(data), 20, 8, "ATTRIBUTES"), vertices())


def test_indices() -> None:
    corners = view(bytes.fromhex(TRIANGLES), 21, 4, "TRIANGLES").view("<u4").reshape(-1, 3)
    assert [sorted(each) for each in corners] == [sorted(each) for each in TRIANGLES_ARE]
    sequence = view(bytes.fromhex(SEQUENCE), 8, 4, "INDICES").view("<u4")
    assert sequence.ravel().tolist() == [0, 1, 51, 2, 49, 1000, 3, 70000]


@pytest.mark.parametrize(
    ("mode", "name", "stride"),
    [("KNOTS", "NONE", 4), ("ATTRIBUTES", "KALMAN", 4), ("ATTRIBUTES", "NONE", 6), ("TRIANGLES", "NONE", 4)],
)
def test_what_cannot_be_right(mode: str, name: str, stride: int) -> None:
    with pytest.raises(FormatError, match=r"walk\.glb.*bufferViews\[0\].*cannot be unpacked by meshoptimizer"):
        view(b"\xa0" + bytes(40), 3, stride, mode, name)


@settings(max_examples=100, deadline=None)
@given(data=st.data())
def test_damage_is_an_error_or_other_numbers(data: st.DataObject) -> None:
    for packed, count, stride, mode in (
        (VERSION_0, 20, 8, "ATTRIBUTES"),
        (VERSION_1, 20, 8, "ATTRIBUTES"),
        (TRIANGLES, 21, 4, "TRIANGLES"),
        (SEQUENCE, 8, 2, "INDICES"),
    ):
        damaged = bytearray(bytes.fromhex(packed))
        for _ in range(data.draw(st.integers(1, 4))):
            damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
        for bad in (bytes(damaged), bytes(damaged[: data.draw(st.integers(0, len(damaged)))])):
            try:
                assert view(bad, count, stride, mode).shape == (count, stride)
            except FormatError as error:
                assert "meshoptimizer" in str(error)


def test_without_its_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(codecs, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"meshopt\.glb is compressed.*pip install 'mixseq\[gltf\]'"):
        load(FOLDER / "meshopt.glb")
