"""USD, writing: value clips, and packages."""

from __future__ import annotations

import os
import re
import shutil
import warnings
import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pxr import Sdf, Tf, Usd, UsdGeom

from mixseq.cli.group import announce, format_bytes
from mixseq.errors import InvalidSequenceError, MixseqWarning, OutputError, SettingsError
from mixseq.sequence.sequence import MeshSequence
from mixseq_io.usd.stage import find_clips
from mixseq_io.usd.writer import write_usd
from tests.formats.usd_maker import Asset, author_normals, character, lift, load, mesh_at, paint, problems, save, shot


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "out.usda"


# Value clips


@pytest.mark.parametrize("over", [False, True])
@pytest.mark.parametrize("length", [1, 2, 3, 7, 100])
def test_clips_give_the_same_as_one_file(asset: Asset, path: Path, over: bool, length: int) -> None:
    points = np.random.default_rng(3).normal(size=(7, 5, 3)).astype(np.float32)
    times = np.array([0, 0.1, 0.2, 0.3, 0.35, 0.4, 1.7])
    beneath = asset.read()
    header = (beneath if over else shot()).header.with_times(times, 30)
    written = MeshSequence.from_header(header, points, -points)
    whole, prim = path.with_name("whole.usdc"), "/set/walker" if over else "/mesh/mesh"
    save(whole, written)
    stage, expected = save(path, written, clips=length), Usd.Stage.Open(str(whole))
    assert problems(stage) == set()
    files = sorted(file.name for file in path.with_name("out.usda.clips").iterdir())
    count = -(-7 // length)
    assert files == [*(f"out.{number:04d}.usdc" for number in range(1, count + 1)), "out.manifest.usdc"]
    one, other = mesh_at(stage, prim), mesh_at(expected, prim)
    codes = other.GetPointsAttr().GetTimeSamples()
    assert one.GetPointsAttr().GetTimeSamples() == codes
    between = (np.array(codes[1:]) + np.array(codes[:-1])) / 2
    for code in [codes[0] - 1, *codes, *between.tolist(), codes[-1] + 1]:
        for name in ("points", "extent", "velocities"):
            got, known = (mesh.GetPrim().GetAttribute(name).Get(code) for mesh in (one, other))
            assert got == known
    back = load(path)
    np.testing.assert_array_equal(back.points, points)
    np.testing.assert_array_equal(back.times, load(whole).times)


def test_clips_of_a_character_with_normals(asset: Asset, path: Path) -> None:
    body = character(asset)
    author_normals(body, "primvars:normals", "constant")
    before = asset.read("/set/rig/body")
    stage = save(path, before.with_points(before.points + 1), clips=2)
    assert problems(stage) - problems(asset.stage) == set()
    np.testing.assert_array_equal(load(path, "/set/rig/body").points, before.points + 1)
    primvar = UsdGeom.PrimvarsAPI(mesh_at(stage, "/set/rig/body")).GetPrimvar("normals")
    assert primvar.GetInterpolation() == "vertex"
    np.testing.assert_allclose(primvar.Get(2), [(0, 0, 1)] * 3)
    root = UsdGeom.Boundable(stage.GetPrimAtPath("/set/rig"))
    np.testing.assert_allclose(root.GetExtentAttr().Get(2)[1], before.points[2].max(axis=0) + 1)


def test_clips_follow_the_shot_that_refers_to_them(path: Path) -> None:
    save(path, shot(), clips=1)
    later = Usd.Stage.CreateInMemory()
    later.SetTimeCodesPerSecond(24)
    later.DefinePrim("/there").GetReferences().AddReference(str(path), Sdf.LayerOffset(1000, 2))
    points = mesh_at(later, "/there/mesh").GetPointsAttr()
    # older versions of USD tell times of the clips besides, without the offset
    assert {1000, 1024, 1048} <= set(points.GetTimeSamples())
    np.testing.assert_array_equal([points.Get(time) for time in (1000, 1024, 1048)], lift())


def test_times_that_are_no_multiples_are_the_same_in_clips(path: Path) -> None:
    times = np.sort(np.random.default_rng(0).uniform(-3, 9, 50))
    save(path, MeshSequence.from_arrays(np.zeros((50, 3, 3)), [[0, 1, 2]], times=times), clips=7)
    save(path.with_suffix(".usdc"), MeshSequence.from_arrays(np.zeros((50, 3, 3)), [[0, 1, 2]], times=times))
    np.testing.assert_array_equal(load(path).times, load(path.with_suffix(".usdc")).times)


def test_clips_replace_older_ones(path: Path) -> None:
    save(path, shot(), clips=1)
    save(path, shot(lift() + 1), clips=2)
    assert len(list(path.with_name("out.usda.clips").iterdir())) == 3
    assert sorted(file.name for file in path.parent.iterdir()) == ["out.usda", "out.usda.clips"]
    np.testing.assert_array_equal(
        Sdf.Layer.OpenAsAnonymous(str(path.with_name("out.usda.clips") / "out.0002.usdc")).QueryTimeSample(
            "/mesh/mesh.points", 24
        ),
        lift()[2] + 1,
    )


def test_files_of_one_name_have_clips_of_their_own(path: Path) -> None:
    save(path, shot(), clips=1)
    save(path.with_suffix(".usdc"), shot(lift() + 1), clips=2)
    np.testing.assert_array_equal(load(path).points, lift())
    np.testing.assert_array_equal(load(path.with_suffix(".usdc")).points, lift() + 1)


@pytest.mark.parametrize("clips", [(2, 0), (0, 2), (2, 3)])
@pytest.mark.parametrize("rates", [(24, 60), (60, 25)])
def test_layers_over_layers(asset: Asset, path: Path, clips: tuple[int, int], rates: tuple[float, float]) -> None:
    before = asset.read()
    between = path.with_name("between.usda")
    header = before.header.with_times([0, 0.5, 1], rates[0])
    save(between, MeshSequence.from_header(header, before.points + 1), clips=clips[0])
    header = load(between).header.with_times(np.linspace(0, 2, 5), rates[1])
    points = np.random.default_rng(1).normal(size=(5, 5, 3)).astype(np.float32)
    save(path, MeshSequence.from_header(header, points), clips=clips[1])
    got = load(path)
    np.testing.assert_allclose(got.times, header.times, atol=1e-12)
    np.testing.assert_array_equal(got.points, points)


@pytest.mark.parametrize("earlier", [False, True])
@pytest.mark.parametrize("step", ["values", "fsync", "rename", "replace"])
def test_nothing_half_written_stays(
    path: Path, files: Any, monkeypatch: pytest.MonkeyPatch, earlier: bool, step: str
) -> None:
    if earlier:
        save(path, shot(), clips=1)
    before = files()
    points = lift() + 1.0

    def refuse(*arguments: object) -> None:
        raise OSError(28, "No space left on device")

    if step == "values":
        points[2] = np.inf
    else:
        monkeypatch.setattr("os.fsync" if step == "fsync" else f"pathlib.Path.{step}", refuse)
    with pytest.raises((OutputError, InvalidSequenceError)):
        write_usd(path, shot().header, [points], clips=2)
    monkeypatch.undo()
    assert files() == before
    assert not path.with_name("out.usda.clips").exists() or earlier


def test_clips_that_are_left_from_an_older_file(path: Path, recwarn: pytest.WarningsRecorder) -> None:
    save(path, shot(), clips=1)
    assert len(find_clips(path)) == 4 and not recwarn
    with pytest.warns(MixseqWarning, match=r"out\.usda\.clips has the clips of an older file"):
        save(path, shot())
    assert find_clips(path) == []
    folder = path.with_name("out.usda.clips")
    assert len(list(folder.iterdir())) == 4  # the user decides
    (folder / "notes.txt").write_text("not ours")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        save(path, shot())


def test_files_that_are_used_are_announced(
    path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    save(path, shot(), clips=2)
    size = format_bytes(sum(file.stat().st_size for file in path.with_name("out.usda.clips").iterdir()))
    monkeypatch.chdir(path.parent)
    announce(Path("out.usda"))
    own = format_bytes(path.stat().st_size)
    assert capsys.readouterr().out == f"wrote out.usda ({own}), with 3 files ({size}) in out.usda.clips\n"


@pytest.mark.parametrize(("file", "clips"), [("a.usdc", 0), ("a.usda", 0), ("a.usdz", 0), ("a.usdc", 2)])
@pytest.mark.parametrize("told", [True, False])
def test_a_full_disk(
    tmp_path: Path, files: Any, monkeypatch: pytest.MonkeyPatch, file: str, clips: int, told: bool
) -> None:
    def refuse(*_: object) -> bool:
        if told:
            raise Tf.ErrorException("Error occurred writing file: No space left on device")
        return False

    monkeypatch.setattr("pxr.Sdf.Layer.Save", refuse)
    free = 1 << 40 if told else 4096
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=free))
    with pytest.raises(OutputError) as caught:
        write_usd(tmp_path / file, shot().header, [lift()], clips=clips)
    cure = "No space left on device; free some space or choose another disk"
    assert str(caught.value) == f"cannot write {tmp_path / file}: {cure}"
    assert files() == {}


