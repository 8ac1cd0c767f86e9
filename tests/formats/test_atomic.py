"""Files appear whole or not at all."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from mixseq.errors import OutputError
from mixseq_io.files import replacing, replacing_folder, replacing_many


def test_the_file_appears_at_the_end(tmp_path: Path) -> None:
    target = tmp_path / "a.usdc"
    with replacing(target) as temporary:
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
    with replacing(link) as temporary:
        temporary.write_text("new")
    assert link.is_symlink()
    assert target.read_text() == "new"
    assert stat.S_IMODE(target.stat().st_mode) == 0o640


def test_new_files_follow_the_umask(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        with replacing(tmp_path / "a") as temporary:
            temporary.write_text("new")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o640


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit, ValueError])
def test_errors_pass_and_leave_no_trace(tmp_path: Path, error: type[BaseException]) -> None:
    target = tmp_path / "a.npz"
    target.write_text("old")
    with pytest.raises(error), replacing(target) as temporary:
        temporary.write_text("new")
        raise error
    with pytest.raises(error), replacing_many(tmp_path / "a_#.obj") as folder:
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
    with replacing(tmp_path / "a") as temporary:
        temporary.write_text("new")
    assert steps == ["file", "rename", "folder"]
    steps.clear()
    with replacing_many(tmp_path / "a_#") as folder:
        for number in (1, 2):
            (folder / f"a_{number}").write_text("new")
    assert steps == ["file", "file", "rename", "rename", "folder"]


def listed(folder: Path) -> dict[str, str]:
    return {str(file.relative_to(folder)): file.read_text() for file in folder.rglob("*") if file.is_file()}


def test_files_in_a_folder_are_replaced_and_what_others_put_there_stays(tmp_path: Path) -> None:
    target = tmp_path / "a.vat"
    for text in ("first", "second"):
        with replacing_folder(target, {"one", "two"}) as folder:
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
    with replacing_folder(target, {"one", "two"}) as folder:
        (folder / "one").write_text("new")
        (target / "one.meta").write_text("an engine's")
        assert listed(target) == {"one": "old", "two": "old", "mine": "old", "one.meta": "an engine's"}
    assert listed(Path()) == {"one": "new", "mine": "old", "one.meta": "an engine's"}
    assert [(each, each.stat().st_ino) for each, _ in before] == before
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_a_folder_stays_as_it_was_after_an_error(tmp_path: Path, error: type[BaseException]) -> None:
    target = tmp_path / "a.vat"
    with pytest.raises(error), replacing_folder(target, {"one"}) as folder:
        (folder / "one").write_text("new")
        raise error
    assert list(tmp_path.iterdir()) == []
    target.mkdir()
    (target / "one").write_text("old")
    with pytest.raises(error), replacing_folder(target, {"one"}) as folder:
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
        replacing_folder(target, {"one", "two", "three"}) as folder,
    ):
        for name in ("one", "three"):
            (folder / name).write_text("new")
    assert asked
    assert listed(tmp_path) == {f"a.vat/{name}": "old" for name in ("one", "two", "three", "mine")}


def test_long_names(tmp_path: Path) -> None:
    with replacing(tmp_path / ("ö" * 120)) as temporary:  # 240 of 255 bytes
        temporary.write_text("new")
    with (
        pytest.raises(OutputError, match="too long; choose a shorter name"),
        replacing(tmp_path / ("x" * 300)),
    ):
        pass


def test_a_file_for_a_folder(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with (
        pytest.raises(OutputError, match="does not exist; make it first"),
        replacing(tmp_path / "file" / "a.npz"),
    ):
        pass
