"""Measures of poses: known numbers on bent strips, none for rigid motions, and nothing without lengths or angles."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixseq.mesh.measures import dihedral_angles, wrap
from mixseq.mesh.topology import Topology
from mixseq.pictures.colours import MEASURES, Curvature, Strain, distances
from mixseq.types import Float
from tests.meshes import Mesh, flipped, grid, joined, pages, rotation, tetrahedron, torus, tube


def rolled(columns: int, degrees: float) -> Float:
    """The strip `grid(1, columns)`, bent by some degrees in each of the lines between its squares."""
    directions = np.radians(degrees) * np.arange(columns)
    x = np.concatenate([[0], np.cumsum(np.cos(directions))])
    z = np.concatenate([[0], np.cumsum(np.sin(directions))])
    return np.concatenate([np.stack([x, np.full_like(x, y), z], axis=1) for y in (0.0, 1.0)])


def folded(degrees: float) -> Float:
    """Two triangles that share the edge from vertex 0 to vertex 1, with some degrees between their planes."""
    angle = np.radians(degrees)
    return np.array([[0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, -np.cos(angle), -np.sin(angle)]])


BOOK = np.array([[0, 1, 2], [1, 0, 3]])

AWKWARD: dict[str, Mesh] = {
    "closed": tetrahedron(),
    "torus": torus(12, 8),
    "open": grid(3, 4),
    "not a manifold": pages(),
    "orientations": (tube(6, 5)[0], flipped(tube(6, 5)[1])),
    "pieces": joined(tetrahedron(), grid(2, 2)),
}


# Strain


def test_strain_is_the_mean_of_the_edges() -> None:
    rest = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]])
    longer = np.array([[0, 0, 0], [2, 0, 0], [0, 1, 0.0]])
    strain = Strain.of(rest, np.array([[0, 1, 2]]))
    hypotenuse = np.sqrt(5 / 2) - 1
    assert np.allclose(strain(longer), [0.5, (1 + hypotenuse) / 2, hypotenuse / 2])
    assert np.allclose(strain(rest), 0)


def test_edges_without_length_are_not_strained() -> None:
    rest = np.array([[0, 0, 0], [0, 0, 0], [0, 1, 0.0]])
    longer = np.array([[0, 0, 0], [2, 0, 0], [0, 1, 0.0]])
    opposite = np.sqrt(5) - 1
    assert np.allclose(Strain.of(rest, np.array([[0, 1, 2]]))(longer), [0, opposite / 2, opposite / 2])


# Curvature


@pytest.mark.parametrize("degrees", [10, -35, 90])
def test_a_strip_bends_between_its_squares(degrees: float) -> None:
    columns = 5
    flat, faces = grid(1, columns)
    change = Curvature.of(flat, faces)(rolled(columns, degrees)).reshape(2, -1)
    # every vertex inside has one line between squares, that bends, and one diagonal, that does not
    assert np.allclose(change[:, 1:-1], abs(degrees) / 2)
    assert np.allclose(change[:, [0, -1]], 0)


def test_it_is_the_change_that_counts() -> None:
    _, faces = grid(1, 4)
    change = Curvature.of(rolled(4, 20), faces)
    assert np.allclose(change(rolled(4, 50)), change(rolled(4, -10)))
    assert np.allclose(change(rolled(4, 50)).max(), 15)


def test_angles_change_the_shorter_way_round() -> None:
    change = Curvature.of(folded(170), BOOK)
    assert np.allclose(change(folded(-170)), [20, 20, 0, 0])
    assert np.allclose(change(folded(-10)), [180, 180, 0, 0])


@pytest.mark.parametrize("name", AWKWARD)
def test_angles_are_those_of_the_signals(name: str) -> None:
    rest, faces = AWKWARD[name]
    now = rest + 0.3 * np.sin(5 * rest[:, [1, 2, 0]] + [0, 1, 2])
    topology = Topology(faces, len(rest))
    change = np.degrees(
        np.abs(wrap(dihedral_angles(now, topology.hinges) - dihedral_angles(rest, topology.hinges)))
    )
    of_vertex: list[list[float]] = [[] for _ in rest]
    for (a, b, _, _), value in zip(topology.hinges, change, strict=True):
        of_vertex[a].append(value)
        of_vertex[b].append(value)
    expected = [sum(values) / max(len(values), 1) for values in of_vertex]
    assert max(expected) > 1
    assert np.allclose(Curvature.of(rest, faces)(now), expected, atol=1e-9)


def test_hinges_of_faces_without_area_do_not_bend() -> None:
    flat, faces = grid(1, 2)
    collapsed = flat.copy()
    collapsed[3] = flat[0]  # only of the triangle 0 4 3, whose diagonal is its one hinge
    turned = rolled(2, 40)
    for rest, now in ((collapsed, turned), (turned, collapsed)):
        assert np.allclose(Curvature.of(rest, faces)(now), [0, 20, 0, 0, 20, 0])
    nothing = np.zeros_like(flat)
    assert np.array_equal(Curvature.of(nothing, faces)(turned), np.zeros(6))
    assert np.array_equal(Curvature.of(turned, faces)(nothing), np.zeros(6))


def test_slivers_do_not_bend() -> None:
    book = folded(0)
    for height in (1e-5, -1e-5):  # below and above its edge: half a turn, if it had an area
        book[3] = [50, height, 0]
        assert np.array_equal(Curvature.of(folded(0), BOOK)(book), np.zeros(4))


# Both


@pytest.mark.parametrize("name", MEASURES)
@given(
    st.tuples(*3 * [st.floats(-3, 3)]), st.tuples(*3 * [st.floats(-10, 10)]), st.sampled_from(sorted(AWKWARD))
)
def test_rigid_motions_change_nothing(
    name: str, turn: tuple[float, float, float], move: tuple[float, float, float], mesh: str
) -> None:
    rest, faces = AWKWARD[mesh]
    assert MEASURES[name].of(rest, faces)(rest @ rotation(turn).T + np.array(move)).max() < 1e-9


@given(st.floats(0.01, 100), st.sampled_from(sorted(AWKWARD)))
def test_scaling_is_strain_and_no_bend(scale: float, mesh: str) -> None:
    rest, faces = AWKWARD[mesh]
    assert np.allclose(Strain.of(rest, faces)(scale * rest), abs(scale - 1), atol=1e-9)
    assert Curvature.of(rest, faces)(scale * rest).max() < 1e-9


@pytest.mark.parametrize("name", MEASURES)
def test_vertices_without_edges_or_hinges_have_nothing(name: str) -> None:
    rest = np.concatenate([folded(30), [[5.0, 5, 5]]])
    now = np.concatenate([2 * folded(60), [[9.0, 5, 5]]])
    assert MEASURES[name].of(rest, BOOK)(now)[4] == 0
    assert Curvature.of(rest, BOOK[:1])(now).tolist() == [0] * 5  # a triangle alone


@pytest.mark.parametrize("name", MEASURES)
def test_single_precision_is_widened(name: str) -> None:
    rest, faces = torus(9, 7)
    now = (1.1 * rest).astype(np.float32)
    single = rest.astype(np.float32)
    found = MEASURES[name].of(single, faces)(now)
    assert found.dtype == np.float64
    assert np.array_equal(found, MEASURES[name].of(single.astype(float), faces)(now.astype(float)))


def test_distances_are_in_diagonals() -> None:
    points = tetrahedron()[0]
    assert np.allclose(distances(points + np.array([0, 3, 4]), points, 10), 0.5)


def test_they_need_no_matplotlib() -> None:
    code = (
        "import mixseq.pictures.colours, mixseq.pictures.colours, sys; assert 'matplotlib' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