def test_a_package_on_a_full_disk(path: Path, files: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pxr.UsdUtils.CreateNewUsdzPackage", lambda *_: False)
    with pytest.raises(OutputError, match=r"out\.usdc cannot be packed"):
        save(path.with_suffix(".usdz"), shot())
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=0))
    with pytest.raises(OutputError, match=r"cannot write .*out\.usdz: No space left on device; free some"):
        save(path.with_suffix(".usdz"), shot())
    assert files() == {}


@pytest.mark.parametrize("clips", [0, 2])
def test_other_reasons_are_short_and_name_no_temporary_files(
    path: Path, monkeypatch: pytest.MonkeyPatch, clips: int
) -> None:
    def refuse(layer: Sdf.Layer) -> None:
        raise Tf.ErrorException(f"Could not close {layer.realPath}; " + "noise " * 100)

    monkeypatch.setattr("pxr.Sdf.Layer.Save", refuse)
    with pytest.raises(OutputError) as caught:
        write_usd(path, shot().header, [lift()], clips=clips)
    place = f"{path}.clips/out.0001.usdc" if clips else str(path)
    message = str(caught.value)
    assert message.startswith(f"cannot write {path}: Could not close {place}; noise noise")
    assert len(message) < len(str(path)) + 280


def test_a_layer_that_is_not_saved_for_no_reason(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pxr.Sdf.Layer.Save", lambda _: False)
    with pytest.raises(OutputError, match=r"usda: USD does not save it, and does not say why; check the free space"):
        save(path, shot())


@pytest.mark.parametrize("name", ["notes.txt", "out.0001.usdc"])
def test_a_folder_of_clips_with_something_else_in_it(path: Path, name: str) -> None:
    folder = path.with_name("out.usda.clips")
    folder.mkdir()
    os.mkfifo(folder / name)
    with pytest.raises(OutputError, match=r"out\.usda\.clips has other files than clips"):
        save(path, shot(), clips=2)
    assert (folder / name).is_fifo()


# Packages


def test_a_package_has_its_textures(asset: Asset, tmp_path: Path) -> None:
    (tmp_path / "wool.png").write_bytes(b"a picture")
    paint(asset)
    before = asset.read()
    with pytest.warns(MixseqWarning, match=r"stands alone, as \.usdz files do: .*asset\.usda"):
        save(tmp_path / "one.usdz", before)
    again = load(tmp_path / "one.usdz")
    save(tmp_path / "two.usdz", again, flatten=True)  # from package to package
    for name, inside in (("one", "wool.png"), ("two", "0/wool.png")):
        moved = tmp_path / "alone"
        moved.mkdir()
        shutil.copy(tmp_path / f"{name}.usdz", moved)
        stage = Usd.Stage.Open(str(moved / f"{name}.usdz"))
        assert problems(stage) == set()
        prim = stage.GetPrimAtPath("/walker/Looks/wool/picture")
        assert prim.GetAttribute("inputs:file").Get().resolvedPath == f"{moved}/{name}.usdz[{inside}]"
        np.testing.assert_array_equal(load(moved / f"{name}.usdz").points, before.points)
        shutil.rmtree(moved)


def packed(asset: Asset, target: Path, texture: str, **options: Any) -> list[str]:
    """Return what is in a package of an asset with a texture, besides its layer."""
    paint(asset, texture)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MixseqWarning)
        save(target, asset.read(), flatten=True, **options)
    return zipfile.ZipFile(target).namelist()[1:]


