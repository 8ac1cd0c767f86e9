"""Rotation-invariant coordinates: blind to rigid motions, exact at frames, bends that halve."""

from __future__ import annotations

import pickle
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mixseq
from mixseq.errors import SettingsError
from mixseq.mesh.topology import Topology
from mixseq.sequence.sequence import MeshSequence
from mixseq.spaces.lri import LRISpace
from mixseq.types import Float, FloatArray, IntArray
from tests.meshes import SEQUENCES, Mesh, grid, rigid_motions, rotation, tetrahedron, torus, tube

pytestmark = pytest.mark.slow

AWKWARD = ("folding sheet", "inconsistent", "zero area", "bowtie", "three pages")


def space_of(points: FloatArray, faces: IntArray) -> LRISpace:
    scale = float(np.linalg.norm(np.ptp(points[0], axis=0))) or 1.0
    return LRISpace(Topology(faces, points.shape[1]), scale, points[0].astype(np.float64) / scale)


def error(space: LRISpace, points: FloatArray, decoded: Float) -> float:
    return float(np.abs(decoded - points).max() / space.scale)


@cache
def made(name: str) -> tuple[MeshSequence, LRISpace]:
    sequence = SEQUENCES[name]()
    return sequence, space_of(sequence.points, sequence.faces)


@pytest.mark.parametrize("name", SEQUENCES)
def test_frames_come_back(name: str) -> None:
    sequence, space = made(name)
    assert error(space, sequence.points, space.decode(space.encode(sequence.points))) < 1e-10


@pytest.mark.parametrize("name", ["bar", "several components", "repeated corners", "bowtie"])
def test_encoding_block_by_block_is_encoding(name: str) -> None:
    sequence, space = made(name)
    whole = space.encode(sequence.points)
    second = space.encode(sequence.points[2:], previous=whole[1])
    np.testing.assert_array_equal(np.concatenate([space.encode(sequence.points[:2]), second]), whole)


@settings(max_examples=15, deadline=None)
@given(motion=rigid_motions, name=st.sampled_from(("bar", *AWKWARD)), frame=st.integers(0, 4))
def test_rigid_motions_change_poses_only(motion: tuple[Float, Float], name: str, frame: int) -> None:
    turn, shift = motion
    sequence, space = made(name)
    points = sequence.points[frame]
    still, moved = space.encode(points[None]), space.encode((points @ turn.T + shift)[None])
    np.testing.assert_allclose(moved[:, : space.shape_dim], still[:, : space.shape_dim], atol=1e-9)
    np.testing.assert_allclose(space.decode(moved)[0], points @ turn.T + shift, atol=1e-9)


@pytest.mark.parametrize("name", SEQUENCES)
def test_frames_of_vertices_are_rotations(name: str) -> None:
    sequence, space = made(name)
    for points in (sequence.points[-1], sequence.points[0] * [1, 0, 0], 0 * sequence.points[0]):
        frames = space.vertex_frames(points[space.pieces.vertex_of_row].astype(np.float64))
        products = np.swapaxes(frames, 1, 2) @ frames
        np.testing.assert_allclose(products, np.tile(np.eye(3), (len(frames), 1, 1)), atol=1e-10)
        np.testing.assert_allclose(np.linalg.det(frames), 1, atol=1e-10)


@pytest.mark.parametrize("squeeze", [(1.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 1e-5, 1e-5)])
def test_meshes_without_area_come_back(squeeze: tuple[float, float, float]) -> None:
    points, faces = tube(6, 5)
    turned = points @ rotation((0.3, 0.8, -0.4)).T
    thin = points * squeeze
    for frames in (np.stack([thin, turned]), np.stack([turned, thin])):
        space = space_of(frames, faces)
        assert np.abs(space.decode(space.encode(frames)) - frames).max() < 1e-9


def test_coordinates_of_a_sheet() -> None:
    """On z = 0 frames turn about z only, edges have no height, and the first axis is along the longest edge."""
    points, faces = grid(3, 4)
    space = space_of(points[None], faces)
    rows = points / space.scale
    frames = space.vertex_frames(rows)
    np.testing.assert_allclose(frames[:, :, 2], np.tile([0, 0, 1.0], (len(points), 1)), atol=1e-14)
    inner = 6  # with edges along x, y, and the diagonals x = y
    np.testing.assert_allclose(np.abs(frames[inner, :, 0]), [np.sqrt(0.5), np.sqrt(0.5), 0], atol=1e-14)
    shape = space.measure_shape(rows)
    count = len(space.edge_rows)
    connections, ends = shape[: 9 * count].reshape(-1, 3, 3), shape[9 * count :].reshape(-1, 2, 3)
    np.testing.assert_allclose(connections[:, 2], np.tile([0, 0, 1.0], (count, 1)), atol=1e-14)
    np.testing.assert_allclose(ends[:, :, 2], 0, atol=1e-14)
    lengths = np.linalg.norm(rows[space.edge_rows[:, 1]] - rows[space.edge_rows[:, 0]], axis=1)
    np.testing.assert_allclose(np.linalg.norm(ends, axis=2), np.stack([lengths, lengths], axis=1))
    assert space.dim == 15 * len(space.topology.edges) + 7


