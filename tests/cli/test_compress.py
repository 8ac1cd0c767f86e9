"""Compressed models on the command line: encode, info, decode, verify, and every other command that opens models."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import pytest

import mixseq
from mixseq.cli.group import as_bytes
from mixseq.mesh.surface import CornerValues
from mixseq.sequence.sequence import MeshSequence
from mixseq_io.coded.streams import Stream, StreamIndex, read_index
from mixseq_io.model_files import read_compressed
from tests.cli.conftest import Contents, Run, succeed
from tests.compression.encoder.test_numbering import shuffled
from tests.meshes import bar

pytestmark = pytest.mark.slow


def rows(text: str) -> dict[str, str]:
    return {name: value.strip() for name, _, value in (line.partition("  ") for line in text.splitlines()) if value}


@pytest.fixture
def small(made_once: Callable[..., Path]) -> Path:
    return made_once("encode", "bar.npz", "small.h5", "--max-error", "0.001", "-q")


@pytest.mark.parametrize("before", [None, "2"])
def test_threads_are_as_many_as_were_asked_for(
    run: Run, small: Path, before: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also of what is given no executor, as long as the command runs; files are the same."""
    monkeypatch.delenv("MIXSEQ_THREADS", raising=False)
    if before is not None:
        monkeypatch.setenv("MIXSEQ_THREADS", before)
    asked = []

    def count() -> int:
        asked.append(os.environ["MIXSEQ_THREADS"])
        return 3

    monkeypatch.setattr("mixseq.runtime.parallel.thread_count", count)
    Path("edits.toml").write_text('[[edit]]\noperation = "reverse"\n')
    for arguments in (
        "encode bar.npz again.h5 --max-error 0.001",
        "decode small.h5 again.npz",
        "decode small.h5 again.vat",
        "decode small.h5 again.glb --as morph",
        "edit small.h5 edited.npz --script edits.toml",
        "resample small.h5 resampled.npz --fps 20",
        "view small.h5 --export again.html",
    ):
        asked.clear()
        succeed(run(*arguments.split(), "--threads", "3", "-q"))
        assert set(asked) == {"3"}, arguments
        assert os.environ.get("MIXSEQ_THREADS") == before
    assert (small.parent / "again.h5").read_bytes() == small.read_bytes()


def damage(path: Path, stream: Callable[[StreamIndex], Stream]) -> None:
    """Flip a bit in the middle of a stream."""
    import h5py

    from mixseq_io.model_files import read_container

    chosen = stream(read_index(path, read_container(path)))
    with h5py.File(path) as file:
        at = file["streams"].id.get_offset() + chosen.start + chosen.size // 2
    data = bytearray(path.read_bytes())
    data[at] ^= 1
    path.write_bytes(data)


# encode ---------------------------------------------------------------------------------------------------


def test_encode_to_an_error(run: Run, bent_bar: MeshSequence) -> None:
    text = succeed(run("encode", "bar.npz", "new.h5", "--max-error", "0.001"))
    table = rows(text)
    assert table["signals"].endswith("bits per vertex and frame")
    assert table["total"].endswith("bits per vertex and frame")
    assert table["max error"].startswith("at most 0.001 diagonals (")
    assert table["KG error"].endswith(" %")
    assert table["time"].endswith(" s")
    assert text.splitlines()[-1].startswith("wrote new.h5 (")
    assert mixseq.compare(bent_bar, mixseq.load("new.h5").sample()).max_error <= 0.001


def test_encode_to_an_error_and_check(run: Run) -> None:
    table = rows(succeed(run("encode", "bar.usdc", "old.h5", "--max-error", "0.0001", "--check")))
    error, _, rest = table["max error"].partition(" ")
    assert 0 < float(error) <= 0.0001
    assert re.match(r"diagonals \(\S+ mm\), in frame ", rest)


@pytest.mark.parametrize("target", ["shot.h5", "shot.glb"])
def test_cuts_are_kept_and_listed(run: Run, target: str) -> None:
    walk = bar(5, 13, 12)
    mixseq.write("shot.npz", walk.with_points(walk.points + 9.0 * (np.arange(12) > 6)[:, None, None]))
    for options, text in (("", "cut between 6 and 7"), ("--cuts 3,9", "cut between 2 and 3; 8 and 9")):
        arguments = f"encode shot.npz {target} --max-error 1e-3 --no-inbetweens --overwrite {options}"
        assert rows(succeed(run(*arguments.split())))["motion"] == text
        assert rows(succeed(run("info", target)))["motion"] == text


