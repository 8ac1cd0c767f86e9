"""Files appear whole or not at all."""

from __future__ import annotations

import os
import socket
import stat
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.errors import FormatError, OutputError, SettingsError
from mixseq.sequence.sequence import MeshSequence
from mixseq_io import files, isolation
from mixseq_io.files import (
    MEMORY_LIMIT_VARIABLE,
    atomic_file,
    atomic_files,
    atomic_folder,
    check_memory,
    max_memory,
    memory_limit,
)
from tests.formats.conftest import TARGETS, Target


def test_the_file_appears_at_the_end(tmp_path: Path) -> None:
    target = tmp_path / "a.usdc"
    with atomic_file(target) as temporary:
        assert temporary.suffix == ".usdc"
        assert temporary.parent == tmp_path
        temporary.write_text("new")
        assert not target.exists()
    assert target.read_text() == "new"
    assert list(tmp_path.iterdir()) == [target]


def test_modes_and_links_are_kept(tmp_path: Path) -> None:
    target, link = tmp_path / "a.npz", tmp_path / "link.npz"
    target.write_text("old")
    target.chmod(0o640)
    link.symlink_to(target)
    with atomic_file(link) as temporary:
        temporary.write_text("new")
    assert link.is_symlink()
    assert target.read_text() == "new"
    assert stat.S_IMODE(target.stat().st_mode) == 0o640


def test_new_files_follow_the_umask(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        with atomic_file(tmp_path / "a") as temporary:
            temporary.write_text("new")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o640


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit, ValueError])
def test_errors_pass_and_leave_no_trace(tmp_path: Path, error: type[BaseException]) -> None:
    target = tmp_path / "a.npz"
    target.write_text("old")
    with pytest.raises(error), atomic_file(target) as temporary:
        temporary.write_text("new")
        raise error
    with pytest.raises(error), atomic_files(tmp_path / "a_#.obj") as folder:
        (folder / "a_1.obj").write_text("new")
        raise error
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_the_file_reaches_the_disk_before_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    steps: list[str] = []
    fsync, replace = os.fsync, Path.replace

    def log_fsync(descriptor: int) -> None:
        steps.append("folder" if stat.S_ISDIR(os.fstat(descriptor).st_mode) else "file")
        fsync(descriptor)

    def log_replace(self: Path, target: Path) -> Path:
        steps.append("rename")
        return replace(self, target)

    monkeypatch.setattr(os, "fsync", log_fsync)
    monkeypatch.setattr(Path, "replace", log_replace)
    with atomic_file(tmp_path / "a") as temporary:
        temporary.write_text("new")
    assert steps == ["file", "rename", "folder"]
    steps.clear()
    with atomic_files(tmp_path / "a_#") as folder:
        for number in (1, 2):
            (folder / f"a_{number}").write_text("new")
    assert steps == ["file", "file", "rename", "rename", "folder"]


def listed(folder: Path) -> dict[str, str]:
    return {str(file.relative_to(folder)): file.read_text() for file in folder.rglob("*") if file.is_file()}


def test_files_in_a_folder_are_replaced_and_what_others_put_there_stays(tmp_path: Path) -> None:
    target = tmp_path / "a.vat"
    for text in ("first", "second"):
        with atomic_folder(target, {"one", "two"}) as folder:
            (folder / ("one" if text == "first" else "two")).write_text(text)
        (target / "deep").mkdir(exist_ok=True)
        (target / "deep" / "notes").write_text("mine")
        (target / "one.import").write_text("mine")
    assert listed(tmp_path) == {"a.vat/two": "second", "a.vat/deep/notes": "mine", "a.vat/one.import": "mine"}