@pytest.fixture
def shelf(tmp_path: Path, asset: Asset) -> Path:
    """Make a folder that is none of the asset's, with a file; and links to it in the asset's."""
    shelf = tmp_path.parent / f"{tmp_path.name}-shelf"
    shelf.mkdir()
    for name in ("secret.png", "wool.1001.png"):
        (shelf / name).write_bytes(b"of the user")
    (asset.path.parent / "link.png").symlink_to(shelf / "secret.png")
    (asset.path.parent / "wool.1001.png").symlink_to(shelf / "wool.1001.png")
    (asset.path.parent / "wool.1002.png").write_bytes(b"of the asset")
    os.mkfifo(asset.path.parent / "pipe.png")
    return shelf


@pytest.mark.parametrize("name", ["absolute", "../{}", "below/../../{}", "link.png", "wool.<UDIM>.png", "pipe.png"])
def test_files_elsewhere_are_not_packed(asset: Asset, tmp_path: Path, shelf: Path, name: str) -> None:
    (asset.path.parent / "below").mkdir()
    secret = shelf / "secret.png"
    texture = str(secret) if name == "absolute" else name.format(f"{shelf.name}/secret.png")
    paint(asset, texture if texture.startswith(("/", ".")) else f"./{texture}")
    before = asset.read()
    target = tmp_path / "out.usdz"
    with pytest.warns(MixseqWarning, match=r"are packed, not .*(secret|link|pipe|wool\.1001)\.png; .*--pack-from"):
        save(target, before, flatten=True)
    assert len(zipfile.ZipFile(target).namelist()) == 1
    assert not Usd.Stage.Open(str(target)).GetPrimAtPath("/walker/Looks/wool/picture").GetAttribute("inputs:file").Get()