def test_encode_to_a_kg_error(run: Run) -> None:
    succeed(run("encode", "bar.npz", "new.h5", "--kg", "0.5"))
    assert mixseq.verify("new.h5", mixseq.read("bar.npz")).kg_percent == pytest.approx(0.5, rel=0.2)


def test_encode_to_a_size(run: Run) -> None:
    succeed(run("encode", "bar.npz", "new.h5", "--size", "3kB"))
    assert Path("new.h5").stat().st_size <= 3000
    found = mixseq.verify("new.h5", mixseq.read("bar.npz"))
    assert found.holds
    assert not found.promised


def test_encode_in_an_order_of_our_own(run: Run) -> None:
    """The numbers of vertices are other ones, and the original is compared all the same."""
    mixseq.write("mixed.npz", shuffled(bar(8, 25)))
    table = rows(succeed(run("encode", "mixed.npz", "new.h5", "--kg", "0.5", "--order", "free", "--check")))
    assert table["order"] == "vertices and faces have other numbers than the original's"
    succeed(run("encode", "mixed.npz", "kept.h5", "--kg", "0.5", "--set", "order=keep"))
    assert "order" not in rows(succeed(run("info", "kept.h5")))
    facts = [json.loads(succeed(run("info", file, "--json"))) for file in ("new.h5", "kept.h5")]
    assert [each["coding"]["order"] for each in facts] == ["free", "keep"]
    assert facts[0]["bytes"]["connectivity"] < facts[1]["bytes"]["connectivity"] / 5
    assert rows(succeed(run("verify", "new.h5", "mixed.npz")))["bound holds"] == "yes"
    succeed(run("decode", "new.h5", "again.npz"))
    for other in ("new.h5", "again.npz"):
        found = json.loads(succeed(run("compare", "mixed.npz", other, "--json")))
        assert found["kg_percent"] == pytest.approx(0.5, rel=0.2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--max-error 0.001 --kg 1", "give one of --max-error and --kg, not 2"),
        ("--max-error 0.001 --kg 1 --size 1MB", "give one of --max-error and --kg and --size, not 3"),
        ("--max-error 0", "--max-error.*0.* is not a length above 0"),
        ("--kg -1", "--kg.*-1.* is not in the range"),
        ("--size lots", "--size.*'lots' is not a size such as 2MB, 500kB or 1.5MiB"),
        ("--size 0MB", "'0MB' is not a size"),
        (
            "--kg 1 --tolerance 0.1",
            "--tolerance is for models that are not compressed; leave it out, or leave out --kg",
        ),
        ("--max-error 0.1 --exact", "--exact is for models .* leave out --max-error"),
        ("--kg 1 --order any", "'any' is not one of 'keep', 'vertices', 'free'"),
        ("--order free", "--order is for compressed models; give --max-error, --kg or --size, too"),
        ("--size 1MB --rank 3", "--rank is for models"),
        ("--size 1MB --space vertex", "--space is for models"),
        ("--size 1MB --knots 3", "--knots is for models"),
        ("--size 1MB --volume 1", "--volume is for"),
    ],
)
def test_encode_refuses(run: Run, contents: Contents, options: str, message: str) -> None:
    before = contents()
    result = run("encode", "bar.npz", "old.h5", *options.split())
    assert result.exit_code == 2
    assert result.stderr.startswith("mixseq: error: ")
    assert result.stderr.count("\n") == 1
    assert re.search(message, result.stderr), result.stderr
    assert contents() == before


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("2MB", 2_000_000),
        ("500kB", 500_000),
        ("500KB", 500_000),
        ("1.5MiB", 1_572_864),
        ("64 KiB", 65_536),
        ("1gb", 10**9),
        (".5GiB", 2**29),
        ("800", 800),
        ("800B", 800),
    ],
)
def test_sizes(text: str, size: int) -> None:
    assert as_bytes(text) == size


