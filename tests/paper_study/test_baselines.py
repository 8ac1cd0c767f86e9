"""Interpolation methods of others, on meshes whose shapes in between are known."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import mixseq
from mixseq.mesh.measures import dihedral_angles, edge_lengths
from mixseq.mesh.topology import Topology
from mixseq.types import Float
from scripts.paper_study.common.baselines import (
    BASELINES,
    SIDES,
    Elastic,
    Geodesic,
    angle_gradients,
    membrane,
    membrane_roots,
    turned,
)
from scripts.paper_study.common.errors import errors
from scripts.paper_study.common.poses import Poses, apart, between
from scripts.paper_study.common.record import Results
from scripts.paper_study.stages.baselines import compared, page
from tests.meshes import bar, grid, rotation, topology_of, tube

MANY = ("ARAP", "NRIC", "geodesic")


def rolled(columns: int, angle: float) -> Float:
    """A strip of two rows, each of whose folds bends by an angle."""
    sides = np.cumsum(np.full(columns - 1, angle)) - angle
    x = np.concatenate([[0], np.cumsum(np.cos(sides))])
    z = np.concatenate([[0], np.cumsum(np.sin(sides))])
    return np.concatenate([np.stack([x, np.full(columns, y), z], axis=1) for y in (0.0, 1.0)])


def strip_poses(columns: int, angle: float) -> Poses:
    """A flat strip and one that is rolled up."""
    faces = grid(1, columns - 1)[1]
    frames = np.stack([rolled(columns, 0.0), rolled(columns, angle)])
    topology = Topology(faces, len(frames[0]))
    return Poses("lion", (0, 1), frames, cast(Any, SimpleNamespace(faces=faces, points=frames)), topology)


@pytest.mark.parametrize("name", MANY)
@pytest.mark.parametrize("weight", [0.25, 0.5])
def test_a_strip_that_is_folded_is_folded_by_the_share(name: str, weight: float) -> None:
    poses = strip_poses(6, 0.5)
    blend = BASELINES[name](poses, np.zeros(0, dtype=np.int64)).at(between(weight))
    found = errors(poses, between(weight), blend.points)
    assert np.abs(found.strain).max() < 1e-5 and np.abs(found.degrees).max() < 1e-3


@pytest.mark.parametrize("name", MANY)
def test_blends_do_not_depend_on_how_poses_are_turned(name: str) -> None:
    poses = strip_poses(6, 0.5)
    other = turned(poses, rotation((0.3, -1.9, 1.5)))
    blends = [BASELINES[name](each, np.zeros(0, dtype=np.int64)).at(between(0.5)).points for each in (poses, other)]
    assert apart(blends[0], blends[1]).max() < 1e-4


def test_bones_of_a_skin_turn_by_the_share() -> None:
    mesh = tube(6, 6)
    upper = mesh[0][:, 2] > 2

    def pose(angle: float) -> Float:
        x = np.array(mesh[0])
        x[upper] = (x[upper] - [0, 0, 2]) @ rotation((angle, 0.0, 0.0)).T + [0, 0, 2]
        return x

    frames = np.stack([pose(0.0), pose(1.0)])
    labels = np.zeros(len(mesh[1]), dtype=np.int64)
    sequence = mixseq.MeshSequence.from_arrays(np.stack([pose(a) for a in (0.0, 0.4, 0.8, 1.2)]), mesh[1])
    poses = Poses("lion", (0, 1), frames, sequence, topology_of(mesh))
    blend = BASELINES["skin"](poses, labels).at(between(0.5))
    assert apart(blend.points, pose(0.5)).max() < 5e-3


def test_angles_change_as_their_gradients_say() -> None:
    rng = np.random.default_rng(0)
    points, faces = tube(5, 4)
    x, topology = points + 0.05 * rng.normal(size=points.shape), Topology(faces, len(points))
    move, step = rng.normal(size=x.shape), 1e-6
    ends = [dihedral_angles(x + s * step * move, topology.hinges) for s in (1, -1)]
    slopes = (angle_gradients(x, topology.hinges) * move[topology.hinges]).sum(axis=(1, 2))
    np.testing.assert_allclose((ends[0] - ends[1]) / (2 * step), slopes, atol=1e-7)


def test_a_face_that_grows_has_the_energy_of_the_formula() -> None:
    a, c = np.array([[1.0, 1.0, 1.0]]), 1.3
    energy = c**2 + c**4 / 4 - 0.75 * np.log(c**4) - 1.25
    assert membrane(a, c**2 * a)[0] == pytest.approx(np.sqrt(3) / 4 * energy)
    assert membrane(a, a)[0] == pytest.approx(0, abs=1e-15)


def test_the_membrane_energy_changes_as_its_derivatives_say() -> None:
    rng = np.random.default_rng(1)
    a, b = (np.array([[1.0, 1.2, 0.9], [0.5, 0.7, 0.6]]) + 0.1 * rng.random((2, 3)) for _ in range(2))
    move, step = rng.normal(size=a.shape), 1e-6
    _, to_a, to_b = membrane(a, b)
    by_a = membrane(a + step * move, b)[0] - membrane(a - step * move, b)[0]
    by_b = membrane(a, b + step * move)[0] - membrane(a, b - step * move)[0]
    for slope, change in ((to_a, by_a), (to_b, by_b)):
        assert change / (2 * step) == pytest.approx(float((slope * move).sum()), abs=1e-8)
    b = 1.001 * a
    roots, moves = membrane_roots(a, b), rng.normal(size=(2, 6))
    ends = [np.hstack(membrane(a + t * moves[:, :3], b + t * moves[:, 3:])[1:]) for t in (step, -step)]
    second = np.einsum("fij,fkj,fk->fi", roots, roots, moves)
    np.testing.assert_allclose(second, (ends[0] - ends[1]) / (2 * step), atol=5e-3)
    assert ((a @ SIDES) * a).sum(axis=1) == pytest.approx(16 * areas(a) ** 2)


def areas(squared: Float) -> Float:
    """Heron's formula."""
    sides = np.sqrt(squared)
    half = sides.sum(axis=1) / 2
    return np.asarray(np.sqrt(half * np.prod(half[:, None] - sides, axis=1)))


