"""A model as Blender shows it: which time, which axes and units, which of its meshes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import mixseq
from mixseq.blender.motion import Motion, Placing, fitting, part_names, part_of, seconds
from mixseq.errors import SettingsError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import MeshObject, Surface
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.model import Model


@pytest.fixture(scope="module")
def pair() -> Model:
    """Two triangles, one above the other, that go along x by 3 units in a second; centimetres, Y up."""
    rest = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1], [0, 5, 0], [1, 5, 0], [0, 5, 1.0]])
    header = SequenceHeader(
        polygons=Polygons.from_triangles([[0, 1, 2], [3, 4, 5]]),
        vertex_count=6,
        times=np.arange(4) / 3,
        fps=3,
        up_axis="Y",
        metres_per_unit=0.01,
        surface=Surface(
            objects=(MeshObject("body", "/rig/body", 3, 1), MeshObject("sword", "/rig/sword", 3, 1))
        ),
    )
    sequence = MeshSequence.from_header(header, rest + np.arange(4)[:, None, None] * [1.0, 0, 0])
    return mixseq.fit(sequence, space="vertex", exact=True)


def test_seconds_are_those_of_caches_in_blender() -> None:
    assert seconds(36, 12, 24) == 1
    assert seconds(0.5, 0, 25) == 0.02


def test_points_are_turned_and_scaled(pair: Model) -> None:
    points = Motion(pair, Placing("Y", 0.01)).points(1 / 2)
    assert points.dtype == np.float32
    assert points.flags.c_contiguous
    np.testing.assert_allclose(
        points[2], [0.015, -0.01, 0], atol=1e-8
    )  # (1.5, 0, 1) cm, z down where y was up
    np.testing.assert_allclose(Motion(pair, Placing("Z", 1)).points(1 / 2)[2], [1.5, 0, 1], atol=1e-6)


@pytest.mark.parametrize(("time", "shown"), [(-1, 0), (0.25, 0.25), (7, 1)])
def test_ends_are_held(pair: Model, time: float, shown: float) -> None:
    motion = Motion(pair, Placing("Z", 1))
    assert motion.held(time) == shown
    assert motion.points(time)[0, 0] == pytest.approx(3 * shown, abs=1e-6)


def test_parts_are_found_by_path_and_by_name(pair: Model) -> None:
    assert part_names(pair.header) == ["/rig/body", "/rig/sword"]
    assert part_of(pair.header, "") == (slice(0, 6), slice(0, 2))
    assert part_of(pair.header, "/rig/sword") == part_of(pair.header, "sword") == (slice(3, 6), slice(1, 2))
    with pytest.raises(SettingsError, match=r"no mesh 'shield'; its meshes are /rig/body, /rig/sword"):
        part_of(pair.header, "shield")


def test_one_mesh_needs_no_name(bar_model: Model) -> None:
    assert part_names(bar_model.header) == [""]


@pytest.mark.parametrize(
    "placing", [Placing("Y", 0.01), Placing("Z", 0.01), Placing("Y", 1), Placing("Z", 1)]
)
def test_a_mesh_is_found_as_importers_leave_it(pair: Model, placing: Placing) -> None:
    mesh = placing.conversion(pair.header).values(pair(2 / 3))[3:]
    assert fitting(pair, mesh.astype(np.float64)) == ("/rig/sword", placing)


def test_another_number_of_vertices_is_told(pair: Model) -> None:
    with pytest.raises(SettingsError, match=r"has 5 vertices, the model 6, 3, 3; import it as a new object"):
        fitting(pair, np.zeros((5, 3)))


def test_a_model_that_does_not_tell_more_stands_upright_in_metres(bar_model: Model) -> None:
    header = replace(bar_model.header, up_axis="Z", metres_per_unit=1)
    assert Placing.as_told(header) == Placing("Z", 1)
    assert not Placing.as_told(header).conversion(header).changes
