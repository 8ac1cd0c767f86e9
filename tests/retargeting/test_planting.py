"""Transfer with contacts: paws rest in the stances of the source."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from mixseq.creature import STANCE_FRACTION, STANCE_TRAVEL_METRES
from mixseq.errors import SettingsError
from mixseq.retargeting.contacts import ContactReport
from mixseq.retargeting.limbs import ArticulatedBody, Contact
from mixseq.retargeting.mixed_transfer import MixedTransfer
from mixseq.retargeting.sources import prepare_source
from mixseq.retargeting.transfer import TransferSettings, plan_transfer
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float, Index
from tests.meshes import bar, coarse_bones, coarse_walk, rotation

pytestmark = pytest.mark.slow

FRAMES = 24
PAWS = ("forepaw.l", "forepaw.r", "hindpaw.l", "hindpaw.r")
BELLY, LONGER = 0.45, 1.3


class Walk(NamedTuple):
    """The fox over the ground, a taller one after it, and the soles of the paws."""

    source: MeshSequence
    target: MeshSequence
    soles: dict[str, Index]
    free: Float
    planted: Float
    report: ContactReport
    method: MixedTransfer


def taller(points: Float) -> Float:
    """Longer legs, and the body on them."""
    height = points[:, 1]
    grown = np.where(height < BELLY, LONGER * height, height + (LONGER - 1) * BELLY)
    return np.stack([points[:, 0], grown, points[:, 2]], axis=1)


def over_the_ground(walk: MeshSequence) -> MeshSequence:
    """The walk as fast as the ground moves past."""
    way = STANCE_TRAVEL_METRES / STANCE_FRACTION * np.arange(walk.frame_count) / walk.frame_count
    return walk.with_points(walk.points + way[:, None, None] * [1.0, 0.0, 0.0])


def soles_of(rest: Float) -> dict[str, Index]:
    """The five lowest vertices of every paw."""
    bones = np.array(coarse_bones())
    paws = {name: np.flatnonzero(bones == name) for name in PAWS}
    return {name: paw[np.argsort(rest[paw, 1], kind="stable")[:5]] for name, paw in paws.items()}


@pytest.fixture(scope="module")
def walk() -> Walk:
    source = over_the_ground(coarse_walk(frames=FRAMES))
    rest = source.points[0]
    target = MeshSequence.from_arrays(taller(rest)[None], source.faces, up_axis="Y")
    soles = soles_of(rest)
    motion = prepare_source(source, parts=prepare_source(source).part_of_face())
    with_contacts = plan_transfer(motion, target, TransferSettings(contacts=soles))
    free = np.concatenate(list(plan_transfer(motion, target).blocks()))
    planted = np.concatenate(list(with_contacts.blocks()))
    assert isinstance(with_contacts.method, MixedTransfer)
    return Walk(source, target, soles, free, planted, with_contacts.contacts, with_contacts.method)


def slides(walk: Walk, points: Float) -> list[float]:
    """Path lengths of the middles of soles during stances."""
    paths = [points[:, walk.soles[group.name]].mean(axis=1) for group in walk.report.groups]
    return [
        sum(float(np.linalg.norm(np.diff(path[some.frames], axis=0), axis=1).sum()) for some in group.stances)
        for path, group in zip(paths, walk.report.groups, strict=True)
    ]


def accelerations(points: Float) -> Float:
    return np.asarray(np.linalg.norm(np.diff(points, 2, axis=0), axis=2))


def test_paws_rest_as_long_as_those_of_the_source(walk: Walk) -> None:
    assert [group.name for group in walk.report.groups] == list(PAWS)
    for group in walk.report.groups:
        frames = sum(some.stop - some.start for some in group.stances)
        assert frames / FRAMES == pytest.approx(STANCE_FRACTION, abs=0.1)


def test_paws_do_not_slide(walk: Walk) -> None:
    for before, after in zip(slides(walk, walk.free), slides(walk, walk.planted), strict=True):
        assert before > 0.02  # metres
        assert after < before / 10


def test_report_matches_measured_sliding(walk: Walk) -> None:
    """Not only its parts: paws that bend within their parts slide by that as well."""
    diagonal = walk.target.diagonal
    after = slides(walk, walk.planted)
    for group, slide in zip(walk.report.groups, after, strict=True):
        assert group.before > 0.005
        assert group.after * diagonal == pytest.approx(slide, abs=1e-6)
        assert group.residual < 0.01
    assert 0 < walk.report.shift < 0.05
    assert 0 < walk.report.turn < 15


def test_accelerations_do_not_increase(walk: Walk) -> None:
    before, after = accelerations(walk.free), accelerations(walk.planted)
    assert after.max() <= 1.2 * before.max()
    assert np.sqrt(np.mean(after**2)) <= 1.1 * np.sqrt(np.mean(before**2))


def test_vertices_outside_legs_stay_smooth(walk: Walk) -> None:
    bones = np.array(coarse_bones())
    elsewhere = np.isin(bones, ("head", "muzzle", "ear.l", "ear.r", "tail3", "tail4", "chest"))
    before, after = accelerations(walk.free[:, elsewhere]), accelerations(walk.planted[:, elsewhere])
    assert after.max() <= 1.2 * before.max()
    # The shape of the head is none of the feet's business.
    head = bones == "head"
    free, planted = (x[:, head] - x[:, head].mean(axis=1, keepdims=True) for x in (walk.free, walk.planted))
    np.testing.assert_allclose(planted, free, atol=2e-3)


def test_the_body_travels_as_its_legs_are_long(walk: Walk) -> None:
    way = walk.planted[-1].mean(axis=0) - walk.planted[0].mean(axis=0)
    own = walk.source.points[-1].mean(axis=0) - walk.source.points[0].mean(axis=0)
    assert 1.1 < way[0] / own[0] < LONGER
    assert way[0] / own[0] == pytest.approx(walk.method.stride_ratio * walk.method.gradients.alignment.scale, rel=0.03)


def test_a_body_that_is_its_contact_has_no_legs() -> None:
    source = bar(sides=5, rings=5, frames=3)
    whole = {"whole": np.arange(source.vertex_count)}
    with pytest.raises(SettingsError, match="legs of the source have no length"):
        plan_transfer(source, source, TransferSettings(contacts=whole, parts=1))


def test_a_contact_may_bend_within_its_part() -> None:
    """Its way is that of its vertices as the part sees them in every frame."""
    walker = ArticulatedBody(np.array([[0.0, 0, 0], [1, 0, 0]]), np.array([[0, 1]]), np.array([[0.5, 0, 0]]), 0)
    points = np.array([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    stiff = Contact("foot", points, np.array([1, 1]))
    turns = np.stack([[np.eye(3), rotation((0, 0, 0.1 * t))] for t in range(4)])
    centres = np.random.default_rng(0).normal(size=(4, 2, 3))
    seen = points + np.arange(4)[:, None, None] * [0.0, 0.0, 0.1]
    soft = Contact("foot", points, np.array([1, 1]), seen)
    np.testing.assert_allclose(
        walker.contact_path(soft, turns, centres)[0], walker.contact_path(stiff, turns, centres)[0], atol=1e-12
    )
    up = walker.contact_path(soft, turns, centres) - walker.contact_path(stiff, turns, centres)
    np.testing.assert_allclose(up, seen - points, atol=1e-12)  # z is not turned
    some = np.array([1, 3])
    np.testing.assert_array_equal(
        walker.contact_path(soft, turns[some], centres[some], some), walker.contact_path(soft, turns, centres)[some]
    )