def test_the_gradient_of_a_path_is_that_of_its_energy() -> None:
    rng = np.random.default_rng(2)
    path = Geodesic(strip_poses(4, 0.5))
    inner = np.stack([path.pair[0]] * 3) + 0.02 * rng.normal(size=(3, 8, 3))
    move, step = rng.normal(size=inner.shape), 1e-6
    slope = (path.value(inner + step * move) - path.value(inner - step * move)) / (2 * step)
    assert slope == pytest.approx(float(path.model(inner).gradient @ move.reshape(-1)), rel=1e-6)
    with pytest.raises(ValueError, match="a multiple of 1/4"):
        path.at(between(0.3))


def test_elastic_weights_of_a_square() -> None:
    points, faces = grid(1, 1)
    topology = Topology(faces, 4)
    x = points.astype(np.float64)[None]
    of_length, of_angle = Elastic(topology, x, thickness=0.5).weights
    lengths = edge_lengths(x[0], topology.edges)
    spread = np.where(np.isclose(lengths, lengths.max()), 2, 1) * (lengths.min() ** 2 / 2) / 3
    np.testing.assert_allclose(of_length, np.sqrt(spread) / lengths)
    assert of_angle == pytest.approx(0.5 * lengths.max() / np.sqrt(spread.max()))


def test_a_page_has_what_was_compared(tmp_path: Path) -> None:
    sequence = bar()
    frames = sequence.points[[0, 2]].astype(np.float64)
    poses = Poses("lion", (0, 2), frames, sequence, Topology(sequence.faces, sequence.vertex_count))
    makers = {name: BASELINES[name] for name in ("vertices", "ARAP")}
    found = compared(poses, makers, tmp_path / "picture.png", lambda text: None)
    assert (tmp_path / "picture.png").exists()
    assert found["ARAP"]["turned"] < 1e-9 and -1 < found["vertices"]["at"]["0.5"]["volume"] < 0
    results: Results = {
        "lion": {"title": "bar", "methods": dict.fromkeys(("ARAP", "skin", "NRIC", "geodesic", "MixIT"), found["ARAP"])}
    }
    results["lion"]["placed"] = [1.0, 2.0, 3.0]
    assert "on lion: lengths 1, angles 1;" in page(results)[-2]
    assert "| ARAP | 0.25 |" in page(results)[4]