def test_a_folder_stays_the_same_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So whoever is in it sees the new files, and what is added while they are written is not lost."""
    target = tmp_path / "a.vat"
    target.mkdir()
    for name in ("one", "two", "mine"):
        (target / name).write_text("old")
    before = [(each, each.stat().st_ino) for each in (target, target / "mine")]
    monkeypatch.chdir(target)
    with atomic_folder(target, {"one", "two"}) as folder:
        (folder / "one").write_text("new")
        (target / "one.meta").write_text("an engine's")
        assert listed(target) == {"one": "old", "two": "old", "mine": "old", "one.meta": "an engine's"}
    assert listed(Path()) == {"one": "new", "mine": "old", "one.meta": "an engine's"}
    assert [(each, each.stat().st_ino) for each, _ in before] == before
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_a_folder_stays_as_it_was_after_an_error(tmp_path: Path, error: type[BaseException]) -> None:
    target = tmp_path / "a.vat"
    with pytest.raises(error), atomic_folder(target, {"one"}) as folder:
        (folder / "one").write_text("new")
        raise error
    assert list(tmp_path.iterdir()) == []
    target.mkdir()
    (target / "one").write_text("old")
    with pytest.raises(error), atomic_folder(target, {"one"}) as folder:
        (folder / "one").write_text("new")
        raise error
    assert listed(tmp_path) == {"a.vat/one": "old"}


@pytest.mark.parametrize("refused", ["old/one", "new/one", "old/three", "new/three", "old/two"])
def test_files_in_a_folder_go_back_if_one_cannot_take_its_place(
    refused: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "a.vat"
    target.mkdir()
    for name in ("one", "two", "three", "mine"):
        (target / name).write_text("old")
    rename = Path.rename
    kind, refused_name = refused.split("/")
    asked: list[Path] = []

    def refuse(self: Path, to: Path) -> Path:
        if self.name == refused_name and (self.parent == target) == (kind == "old") and not asked:
            asked.append(self)
            raise PermissionError(13, "no")
        return rename(self, to)

    monkeypatch.setattr(Path, "rename", refuse)
    with (
        pytest.raises(OutputError, match=r"cannot write .*a\.vat: Permission denied; choose"),
        atomic_folder(target, {"one", "two", "three"}) as folder,
    ):
        for name in ("one", "three"):
            (folder / name).write_text("new")
    assert asked
    assert listed(tmp_path) == {f"a.vat/{name}": "old" for name in ("one", "two", "three", "mine")}


def test_long_names(tmp_path: Path) -> None:
    with atomic_file(tmp_path / ("ö" * 120)) as temporary:  # 240 of 255 bytes
        temporary.write_text("new")
    with pytest.raises(OutputError, match="too long; choose a shorter name"), atomic_file(tmp_path / ("x" * 300)):
        pass


def test_a_file_for_a_folder(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="does not exist; make it first"), atomic_file(tmp_path / "file" / "a.npz"):
        pass


def test_pipes_sockets_and_links_to_them_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # paths of sockets are short
    (tmp_path / "c").mkdir()
    os.mkfifo("a0")
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind("a1")
    for name in ("a0", "a1"):
        Path(f"b{name[1]}").symlink_to(name)
    for file in map(Path, ("a0", "b0", "a1", "b1")):
        before = file.lstat()
        with pytest.raises(OutputError, match=f"^{file} is a device, a pipe or a socket"), atomic_file(file):
            pytest.fail("the work was begun")
        with pytest.raises(OutputError, match=f"^{file} is a device"), atomic_folder(file, {"one"}):
            pytest.fail("the work was begun")
        with pytest.raises(OutputError, match=f"/{file} is a device"), atomic_files("a#") as temporary:
            for name in ("a", "b", file.name):
                (temporary / name).write_text("new")
        (inner := Path("c", "one")).symlink_to(file.resolve())
        for written in ("one", "two"):  # replaced, or no longer needed
            with pytest.raises(OutputError, match=r"one is a device, .* link to"), atomic_folder("c", {"one"}) as new:
                (new / written).write_text("new")
        inner.unlink()
        assert (file.lstat().st_ino, file.lstat().st_mode) == (before.st_ino, before.st_mode)
    assert {path.name for path in tmp_path.iterdir()} == {"a0", "b0", "a1", "b1", "c"}


def test_links_in_folders_are_replaced_and_what_they_lead_to_stays(tmp_path: Path) -> None:
    (mine := tmp_path / "mine").write_text("mine")
    (folder := tmp_path / "folder").mkdir()
    (folder / "a_1").symlink_to(mine)
    with atomic_files(folder / "a_#") as temporary:
        (temporary / "a_1").write_text("new")
    assert listed(tmp_path) == {"mine": "mine", "folder/a_1": "new"}
    assert not (folder / "a_1").is_symlink()


# The limit of memory: one for all readers, told in their errors

FACES = np.array([[0, 1, 2]])


@pytest.mark.parametrize(("machine", "limit"), [(4e9, 2e9), (64e9, 8e9)])
def test_default(monkeypatch: pytest.MonkeyPatch, machine: float, limit: float) -> None:
    monkeypatch.delenv(MEMORY_LIMIT_VARIABLE, raising=False)
    monkeypatch.setattr(files, "_machine_memory", lambda: int(machine))
    assert max_memory() == limit


def test_the_call_counts_more_than_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(MEMORY_LIMIT_VARIABLE, "0.5")
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
    monkeypatch.setenv(MEMORY_LIMIT_VARIABLE, "much")
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
    monkeypatch.setattr(isolation, "idle_workers", [])
    monkeypatch.setenv("MIXSEQ_READER_SECONDS", "20")  # some wait forever
    yield
    isolation.close_idle_workers()


@pytest.mark.slow
@pytest.mark.usefixtures("new_workers")
@pytest.mark.parametrize(
    "target", {target.format.reader: target for target in TARGETS}.values(), ids=lambda target: target.file_name
)
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
