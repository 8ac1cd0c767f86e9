"""Velocities in files: kept, or missed out loud."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any, cast

import h5py
import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom

import mixseq
from mixseq.errors import FormatError, InvalidSequenceError, MixseqWarning
from mixseq.operations.resampling import plan, resample
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import FloatArray
from mixseq_io import open_sequence, read, unzip_blocks, write, write_blocks

UsdValidation: Any = import_module("pxr.UsdValidation")

NAMES = ("walk.usdc", "walk.usda", "walk.npz", "walk.h5")
FACES = [[0, 1, 2], [1, 3, 2]]


def moving(frames: int = 5, dtype: type = np.float32, fps: float = 24.0) -> MeshSequence:
    rng = np.random.default_rng(frames)
    points, velocities = rng.normal(size=(2, frames, 4, 3)).astype(dtype)
    still = MeshSequence.from_arrays(points, FACES, fps=fps)
    return MeshSequence.from_header(still.header, still.points, velocities)


@pytest.fixture(params=NAMES)
def path(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A file of every format that holds velocities."""
    return tmp_path / str(request.param)


def assert_same(got: MeshSequence, expected: MeshSequence) -> None:
    assert got.velocities is not None and expected.velocities is not None
    assert got.velocities.dtype == got.points.dtype
    np.testing.assert_array_equal(got.points, expected.points)
    np.testing.assert_array_equal(got.velocities, expected.velocities)


# Round trips ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("frames", [1, 5, 40])
def test_what_is_written_is_read(path: Path, frames: int) -> None:
    written = moving(frames)
    write(path, written)
    assert_same(read(path), written)


@pytest.mark.parametrize("name", ["walk.npz", "walk.h5"])
def test_double_precision(tmp_path: Path, name: str) -> None:
    write(tmp_path / name, moving(dtype=np.float64))
    assert_same(read(tmp_path / name), moving(dtype=np.float64))


def test_velocities_get_the_precision_of_the_points(path: Path) -> None:
    fine = moving(dtype=np.float64)
    assert fine.velocities is not None
    coarse = MeshSequence.from_header(fine.header, fine.points.astype(np.float32), fine.velocities)
    write(path, coarse)
    got = read(path)
    assert got.velocities is not None
    np.testing.assert_array_equal(got.velocities, fine.velocities.astype(np.float32))


def test_without_velocities_there_are_none(path: Path) -> None:
    write(path, moving().with_points(moving().points))
    assert read(path).velocities is None
    with open_sequence(path) as reader:
        assert not reader.has_velocities
        assert reader.velocity_blocks() is None


def test_a_compressed_archive(tmp_path: Path) -> None:
    write(tmp_path / "walk.npz", moving(), compress=True)
    assert_same(read(tmp_path / "walk.npz"), moving())
    with np.load(tmp_path / "walk.npz") as arrays:
        np.testing.assert_array_equal(arrays["velocities"], moving().velocities)


def test_a_file_written_onto_itself(path: Path) -> None:
    write(path, moving(40))
    with open_sequence(path) as reader:
        alone = {"flatten": True} if path.suffix.startswith(".usd") else {}
        write_blocks(path, reader.header, reader.blocks(3), reader.velocity_blocks(3), **alone)
    assert_same(read(path), moving(40))


def test_blocks_in_step(path: Path) -> None:
    """Writers take pairs one after the other: nothing piles up, however long the sequence is."""
    sequence = moving(7)
    assert sequence.velocities is not None
    log: list[int] = []

    def pairs() -> Iterator[tuple[FloatArray, FloatArray]]:
        assert sequence.velocities is not None
        for frame in range(0, 7, 2):
            log.append(frame)
            yield sequence.points[frame : frame + 2], sequence.velocities[frame : frame + 2]

    points, velocities = unzip_blocks(pairs())
    taken: list[list[int]] = []
    watched = (taken.append(list(log)) or block for block in velocities)  # type: ignore[func-returns-value]
    write_blocks(path, sequence.header, points, watched)
    assert taken == [[0], [0, 2], [0, 2, 4], [0, 2, 4, 6]]
    assert_same(read(path), sequence)


