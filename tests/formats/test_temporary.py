"""Temporary names, and what becomes of those whose writer was killed."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from mixseq_io import files
from mixseq_io.files import atomic_file, atomic_files, backup_path, temporary_prefix

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="there are no locks")


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def killed_while_writing(folder: Path) -> None:
    """Let a process die in the middle of a file, of many, and while it replaces a folder."""
    child = os.fork()
    if not child:
        with (
            atomic_file(folder / "a.npz") as file,
            atomic_files(folder / "a_#.obj") as many,
            temporary_prefix(folder) as name,
        ):
            file.write_text("half")
            (many / "a_1.obj").write_text("half")
            (folder / "clips").rename(backup_path(name, folder / "clips"))
            os._exit(0)  # as of SIGKILL: nothing is cleaned up
    os.waitpid(child, 0)


def test_the_next_writer_clears_what_a_killed_one_left(tmp_path: Path) -> None:
    (tmp_path / "a.npz").write_text("old")
    (tmp_path / "clips").mkdir()
    (tmp_path / "clips" / "1.usdc").write_text("old")
    (tmp_path / ".mixseq.txt").write_text("somebody's")
    killed_while_writing(tmp_path)
    assert len(names(tmp_path)) == 8  # the two that are left, three locks and what they are for
    with atomic_file(tmp_path / "b.npz") as file:
        file.write_text("new")
    assert names(tmp_path) == [".mixseq.txt", "a.npz", "b.npz", "clips"]
    assert (tmp_path / "a.npz").read_text() == "old"
    assert (tmp_path / "clips" / "1.usdc").read_text() == "old"


def test_what_is_being_written_is_left_alone(tmp_path: Path) -> None:
    with atomic_file(tmp_path / "a.npz") as one:
        one.write_text("new")
        with atomic_files(tmp_path / "b_#.obj") as many:
            (many / "b_1.obj").write_text("new")
            with atomic_file(tmp_path / "c.npz") as other:
                other.write_text("new")
    assert names(tmp_path) == ["a.npz", "b_1.obj", "c.npz"]


@pytest.mark.parametrize("name", ["another.01234567.usdc", "another.01234567.lock"])
def test_those_of_other_hosts_are_cleared_when_they_are_old(tmp_path: Path, name: str) -> None:
    left = tmp_path / f".mixseq.{name}"
    left.mkdir()
    (left / "1.obj").touch()
    files.delete_leftovers(tmp_path)
    assert left.exists()
    long_ago = time.time() - 25 * 3600
    os.utime(left, (long_ago, long_ago))
    files.delete_leftovers(tmp_path)
    assert left.exists()  # what is in it is new
    os.utime(left / "1.obj", (long_ago, long_ago))
    files.delete_leftovers(tmp_path)
    assert not left.exists()


def test_file_systems_without_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError("no locks")

    monkeypatch.setattr("fcntl.flock", refuse)
    (tmp_path / "clips").mkdir()
    killed_while_writing(tmp_path)
    with atomic_file(tmp_path / "b.npz") as file:
        file.write_text("new")
    assert len(names(tmp_path)) == 7  # they may be somebody's
    for path in tmp_path.rglob(".mixseq*"):
        for each in (path, *path.rglob("*")):
            os.utime(each, (0, 0))
    files.delete_leftovers(tmp_path)
    assert names(tmp_path) == ["b.npz", "clips"]


def test_a_name_that_another_takes_away_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lock, tries = files._try_lock, []

    def too_late(descriptor: int) -> bool | None:
        tries.append(descriptor)
        if len(tries) < 3:  # once before we lock it, once after
            next(tmp_path.glob("*.lock")).unlink()
        return lock(descriptor) if len(tries) > 1 else False

    monkeypatch.setattr(files, "_try_lock", too_late)
    monkeypatch.setattr(files, "delete_leftovers", lambda _: None)
    with temporary_prefix(tmp_path) as name:
        assert Path(f"{name}.lock").exists()
    assert len(tries) == 3