@pytest.mark.parametrize("mesh", [tetrahedron(), torus(7, 5), tube(5, 4)], ids=["tetrahedron", "torus", "tube"])
def test_half_way_to_three_times_the_size_is_twice_the_size(mesh: Mesh) -> None:
    turn = np.array([0.6, -1.2, 0.3])
    centred = mesh[0] - mesh[0].mean(axis=0)
    points = np.stack([centred, 3 * centred @ rotation(turn).T + [1.0, 0, 0]])
    space = space_of(points, mesh[1])
    half = space.decode(space.encode(points).mean(axis=0, keepdims=True))[0]
    np.testing.assert_allclose(half, 2 * centred @ rotation(turn / 2).T + [0.5, 0, 0], atol=1e-12)


def arc(sheet: Float, angle: float) -> Float:
    """Roll a sheet of length 8 along x into an arc."""
    radius = 8 / angle
    turned = sheet[:, 0] / radius
    return np.stack([radius * np.sin(turned), sheet[:, 1], radius * (1 - np.cos(turned))], axis=1)


def test_half_way_to_a_half_circle_is_a_quarter_circle() -> None:
    """Vertices that are averaged shorten the sheet by far more."""
    sheet, faces = grid(2, 24)
    sheet = sheet * [8 / 24, 0.5, 1]
    points = np.stack([arc(sheet, 1e-9), arc(sheet, np.pi)])
    space = space_of(points, faces)
    half = space.decode(space.encode(points).mean(axis=0, keepdims=True))
    wanted = arc(sheet, np.pi / 2)

    def distance(x: Float) -> float:
        aligned = space.pieces.place(x / space.scale, *space.pieces.measure_poses(wanted / space.scale))
        return error(space, wanted, aligned * space.scale)

    assert distance(half[0]) < 0.005
    assert distance(points.mean(axis=0)) > 0.05


def test_blends_that_are_no_rotations_decode() -> None:
    """A bar and one that is bent the other way round: connections between them are short."""
    sequence, space = made("bar")
    vectors = space.encode(sequence.points)
    for weights in ([0.5, 0, 0, 0, 0.5], [2.0, 0, 0, 0, -1.0], [-0.5, 0, 0, 0, 1.5]):
        decoded = space.decode((np.array(weights) @ vectors)[None])
        assert np.isfinite(decoded).all()
        assert error(space, sequence.points[2], decoded) < 3


def test_the_metric_is_in_diagonals() -> None:
    """Where a frame of a triangle turns by one radian, the corners next to it move by about the sides' lengths."""
    points, faces = np.array([[0.0, 0, 0], [3, 0, 0], [0, 4, 0]]), np.array([[0, 1, 2]])
    space = space_of(points[None], faces)
    weights = space.weights
    assert weights.shape == (space.dim,) == (3 * 15 + 7,)
    np.testing.assert_allclose(weights[:27], np.repeat([0.6, 0.8, 1.0], 9) * np.sqrt(0.5))
    np.testing.assert_allclose(weights[27:45], np.sqrt(0.5))
    np.testing.assert_allclose(weights[45:49], 2 * space.pieces.radii[0])
    np.testing.assert_allclose(weights[49:], 1)


def test_edges_of_repeated_corners_have_no_coordinates() -> None:
    topology = Topology(np.array([[0, 1, 2], [0, 0, 1], [3, 3, 3]]), 4)
    points = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 2, 2]]])
    space = LRISpace(topology, 1.0, points[0])
    assert space.edge_rows.tolist() == [[0, 1], [0, 2], [1, 2]]
    np.testing.assert_allclose(space.decode(space.encode(points)), points, atol=1e-13)


def test_a_pickled_space_is_the_same() -> None:
    sequence, space = made("bar")
    vectors = space.encode(sequence.points[1:2])
    decoded = space.decode(vectors)
    copy = pickle.loads(pickle.dumps(space))
    np.testing.assert_array_equal(copy.decode(vectors), decoded)


def test_vectors_of_other_spaces_are_refused() -> None:
    _, space = made("bar")
    with pytest.raises(SettingsError, match=rf"vectors have shape \(1, 5\); \(T, {space.dim}\) is expected"):
        space.decode(np.zeros((1, 5)))


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["lion_poses", "cat_poses", "horse_poses", "horse_gallop", "fox_run"])
def test_real_frames_come_back(data: Path, name: str) -> None:
    sequence = mixseq.read(data / "npz" / f"{name}.npz")
    space = space_of(sequence.points, sequence.faces)
    some = sequence.points[:: max(1, sequence.frame_count // 2)]
    assert error(space, some, space.decode(space.encode(some))) < 1e-9