def test_files_elsewhere_are_packed_where_that_is_allowed(asset: Asset, tmp_path: Path, shelf: Path) -> None:
    for number, texture in enumerate((str(shelf / "secret.png"), "./link.png", "./wool.<UDIM>.png")):
        target = tmp_path / f"out{number}.usdz"
        names = packed(asset, target, texture, pack_from=shelf)
        assert len(names) == (2 if "UDIM" in texture else 1)
    with pytest.raises(SettingsError, match=r"only \.usdz files have textures packed"):
        save(tmp_path / "out.usdc", asset.read(), flatten=True, pack_from=shelf)


@pytest.mark.parametrize("name", ["./missing.png", "./", "./noext", "missing.png[b.png]", "./wool.<UDIM>.png"])
def test_textures_that_cannot_be_packed_are_left_out_and_named(asset: Asset, tmp_path: Path, name: str) -> None:
    (asset.path.parent / "noext").write_bytes(b"a picture")
    paint(asset, name)
    before = asset.read()
    with pytest.warns(MixseqWarning, match=rf"textures that exist .* are packed, not .*{re.escape(name[2:])}"):
        save(tmp_path / "out.usdz", before, flatten=True)
    assert len(zipfile.ZipFile(tmp_path / "out.usdz").namelist()) == 1
    np.testing.assert_array_equal(load(tmp_path / "out.usdz").points, before.points)


def test_a_scene_is_no_texture(asset: Asset, tmp_path: Path, shelf: Path) -> None:
    (asset.path.parent / "scene.usda").write_text(
        f'#usda 1.0\ndef "a" {{\nasset picture = @{shelf / "secret.png"}@\n}}\n'
    )
    assert packed(asset, tmp_path / "out.usdz", "./scene.usda") == []
