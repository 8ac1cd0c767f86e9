"""Alembic, reading: when frames are, and where points are in them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

imath = pytest.importorskip("imath")
from alembic3d import Abc, AbcCoreAbstract, AbcGeom  # noqa: E402

from mixseq.errors import InvalidSequenceError, MixseqWarning  # noqa: E402
from mixseq.mesh.measures import corner_normals  # noqa: E402
from mixseq.mesh.rotations import rotvec_to_matrix  # noqa: E402
from mixseq.mesh.surface import MeshObject  # noqa: E402
from tests.formats.alembic.alembic_maker import (  # noqa: E402
    CLOCKWISE,
    SQUARE,
    TRIANGLES,
    Scope,
    acyclic,
    add_mesh,
    add_transform,
    filled,
    load,
    positions,
    rising,
    save_mesh,
    shift,
)


def test_faces_are_turned_counter_clockwise(path: Path) -> None:
    save_mesh(path, "square", rising())
    got = load(path)
    assert got.polygons.same_as(TRIANGLES)
    np.testing.assert_array_equal(got.points, rising())
    np.testing.assert_array_equal(got.times, [0, 0.5, 1])
    assert (got.fps, got.name, got.up_axis, got.metres_per_unit) == (2, "square", "Y", 1)
    assert got.surface.objects == (MeshObject("square", "/square", 4, 2),)
    assert corner_normals(got.points, got.polygons)[0].tolist() == [[0, 0, 1]] * 4


@pytest.mark.parametrize(
    ("sampling", "times", "fps"),
    [
        (lambda: AbcCoreAbstract.TimeSampling(1001 / 30000, 1.0), 1 + np.arange(3) * 1001 / 30000, 30000 / 1001),
        (lambda: acyclic(-1, 0.5, 7 / 3), [-1, 0.5, 7 / 3], 24),
        (lambda: acyclic(0, 1 / 25, 4 / 25), [0, 1 / 25, 4 / 25], 25),
        (lambda: acyclic(-0.2, 0, 0.2, 0.7, 9), [-0.2, 0, 0.2], 5),
        (lambda: AbcCoreAbstract.TimeSampling(1 / 24, 1e6), 1e6 + np.arange(3) / 24, 24),
    ],
    ids=["uniform", "acyclic", "acyclic on a time line", "acyclic with a pre-roll", "uniform and late"],
)
def test_times(path: Path, sampling: Callable[[], Any], times: ArrayLike, fps: float) -> None:
    save_mesh(path, "square", rising(), sampling())
    got = load(path)
    np.testing.assert_allclose(got.times, np.asarray(times, np.float64), rtol=1e-15)
    assert got.fps == fps


def test_cycles_of_several_samples(path: Path) -> None:
    shutter = AbcCoreAbstract.TimeVector()
    shutter.extend([0.0, 0.125])
    archive = Abc.OArchive(str(path))
    cycles = AbcCoreAbstract.TimeSampling(AbcCoreAbstract.TimeSamplingType(2, 1.0), shutter)
    add_mesh(archive.getTop(), "square", rising(5), cycles)
    del archive
    got = load(path)
    np.testing.assert_array_equal(got.times, [0, 0.125, 1, 1.125, 2])
    np.testing.assert_array_equal(got.points, rising(5))


def test_frame_rate_of_the_application(path: Path) -> None:
    archive = Abc.CreateArchiveWithInfo(str(path), 24.0, "test", "")
    add_mesh(archive.getTop(), "square", rising(), AbcCoreAbstract.TimeSampling(1 / 48, 0))
    del archive
    assert load(path).fps == 24


def test_transforms_multiply_up_to_one_that_inherits_nothing(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    far = add_transform(archive.getTop(), "far", shift(100))
    middle = add_transform(far, "middle", shift(0, 10), inherits=False)
    near = add_transform(middle, "near", shift(0, 0, 1, scale=(2, 2, 2)))
    add_mesh(near, "square", rising())
    del archive, far, middle, near
    np.testing.assert_array_equal(load(path).points, 2 * rising() + np.array([0, 10, 1], np.float32))


def test_an_animated_transform_moves_a_still_mesh(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    transform = add_transform(archive.getTop(), "mover", shift(0), shift(1), shift(4), sampling=acyclic(0, 1, 3))
    add_mesh(transform, "square", SQUARE[None])
    del archive, transform
    got = load(path)
    np.testing.assert_array_equal(got.times, [0, 1, 3])
    np.testing.assert_array_equal(got.points[:, 0, 0], [0, 1, 4])


def test_between_samples_points_and_transforms_are_interpolated(path: Path) -> None:
    quarter = np.eye(4)
    quarter[:3, :3] = rotvec_to_matrix(np.array([0, 0, np.pi / 2])).T  # rows
    archive = Abc.OArchive(str(path))
    turn = add_transform(archive.getTop(), "turn", np.eye(4), quarter, sampling=acyclic(0, 1))
    add_mesh(turn, "square", rising(3), acyclic(0, 0.5, 2))
    del archive, turn
    got = load(path)
    np.testing.assert_array_equal(got.times, [0, 0.5, 1, 2])
    angle, height = np.array([0, 45, 90, 90]), np.array([0, 1, 4 / 3, 2])
    expected = np.stack([np.cos(np.radians(angle)), np.sin(np.radians(angle)), height], axis=1)
    np.testing.assert_allclose(got.points[:, 1], expected, atol=1e-7)


def test_transforms_are_sampled_at_times_of_their_own(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    slide = add_transform(archive.getTop(), "slide", shift(0), shift(10), sampling=acyclic(-1, 1))
    add_mesh(slide, "square", rising(3), acyclic(-0.5, 0, 0.5))
    del archive, slide
    got = load(path)
    np.testing.assert_array_equal(got.times, [-1, -0.5, 0, 0.5, 1])
    np.testing.assert_array_equal(got.points[:, 0, 0], [0, 2.5, 5, 7.5, 10])
    np.testing.assert_array_equal(got.points[:, 0, 2], [0, 0, 1, 2, 2])


def test_a_mirroring_transform_keeps_faces_outward(path: Path) -> None:
    def dress(sample: Any, frame: int) -> None:
        uvs = filled(imath.V2fArray, np.arange(12).reshape(6, 2))
        sample.setUVs(AbcGeom.OV2fGeomParamSample(uvs, Scope.kFacevaryingScope))

    archive = Abc.OArchive(str(path))
    mirror = add_transform(archive.getTop(), "mirror", shift(scale=(-1, 1, 1)))
    add_mesh(mirror, "square", rising(), dress=dress)
    del archive, mirror
    got = load(path)
    assert corner_normals(got.points, got.polygons)[0].tolist() == [[0, 0, 1]] * 4
    assert got.polygons.indices.tolist() == CLOCKWISE.tolist()
    assert got.surface.uvs is not None
    assert got.surface.uvs.at_corners.tolist() == np.arange(12).reshape(6, 2).tolist()


def test_a_transform_that_begins_to_mirror(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    mirror = add_transform(archive.getTop(), "mirror", np.eye(4), shift(scale=(-1, 1, 1)))
    add_mesh(mirror, "square", rising(2))
    del archive, mirror
    with pytest.raises(
        InvalidSequenceError, match=r"the frame at 0.5 s \(index 1\) of /mirror/square: the transform mirrors"
    ):
        load(path)


def test_a_transform_that_is_not_finite(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    lost = add_transform(archive.getTop(), "lost", np.eye(4), shift(np.inf), sampling=acyclic(0, 2))
    add_mesh(lost, "square", rising(3), acyclic(0, 1, 2))
    del archive, lost
    with pytest.raises(InvalidSequenceError, match=r"walk.abc: frame 1: vertex 0 is"):
        load(path)


def test_velocities_are_turned_as_points(path: Path) -> None:
    quarter = np.eye(4)
    quarter[:3, :3] = rotvec_to_matrix(np.array([0, 0, np.pi / 2])).T
    archive = Abc.OArchive(str(path))
    turn = add_transform(archive.getTop(), "turn", quarter)
    add_mesh(turn, "square", rising(), dress=lambda sample, k: sample.setVelocities(positions([[k, 0, 0]] * 4)))
    del archive, turn
    velocities = load(path).velocities
    assert velocities is not None
    np.testing.assert_allclose(velocities[:, 2], [[0, 0, 0], [0, 1, 0], [0, 2, 0]], atol=1e-7)


def test_velocities_under_a_moving_transform(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    mover = add_transform(archive.getTop(), "mover", shift(0), shift(1))
    add_mesh(mover, "square", rising(2), dress=lambda sample, _: sample.setVelocities(positions(SQUARE)))
    del archive, mover
    with pytest.warns(MixseqWarning, match="velocities of /mover/square do not contain the motion of its transforms"):
        assert load(path).velocities is None
