"""Reports of transfers: known values, any blocks, and given results."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixseq.choices import TRANSFERS
from mixseq.errors import InvalidSequenceError
from mixseq.mesh.surface import MeshObject, Surface
from mixseq.mesh.topology import Topology
from mixseq.metrics import compare
from mixseq.retargeting.markers import Correspondence
from mixseq.retargeting.report import (
    Acceleration,
    FrameCounts,
    TransferMeter,
    TransferReport,
    measure_coverage,
    measure_transfer,
    name_components,
)
from mixseq.retargeting.transfer import Transfer, TransferSettings, plan_transfer
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import FloatArray
from tests.meshes import bar, bent, grid, joined, rotation, tetrahedron, tube


def at_rest(sequence: MeshSequence, points: FloatArray | None = None) -> MeshSequence:
    """The first frame of a sequence, or another pose."""
    return MeshSequence.from_arrays(sequence.points[:1] if points is None else points[None], sequence.faces)


def planned(source: MeshSequence, target: MeshSequence, mapping: Correspondence | None = None) -> Transfer:
    return plan_transfer(source, target, TransferSettings(mapping=mapping, method="gradients"))


def reported(source: MeshSequence, points: FloatArray) -> TransferReport:
    """Report of given frames as a transfer of the source to its own mesh."""
    return measure_transfer(planned(source, at_rest(source)), [points])


@pytest.fixture(scope="module")
def body() -> MeshSequence:
    return bar(6, 9, frames=5)


def test_a_sequence_as_its_own_transfer_has_no_excess(body: MeshSequence) -> None:
    report = reported(body, body.points)
    assert report.excess.max < 1e-12
    assert report.strain == report.source_strain
    assert report.smoothness is not None
    assert report.smoothness.ratio == 1.0
    assert report.intersections.values == report.source_intersections.values
    assert report.volume.value == pytest.approx(0)
    assert report.lift.value < 0.1
    assert report.turned_over.worst == 0


def test_strain_is_that_of_compare(body: MeshSequence) -> None:
    still = body.with_points(np.repeat(body.points[:1], 5, axis=0))
    error, report = compare(still, body).edge_strain, reported(body, body.points)
    for name in ("rms", "p999", "max"):
        assert getattr(report.strain, name) == pytest.approx(getattr(error, name), rel=1e-12)


def test_report_is_invariant_to_rotation_and_scale(body: MeshSequence) -> None:
    turn = rotation((0.4, 1.1, -0.3))
    target = at_rest(body, 2.5 * body.points[0] @ turn.T + [3, 0, 1])
    report = measure_transfer(planned(body, target), [2.5 * body.points @ turn.T + [3, 0, 1]])
    assert report.excess.max < 1e-10
    assert report.smoothness is not None
    assert report.smoothness.ratio == pytest.approx(1.0)


def test_excess_of_a_stretch_that_the_source_has_not() -> None:
    still = MeshSequence.from_arrays(np.repeat(grid(2, 2)[0][None], 3, axis=0), grid(2, 2)[1])
    report = reported(still, still.points * np.array([1.0, 1.25, 1.5])[:, None, None])
    assert report.source_strain.max == 0
    assert report.excess.max == pytest.approx(0.5)
    assert report.excess.rms == report.strain.rms == pytest.approx(np.sqrt((0.25**2 + 0.5**2) / 3))


def test_the_source_strain_is_expected_of_the_target() -> None:
    points, faces = grid(2, 2)
    growing = MeshSequence.from_arrays(points * np.array([1.0, 1.2])[:, None, None], faces)
    target = at_rest(growing, points * [3, 1, 1])
    report = measure_transfer(planned(growing, target), [np.stack([target.points[0], 1.2 * target.points[0]])])
    assert report.excess.max < 1e-12
    assert report.strain.max == pytest.approx(0.2)


def test_a_triangle_that_is_turned_over() -> None:
    points, faces = grid(2, 2)
    still = MeshSequence.from_arrays(np.repeat(points[None], 3, axis=0), faces)
    folded = still.points.copy()
    folded[1, 0] = [1.5, 1.5, 0.0]  # a corner that is in one or two triangles goes across the edge
    report = reported(still, folded)
    corner = int((faces == 0).any(axis=1).sum())
    assert report.turned_over.values == (0, corner, 0)
    assert report.turned_over.worst_frame == 1
    assert report.turned_over.mean == pytest.approx(corner / 3)


def test_flat_triangles_count_if_they_were_not_flat_at_rest() -> None:
    points, faces = tetrahedron()
    faces = np.concatenate([faces, [[0, 0, 1]]])
    still = MeshSequence.from_arrays(np.repeat(points[None], 2, axis=0), faces)
    flat = still.points.copy()
    flat[1, 3] = (points[0] + points[1]) / 2
    report = reported(still, flat)
    assert report.flat == FrameCounts(1, (0, 1), (0, 1), (report.flat.vertices[0], 0))
    assert report.flat.worst_vertex in (0, 1, 2, 3)


def test_volume_changes_beyond_those_of_the_source() -> None:
    points, faces = tetrahedron()
    growing = MeshSequence.from_arrays(points * np.array([1.0, 1.2, 1.1])[:, None, None], faces)
    report = reported(growing, growing.points * np.array([1.0, 1.0, 0.5])[:, None, None])
    assert report.volume.value == pytest.approx(np.log(0.125))
    assert report.volume.frame == 2


def test_lift_is_the_height_over_the_ground_where_the_source_stands() -> None:
    points, faces = grid(3, 3)
    flat = MeshSequence.from_arrays(np.repeat(points[:, [0, 2, 1]][None], 3, axis=0), faces[:, ::-1])
    raised = flat.points.copy()
    raised[1, 4:] += [0, 0.1, 0]
    report = reported(flat, raised)
    assert report.lift.value == pytest.approx(0.1 / flat.diagonal, rel=1e-6)
    assert report.lift.frame == 1
    assert report.lift.vertex is not None and report.lift.vertex >= 4


def test_self_intersections_at_rest_and_after() -> None:
    one, other = tube(6, 5), tetrahedron()
    points, faces = joined(one, (0.2 * other[0] + [3, 0, 2], other[1]))
    still = MeshSequence.from_arrays(np.repeat(points[None], 4, axis=0), faces)
    through = still.points.copy()
    through[2, len(one[0]) :] -= [2.5, 0, 0]
    report = reported(still, through)
    assert (report.intersections.rest, report.intersections.worst_frame) == (0, 2)
    assert report.intersections.worst > 0
    assert report.intersections.frames == (0, 1, 2, 3)
    assert report.source_intersections.values == (0, 0, 0, 0)


def test_smoothness_of_a_parabola_and_of_a_pop() -> None:
    points, faces = tetrahedron()
    times = np.arange(6.0)
    falling = MeshSequence.from_arrays(points + times[:, None, None] ** 2 * [0, 0.5, 0], faces)
    popped = falling.points.copy()
    popped[3, 1] += [0, 1.0, 0]
    smooth, jumpy = reported(falling, falling.points).smoothness, reported(falling, popped).smoothness
    assert smooth is not None and jumpy is not None
    assert smooth.rms == smooth.max == pytest.approx(1 / falling.diagonal)
    assert jumpy.worst_frame in (2, 3, 4)
    assert jumpy.max == pytest.approx(2 / falling.diagonal)
    assert jumpy.ratio is not None and jumpy.ratio > 1


def test_two_frames_have_no_acceleration_and_a_still_source_no_ratio(body: MeshSequence) -> None:
    two = MeshSequence.from_arrays(body.points[:2], body.faces)
    assert reported(two, two.points).smoothness is None
    still = MeshSequence.from_arrays(np.repeat(body.points[:1], 3, axis=0), body.faces)
    smooth = reported(still, still.points).smoothness
    assert smooth is not None
    assert smooth.ratio is None


@pytest.mark.parametrize("sizes", [[5], [1, 1, 1, 1, 1], [2, 3], [4, 1]])
def test_report_does_not_depend_on_blocks(body: MeshSequence, sizes: list[int]) -> None:
    made = planned(body, at_rest(body, body.points[0] * [1, 1, 1.3]))
    frames = np.concatenate(list(made.blocks()))
    blocks = np.split(frames, np.cumsum(sizes)[:-1])
    meter = TransferMeter(made)
    passed = list(meter.measure_blocks(blocks))
    assert all(a is b for a, b in zip(passed, blocks, strict=True))
    assert meter.report() == measure_transfer(made)


def test_other_meshes_and_numbers_of_frames_are_refused(body: MeshSequence) -> None:
    made = planned(body, at_rest(body))
    with pytest.raises(InvalidSequenceError, match="frame 0 has 7 vertices"):
        measure_transfer(made, [body.points[:, :7]])
    with pytest.raises(InvalidSequenceError, match="more frames than the 5 of the source"):
        measure_transfer(made, [body.points, body.points[:1]])
    with pytest.raises(InvalidSequenceError, match="4 frames were measured, the source has 5"):
        measure_transfer(made, [body.points[:4]])


def test_both_methods_can_be_compared(body: MeshSequence) -> None:
    target = at_rest(body, bent(body.points[0], 0.2) * [1, 1, 1.2])
    mixed, gradients = (
        measure_transfer(plan_transfer(body, target, TransferSettings(method=method))) for method in TRANSFERS
    )
    assert mixed.source_strain == gradients.source_strain
    assert mixed.excess.rms < 0.2 and gradients.excess.rms < 0.2
    assert mixed.as_dict().keys() == gradients.as_dict().keys()


def test_followers_are_named(body: MeshSequence) -> None:
    eye = tetrahedron()
    points, faces = joined((body.points[0].astype(np.float64), body.faces.astype(np.int64)), eye)
    target = MeshSequence.from_arrays(points[None], faces)
    same = Correspondence.identity(body.vertex_count, len(body.faces))
    led = np.full((4, 3), -1)
    mapping = replace(
        same,
        target_size=(len(points), len(faces)),
        corners=np.concatenate([same.corners, led]),
        weights=np.concatenate([same.weights, np.zeros((4, 3))]),
        faces=np.concatenate([same.faces, led[:, 0]]),
        leaders=np.concatenate([same.leaders, np.full(4, 11)]),
    )
    found = measure_coverage(planned(body, target, mapping))
    assert found.source_area == 1.0
    assert 0 < found.area < 1
    assert found.vertices == pytest.approx(body.vertex_count / len(points))
    (follower,) = found.followers
    assert vars(follower) == {"name": "component 2", "vertices": 4, "leader": 11, "leads": "component 1"}
    report = measure_transfer(planned(body, target, mapping))
    assert report.as_dict()["coverage"]["followers"] == (vars(follower),)


def test_components_have_the_names_of_objects() -> None:
    points, faces = joined(tetrahedron(), tetrahedron(), tetrahedron())
    sequence = MeshSequence.from_arrays(points[None], faces)
    objects = MeshObject("body", "", 8, 8), MeshObject("hat", "", 4, 4)
    named = replace(sequence.header, surface=Surface(objects=objects))
    topology = Topology(faces, len(points))
    assert name_components(named, topology) == ["component 1 of body", "component 2 of body", "hat"]
    assert name_components(sequence.header, topology) == ["component 1", "component 2", "component 3"]


def test_accelerations_of_no_frames() -> None:
    acceleration = Acceleration()
    acceleration.add(np.zeros((1, 3, 3)))
    acceleration.add(np.ones((1, 3, 3)))
    assert (acceleration.rms, acceleration.max) == (0, 0)
