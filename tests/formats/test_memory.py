"""The limit of memory: one for all readers, told in their errors."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.errors import FormatError, SettingsError
from mixseq.sequence.sequence import MeshSequence
from mixseq_io import files, isolation
from mixseq_io.files import VARIABLE, check_memory, max_memory, memory_limit
from tests.formats.conftest import Target

FACES = np.array([[0, 1, 2]])


@pytest.mark.parametrize(("machine", "limit"), [(4e9, 2e9), (64e9, 8e9)])
def test_default(monkeypatch: pytest.MonkeyPatch, machine: float, limit: float) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setattr(files, "_memory_of_machine", lambda: int(machine))
    assert max_memory() == limit


def test_the_call_counts_more_than_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "0.5")
    assert max_memory() == 1 << 29
    with memory_limit(100):
        with memory_limit(None):
            assert max_memory() == 100
        with memory_limit(50):
            assert max_memory() == 50
        assert max_memory() == 100
    assert max_memory() == 1 << 29


def test_limits_that_are_none(monkeypatch: pytest.MonkeyPatch) -> None:
    for size in (0, -1.0, float("nan"), float("inf")):
        with pytest.raises(SettingsError, match="limit of memory"), memory_limit(size):
            pass
    monkeypatch.setenv(VARIABLE, "much")
    with pytest.raises(SettingsError, match="MIXSEQ_READER_MEMORY is 'much'"):
        max_memory()


def test_the_error_tells_what_would_help() -> None:
    with (
        memory_limit(1e9),
        pytest.raises(
            FormatError,
            match=r"walk\.npz: faces would take 2 GB of memory, the limit is 1 GB; .*--max-memory 3GB \(max_memory=",
        ),
    ):
        check_memory("walk.npz", 2e9, "faces")
    with memory_limit(1e9):
        check_memory("walk.npz", 1e9)


@pytest.fixture
def new_workers(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """End the workers of this test, which have been short of memory."""
    monkeypatch.setattr(isolation, "idle", [])
    yield
    isolation.dismiss_all()


@pytest.mark.slow
@pytest.mark.usefixtures("new_workers")
def test_every_reader_keeps_it(
    target: Target, store: Callable[[Target, MeshSequence], Path], plain: MeshSequence
) -> None:
    path = store(target, plain)
    with pytest.raises(FormatError, match=r"walk.* of memory.*--max-memory"):
        mixseq.read(path, max_memory=16)
    assert mixseq.read(path, max_memory=1e9).vertex_count


def test_blocks_are_shorter_where_memory_is_short(tmp_path: Path) -> None:
    path = tmp_path / "long.npz"
    np.savez(path, points=np.zeros((10, 1000, 3)), faces=FACES)
    with mixseq.open_sequence(path, max_memory=60_000) as reader:
        assert [len(block) for block in reader.blocks()] == [2] * 5
    with pytest.raises(FormatError, match="all its 10 frames would take"):
        mixseq.read(path, max_memory=60_000)
    with (
        mixseq.open_sequence(path, max_memory=20_000) as reader,
        pytest.raises(FormatError, match="a frame would take"),
    ):
        reader.blocks()


@pytest.mark.slow
def test_models(tmp_path: Path, plain: MeshSequence) -> None:
    mixseq.save(tmp_path / "model.h5", mixseq.fit(plain, space="vertex", exact=True))
    mixseq.save(tmp_path / "small.h5", mixseq.compress(plain, max_error=1e-2))
    for name in ("model.h5", "small.h5"):
        with pytest.raises(FormatError, match=rf"{name}: the file itself would take .*--max-memory"):
            mixseq.load(tmp_path / name, max_memory=100)
        assert mixseq.load(tmp_path / name, max_memory=1e9).header.vertex_count == plain.vertex_count


def member(shape: tuple[int, ...], content: bytes, dtype: str = "<i4") -> bytes:
    """Return the bytes of an array that tells a shape, and has any content."""
    header = f"{{'descr': {dtype!r}, 'fortran_order': False, 'shape': {shape}}}".encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + content


def archive(path: Path, faces: bytes, method: int = zipfile.ZIP_DEFLATED) -> None:
    with zipfile.ZipFile(path, "w", method) as file:
        file.writestr("points.npy", member((1, 3, 3), bytes(36), "<f4"))
        file.writestr("faces.npy", faces)


def lie(path: Path, before: int, after: int) -> None:
    """Tell another size of what a zip file unpacks to, in all headers."""
    data = path.read_bytes()
    old, new = before.to_bytes(4, "little"), after.to_bytes(4, "little")
    assert data.count(old) >= 2
    path.write_bytes(data.replace(old, new))


@pytest.mark.parametrize("read", [mixseq.read, lambda path, **limit: mixseq.open_sequence(path, **limit)])
def test_a_small_archive_of_large_arrays(tmp_path: Path, read: Callable[..., object]) -> None:
    path, content = tmp_path / "bomb.npz", bytes(12 * 200_000)
    archive(path, member((200_000, 3), content))
    with pytest.raises(FormatError, match=r"bomb\.npz: its arrays, with 'faces', would take 0.0024 GB"):
        read(path, max_memory=1e6)
    for method in (zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):
        archive(path, member((200_000, 3), content), method)
        with pytest.raises(FormatError, match=f"faces is compressed by method {method}"):
            read(path)


def test_headers_that_lie(tmp_path: Path) -> None:
    path = tmp_path / "lies.npz"
    for shape in ((1 << 40, 3), (-1, -3), (1 << 70, 3)):
        archive(path, member(shape, bytes(12)))
        with pytest.raises(FormatError, match=r"lies\.npz"):
            mixseq.read(path)
    archive(path, member((), b"", "<U100000000"))
    with pytest.raises(FormatError, match=r"lies\.npz: faces of shape \(\) do not fill their 128 bytes"):
        mixseq.read(path)
    whole = member((200_000, 3), bytes(12 * 200_000))
    archive(path, whole)
    lie(path, len(whole), len(member((1, 3), bytes(12))))
    with pytest.raises(FormatError, match=r"lies\.npz"):
        mixseq.read(path)


@pytest.mark.parametrize("name", ["walk.obj", "walk.usda", "walk.h5", "walk.npz", "walk.unknown", "walk.mdd"])
def test_pipes_are_no_files(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    for read in (mixseq.open_sequence, mixseq.load):
        with pytest.raises(FormatError, match=f"{name} is a pipe, a socket or a device"):
            read(tmp_path / name)
