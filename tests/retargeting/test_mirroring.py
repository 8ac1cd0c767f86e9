"""Mirrored partners: exact on symmetric bodies, on the correct bone in other poses."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.mesh.topology import Topology
from mixseq.retargeting.proposals import Mirror
from tests.meshes import joined, topology_of, torus, tube
from tests.retargeting.foxes import on_bones, short, tall

pytestmark = pytest.mark.slow

PAIRED = ("ear", "cheek", "forepaw", "forearm", "shank", "hindpaw")
"""Bones beside the middle."""


def test_a_walking_fox() -> None:
    for fox in (short(), tall()):
        mirror = Mirror.from_poses(fox.points[None], fox.topology)
        assert mirror is not None
        for side, other in ("lr", "rl"):
            for bone, vertex in zip(PAIRED, on_bones(fox, *(f"{each}.{side}" for each in PAIRED)), strict=True):
                partner = mirror.find_partner(int(vertex))
                if partner is not None:
                    assert fox.bones[partner].endswith(f".{other}"), bone
                    assert fox.bones[partner].split(".")[0] in (bone, *neighbours(bone))
        assert (
            sum(mirror.find_partner(int(v)) is not None for v in on_bones(fox, "ear.l", "forepaw.l", "hindpaw.l")) == 3
        )


def neighbours(bone: str) -> tuple[str, ...]:
    """Bones that begin where this one ends."""
    chains = (("arm", "forearm", "forepastern", "forepaw"), ("thigh", "shank", "hindpastern", "hindpaw"))
    for chain in chains:
        if bone in chain:
            place = chain.index(bone)
            return chain[max(place - 1, 0) : place + 2]
    return ("head",)


def test_middle_vertices_have_no_partner() -> None:
    fox = short()
    mirror = Mirror.from_poses(fox.points[None], fox.topology)
    assert mirror is not None
    assert mirror.find_partner(int(on_bones(fox, "nose")[0])) is None
    assert mirror.find_partner(int(on_bones(fox, "tail4")[0])) is None


def test_partners_do_not_depend_on_place_and_unit() -> None:
    fox = short()
    one, other = (
        Mirror.from_poses(fox.points[None], fox.topology),
        Mirror.from_poses(50 * fox.points[None] + 3, fox.topology),
    )
    assert one is not None
    assert other is not None
    vertices = range(0, len(fox.points), 40)
    assert [one.find_partner(v) for v in vertices] == [other.find_partner(v) for v in vertices]


def test_other_components_have_no_partners() -> None:
    fox, hat = short(), tube(8, 4)
    points, faces = joined((fox.points, fox.mesh.faces.astype(np.int64)), (0.05 * hat[0] + [0.3, 1.1, 0], hat[1]))
    mirror = Mirror.from_poses(points[None], Topology(faces, len(points)))
    assert mirror is not None
    assert mirror.find_partner(len(fox.points) + 3) is None


@pytest.mark.parametrize("mesh", [torus(20, 12), tube(12, 30)])
def test_bodies_without_limbs_have_no_sides(mesh: tuple[np.ndarray, np.ndarray]) -> None:
    mirror = Mirror.from_poses(mesh[0][None], topology_of(mesh))
    assert mirror is None
