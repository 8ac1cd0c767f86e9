"""``mixseq plot``: pictures of every kind, and one line about what goes wrong."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest

import mixseq
from mixseq.choices import PICTURES
from mixseq.errors import MissingExtraError
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.fitting import fit
from tests.cli.conftest import Contents, Run

pytestmark = pytest.mark.slow


pytest.importorskip("matplotlib")


@pytest.mark.parametrize("kind", PICTURES)
def test_one_picture(run: Run, kind: str) -> None:
    against = ("--against", "bar.usdc") if kind.startswith("error") else ()
    if kind == "values":
        np.savetxt("values.txt", np.arange(77))
        against = ("--scalar", "values.txt")
    result = run("plot", "model.h5", "new.svg", "--kind", kind, *against)
    assert (result.exit_code, result.stderr) == (0, "")
    assert re.fullmatch(r"wrote new\.svg \(.* kB\)\n", result.stdout)
    assert b"<svg" in Path("new.svg").read_bytes()


def test_everything_on_one_page(run: Run) -> None:
    result = run("plot", "model.h5", "old.PNG", "--against", "bar.npz", "--tolerance", "0.001", "-q")
    assert (result.exit_code, result.stderr) == (0, "")
    assert Path("old.PNG").read_bytes().startswith(b"\x89PNG")


def test_the_same_input_gives_the_same_file(run: Run) -> None:
    for name in ("one.svg", "two.svg"):
        assert run("plot", "model.h5", name, "--kind", "embedding", "--frames", "0,2").exit_code == 0
    assert Path("one.svg").read_bytes() == Path("two.svg").read_bytes()


def test_a_sequence_is_drawn_as_its_model(run: Run) -> None:
    assert run("plot", "bar.npz", "new.svg", "--kind", "embedding").exit_code == 0
    assert Path("new.svg").read_text(encoding="utf-8").startswith("<?xml")


def test_reader_options_are_for_the_original(run: Run) -> None:
    arguments = ("plot", "model.h5", "new.png", "--kind", "error-frames", "--against", "bar.npz")
    assert run(*arguments, "--input-fps", "10").exit_code == 0


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("plot none.h5 new.png", "none.h5 does not exist"),
        ("plot cut_model.h5 new.png", "cut_model.h5"),
        ("plot model.h5 new.pdf", "new.pdf: pictures are PNG or SVG files; end the name in .png or .svg"),
        ("plot none.h5 new", "new: pictures are PNG or SVG files"),
        ("plot model.h5 nowhere/new.png", "nowhere does not exist; make it first"),
        ("plot model.h5 new.png --kind pie", "--kind.*'pie' is not one of 'embedding'"),
        ("plot model.h5 new.png --kind error-frames", "error-frames needs the original"),
        ("plot model.h5 new.png --tolerance 1", "tolerance needs the original"),
        ("plot model.h5 new.png --tolerance 0 --against bar.npz", "--tolerance.*0.* is not a length above 0"),
        ("plot model.h5 new.png --kind parts --against bar.npz", "against is for .* not for parts"),
        ("plot model.h5 new.png --against none.npz", "none.npz.* does not exist"),
        ("plot model.h5 new.png --against other.npz", "errors need the same topology"),
        ("plot model.h5 new.png --frames 0;1", "--frames.*'0;1' is not a range of frames such as 1005-1010"),
        ("plot model.h5 new.png --frames 0.5", "--frames.*'0.5' is not a range of frames"),
        ("plot model.h5 new.png --frames 4", "there is no frame 4; frames are 0 to 3"),
        (
            "plot model.h5 new.png --frames 1 --kind parts",
            "frames is for embedding and error-vertices and values, not for parts",
        ),
        ("plot model.h5 new.png --input-fps 10", "are for reading a sequence; give --against"),
        ("plot model.h5 new.png --against bar.usdc --prim /none", "/none"),
        ("plot", "Missing argument 'MODEL'.*see mixseq plot --help"),
        ("plot model.h5", "Missing argument 'TARGET'"),
        ("plot model.h5 bar.npz new.png", "new.png is one file too many"),
        ("plot model.h5 new.png --turn 90", "--turn is about films; give --video"),
        ("plot model.h5 new.png --kind embedding --camera 0,0", "camera is for parts and error-vertices"),
        ("plot model.h5 new.png --camera 0,nan", "the camera is at"),
        ("plot model.h5 new.png --kind values", "values needs numbers of the vertices; give values .--scalar"),
        ("plot model.h5 new.png --scalar bar.npz", "bar.npz"),
        ("plot --video new.gif bar.npz --colour values", "give --scalar"),
        ("plot model.h5 new.png --follow", "--follow is about films; give --video"),
        ("plot --video new.gif bar.npz --camera 30", "--camera.*'30' is no angle and height such as 30,15"),
        ("plot model.h5 new.png --fps 30", "--fps is about films; give --video"),
        ("plot --video new.gif", "Missing argument 'FILES...'"),
        ("plot --video new.avi bar.npz", "films are MP4, GIF or WebP files; end the name in .mp4"),
        ("plot --video nowhere/new.gif bar.npz", "nowhere does not exist; make it first"),
        ("plot --video new.gif none.npz", "none.npz.* does not exist"),
        ("plot --video new.gif model.h5 none.h5", "none.h5 does not exist"),
        ("plot --video new.gif cut_model.h5", "cut_model.h5"),
        ("plot --video new.gif bar.npz --kind parts", "--kind is about pictures"),
        ("plot --video new.gif bar.npz --frames 1", "--frames is about pictures"),
        ("plot --video new.gif bar.npz --tolerance 1", "--tolerance is about pictures"),
        ("plot --video new.gif bar.npz --size 640", "--size.*'640' is not a size such as 1280x720"),
        ("plot --video new.mp4 bar.npz --size 641x480", "MP4 needs even numbers"),
        ("plot --video new.gif bar.npz --fps 60", "too many for GIF"),
        ("plot --video new.gif bar.npz --seconds 0", "the duration is 0.0"),
        ("plot --video new.gif bar.npz --seconds 1e9", "a film has 2 to 100,000"),
        ("plot --video new.gif bar.npz --colour parts", "bar has no parts"),
        ("plot --video new.gif bar.npz --colour error", "needs the original"),
        ("plot --video new.gif bar.npz --against bar.usdc", "only the colour error needs the original"),
        ("plot --video new.gif model.h5 --colour error --against other.npz", "errors need the same topology"),
        ("plot --video new.gif bar.npz --names a,b", "--names has 2 names for 1 files"),
        ("plot --video new.gif bar.npz --prim /none", "none of the files is read with an option 'prim'"),
    ],
)
def test_failure(run: Run, contents: Contents, line: str, message: str) -> None:
    before = contents()
    result = run(*line.split())
    assert (result.exit_code, result.stdout) == (2, ""), result.output
    assert re.fullmatch(f"mixseq: error: .*{message}.*\n", result.stderr), result.stderr
    assert contents() == before


def test_a_source_is_not_overwritten(run: Run, contents: Contents, folder: Path) -> None:
    for name, source in (("model.png", "model.h5"), ("bar.svg", "bar.npz")):
        (folder / name).symlink_to(folder / source)
    before = contents()
    assert "is the source itself" in run("plot", "model.h5", "model.png").stderr
    assert "is the source itself" in run("plot", "model.h5", "bar.svg", "--against", "bar.npz").stderr
    assert contents() == before


@pytest.mark.parametrize(
    ("line", "start"),
    [
        ("new.gif bar.npz", b"GIF89a"),
        ("old.webp bar.usdc model.h5 --names=one,two --turn 90 --seconds 0.5 -q", b"RIFF"),
        ("new.gif model.h5 bar.npz --colour parts --fps 20", b"GIF89a"),
        ("new.gif model.h5 --colour error --against bar.usdc --scale 0.01", b"GIF89a"),
        ("new.gif bar.npz --scalar numbers.npy", b"GIF89a"),
        ("new.gif bar_sequence.h5 --colour strain --up-axis Z --camera -30,10 --follow", b"GIF89a"),
    ],
)
def test_films(run: Run, line: str, start: bytes) -> None:
    np.save("numbers.npy", np.arange(4 * 77).reshape(4, 77))
    result = run("plot", "--size", "96x64", "--video", *line.split())
    assert (result.exit_code, result.stderr) == (0, "")
    name = line.split()[0]
    assert re.fullmatch(rf"wrote {name} \(.* (kB|bytes)\)\n", result.stdout)
    assert Path(name).read_bytes().startswith(start)


def test_a_film_does_not_replace_what_it_shows(run: Run, contents: Contents, folder: Path) -> None:
    (folder / "bar.gif").symlink_to(folder / "bar.npz")
    before = contents()
    assert "is the source itself" in run("plot", "--video", "bar.gif", "bar.npz").stderr
    assert contents() == before


def test_vertex_models_have_no_parts(run: Run, bent_bar: MeshSequence) -> None:
    mixseq.save("vertex.h5", fit(bent_bar, rank=1, space="vertex"))
    result = run("plot", "vertex.h5", "new.png", "--kind", "parts")
    assert result.exit_code == 2
    assert "the vertex space has no parts" in result.stderr
    assert not Path("new.png").exists()
    assert run("plot", "vertex.h5", "new.png").exit_code == 0


def test_without_matplotlib(run: Run, contents: Contents, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> NoReturn:
        raise MissingExtraError("pictures need matplotlib; get it with: pip install 'mixseq[plot]'")

    monkeypatch.setattr("mixseq.pictures.charts.import_matplotlib", missing)
    before = contents()
    result = run("plot", "model.h5", "new.png")
    assert (result.exit_code, result.stdout) == (2, "")
    assert "pip install 'mixseq[plot]'" in result.stderr
    assert contents() == before


def test_an_error_while_writing(run: Run, contents: Contents, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> NoReturn:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("mixseq_io.files._flush", full)
    before = contents()
    result = run("plot", "model.h5", "new.png", "--kind", "embedding")
    assert result.exit_code == 2
    assert re.search("cannot write .*No space left on device; free some space", result.stderr)
    assert contents() == before
