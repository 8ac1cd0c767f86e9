"""``mixseq decode --as``: from models and sequences to skins and morphs, with errors that are those of the file."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.sequence.sequence import MeshSequence
from tests.cli.conftest import Contents, Run, succeed
from tests.cli.test_commands import rows
from tests.formats.gltf_files import Gltf

pytestmark = pytest.mark.slow


def number(text: str) -> float:
    """The first number of a cell."""
    found = re.match(r"\s*([-+.\de]+)", text)
    assert found, text
    return float(found[1])


def test_a_model_becomes_a_skin(run: Run, bent_bar: MeshSequence) -> None:
    table = rows(succeed(run("decode", "model.h5", "bar.glb", "--as", "skin", "--bones", "2")))
    file = Gltf(Path("bar.glb"))
    assert len(file.json["skins"][0]["joints"]) == 2 == number(table["bones"])
    assert number(table["morph targets"]) == 0
    found = mixseq.compare(bent_bar, mixseq.read("bar.glb"))
    assert number(table["max error"]) == pytest.approx(found.max_error, rel=1e-3)
    assert number(table["rms error"]) == pytest.approx(found.rms_error, rel=1e-3)
    assert number(table["KG error"]) == pytest.approx(found.kg_percent, rel=1e-3)
    assert found.max_error < 0.05


def test_a_model_becomes_a_morph(run: Run, bent_bar: MeshSequence) -> None:
    table = rows(succeed(run("decode", "model.h5", "bar.glb", "--as", "morph", "--max-error", "1e-4")))
    assert "bones" not in table
    assert number(table["morph targets"]) == len(Gltf(Path("bar.glb")).primitives("bar")[0]["targets"])
    assert mixseq.compare(bent_bar, mixseq.read("bar.glb")).max_error <= 1.001e-4


@pytest.mark.parametrize("kind", ["skin", "morph"])
def test_a_bound_between_frames_takes_more_keys(run: Run, bent_bar: MeshSequence, kind: str) -> None:
    arguments = ("decode", "model.h5", "bar.glb", "--as", kind, "--max-error", "0.008")
    plain, held = (rows(succeed(run(*arguments, *option))) for option in ((), ("--between-frames",)))
    assert number(plain["between frames"]) > 0.008 >= number(held["between frames"])
    assert number(held["keys"]) > number(plain["keys"])
    with mixseq.open_sequence("bar.glb") as played:
        found = mixseq.measure_between(mixseq.load("model.h5"), played)
    assert number(held["between frames"]) == pytest.approx(found, rel=0.05)


def test_frames_of_gltf_are_measured_between_frames(run: Run, bent_bar: MeshSequence) -> None:
    table = rows(succeed(run("decode", "model.h5", "bar.glb")))
    again = rows(succeed(run("resample", "model.h5", "again.glb", "--speed", "0.5")))
    found = mixseq.measure_between(mixseq.load("model.h5"), mixseq.load("model.h5").sample())
    assert number(table["between frames"]) == pytest.approx(found, rel=0.05)
    assert number(again["between frames"]) == pytest.approx(found / 4, rel=0.5)
    facts = json.loads(succeed(run("compare", "model.h5", "bar.glb", "--between-frames", "--json")))
    assert facts["between_error"] == pytest.approx(found, rel=1e-3)


def test_correctives_bring_a_skin_under_an_error(run: Run, bent_bar: MeshSequence) -> None:
    options = ("--as", "skin", "--bones", "2", "--correctives", "0.002")
    table = rows(succeed(run("decode", "model.h5", "bar.glb", *options)))
    assert number(table["morph targets"]) > 0
    assert mixseq.compare(bent_bar, mixseq.read("bar.glb")).max_error <= 0.002001


@pytest.mark.parametrize("option", [("--max-error", "0.01"), ("--kg", "2")])
def test_an_error_tells_how_many_bones(run: Run, bent_bar: MeshSequence, option: tuple[str, str]) -> None:
    table = rows(succeed(run("decode", "model.h5", "bar.glb", "--as", "skin", *option)))
    found = mixseq.compare(bent_bar, mixseq.read("bar.glb"))
    assert (found.max_error if option[0] == "--max-error" else found.kg_percent) <= float(option[1]) * 1.001
    assert number(table["morph targets"]) == 0


def test_a_skin_has_the_skeleton_of_a_file(run: Run, bent_bar: MeshSequence) -> None:
    succeed(run("decode", "bar.npz", "rig.glb", "--as", "skin", "--bones", "3"))
    table = rows(succeed(run("decode", "model.h5", "again.glb", "--as", "skin", "--skeleton", "rig.glb")))
    given, found = mixseq.read_skeleton("rig.glb"), mixseq.read_skeleton("again.glb")
    assert found.names == given.names
    np.testing.assert_allclose(found.pivots, given.pivots, atol=1e-4)  # as the root stands in the first frame
    assert number(table["bones"]) == given.bone_count
    assert mixseq.compare(bent_bar, mixseq.read("again.glb")).max_error < 0.05


def test_a_skeleton_alone_stands_in_the_first_frame(run: Run, bent_bar: MeshSequence) -> None:
    succeed(run("decode", "bar.npz", "rig.gltf", "--as", "skin", "--bones", "3"))
    file = json.loads(Path("rig.gltf").read_text())
    for node in file["nodes"]:
        node.pop("mesh", None)
        node.pop("skin", None)
    Path("bones.gltf").write_text(json.dumps(file))
    succeed(run("decode", "model.h5", "again.glb", "--as", "skin", "--skeleton", "bones.gltf"))
    assert mixseq.read_skeleton("again.glb").names == mixseq.read_skeleton("rig.gltf").names
    assert mixseq.compare(bent_bar, mixseq.read("again.glb")).max_error < 0.05


def test_a_damaged_mesh_on_a_skeleton_is_an_error(run: Run) -> None:
    succeed(run("decode", "bar.npz", "rig.gltf", "--as", "skin", "--bones", "3"))
    file = json.loads(Path("rig.gltf").read_text())
    file["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = 99
    Path("damaged.gltf").write_text(json.dumps(file))
    assert mixseq.read_skeleton("damaged.gltf").bone_count
    result = run("decode", "model.h5", "again.glb", "--as", "skin", "--skeleton", "damaged.gltf")
    assert result.exit_code == 2
    assert "error: damaged.gltf" in result.stderr
    assert not Path("again.glb").exists()


@pytest.mark.parametrize("copies", [0, 1])
def test_another_mesh_on_a_skeleton_is_told(run: Run, bent_bar: MeshSequence, copies: int) -> None:
    """A triangle, alone or beside the bar, as a sword in its hand would be."""
    succeed(run("decode", "bar.npz", "rig.usda", "--as", "skin", "--bones", "3"))
    beside = np.tile(np.eye(3), (bent_bar.frame_count, 1, 1))
    points = np.concatenate([*copies * [bent_bar.points], beside], axis=1)
    faces = np.concatenate([*copies * [bent_bar.faces], [[77 * copies + corner for corner in range(3)]]])
    mixseq.write("more.npz", mixseq.MeshSequence.from_arrays(points, faces, fps=10))
    result = run("decode", "more.npz", "again.glb", "--as", "skin", "--skeleton", "rig.usda")
    assert (
        f"warning: rig.usda: the mesh on the skeleton has 77 vertices, that of the sequence has {len(points[0])}; "
        "it is left out, and the skeleton is taken as it would stand in the first frame" in result.stderr
    )
    assert ("encode that one alone (mixseq encode --prim)" in result.stderr) == bool(copies)


@pytest.mark.parametrize(("source", "kind"), [("bar.npz", "morph"), ("bar.usdc", "skin"), ("bar_sequence.h5", "skin")])
def test_a_sequence_is_fitted_as_it_is(run: Run, source: str, kind: str, bent_bar: MeshSequence) -> None:
    succeed(run("decode", source, "out.glb", "--as", kind))
    back = mixseq.read("out.glb")
    np.testing.assert_allclose(back.times, bent_bar.times, atol=1e-9)
    assert back.vertex_count == bent_bar.vertex_count


def test_keys_are_at_the_rate_that_is_asked_for(run: Run) -> None:
    table = rows(succeed(run("decode", "model.h5", "out.glb", "--as", "skin", "--bones", "2", "--fps", "20")))
    assert table["keys"].strip() == "7 from 0 to 0.3 s at 20 frames per second"
    np.testing.assert_allclose(mixseq.read("out.glb").times, np.arange(7) / 20, atol=1e-9)
    table = rows(succeed(run("decode", "model.h5", "out.gltf", "--as", "morph", "--times", "0.05,0.25")))
    assert table["keys"].strip().startswith("2 from 0.05 to 0.25 s")
    assert "buffers" in json.loads(Path("out.gltf").read_text())


def test_quiet_tells_only_the_file(run: Run) -> None:
    text = succeed(run("decode", "model.h5", "out.glb", "--as", "skin", "-q"))
    assert re.fullmatch(r"wrote out.glb \([^)]*\)\n", text)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("out.glb", "--bones", "3"), "--bones is for --as skin; leave it out, or give both"),
        (("out.glb", "--correctives", "0.1"), "--correctives is for --as skin"),
        (("out.glb", "--kg", "0.1"), "--kg is for --as skin"),
        (("out.glb", "--skeleton", "bar.glb"), "--skeleton is for --as skin"),
        (("out.glb", "--max-error", "0.1"), "--max-error is for --as skin or morph"),
        (("out.glb", "--max-targets", "3"), "--max-targets is for --as skin or morph"),
        (
            ("out.glb", "--as", "skin", "--max-error", "0.1", "--bones", "3"),
            "--bones and --max-error both choose the bones; give one of them",
        ),
        (
            ("out.glb", "--as", "skin", "--kg", "0.1", "--skeleton", "bar.glb"),
            "--skeleton and --kg both choose the bones; give one of them",
        ),
        (("out.glb", "--as", "skin", "--skeleton", "none.glb"), "none.glb does not exist"),
        (("out.glb", "--as", "morph", "--bones", "3"), "--bones is for --as skin"),
        (("out.glb", "--as", "morph", "--correctives", "0.1"), "--correctives is for --as skin"),
        (("out.glb", "--as", "skin", "--velocities"), "a skin has no place for velocities; leave out --velocities"),
        (("out.glb", "--as", "skin", "--onto", "bar.usdc"), "no place for other files to build on; leave out --onto"),
        (("out.glb", "--as", "skin", "--clips", "3"), "no place for clips; leave out --clips, or --as"),
        (("out.abc", "--as", "skin"), "skins and morphs are written as glTF or USD; end the name in .glb, "),
        (("out.glb", "--as", "skin", "--times", "0", "--end", "1"), "leave out --start and --end"),
        (("nowhere/out.glb", "--as", "skin"), "does not exist; make it first"),
    ],
)
def test_what_does_not_fit_is_refused(run: Run, contents: Contents, arguments: tuple[str, ...], message: str) -> None:
    before = contents()
    result = run("decode", "model.h5", *arguments)
    assert result.exit_code == 2
    assert message in result.stderr
    assert contents() == before


@pytest.mark.parametrize("option", [("--fps", "10"), ("--times", "0"), ("--start", "0"), ("--end", "1")])
def test_times_of_a_sequence_are_its_own(run: Run, option: tuple[str, str]) -> None:
    result = run("decode", "bar.npz", "out.glb", "--as", "skin", *option)
    assert result.exit_code == 2
    assert "bar.npz is a sequence, whose frames are fitted as they are; leave out --fps" in result.stderr


@pytest.mark.parametrize("source", ["missing.h5", "missing.usdc", "notes.txt", "cut_model.h5", "cut_bar.usdc"])
def test_sources_that_cannot_be_read(run: Run, source: str) -> None:
    result = run("decode", source, "out.glb", "--as", "skin")
    assert result.exit_code == 2
    assert source in result.stderr
    assert not Path("out.glb").exists()


def test_the_file_that_a_sequence_came_from_stays(run: Run) -> None:
    mixseq.write("origin.glb", mixseq.read("bar.npz"))
    succeed(run("convert", "origin.glb", "copy.h5"))
    before = Path("origin.glb").read_bytes()
    result = run("decode", "copy.h5", "origin.glb", "--as", "skin")
    assert result.exit_code == 2
    assert "is the file that the sequence came from, which would be lost; give another name" in result.stderr
    assert Path("origin.glb").read_bytes() == before


def test_textures(run: Run) -> None:
    plain = rows(succeed(run("decode", "model.h5", "plain.vat")))
    low = rows(succeed(run("decode", "bar.usdc", "low.vat", "--max-error", "1e-3")))
    assert number(low["max error"]) <= 1e-3
    assert "basis vectors" in low["textures"]
    assert plain["textures"].strip().startswith("plain: ")
    told = json.loads(Path("low.vat/vat.json").read_text())
    assert told["error"]["max"] == pytest.approx(number(low["max error"]), rel=1e-3)
    assert sorted(each.name for each in Path("low.vat").iterdir()) == [
        "coefficients.png", "godot.gdshader", "mesh.glb", "normals.png", "points.png", "unity.shader",
        "unreal.hlsl", "vat.json", "webgl2.js",
    ]  # fmt: skip


def test_textures_replace_those_of_an_older_run(run: Run, contents: Contents) -> None:
    succeed(run("decode", "model.h5", "bar.vat", "--max-error", "1e-3"))
    Path("bar.vat/points.png.import").write_text("an engine's")
    before = contents()
    refused = run("decode", "model.h5", "bar.vat", "--no-overwrite")
    assert "bar.vat exists; give another name, or --overwrite" in refused.stderr
    failed = run("decode", "model.h5", "bar.vat", "--max-error", "1e-9", "--overwrite")
    assert "rounding to 16 bits alone" in failed.stderr
    lost = run("decode", "bar.vat/mesh.glb", "bar.vat", "--overwrite")
    assert "mesh.glb is the source itself and would be lost" in lost.stderr
    assert contents() == before
    for option in ("--overwrite", "--quiet"):
        succeed(run("decode", "model.h5", "bar.vat", option))
    assert json.loads(Path("bar.vat/vat.json").read_text())["kind"] == "plain"
    assert Path("bar.vat/points.png.import").read_text() == "an engine's"
    assert not Path("bar.vat/coefficients.png").exists()


def test_only_files_of_textures_are_lost(run: Run, contents: Contents) -> None:
    """What else is in the folder, or below it, may be the source, or what the sequence came from."""
    succeed(run("decode", "model.h5", "bar.vat"))
    Path("bar.vat/deep").mkdir()
    Path("bar.npz").rename("bar.vat/bar.npz")
    mixseq.write("bar.vat/deep/mesh.glb", mixseq.read("bar.vat/bar.npz"))
    succeed(run("convert", "bar.vat/deep/mesh.glb", "copy.h5"))
    kept = {name: contents()[name] for name in ("bar.vat/bar.npz", "bar.vat/deep/mesh.glb")}
    for source in ("bar.vat/bar.npz", "bar.vat/deep/mesh.glb", "copy.h5"):
        succeed(run("decode", source, "bar.vat"))
    assert kept.items() <= contents().items()

    mixseq.write("bar.vat/mesh.glb", mixseq.read("bar.vat/bar.npz"))
    Path("link.glb").symlink_to("bar.vat/mesh.glb")
    succeed(run("convert", "bar.vat/mesh.glb", "of_mesh.h5"))
    before = contents()
    for source, message in (
        ("bar.vat/mesh.glb", "mesh.glb is the source itself and would be lost; give another name"),
        ("link.glb", "link.glb is the source itself and would be lost"),
        ("of_mesh.h5", "mesh.glb is the file that the sequence came from, which would be lost"),
    ):
        refused = run("decode", source, "bar.vat")
        assert refused.exit_code == 2
        assert message in refused.stderr
    assert contents() == before


def test_a_file_is_no_folder_of_textures(run: Run, contents: Contents) -> None:
    Path("old.vat").write_text("somebody's work")
    before = contents()
    assert "old.vat is a file; give the name of a folder" in run("decode", "model.h5", "old.vat").stderr
    assert contents() == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("walk.vat", "--as", "skin"), "no place for --as"),
        (("walk.vat", "--velocities"), "no place for --velocities"),
        (("walk.vat", "--set", "keep_start=yes"), "no place for --keep-start"),
        (("walk.vat", "--kg", "1"), "no place for --kg"),
        (("walk.vat", "--set", "bones=3"), "no place for --bones"),
        (("walk.vat", "--skeleton", "bar.glb"), "no place for --skeleton"),
        (("walk.vat", "--correctives", "1"), "no place for --correctives"),
        (("walk.vat", "--max-targets", "0"), "no place for --max-targets"),
        (("walk.usdc", "--set", "texture=exr"), "end the target in .vat"),
        (("walk.usdc", "--max-error", "1e-3"), "or a target .vat"),
    ],
)
def test_options_that_do_not_fit_textures(run: Run, arguments: tuple[str, ...], message: str) -> None:
    result = run("decode", "model.h5", *arguments)
    assert result.exit_code == 2
    assert message in result.stderr


@pytest.mark.parametrize("kind", ["skin", "morph"])
@pytest.mark.parametrize("target", ["bar.usda", "bar.usdz"])
def test_usd_tells_its_error_as_gltf_does(run: Run, target: str, kind: str, bent_bar: MeshSequence) -> None:
    table = rows(succeed(run("decode", "model.h5", target, "--as", kind, "--set", "max_targets=2")))
    found = mixseq.compare(bent_bar, mixseq.read(target))
    assert number(table["max error"]) == pytest.approx(found.max_error, rel=1e-3)
    assert "every frame" not in table
