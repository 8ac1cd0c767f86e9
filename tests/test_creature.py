"""The walking fox: a closed, even, well-behaved mesh, and a plausible gait."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from threadpoolctl import threadpool_limits

from mixseq import creature
from mixseq.creature import (
    BONE_HEADS,
    BONE_NAMES,
    BONE_PARENTS,
    BONE_TAILS,
    BONES,
    LEGS,
    STANCE_FRACTION,
    STANCE_TRAVEL_METRES,
    body_distance,
    bone_distances,
    part_of_vertex,
    paw_path,
    polygonise,
    pose_skeleton,
    walk_cycle,
)
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import FloatArray


@pytest.fixture(scope="module")
def fox() -> MeshSequence:
    return walk_cycle()


def directed_edges(faces: NDArray[np.int32]) -> NDArray[np.int64]:
    return np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2).astype(np.int64)


def min_angles(points: FloatArray, faces: NDArray[np.int32]) -> FloatArray:
    corners = points[faces]
    ahead, behind = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    cosine = np.sum(ahead * behind, axis=2) / np.linalg.norm(ahead, axis=2) / np.linalg.norm(behind, axis=2)
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1, 1))).min(axis=1))


def volumes(points: FloatArray, faces: NDArray[np.int32]) -> FloatArray:
    a, b, c = np.moveaxis(points[:, faces], 2, 0)
    return np.asarray(np.sum(a * np.cross(b, c), axis=(1, 2)) / 6)


def test_is_one_closed_oriented_surface_of_genus_zero(fox: MeshSequence) -> None:
    edges = directed_edges(fox.faces)
    keys, opposite = edges @ [fox.vertex_count, 1], edges @ [1, fox.vertex_count]
    assert len(np.unique(keys)) == len(keys)
    assert np.array_equal(np.sort(keys), np.sort(opposite))
    assert fox.vertex_count - len(edges) // 2 + len(fox.faces) == 2
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(fox.vertex_count,) * 2)
    assert connected_components(graph)[0] == 1


def test_faces_around_every_vertex_form_one_fan(fox: MeshSequence) -> None:
    # around a vertex, each face leads from one neighbour to the next: one cycle per vertex
    corners = np.concatenate([np.roll(fox.faces, -k, axis=1) for k in range(3)]).astype(np.int64)
    spokes = np.unique(corners[:, 0] * fox.vertex_count + corners[:, 1])
    start = np.searchsorted(spokes, corners[:, 0] * fox.vertex_count + corners[:, 1])
    end = np.searchsorted(spokes, corners[:, 0] * fox.vertex_count + corners[:, 2])
    graph = coo_array((np.ones(len(start)), (start, end)), shape=(len(spokes),) * 2)
    assert connected_components(graph)[0] == fox.vertex_count


def test_size_and_units(fox: MeshSequence) -> None:
    assert fox.points.shape == (48, fox.vertex_count, 3)
    assert 3000 <= fox.vertex_count <= 6000
    assert (fox.fps, fox.up_axis, fox.metres_per_unit) == (24.0, "Y", 1.0)
    assert 0.9 < np.ptp(fox.points[0, :, 1]) < 1.1
    assert fox.points[..., 1].min() == pytest.approx(0, abs=2e-3)


def test_volume_is_positive_and_steady(fox: MeshSequence) -> None:
    volume = volumes(fox.points, fox.faces)
    assert volume.min() > 0
    assert np.ptp(volume) < 0.05 * volume.mean()


def test_two_calls_agree_and_do_not_share_memory(fox: MeshSequence) -> None:
    again = walk_cycle()
    assert np.array_equal(fox.points, again.points)
    assert fox.polygons.same_as(again.polygons)
    assert not np.shares_memory(fox.points, again.points)


def test_loops_without_a_jump(fox: MeshSequence) -> None:
    around = np.concatenate([fox.points, fox.points[:3]])
    velocity = np.linalg.norm(np.diff(around, axis=0), axis=2).max(axis=1)
    jerk = np.linalg.norm(np.diff(around, n=2, axis=0), axis=2).max(axis=1)
    assert velocity[47] < 1.1 * velocity[:47].max()
    assert jerk[46:48].max() <= 1.1 * jerk[:46].max()


def test_more_frames_show_the_same_walk(fox: MeshSequence) -> None:
    assert np.allclose(walk_cycle(frames=96, fps=48).points[::2], fox.points, atol=1e-12)


def test_triangles_are_even(fox: MeshSequence) -> None:
    assert (min_angles(fox.points[0], fox.faces) > 20).mean() > 0.995
    for pose_points in fox.points[::6]:
        angles = min_angles(pose_points, fox.faces)
        assert (angles > 10).mean() > 0.998
        assert angles.min() > 0.5


def test_edges_keep_their_length(fox: MeshSequence) -> None:
    edges = directed_edges(fox.faces)
    lengths = np.linalg.norm(fox.points[:, edges[:, 0]] - fox.points[:, edges[:, 1]], axis=2)
    strain = lengths / np.median(lengths, axis=0)
    assert ((strain > 0.5) & (strain < 2)).mean() > 0.999
    assert strain.min() > 0.05


def test_middle_of_each_limb_is_nearly_rigid(fox: MeshSequence) -> None:
    rotations, heads = pose_skeleton(np.arange(48) / 48)
    part, names = part_of_vertex()
    for name in ("arm.l", "forearm.r", "thigh.l", "shank.r", "head", "tail3", "belly"):
        bone = names.index(name)
        # where its vertices are as seen from the bone: they hardly move
        offset = fox.points[:, part == bone] - heads[:, None, bone]
        local = np.einsum("tji,tvj->tvi", rotations[:, bone], offset)
        along = local[0] @ (BONE_TAILS - BONE_HEADS)[bone] / np.sum((BONE_TAILS - BONE_HEADS)[bone] ** 2)
        wobble = np.ptp(local, axis=0).max(axis=1)
        assert np.median(wobble[np.abs(along - 0.5) < 0.15]) < 0.01, name


def test_every_bone_has_vertices(fox: MeshSequence) -> None:
    part, names = part_of_vertex()
    assert part.shape == (fox.vertex_count,)
    assert len(names) >= 15
    assert np.bincount(part, minlength=len(names)).min() >= 4


def test_planted_paws_move_with_the_ground(fox: MeshSequence) -> None:
    part, names = part_of_vertex()
    phase = np.arange(48) / 48
    speed = STANCE_TRAVEL_METRES / STANCE_FRACTION / 48  # metres per frame
    for leg in LEGS:
        paw = np.flatnonzero(part == names.index(leg.paw))
        sole = paw[np.argsort(fox.points[:, paw, 1].mean(axis=0))[:5]]
        # the heel rises in late stance, so look where the whole sole is down
        flat = np.flatnonzero((phase - leg.landing) % 1.0 < 0.8 * STANCE_FRACTION)
        flat = flat[np.isin((flat + 1) % 48, flat)]
        steps = fox.points[(flat + 1) % 48][:, sole] - fox.points[flat][:, sole]
        assert np.abs(steps[..., 0] + speed).max() < 0.15 * speed
        assert np.abs(steps[..., 1:]).max() < 0.15 * speed
        assert np.abs(fox.points[flat][:, sole, 1]).max() < 0.02


def test_walk_always_has_two_or_three_paws_down() -> None:
    phase = np.linspace(0, 1, 200, endpoint=False)
    down = sum(((phase - leg.landing) % 1.0 < STANCE_FRACTION).astype(int) for leg in LEGS)
    assert set(np.unique(down)) <= {2, 3}
    assert [leg.paw for leg in LEGS] == ["hindpaw.l", "forepaw.l", "hindpaw.r", "forepaw.r"]


def test_paw_path_is_periodic_and_smooth() -> None:
    phase = np.linspace(-1, 1, 4001)
    for curve in paw_path(phase):
        assert np.allclose(curve, [*np.roll(curve[:-1], 2000), curve[0]], atol=1e-9)
        assert np.abs(np.diff(curve)).max() < 0.02


def test_bones_keep_their_length_and_stay_connected() -> None:
    rotations, heads = pose_skeleton(np.linspace(0, 1, 97))
    assert np.allclose(rotations @ np.swapaxes(rotations, 2, 3), np.eye(3))
    assert np.allclose(np.linalg.det(rotations), 1)
    for bone, parent in list(enumerate(BONE_PARENTS))[1:]:
        joint = heads[:, parent] + rotations[:, parent] @ (BONE_HEADS[bone] - BONE_HEADS[parent])
        assert np.allclose(joint, heads[:, bone], atol=1e-9), BONE_NAMES[bone]


def test_bone_distance_of_known_points() -> None:
    bone = BONES[0]
    along, up = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
    head = np.array(bone.head)
    distances = bone_distances(np.stack([head, head - along, head + up]))[:, 0]
    assert distances[0] == pytest.approx(-bone.head_radius, abs=1e-3)
    assert distances[1] == pytest.approx(1 - bone.head_radius, abs=2e-3)
    assert distances[2] == pytest.approx(1 - bone.head_radius, abs=1e-2)


def test_body_encloses_every_bone() -> None:
    assert body_distance(BONE_HEADS).max() < 0
    assert body_distance(BONE_TAILS).max() < 0


def test_polygonise_makes_a_sphere() -> None:
    def sphere(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.linalg.norm(points, axis=-1) - 1)

    points, faces = polygonise(sphere, np.full(3, -1.3), np.full(3, 1.3), 0.1)
    assert np.allclose(np.linalg.norm(points, axis=1), 1, atol=1e-4)
    assert volumes(points[None], faces.astype(np.int32))[0] == pytest.approx(4 / 3 * np.pi, rel=0.01)
    assert min_angles(points, faces.astype(np.int32)).min() > 20


def test_threads_do_not_matter() -> None:
    def made(threads: int) -> bytes:
        creature._rest_mesh.cache_clear()
        with threadpool_limits(threads):
            return walk_cycle(4).points.tobytes()

    assert made(1) == made(2)