def test_reading_in_blocks(path: Path) -> None:
    write(path, moving(7))
    with open_sequence(path) as reader:
        for size in (1, 3, 100):
            points, velocities = list(reader.blocks(size)), reader.velocity_blocks(size)
            assert velocities is not None
            blocks = list(velocities)
            assert [len(block) for block in blocks] == [len(block) for block in points]
            np.testing.assert_array_equal(np.concatenate(blocks), moving(7).velocities)
        late = reader.velocity_blocks()
    assert late is not None
    with pytest.raises(FormatError, match="is closed"):
        next(late)


def test_large_velocities_wait_on_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mixseq_io.npz._MAX_SPOOLED_BYTES", 100)
    monkeypatch.setattr("mixseq_io.npz._COPY_CHUNK_BYTES", 7)
    write(tmp_path / "walk.npz", moving(40))
    assert_same(read(tmp_path / "walk.npz"), moving(40))
    assert [file.name for file in tmp_path.iterdir()] == ["walk.npz"]


# What does not fit ----------------------------------------------------------------------------------------


def test_formats_without_a_place_for_them(tmp_path: Path) -> None:
    with pytest.warns(MixseqWarning, match=r"OBJ files cannot hold velocities; USD, .npz and .h5 can"):
        write(tmp_path / "walk_#.obj", moving())
    assert read(tmp_path / "walk_#.obj").velocities is None
    np.testing.assert_array_equal(read(tmp_path / "walk_#.obj").points, moving().points)


def with_a_hole(velocities: FloatArray) -> FloatArray:
    holed = velocities.copy()
    holed[3, 1, 2] = np.nan
    return holed


@pytest.mark.parametrize("name", ["walk.usdc", "walk.h5", "walk_#.obj"])
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda v: [v[:2]], "velocities end before frame 2; give one velocity per point"),
        (lambda v: [v[:2], v[2:4]], r"velocities from frame 2 on have shape \(2, 4, 3\), points \(3, 4, 3\)"),
        (lambda v: [v[:2], v[2:, :3]], r"velocities from frame 2 on have shape \(3, 3, 3\), points"),
        (lambda v: [v[:2], v[2:], v], "more velocities than points"),
        (lambda v: [v[:2], with_a_hole(v)[2:]], r"frame 3: the velocity of vertex 1 is .*nan.*must be finite"),
        (lambda v: [v[:2], 1e39 * v[2:].astype(float)], "frame 2: the velocity of vertex 0 is .*too large"),
    ],
    ids=["few", "short", "vertices", "many", "nan", "large"],
)
@pytest.mark.filterwarnings("ignore::mixseq.errors.MixseqWarning")
def test_velocities_that_do_not_fit(
    tmp_path: Path, name: str, change: Callable[[FloatArray], list[FloatArray]], message: str
) -> None:
    sequence = moving()
    assert sequence.velocities is not None
    blocks = [sequence.points[:2], sequence.points[2:]]
    with pytest.raises(InvalidSequenceError, match=message):
        write_blocks(tmp_path / name, sequence.header, blocks, change(sequence.velocities))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["walk.npz", "walk.h5"])
