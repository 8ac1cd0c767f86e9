"""glTF files in: creatures whose points others have baked."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import KDTree

from mixseq.sequence.sequence import MeshSequence
from tests.formats.gltf_maker import load

pytestmark = pytest.mark.slow


def like(baked: NDArray[np.float32], got: MeshSequence) -> NDArray[np.intp]:
    """Return the vertex of `got` at every baked vertex of frame 0."""
    nearest = np.asarray(KDTree(got.points[0]).query(baked[0])[1], dtype=np.intp)
    assert np.unique(nearest).size == got.vertex_count
    return nearest


def sorted_faces(faces: NDArray[np.integer[Any]]) -> list[list[int]]:
    """Return faces that have an area, each from its smallest vertex on, in order."""
    whole = [face for face in faces.tolist() if len(set(face)) == 3]
    return sorted(face[face.index(min(face)) :] + face[: face.index(min(face))] for face in whole)


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("file", "animation", "fps", "baked"),
    [
        ("KhronosFox", "Survey", None, "fox_survey"),
        ("KhronosFox", "Run", 48, "fox_run"),
        ("Horse", "AnimalArmature|Gallop", 48, "q_horse_gallop"),
        ("Horse", "AnimalArmature|Eating", 12, "q_horse_eating"),
        ("Wolf", "AnimalArmature|Gallop", 48, "q_wolf_gallop"),
        ("Wolf", "AnimalArmature|Attack", 30, "q_wolf_attack"),
        ("Trex", "Armature|TRex_Run", 30, "q_trex_run"),
        ("RobotExpressive", "Dance", None, "robotexpressive_dance"),
    ],
)
def test_creatures_are_as_others_have_baked_them(
    data: Path, file: str, animation: str, fps: float | None, baked: str
) -> None:
    got = load(data / "gltf" / f"{file}.glb", animation=animation, fps=fps, prim="/")
    with np.load(data / "npz" / f"{baked}.npz") as arrays:
        points, faces = arrays["points"], arrays["faces"]
    assert got.vertex_count == points.shape[1]
    nearest = like(points, got)
    assert sorted_faces(nearest[faces]) == sorted_faces(got.faces)
    # Where the last key is between two frames, others have one more, which holds the last key.
    assert len(points) - got.frame_count in (0, 1)
    diagonal = np.linalg.norm(np.ptp(points[0], axis=0))
    errors = np.linalg.norm(got.points[:, nearest] - points[: got.frame_count], axis=2) / diagonal
    assert errors.max() < 1e-6
    if len(points) > got.frame_count:
        last = load(data / "gltf" / f"{file}.glb", animation=animation).points[-1, nearest]
        assert np.abs(last - points[-1]).max() / diagonal < 1e-6


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("file", "vertices", "frames", "objects"),
    [
        ("CesiumMan", 2338, 49, ["node 0/node 1"]),
        ("RiggedFigure", 130, 31, ["node 0/node 1"]),
        ("RiggedSimple", 96, 50, ["node 0/node 1"]),
    ],
)
def test_other_characters(data: Path, file: str, vertices: int, frames: int, objects: list[str]) -> None:
    got = load(data / "gltf" / f"{file}.glb")
    assert (got.vertex_count, got.frame_count) == (vertices, frames)
    assert [each.path for each in got.objects] == objects
    assert np.linalg.norm(np.ptp(got.points, axis=0), axis=1).max() > 0.01


@pytest.mark.realdata
def test_horns_that_hang_on_a_bone(data: Path) -> None:
    got = load(data / "gltf" / "Stag.glb", animation=0)
    assert [(each.name, each.vertex_count) for each in got.objects] == [("Stag_Horns", 818), ("Stag", 1027)]
    assert got.name == "RootNode"
    # The horns touch the head in all frames.
    horns, body = got.points[:, :818], got.points[:, 818:]
    gaps = [np.linalg.norm(one[:, None] - two, axis=2).min() for one, two in zip(horns, body, strict=True)]
    assert max(gaps) < 0.1
