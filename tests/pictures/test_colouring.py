"""Colours in the viewer: entries of palettes, scales that reach what is shown, and captions."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from mixseq.errors import SettingsError
from mixseq.mesh.topology import Topology
from mixseq.pictures.colours import (
    CLAY,
    JOINT,
    JOINT_RED,
    LEAST,
    SHARE,
    Colouring,
    Curvature,
    Strain,
    colourings_of,
    part_colours,
    two_digits,
)
from mixseq.segmentation.joints import Decomposition, decompose
from mixseq.sequence.sequence import MeshSequence
from tests.meshes import bar, grid, rotation

BAR = bar(frames=4)
REST = BAR.points[0]
PALETTE = np.zeros((256, 3), dtype=np.uint8)


def poses(sequence: MeshSequence = BAR) -> Iterator[tuple[float, NDArray[np.float64]]]:
    """What a viewer shows of a sequence, pose by pose."""
    return ((float(t - sequence.times[0]), x) for t, x in zip(sequence.times, sequence.points, strict=True))


def original(elapsed: float) -> NDArray[np.float64]:
    return np.asarray(BAR.points[round(elapsed * BAR.fps)])


def halves(mesh: MeshSequence = BAR) -> Decomposition:
    upper = mesh.points[0][mesh.faces].mean(axis=1)[:, 2] > 2
    return decompose(Topology(mesh.faces, mesh.vertex_count), upper.astype(np.int64), 2)


def cut(part_of_face: list[int]) -> tuple[MeshSequence, Decomposition]:
    """A flat strip of two squares, cut into parts without joints."""
    flat, faces = grid(1, 2)
    strip = MeshSequence.from_arrays(flat[None], faces)
    return strip, Decomposition(np.array(part_of_face), (), (), np.zeros(0, dtype=np.int64))


# Which there are


def test_there_are_those_that_can_be_shown() -> None:
    assert list(colourings_of(BAR.header, REST)) == ["clay", "strain", "curvature"]
    everything = colourings_of(BAR.header, REST, halves(), original, poses())
    assert list(everything) == ["clay", "parts", "error", "strain", "curvature"]
    for name, colouring in everything.items():
        assert colouring.name == name
        assert colouring.palette.shape == (256, 3)
        assert colouring.palette.dtype == np.uint8
        indices = colouring.indices(REST, 0.0)
        assert indices.shape == (BAR.vertex_count,)
        assert indices.dtype == np.uint8
    assert [name for name, colouring in everything.items() if colouring.constant] == ["clay", "parts"]


def test_clay_is_clay() -> None:
    clay = colourings_of(BAR.header, REST)["clay"]
    assert np.allclose(clay.palette[clay.indices(REST, 0)] / 255, CLAY, atol=0.5 / 255)


# Parts


def test_joints_are_red_and_parts_are_not() -> None:
    parts = colourings_of(BAR.header, REST, halves())["parts"]
    entries = parts.indices(REST, 0.0)
    joint = np.zeros(BAR.vertex_count, dtype=bool)
    joint[BAR.faces[halves().joint_of_face >= 0]] = True
    assert 0 < joint.sum() < BAR.vertex_count
    assert np.array_equal(entries == JOINT, joint)
    assert np.array_equal(entries[~joint], REST[~joint][:, 2] > 2)
    colours = parts.palette[[0, 1, JOINT]] / 255
    assert np.allclose(colours, [*part_colours(2), JOINT_RED], atol=0.5 / 255)


def test_most_faces_of_a_vertex_tell_its_part() -> None:
    # triangles 0 1 4, 0 4 3, 1 2 5, 1 5 4
    strip, decomposition = cut([2, 1, 2, 1])
    parts = colourings_of(strip.header, strip.points[0], decomposition)["parts"]
    # 0: 2 and 1; 1: 2, 2 and 1; 2: 2; 3: 1; 4: 2, 1 and 1; 5: 2 and 1
    assert parts.indices(strip.points[0], 0).tolist() == [1, 2, 2, 1, 1, 1]


def test_numbers_of_parts_go_around_below_the_joints() -> None:
    strip, decomposition = cut([254, 255, 254, 256])
    parts = colourings_of(strip.header, strip.points[0], decomposition)["parts"]
    # ties are of the lowest part, not of the lowest entry
    assert parts.indices(strip.points[0], 0).tolist() == [254, 254, 254, 0, 254, 254]


def test_vertices_without_faces_are_survived() -> None:
    strip, decomposition = cut([3, 3, 3, 3])
    points = np.concatenate([strip.points, [[[9.0, 9, 9]]]], axis=1)
    loose = MeshSequence.from_arrays(points, strip.faces)
    assert colourings_of(loose.header, points[0], decomposition)["parts"].indices(points[0], 0)[6] == 0


def test_shared_colours_cannot_be_written_to() -> None:
    with pytest.raises(ValueError, match="read-only"):
        colourings_of(BAR.header, REST)["clay"].indices(REST, 0)[0] = 1


# Numbers


def test_scales_reach_what_is_shown() -> None:
    found = colourings_of(BAR.header, REST, original=original, poses=poses())
    strain, curvature = Strain.of(REST, BAR.faces), Curvature.of(REST, BAR.faces)
    assert np.isclose(found["strain"].top, max(100 * np.quantile(strain(x), SHARE) for x in BAR.points))
    assert np.isclose(found["curvature"].top, max(np.quantile(curvature(x), SHARE) for x in BAR.points))
    assert found["error"].top == LEAST["error"]  # it is the original
    assert np.array_equal(found["curvature"].indices(REST, 0), np.zeros(BAR.vertex_count))
    assert found["curvature"].indices(BAR.points[-1], 0.3).max() == 255


def test_errors_are_at_the_same_time_in_diagonals() -> None:
    diagonal = float(np.linalg.norm(np.ptp(REST, axis=0)))
    moved = MeshSequence.from_arrays(
        BAR.points + np.array([0.1 * diagonal, 0, 0]), BAR.faces, fps=BAR.fps, times=BAR.times + 5
    )
    error = colourings_of(moved.header, moved.points[0], None, original, poses(moved))["error"]
    assert np.isclose(error.top, 0.1)
    assert np.array_equal(error.scaled(0.4).indices(moved.points[2], 0.2), np.full(BAR.vertex_count, 64))
    assert error.scaled(0.4).indices(moved.points[2], 0.0).max() > 64
    assert error.unit == "diagonals"


@pytest.mark.parametrize(("name", "reached"), [("strain", 2.0), ("curvature", 2.0), ("error", 1e6)])
def test_one_vertex_in_a_hundred_may_have_more_strain_but_no_error(name: str, reached: float) -> None:
    values = np.append(np.full(999, 2.0), 1e6)
    assert Colouring(name, PALETTE, measure=lambda points, elapsed: values).reached(REST, 0) == reached


@given(st.floats(0, 10), st.floats(0.01, 10))
def test_entries_are_shares_of_the_scale(value: float, top: float) -> None:
    colouring = Colouring("a", PALETTE, measure=lambda points, elapsed: np.array([value]), top=top)
    assert colouring.indices(REST, 0).tolist() == [round(255 * min(value / top, 1))]


def test_poses_are_used_once_and_one_by_one() -> None:
    alive = []

    def once() -> Iterator[tuple[float, NDArray[np.float64]]]:
        for elapsed, points in poses():
            alive.append(elapsed)
            yield elapsed, points

    iterator = once()
    colourings_of(BAR.header, REST, None, original, iterator)
    assert len(alive) == BAR.frame_count
    assert next(iterator, None) is None


def test_a_rigid_motion_has_no_colours() -> None:
    moved = (REST @ rotation((0.3, 1, 2)).T + [1, 2, 3]).astype(np.float32)
    found = colourings_of(BAR.header, REST.astype(np.float32), poses=[(0.0, REST), (1.0, moved)])
    for name in ("strain", "curvature"):
        assert found[name].top == LEAST[name]
        assert found[name].indices(moved, 1.0).max() < 20
    assert (found["strain"].unit, found["curvature"].unit) == ("%", "degrees")


def test_ends_of_scales_have_two_digits() -> None:
    assert [two_digits(top) for top in (0.0123, 0.1, 12, 123.4)] == ["0.012", "0.1", "12", "120"]


# Refusals


@pytest.mark.parametrize("top", [0, -1, np.nan, np.inf])
def test_scales_are_positive(top: float) -> None:
    with pytest.raises(SettingsError, match="a positive number is expected"):
        colourings_of(BAR.header, REST)["strain"].scaled(top)


def test_what_means_no_numbers_has_no_scale() -> None:
    with pytest.raises(SettingsError, match="clay has no scale; choose a colour that means numbers"):
        colourings_of(BAR.header, REST)["clay"].scaled(1)


def test_colours_are_fixed_or_measured() -> None:
    fixed = np.zeros(3, dtype=np.uint8)
    for given_ in ({}, {"fixed": fixed, "measure": lambda points, elapsed: fixed}):
        with pytest.raises(SettingsError, match="either fixed or measured"):
            Colouring("a", PALETTE, **given_)  # type: ignore[arg-type]


def test_other_meshes_are_refused() -> None:
    with pytest.raises(
        SettingsError, match=r"the pose at rest has the shape \(7, 3\), the mesh 202 vertices"
    ):
        colourings_of(BAR.header, REST[:7])
    with pytest.raises(SettingsError, match=r"the original has the shape \(7, 3\)"):
        colourings_of(BAR.header, REST, original=lambda elapsed: REST[:7])
    decomposition = replace(halves(), part_of_face=np.zeros(7, dtype=np.int64))
    with pytest.raises(SettingsError, match="the parts are of 7 triangles, the mesh has 400"):
        colourings_of(BAR.header, REST, decomposition)


def test_they_need_no_matplotlib() -> None:
    code = "import mixseq.pictures.colours, sys; assert not {'matplotlib', 'viser'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
