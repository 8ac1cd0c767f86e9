"""The free placement: where parts and joints go, from lengths and angles alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixseq.mesh.rigid import kabsch, transform_points
from mixseq.mesh.rotations import matrix_to_quat, quat_multiply
from mixseq.spaces.mixed.assembly import FreeFrame
from mixseq.spaces.mixed.mixed_space import MixedSpace
from mixseq.types import Float
from tests.meshes import rotation
from tests.spaces.mixed.made import error, sequence_of, space_of


def rms(differences: Float) -> float:
    return float(np.sqrt(np.mean(differences**2)))


def frame_of(space: MixedSpace, vector: Float) -> FreeFrame:
    blocks = space.split(vector[None])
    return FreeFrame(blocks.lengths[0], blocks.angles[0], blocks.rest_vertices[0], space.skin(vector[None])[0])


def test_half_way_the_joint_bends_by_half() -> None:
    """Averaged vertices, which shorten and fold what turns, are the yardstick."""
    space, points = space_of("bar", "free"), sequence_of("bar").points
    middle = space.encode(points)[[0, 4]].mean(axis=0, keepdims=True)
    decoded = space.decode(middle)
    averaged = points[[0, 4]].mean(axis=0, keepdims=True)
    wanted, got, plain = (
        space.split(vectors)
        for vectors in (middle, space.encode(decoded, middle[0]), space.encode(averaged, middle[0]))
    )
    assert rms(got.angles - wanted.angles) < 0.4 * rms(plain.angles - wanted.angles)
    assert rms(got.lengths - wanted.lengths) < 0.2 * rms(plain.lengths - wanted.lengths)


@pytest.mark.parametrize("name", ["bar", "rigid component", "several components"])
def test_how_parts_stand_to_each_other_does_not_matter(name: str) -> None:
    """But where one part of every component is: lengths and angles tell where the others are."""
    space, points = space_of(name, "free"), sequence_of(name).points
    vectors = space.encode(points[2:3])
    assembly, parts = space.assembly, len(space.decomposition.parts)
    seeds = {int(space.rigid_part_of_vertex[vertices[0]]) for vertices in assembly._seed_vertices}
    others = sorted(set(range(parts)) - seeds - {-1})
    assert others
    frame = frame_of(space, vectors[0])
    moved = frame.skinned_vertices.copy()
    for part in others:
        own = space.rigid_part_of_vertex == part
        moved[own] = moved[own] @ rotation((0.3, 0.1, -0.2)).T + 0.05
    held = np.unique(np.concatenate(assembly._seed_vertices))
    np.testing.assert_array_equal(moved[held], frame.skinned_vertices[held])
    found = assembly.assemble(frame._replace(skinned_vertices=moved)).points
    assert error(space, points[2] / space.scale, found) * space.scale < 1e-9


def test_bodies_turn_with_their_placement() -> None:
    space, points = space_of("rigid component", "free"), sequence_of("rigid component").points
    vectors = space.encode(points[1:2])
    blocks = space.split(vectors)
    turn = rotation((0.3, -1.0, 0.4))
    for body in range(space.rotation_count):
        turns, centres = blocks.body_rotations.copy(), blocks.body_centres.copy()
        turns[:, body] = quat_multiply(matrix_to_quat(turn), turns[:, body])
        centres[:, body] += [0.1, 0.2, -0.3]
        decoded = space.decode(space.join(blocks._replace(body_rotations=turns, body_centres=centres)))[0]
        own = np.isin(space.rigid_part_of_vertex, np.flatnonzero(space.articulation.body_of_part == body))
        there, here = decoded[own], points[1][own]
        np.testing.assert_allclose(kabsch(here, there)[0], turn, atol=1e-9)
        np.testing.assert_allclose(transform_points(here, *kabsch(here, there)), there, atol=1e-9)
        rest = np.isin(space.rigid_part_of_vertex, np.flatnonzero(space.articulation.body_of_part != body))
        np.testing.assert_allclose(decoded[rest], points[1][rest], atol=1e-9)


def test_vertices_of_no_face_are_posed() -> None:
    space, points = space_of("unused vertices", "free"), sequence_of("unused vertices").points
    loose = space.topology.unused_vertices
    assert len(loose) == 3
    blend = space.encode(points)[[0, 2]].mean(axis=0, keepdims=True)
    np.testing.assert_array_equal(space.decode(blend)[0, loose], space.skin(blend)[0, loose] * space.scale)


def test_steps_make_lengths_and_angles_agree() -> None:
    """They lower the energy, and none is taken where there is nothing to do."""
    space = space_of("bar", "free")
    vectors = space.encode(sequence_of("bar").points)
    half, first = (frame_of(space, vector) for vector in (vectors[[0, 4]].mean(axis=0), vectors[0]))
    with_steps = {n: replace(space, projection=replace(space.projection, steps=n)).assembly for n in (0, 6, 10, 100)}
    none, few, many = (with_steps[n].assemble(half).energy for n in (0, 10, 100))
    assert many <= 1.001 * few < 0.5 * none
    still, moved = (with_steps[n].assemble(first) for n in (0, 6))
    np.testing.assert_array_equal(still.points, moved.points)


def test_rigid_parts_stay_rigid_at_the_start() -> None:
    """Before steps are taken: each is its unposed vertices, turned."""
    space = space_of("bar", "free")
    plain = replace(space, projection=replace(space.projection, steps=0))
    blend = plain.encode(sequence_of("bar").points)[[0, 4]].mean(axis=0)
    points, frame = plain.decode(blend[None])[0] / plain.scale, frame_of(plain, blend)
    for part in plain.assembly._rigid_parts:
        here = frame.rest_vertices[part]
        np.testing.assert_allclose(transform_points(here, *kabsch(here, points[part])), points[part], atol=2e-2)
