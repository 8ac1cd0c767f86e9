"""MP4 by ffmpeg: what it is asked for, what becomes of its answers, and a film of the real one if it is here."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

from mixseq.errors import MissingExtraError, OutputError
from mixseq.pictures.film import FilmSettings, film
from mixseq.pictures.film_encoding import check_film
from mixseq.pictures.scene import SceneItem
from mixseq.runtime.parallel import serial_executor, thread_executor
from mixseq.sequence.sequence import MeshSequence

pytest.importorskip("PIL.Image")
pytest.importorskip("matplotlib")

SETTINGS = FilmSettings(size=(96, 64), fps=24000 / 1001)
Fake = Callable[[str, str], None]

WRITES = """
data = sys.stdin.buffer.read()
with open(sys.argv[-1], "w") as file:
    json.dump({"arguments": sys.argv[1:-1], "bytes": len(data)}, file)
"""
FAILS = """
sys.stdin.buffer.read(100)
sys.exit("no room\\nsomething that follows from it")
"""


@pytest.fixture
def fake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Fake:
    """Puts a program called ffmpeg on the PATH, which has an encoder and does something with frames."""

    def make(encoder: str, what: str) -> None:
        folder = tmp_path / "bin"
        folder.mkdir()
        program = folder / "ffmpeg"
        program.write_text(
            f"#!{sys.executable}\nimport json, sys\n"
            f'if "-encoders" in sys.argv:\n    print(" V....D {encoder} some words")\n    sys.exit(0)\n{what}'
        )
        program.chmod(0o755)
        monkeypatch.setenv("PATH", str(folder))

    return make


def test_frames_are_piped_to_ffmpeg(gem: MeshSequence, tmp_path: Path, fake: Fake) -> None:
    fake("libx264", WRITES)
    film(tmp_path / "a.mp4", [SceneItem("", gem)], SETTINGS)
    said = json.loads((tmp_path / "a.mp4").read_text())
    assert said["bytes"] == 9 * 96 * 64 * 3
    words = said["arguments"]
    pairs = dict(pairwise(words))
    assert (pairs["-video_size"], pairs["-framerate"], pairs["-i"]) == ("96x64", "24000/1001", "pipe:0")
    assert (pairs["-c:v"], pairs["-crf"], pairs["-movflags"]) == ("libx264", "18", "+faststart")
    assert "yuv420p" in words
    assert pairs["-threads"] == "1"  # else the bytes would depend on the machine


def test_what_ffmpeg_says_when_it_fails(gem: MeshSequence, tmp_path: Path, fake: Fake) -> None:
    fake("libx264", FAILS)
    target = tmp_path / "a.mp4"
    target.write_text("old")
    with pytest.raises(OutputError, match="ffmpeg cannot write the film: no room"):
        film(target, [SceneItem("", gem)], SETTINGS)
    assert target.read_text() == "old"
    assert {path.name for path in tmp_path.iterdir()} == {"a.mp4", "bin"}


def test_ffmpeg_is_ended_when_drawing_fails(
    gem: MeshSequence, tmp_path: Path, fake: Fake, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake("libx264", WRITES)
    begun: list[subprocess.Popen[bytes]] = []

    def watched(*args: object, **settings: object) -> subprocess.Popen[bytes]:
        begun.append(original(*args, **settings))  # type: ignore[call-overload]
        return begun[-1]

    def fail_late(done: int, total: int, what: str) -> None:
        if what == "drawing frames" and done == 5:
            raise KeyboardInterrupt

    original = subprocess.Popen
    monkeypatch.setattr("mixseq.pictures.film_encoding.subprocess.Popen", watched)
    with pytest.raises(KeyboardInterrupt):
        film(tmp_path / "a.mp4", [SceneItem("", gem)], SETTINGS, progress=fail_late)
    assert begun[-1].returncode is not None
    assert [path.name for path in tmp_path.iterdir()] == ["bin"]


def test_no_ffmpeg(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(MissingExtraError, match=r"is not on the PATH; install it .* \.webp or \.gif"):
        check_film("mp4", (64, 64))


def test_an_ffmpeg_without_h264(fake: Fake) -> None:
    fake("libx265", FAILS)
    with pytest.raises(MissingExtraError, match=r"MP4 needs the encoder libx264, and .*ffmpeg has none"):
        check_film("mp4", (64, 64))


def test_an_ffmpeg_that_does_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "ffmpeg"
    program.write_text("this is no program")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(MissingExtraError, match="ffmpeg does not run"):
        check_film("mp4", (64, 64))


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="there is no ffmpeg here")
def test_a_film_of_the_real_one(gem: MeshSequence, tmp_path: Path) -> None:
    for name, workers in (("one", serial_executor), ("three", thread_executor(3))):
        film(tmp_path / f"{name}.mp4", [SceneItem("gem", gem)], SETTINGS, workers=workers)
    data = (tmp_path / "one.mp4").read_bytes()
    assert data == (tmp_path / "three.mp4").read_bytes()
    assert b"avc1" in data
    assert data.index(b"moov") < data.index(b"mdat")  # it plays while it is loaded