def test_damage_is_noticed(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    sequence = moving(100, dtype=np.float64)
    assert sequence.velocities is not None
    write(path, sequence)
    content = bytearray(path.read_bytes())
    if name == "walk.npz":
        place = content.index(sequence.velocities.tobytes()) + 9000
    else:
        with h5py.File(path) as file:
            place = file["velocities"].id.get_chunk_info(0).byte_offset + 20
    content[place] ^= 1
    path.write_bytes(content)
    with pytest.raises(FormatError, match="damaged"):
        read(path)
    with open_sequence(path) as reader:  # points are sound
        np.testing.assert_array_equal(np.concatenate(list(reader.blocks())), sequence.points)


def test_archives_of_others(tmp_path: Path) -> None:
    points = moving().points
    np.savez(tmp_path / "diff.npz", points=points, faces=FACES, velocities=np.diff(points, axis=0))
    with pytest.warns(MixseqWarning, match=r"velocities have shape \(4, 4, 3\), points \(5, 4, 3\); they are left"):
        assert read(tmp_path / "diff.npz").velocities is None
    np.savez(tmp_path / "whole.npz", points=points, faces=FACES, velocities=np.ones((5, 4, 3), dtype=np.int8))
    velocities = read(tmp_path / "whole.npz").velocities
    assert velocities is not None and (velocities == 1).all()
    np.savez(tmp_path / "text.npz", points=points, faces=FACES, velocities=["fast"])
    with pytest.raises(FormatError, match="velocities have type"):
        read(tmp_path / "text.npz")


def test_a_damaged_shape(tmp_path: Path) -> None:
    write(tmp_path / "walk.h5", moving())
    with h5py.File(tmp_path / "walk.h5", "a") as file:
        del file["velocities"]
        file["velocities"] = np.zeros((5, 3, 3))
    with pytest.raises(FormatError, match=r"velocities are float64 of shape \(5, 3, 3\); it is damaged"):
        read(tmp_path / "walk.h5")


# USD ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("extension", ["usda", "usdc"])
def test_a_valid_asset(tmp_path: Path, extension: str) -> None:
    path = tmp_path / f"walk.{extension}"
    sequence = moving(fps=30)
    assert sequence.velocities is not None
    write(path, sequence)
    stage = Usd.Stage.Open(str(path))
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    assert [error.GetErrorAsString() for error in errors] == []
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/mesh/mesh"))
    velocities = mesh.GetVelocitiesAttr()
    assert velocities.GetTypeName() == "vector3f[]"
    assert velocities.GetTimeSamples() == mesh.GetPointsAttr().GetTimeSamples() == [0, 1, 2, 3, 4]
    # Between samples USD itself moves points by velocity times seconds, which tells the unit.
    between = np.array(mesh.ComputePointsAtTime(Usd.TimeCode(2.25), Usd.TimeCode(2)))
    np.testing.assert_allclose(between, sequence.points[2] + sequence.velocities[2] * 0.25 / 30, atol=1e-6)


def make_stage(path: Path) -> tuple[Usd.Stage, UsdGeom.Mesh]:
    write(path, moving(3))
    stage = Usd.Stage.Open(str(path))
    return stage, UsdGeom.Mesh(stage.GetPrimAtPath("/mesh/mesh"))


def test_a_transform_turns_velocities(tmp_path: Path) -> None:
    stage, mesh = make_stage(tmp_path / "walk.usda")
    mesh.AddTranslateOp().Set(Gf.Vec3d(10, 20, 30))
    mesh.AddRotateZOp().Set(90.0)
    mesh.AddScaleOp().Set(Gf.Vec3f(2, 2, 2))
    stage.Save()
    got, local = read(tmp_path / "walk.usda").velocities, moving(3).velocities
    assert got is not None and local is not None
    turned = 2 * np.stack([-local[..., 1], local[..., 0], local[..., 2]], axis=-1)
    np.testing.assert_allclose(got, turned, atol=1e-6)


def move_the_mesh(mesh: UsdGeom.Mesh) -> None:
    slide = mesh.AddTranslateOp()
    slide.Set(Gf.Vec3d(0, 0, 0), 0)
    slide.Set(Gf.Vec3d(1, 0, 0), 2)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (move_the_mesh, "lack the motion of an animated transform or skeleton"),
        (lambda mesh: mesh.GetVelocitiesAttr().ClearAtTime(1), "are not sampled at the times of the points"),
        (lambda mesh: mesh.GetVelocitiesAttr().Set([(0, 0, 1)], 0), "are 1 for 4 points"),
    ],
    ids=["moving", "times", "count"],
)
def test_velocities_that_mean_something_else(
    tmp_path: Path, change: Callable[[UsdGeom.Mesh], object], message: str
) -> None:
    stage, mesh = make_stage(tmp_path / "walk.usda")
    change(mesh)
    stage.Save()
    with pytest.warns(MixseqWarning, match=f"velocities {message}; they are left out: /mesh/mesh"):
        assert read(tmp_path / "walk.usda").velocities is None