@pytest.mark.parametrize("text", ["", "MB", "-1MB", "1e6", "1.2.3kB", "1TB", "1 iB", "1ki", "0.5", "nan"])
def test_what_is_no_size(text: str) -> None:
    with pytest.raises(click.BadParameter, match="is not a size such as"):
        as_bytes(text)


# info -----------------------------------------------------------------------------------------------------


def test_info(run: Run, small: Path) -> None:
    table = rows(succeed(run("info", "small.h5")))
    assert table["model"] == "bar"
    assert table["max error"].startswith("at most 0.001 diagonals (")
    assert {"signals", "total", "KG error", "history"} <= set(table)
    facts = json.loads(succeed(run("info", "small.h5", "--json")))
    sizes, coding = facts["bytes"], facts["coding"]
    assert sizes["total"] == small.stat().st_size
    assert sizes["total"] == sizes["connectivity"] + sizes["container"] + sizes["signals"]
    assert sizes["container"] < 6000
    assert coding["bits"]["signals"] == pytest.approx(8 * sizes["signals"] / (4 * 77))
    assert coding["bits"]["total"] == pytest.approx(8 * sizes["total"] / (4 * 77))
    assert (coding["max_error"], coding["promised"]) == (0.001, True)
    assert (facts["kind"], facts["vertices"], facts["frames"]) == ("model", 77, 4)


def test_info_of_what_is_not_compressed_says_nothing_of_it(run: Run) -> None:
    facts = json.loads(succeed(run("info", "model.h5", "--json")))
    assert set(facts["bytes"]) == {"total", "frames"}
    assert "coding" not in facts


# decode ----------------------------------------------------------------------------------------------------


def test_decode(run: Run, small: Path, bent_bar: MeshSequence) -> None:
    succeed(run("decode", "small.h5", "new.npz"))
    assert mixseq.compare(bent_bar, mixseq.read("new.npz")).max_error <= 0.001
    succeed(run("decode", "small.h5", "new.h5", "--fps", "20", "--velocities"))
    assert mixseq.read("new.h5").frame_count == 7


def test_damaged_files_are_refused(run: Run, folder: Path) -> None:
    walk = bar(5, 5, 260)  # more than one chunk
    mixseq.save("long.h5", mixseq.compress(walk, max_error=0.01, chunk=128))
    first = read_compressed(Path("long.h5")).chunks[1].first
    damage(Path("long.h5"), lambda index: index.chunks[1].coefficients)
    result = run("decode", "long.h5", "old.npz")
    assert result.exit_code == 2
    assert result.stderr.startswith(f"mixseq: error: long.h5: the coefficients of frames {first} to 259 are damaged; ")
    assert Path("old.npz").read_bytes() == b"somebody's work"


# verify ---------------------------------------------------------------------------------------------------


def test_verify(run: Run, small: Path) -> None:
    table = rows(succeed(run("verify", "small.h5")))
    assert table["intact"] == "4 frames of 77 vertices"
    assert re.fullmatch(r"0\.001 diagonals \(\S+ mm\) from bar\.npz, requested", table["bound"])
    assert table["history"] == "1e-3 from bar.npz"
    table = rows(succeed(run("verify", "small.h5", "bar.npz")))
    assert table["bound holds"] == "yes"
    assert "), of vertex " in table["max error"]
    facts = json.loads(succeed(run("verify", "small.h5", "bar.npz", "--json")))
    assert facts["holds"] is True
    assert 0 < facts["max_error"] <= facts["bound"] == 0.001
    assert succeed(run("verify", "small.h5", "bar.npz", "-q")) == ""
    facts = json.loads(succeed(run("verify", "small.h5", "--json")))
    assert (facts["original"], facts["max_error"], facts["holds"]) == (None, None, True)


def test_verify_says_no(run: Run, small: Path) -> None:
    coded = read_compressed(small)
    mixseq.save(small, replace(coded, parameters=replace(coded.parameters, max_error=1e-9)))
    result = run("verify", "small.h5", "bar.npz")
    assert (result.exit_code, result.stderr) == (1, "")
    assert rows(result.stdout)["bound holds"] == "no"
    result = run("verify", "small.h5", "bar.npz", "--json")
    assert result.exit_code == 1
    assert json.loads(result.stdout)["holds"] is False


