"""Where transforms place a mesh, and how fast."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("imath")
from mixseq.errors import FormatError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import MeshObject, Surface
from mixseq.sequence.header import SequenceHeader
from mixseq_io.alembic.samples import MeshTransform
from mixseq_io.alembic.writer import choose_paths
from mixseq_io.scene_meshes import split_meshes
from tests.formats.alembic.alembic_maker import SQUARE, shift


def turning(angle: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:2, :2] = [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
    return matrix


def test_to_own_space_and_back() -> None:
    placing = MeshTransform(shift(x=1, scale=(2, 2, 4))[None], np.zeros((1, 4, 4)))
    own = placing.to_mesh_points(SQUARE, 0)
    np.testing.assert_allclose(own, (SQUARE - [1, 0, 0]) / [2, 2, 4])
    speeds = placing.to_mesh_velocities(np.ones_like(SQUARE), own, 0)
    np.testing.assert_allclose(speeds, np.tile([0.5, 0.5, 0.25], (4, 1)))
    np.testing.assert_allclose(placing.to_world_velocities(speeds, own, 0), 1)


def test_what_rests_on_what_turns_moves_in_circles() -> None:
    """A quarter turn, at one radian per second: x' is (-y, x)."""
    rate = turning(np.pi)  # the derivative of a rotation is the rotation a quarter turn later
    rate[2, 2] = rate[3, 3] = 0
    placing = MeshTransform(turning(np.pi / 2)[None], rate[None])
    world = SQUARE @ turning(np.pi / 2)[:3, :3]
    circling = np.stack([-world[:, 1], world[:, 0], 0 * world[:, 0]], axis=1)
    np.testing.assert_allclose(placing.to_mesh_velocities(circling, SQUARE, 0), 0, atol=1e-7)
    np.testing.assert_allclose(placing.to_world_velocities(0 * SQUARE, SQUARE, 0), circling, atol=1e-7)


def test_flat() -> None:
    MeshTransform(np.stack([np.eye(4), shift(scale=(1e-9, 1, 1))]), np.zeros((2, 4, 4))).check_invertible()
    for matrix in (shift(scale=(1, 0, 1)), np.full((4, 4), np.nan)):
        with pytest.raises(FormatError, match="flat in frame 1"):
            MeshTransform(np.stack([np.eye(4), matrix]), np.zeros((2, 4, 4))).check_invertible()


# Where meshes are in an archive of their own


def places(name: str, *paths: str) -> list[str]:
    objects = tuple(MeshObject(path.rpartition("/")[2], path, 3, 1) for path in paths)
    header = SequenceHeader(
        polygons=Polygons.from_triangles(np.arange(3 * len(paths)).reshape(-1, 3)),
        vertex_count=3 * len(paths),
        times=np.zeros(1),
        name=name,
        surface=Surface(objects=objects),
    )
    return ["/" + "/".join(place) for place in choose_paths(header, split_meshes(header))]


@pytest.mark.parametrize(
    ("name", "paths"),
    [
        ("body", ["/rig/body/body"]),
        ("rig", ["/rig/body/body", "/rig/sword/sword"]),
        ("shot", ["/body/body", "/sword/sword"]),
    ],
)
def test_paths_are_kept(name: str, paths: list[str]) -> None:
    assert places(name, *paths) == paths


@pytest.mark.parametrize(
    ("name", "paths", "expected"),
    [
        ("body", ["/body"], ["/body/body"]),  # without a transform tools have no name for it
        ("hero", ["/rig/body/body"], ["/hero/hero"]),  # the name is read from the path
        ("rig", ["Root/body", "Root/hat"], ["/rig/body/body", "/rig/hat/hat"]),  # of glTF
        ("rig", ["/rig/body", "/rig/body/hat"], ["/rig/body/body", "/rig/hat/hat"]),
        ("rig", ["/rig/body", "/rig/body"], ["/rig/body/body", "/rig/body_2/body_2"]),
        ("rig", ["/rig//body", "/rig/hat"], ["/rig/body/body", "/rig/hat/hat"]),
    ],
)
def test_other_paths_are_made(name: str, paths: list[str], expected: list[str]) -> None:
    assert places(name, *paths) == expected