def test_a_frame_with_too_few(tmp_path: Path) -> None:
    stage, mesh = make_stage(tmp_path / "walk.usda")
    mesh.GetVelocitiesAttr().Set([(0, 0, 1)], 2)
    stage.Save()
    with pytest.raises(
        InvalidSequenceError, match=r"frame 2 \(time code 2\): /mesh/mesh has 1 velocities for 4 points"
    ):
        read(tmp_path / "walk.usda")


# Of models ------------------------------------------------------------------------------------------------


def test_velocities_of_a_model(path: Path) -> None:
    """Corners on parabolas, which one cubic has for a curve, in slow motion: half the velocities."""
    times = np.arange(6) / 10
    accelerations = np.random.default_rng(3).normal(size=(4, 3))
    points = moving().points[:1] + 0.5 * times[:, None, None] ** 2 * accelerations
    model = mixseq.fit(MeshSequence.from_arrays(points, FACES, fps=10), knots=0, space="vertex")
    write(path, resample(model, speed=0.5, velocities=True))
    got = read(path)
    assert got.velocities is not None
    expected = 0.5 * (0.5 * got.times)[:, None, None] * accelerations
    np.testing.assert_allclose(got.velocities, expected, atol=1e-5)


@pytest.mark.parametrize(
    "use",
    [
        lambda source: mixseq.fit(source, exact=True, space="vertex"),
        lambda source: mixseq.compress(source, max_error=0.01, parts=1),
        lambda source: mixseq.transfer(
            source, MeshSequence.from_arrays(moving().points[:1], FACES), method="gradients"
        ),
        resample,
    ],
    ids=["fit", "compress", "transfer", "resample"],
)
def test_a_warning_says_that_they_are_lost(tmp_path: Path, use: Callable[[Any], Any]) -> None:
    path = tmp_path / "walk.npz"
    write(path, moving())
    for source in (read(path), path):
        with pytest.warns(MixseqWarning, match="'.*': velocities are left out") as caught:
            use(source)
        assert len(caught) == 1
    use(moving().with_points(moving().points))  # no warning


def test_resampled_velocities_replace_those_of_the_source(tmp_path: Path) -> None:
    path = tmp_path / "walk.npz"
    write(path, moving())
    # Without a warning.
    assert resample(cast(Any, path), velocities=True).velocities is not None
    assert resample(read(path), velocities=True).velocities is not None


@pytest.mark.realdata
def test_velocities_of_a_gallop(data: Path, tmp_path: Path) -> None:
    """Written velocities are central differences of the model in time.

    Of most vertices: in a joint that is about to fold some turn so sharply that differences tell nothing of them.
    """
    path = tmp_path / "wolf.usdc"
    wolf = read(data / "npz" / "q_wolf_gallop.npz")
    model = mixseq.fit(MeshSequence.from_header(wolf.header.with_times(wolf.times[:14]), wolf.points[:14]), exact=True)
    planned = plan(model, start=0.2, end=0.23, speed=0.5)
    points, velocities = unzip_blocks(planned.moving_blocks())
    write_blocks(path, planned.header, points, velocities)
    written = read(path)
    assert written.velocities is not None
    assert len(written.velocities) == 3
    step = 1e-5
    for time, velocity in zip(planned.header.times, written.velocities, strict=True):
        ahead, behind = (model(planned.retiming([time]).item() + 0.5 * side * step) for side in (1, -1))
        differences = (ahead - behind) / (2 * step)
        errors = np.linalg.norm(velocity - differences, axis=1)
        assert np.quantile(errors, 0.8) <= 1e-5 * np.linalg.norm(differences, axis=1).max()


def test_nothing_else_is_left_behind(path: Path) -> None:
    write(path, moving())
    copy = path.with_stem("copy")
    shutil.copy(path, copy)
    write(path, moving().with_points(moving().points))
    assert read(path).velocities is None
    assert read(copy).velocities is not None