def test_verify_finds_damage(run: Run, small: Path) -> None:
    damage(small, lambda index: index.chunks[0].coefficients)
    result = run("verify", "small.h5")
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith("mixseq: error: small.h5: the coefficients of frames 0 to ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("verify none.h5", "none.h5 does not exist"),
        ("verify bar.npz", "bar.npz"),
        ("verify bar_sequence.h5", "bar_sequence.h5 is an HDF5 file, but not a mixseq model"),
        ("verify small.h5 --script edit.toml", "is applied to ORIGINAL, which is missing"),
        ("verify cut_model.h5", "cut_model.h5"),
        ("verify small.h5 none.npz", "none.npz"),
        ("verify small.h5 other.npz", "the reference has 4 vertices, the other sequence 77"),
        ("verify small.h5 --prim /", "'prim' is for reading ORIGINAL, which is missing"),
    ],
)
def test_verify_refuses(run: Run, small: Path, arguments: str, message: str) -> None:
    result = run(*arguments.split())
    assert (result.exit_code, result.stdout) == (2, "")
    assert message in result.stderr
    assert result.stderr.count("\n") == 1


# Everything else that opens models ------------------------------------------------------------------------


@pytest.mark.parametrize(
    "arguments",
    [
        "compare bar.npz small.h5",
        "convert small.h5 new.npz",
        "resample small.h5 new.h5 --fps 20",
        "plot small.h5 new.png",
        "encode small.h5 new.h5 --exact",
        "encode small.h5 new.h5 --kg 1",
        "interpolate small.h5 new.npz --pose 0 --pose 3 --steps 3",
    ],
)
def test_other_commands_take_compressed_models(run: Run, small: Path, arguments: str) -> None:
    result = run(*arguments.split())
    assert result.exit_code == 0, result.output


def test_edits_of_compressed_models_are_ordinary_models(run: Run, small: Path) -> None:
    Path("edit.toml").write_text('[[edit]]\noperation = "reverse"\n')
    result = run("edit", "small.h5", "new.h5", "--script", "edit.toml")
    assert result.exit_code == 0, result.output
    assert "coding" not in json.loads(succeed(run("info", "new.h5", "--json")))
    got, small_points = mixseq.load("new.h5").sample().points, mixseq.load("small.h5").sample().points
    assert np.abs(got - small_points[::-1]).max() < 0.002 * mixseq.read("bar.npz").diagonal


def test_a_batch_leaves_compressed_models_alone(run: Run, small: Path) -> None:
    Path("caches").mkdir()
    small.rename("caches/small.h5")
    Path("bar.npz").rename("caches/bar.npz")
    result = run("batch", "encode", "caches", "--out", "models")
    assert result.exit_code == 0, result.output
    assert sorted(path.name for path in Path("models").glob("*.h5")) == ["bar.h5"]


def test_texture_coordinates_are_told_and_left_out(run: Run) -> None:
    walk = mixseq.read("bar.npz")
    uvs = CornerValues(walk.points[0][:, :2] / 7, walk.polygons.indices)
    surface = replace(walk.surface, uvs=uvs)
    mixseq.write("textured.npz", MeshSequence.from_header(replace(walk.header, surface=surface), walk.points))
    encode = ("encode", "textured.npz", "small.h5", "--max-error", "0.01", "--overwrite")
    assert "texture error  at most 0.001 of the square" in run(*encode, "--set", "uv_error=0.001").output
    result = run("verify", "small.h5", "textured.npz")
    assert (result.exit_code, "texture        0.001 of the square, requested" in result.output) == (0, True)
    assert "texture coordinates" in run("info", "small.h5").output
    for options in (("--no-uvs",), ("--set", "uvs=no")):
        told = run(*encode, *options).output.replace("textured.npz", "")
        assert "texture" not in told.replace("texture coordinates and the like", "")
        assert mixseq.load("small.h5").header.surface.uvs is None


@pytest.mark.parametrize(("option", "name"), [("--no-uvs", "no-uvs"), ("--uv-error=0.1", "uv-error")])
def test_options_of_texture_coordinates_are_for_compressed_models(run: Run, option: str, name: str) -> None:
    refused = run("encode", "bar.npz", "small.h5", option)
    assert refused.exit_code == 2
    assert f"--{name} is for compressed models; give --max-error, --kg or --size, too" in refused.output
