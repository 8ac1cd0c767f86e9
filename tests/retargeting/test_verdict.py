"""Verdicts: good transfers, every measure outside its limit, and where to look."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mixseq.errors import MixseqWarning
from mixseq.mesh.surface import MeshObject, Surface
from mixseq.retargeting.contacts import ContactReport, GroupReport, PlantedMotion
from mixseq.retargeting.correspond import CorrespondenceQuality
from mixseq.retargeting.markers import Correspondence, Markers
from mixseq.retargeting.report import FrameCounts, FrameExtreme, TransferReport, measure_transfer
from mixseq.retargeting.transfer import Transfer, TransferSettings, plan_transfer
from mixseq.retargeting.verdict import judge_transfer, name_place, sample_far_points
from mixseq.sequence.header import header_fields
from mixseq.sequence.sequence import MeshSequence
from tests.meshes import bar, tetrahedron

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def transfer() -> Transfer:
    body = bar(6, 9, frames=4)
    return plan_transfer(body, MeshSequence.from_arrays(2 * body.points[:1], body.faces))


@pytest.fixture(scope="module")
def report(transfer: Transfer) -> TransferReport:
    return measure_transfer(transfer)


def quality(**values: Any) -> CorrespondenceQuality:
    """Quality of a correspondence from one marker at vertex 3, which has a name."""
    good = CorrespondenceQuality(1, 1, 0, 0, 0, 0, 0, 0, 0, np.zeros(1), Markers.from_pairs([[3, 3]], ("left paw",)))
    return replace(good, **values)


def test_a_transfer_to_a_copy_is_good(transfer: Transfer, report: TransferReport) -> None:
    assert report.volume.value == pytest.approx(0, abs=1e-6)
    assert report.lift.value < 0.1
    verdict = judge_transfer(transfer, report)
    assert not verdict.findings
    assert verdict.text.startswith("good: ")


COUNTS = FrameCounts(0, (0, 1, 2, 3), (0, 0, 30, 1), (0, 0, 5, 0))


@pytest.mark.parametrize(
    ("name", "value", "start", "message"),
    [
        ("turned_over", COUNTS, r"look at .*vertex 5\) in frame 2: ", "30 triangles are turned over"),
        ("flat", COUNTS, r"look at .*vertex 5\) in frame 2: ", "30 triangles are flat"),
        ("intersections", COUNTS, r"look at .*vertex 5\) in frame 2: ", r"goes through itself \(30 pairs\)"),
        ("volume", FrameExtreme(np.log(0.5), 1), "check: ", "the volume changes by -50 % more than the source's"),
        ("lift", FrameExtreme(0.3, 1, 7), r"look at .*vertex 7\) in frame 1: ", "30 % of the diagonal over the ground"),
    ],
)
def test_measures_outside_their_limits(
    transfer: Transfer, report: TransferReport, name: str, value: Any, start: str, message: str
) -> None:
    verdict = judge_transfer(transfer, replace(report, **{name: value}))
    assert verdict.findings
    assert re.match(start + message, verdict.text)


def test_strains_pops_and_coverage(transfer: Transfer, report: TransferReport) -> None:
    assert report.smoothness is not None
    bad = replace(
        report,
        strain=replace(report.strain, rms=2 * max(report.source_strain.rms, 0.05)),
        smoothness=replace(report.smoothness, max=3 * report.smoothness.source_max, worst_frame=1, worst_vertex=4),
        coverage=replace(report.coverage, area=0.9),
        volume=FrameExtreme(1.0, 0),
    )
    verdict = judge_transfer(transfer, bad)
    messages = [finding.message for finding in verdict.findings]
    assert messages[:3] == [
        "10.0 % of the target has no counterpart; set markers there",
        "stretches 2 times as much as the source",
        "pops",
    ]
    assert (verdict.findings[2].vertex, verdict.findings[2].frame) == (4, 1)
    assert verdict.text == f"check: {messages[0]}; and 3 more"


def test_quality_of_markers(transfer: Transfer, report: TransferReport) -> None:
    missed = replace(transfer, quality=quality(marker_distances=np.array([0.1])))
    verdict = judge_transfer(missed, report)
    assert verdict.text.startswith(
        "look at the left paw (vertex 3) at rest: marker 'left paw' (3 -> 3) is missed by 0.1"
    )
    few = judge_transfer(replace(transfer, quality=quality(target_coverage=0.5)), report)
    assert few.text == "check: only 50.0 % of the target fits the source; set more markers"
    stretched = GroupReport("paw", (), 0.0, 0.0, 0.5)
    planted = PlantedMotion(np.zeros(0), np.zeros(0), ContactReport((stretched,)))
    assert judge_transfer(replace(transfer, planted=planted), report).text == "check: the limb of paw gets 50 % longer"


def test_units_that_were_mistaken(transfer: Transfer, report: TransferReport) -> None:
    small = replace(transfer, header=replace(transfer.header, metres_per_unit=0.01))
    assert judge_transfer(small, report).text.startswith("check: the target is 0.02 times as large as the source")


def test_exchanged_limbs_and_tears() -> None:
    body = bar(6, 9, frames=3)
    order = np.arange(body.vertex_count)
    low = body.points[0, :, 2] < np.median(body.points[0, :, 2])
    order[low] = order[low][::-1]  # the ring at one end is turned over, half of the bar
    mapping = Correspondence.identity(body.vertex_count, len(body.faces)).renumbered(order, np.arange(len(body.faces)))
    made = plan_transfer(body, body, TransferSettings(mapping=mapping, method="gradients"))
    verdict = judge_transfer(made, measure_transfer(made))
    messages = " ".join(finding.message for finding in verdict.findings)
    assert "limbs seem exchanged" in messages
    assert "% of the source apart" in messages
    assert all(finding.vertex is not None for finding in verdict.findings[:2])


def test_a_wrong_rest_pose_names_the_part_and_the_frame() -> None:
    body = bar(6, 12, frames=5)
    with pytest.warns(MixseqWarning, match="not at rest in the target's pose"):
        made = plan_transfer(body, MeshSequence.from_arrays(body.points[-1:], body.faces))
    verdict = judge_transfer(made, measure_transfer(made))
    assert verdict.text.startswith("wrong rest pose: points are ")
    assert " is turned by " in verdict.text
    assert "--rest 4 is more alike" in verdict.text


def test_places_have_names_of_markers_objects_and_sides(transfer: Transfer) -> None:
    corner = int((transfer.target @ [1.0, 1.0, 1.0]).argmax())
    assert name_place(transfer, corner) == f"the top front left (vertex {corner})"
    assert name_place(replace(transfer, quality=quality()), 3) == "the left paw (vertex 3)"
    one, other = tetrahedron(), bar(6, 9, frames=3)
    faces = np.concatenate([one[1], other.faces + 4])
    objects = (MeshObject("hat", "", 4, 4), MeshObject("body", "", other.vertex_count, len(other.faces)))
    still = np.repeat(one[0][None] + 9, 3, axis=0)
    both = MeshSequence.from_arrays(np.concatenate([still, other.points], axis=1), faces)
    both = MeshSequence(**{**header_fields(both), "surface": Surface(objects=objects), "points": both.points})
    made = plan_transfer(both, both, TransferSettings(method="gradients"))
    assert [name_place(made, vertex).split("(")[1] for vertex in (3, 4)] == ["hat, vertex 3)", "body, vertex 4)"]


def test_samples_are_far_from_each_other() -> None:
    points = np.array([[0.0, 0, 0], [0.1, 0, 0], [1, 0, 0], [0.4, 0, 0]])
    assert sample_far_points(points, np.arange(4), 3).tolist() == [2, 0, 3]
    assert sorted(sample_far_points(points, np.array([1, 3])).tolist()) == [1, 3]
