"""Compressed models as .glb on the command line: made, told about, and taken by every command that opens models."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

import mixseq
from mixseq_io.model_files import read_container
from tests.cli.conftest import Run, succeed
from tests.cli.test_compress import rows

pytestmark = pytest.mark.slow


@pytest.fixture
def glb(made_once: Callable[..., Path]) -> Path:
    return made_once("encode", "bar.npz", "small.glb", "--max-error", "0.001", "--still", "plain", "-q")


def test_encode_to_an_error(run: Run) -> None:
    text = succeed(run("encode", "bar.usdc", "new.glb", "--max-error", "0.001", "--set", "still=plain", "--check"))
    table = rows(text)
    assert "first frame and" in table["of it"]
    assert float(table["max error"].partition(" ")[0]) <= 0.001
    assert "wrote new.glb (" in text
    found = mixseq.verify("new.glb", mixseq.read("bar.usdc"))
    assert found.holds and found.promised


@pytest.mark.parametrize("still", ["plain", "none"])
def test_encode_to_a_size(run: Run, still: str) -> None:
    size = {"plain": 14_000, "none": 4_000}[still]
    succeed(run("encode", "bar.npz", "new.glb", "--size", str(size), "--still", still))
    assert 0.5 * size < Path("new.glb").stat().st_size <= size
    assert mixseq.verify("new.glb", mixseq.read("bar.npz")).holds
    refused = run("encode", "bar.npz", "new.glb", "--size", "900", "--still", still)
    assert refused.exit_code == 2
    cure = "" if still == "none" else "leave out the first frame (--still none), or "
    assert f"by the container; {cure}give more" in refused.stderr


def test_compressed_models_become_glb_as_they_are(run: Run) -> None:
    succeed(run("encode", "bar.npz", "small.h5", "--max-error", "0.001", "-q"))
    succeed(run("encode", "small.h5", "new.glb", "--still", "none"))
    assert read_container(Path("new.glb")) == read_container(Path("small.h5"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("bar.npz new.glb", r"a .glb holds compressed models; give --max-error, --kg or --size, too"),
        ("anchored.h5 new.glb", "anchored.h5 is not a compressed model; make one with mixseq encode --max-error"),
        ("bar.npz new.h5 --max-error 0.001 --still none", "--still is for .glb files; leave it out"),
        ("bar.npz new.obj --max-error 0.001", "end the name in .h5 or .hdf5, or in .glb for the web"),
    ],
)
def test_what_cannot_be_is_refused(run: Run, bar_model: mixseq.Model, arguments: str, message: str) -> None:
    mixseq.save("anchored.h5", bar_model)
    refused = run("encode", *arguments.split())
    assert refused.exit_code == 2
    assert message in refused.stderr
    assert refused.stderr.count("\n") == 1
    assert not Path("new.glb").exists()


def test_info_and_verify(run: Run, glb: Path) -> None:
    facts = json.loads(succeed(run("info", "small.glb", "--json")))
    assert (facts["kind"], facts["coding"]["promised"]) == ("model", True)
    sizes = facts["bytes"]
    parts = ("connectivity", "signals", "still", "container")
    assert sizes["total"] == sum(sizes[part] for part in parts) == glb.stat().st_size
    assert rows(succeed(run("verify", "small.glb", "bar.npz")))["bound holds"] == "yes"
    data = bytearray(glb.read_bytes())
    data[data.index(b"msq1") + 200] ^= 1
    glb.write_bytes(data)
    refused = run("verify", "small.glb")
    assert refused.exit_code == 2
    assert "damaged" in refused.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        "compare bar.npz small.glb",
        "convert small.glb new.npz",
        "decode small.glb new.npz --fps 48",
        "resample small.glb new.h5 --fps 20",
        "plot small.glb new.png",
        "encode small.glb new.h5 --exact",
        "encode small.glb new.h5 --kg 1",
        "interpolate small.glb new.npz --pose 0 --pose 3 --steps 3",
        "segment small.glb new.npz --parts 3 --no-picture",
        "view small.glb --export new.html",
    ],
)
def test_other_commands_take_them(run: Run, glb: Path, arguments: str) -> None:
    result = run(*arguments.split())
    assert result.exit_code == 0, result.output


def test_edits_take_them(run: Run, glb: Path) -> None:
    Path("edit.toml").write_text('[[edit]]\noperation = "reverse"\n')
    succeed(run("edit", "small.glb", "new.h5", "--script", "edit.toml", "-q"))
    first, last = mixseq.load("new.h5").sample().points[[0, -1]]
    points = mixseq.load("small.glb").sample().points
    assert abs(first - points[-1]).max() < 2e-3 * mixseq.read("bar.npz").diagonal
    assert abs(last - points[0]).max() < 2e-3 * mixseq.read("bar.npz").diagonal


def test_a_batch_leaves_them_alone(run: Run, glb: Path) -> None:
    Path("caches").mkdir()
    glb.rename("caches/small.glb")
    Path("bar.npz").rename("caches/bar.npz")
    result = run("batch", "encode", "caches", "--out", "models")
    assert result.exit_code == 0, result.output
    assert [path.name for path in Path("models").glob("*.h5")] == ["bar.h5"]
