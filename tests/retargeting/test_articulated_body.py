"""Parts that hang on each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixseq.errors import SettingsError
from mixseq.retargeting.limbs import ArticulatedBody, Contact, leg_length, leg_ratio
from tests.retargeting.walkers import BONES, body


def contact(parts: list[int], name: str = "sole") -> Contact:
    return Contact(name, np.zeros((len(parts), 3)), np.array(parts, dtype=np.int64))


def test_limbs_lead_from_the_root_to_the_ground() -> None:
    walker, (left, right) = body(1.0)
    assert walker.limb(left) == (1, 2, 3)
    assert walker.limb(right) == (4, 5, 6)
    assert replace(walker, root=3).limb(right) == (2, 1, 0, 4, 5, 6)


def test_vertices_on_several_parts_belong_to_the_first_that_carries_all() -> None:
    walker, _ = body(1.0)
    assert walker.limb(contact([3, 2, 3])) == (1, 2)
    assert walker.limb(contact([0, 0])) == ()


def test_pivots_may_form_loops() -> None:
    walker, (left, _) = body(1.0)
    loop = replace(walker, pairs=np.concatenate([walker.pairs, [[1, 3]]]), pivots=np.zeros((7, 3)))
    assert loop.limb(left) == (1, 3)  # the shorter way


def test_legs_are_as_long_as_their_bones() -> None:
    walker, (left, _) = body(1.4)
    middle = np.hypot(1.4 * BONES["foot"], left.points.mean(axis=0)[0])
    assert leg_length(walker, left) == pytest.approx(1.4 * (BONES["thigh"] + BONES["shank"]) + middle)
    assert leg_length(walker, contact([0])) == pytest.approx(np.linalg.norm(walker.centres[0]))


def test_ratio_of_legs() -> None:
    source, target = body(1.0), body(1.0)
    grown = replace(target[0], pivots=3 * target[0].pivots, centres=3 * target[0].centres)
    contacts = [replace(each, points=3 * each.points) for each in target[1]]
    assert leg_ratio(source[0], grown, source[1], contacts) == pytest.approx(3.0)


def test_placed_points_follow_their_parts() -> None:
    walker = ArticulatedBody(
        np.array([[1.0, 0, 0], [3, 0, 0]]), np.array([[0, 1]]), np.array([[2.0, 0, 0]]), 0
    )
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    rotations, centres = np.stack([np.eye(3), quarter])[None], np.array([[[1.0, 0, 0], [2, 1, 0]]])
    both = walker.placed(np.array([[2.0, 0, 0], [2, 0, 0]]), [0, 1], rotations, centres)
    np.testing.assert_allclose(both, [[[2, 0, 0], [2, 0, 0]]], atol=1e-15)


def test_refuses_vertices_that_follow_nothing() -> None:
    walker, _ = body(1.0)
    with pytest.raises(SettingsError, match="contact 'sole' follow no part"):
        walker.limb(contact([3, -1]))
    loose = replace(walker, pairs=walker.pairs[1:], pivots=walker.pivots[1:])
    with pytest.raises(SettingsError, match="follow part 3, which nothing links to the root"):
        loose.limb(contact([3]))
    with pytest.raises(SettingsError, match="contact 'sole' has 0 vertices"):
        walker.limb(contact([]))


def test_refuses_a_contact_on_several_limbs() -> None:
    with pytest.raises(SettingsError, match=r"'sole' are on several limbs \(parts 3, 6\); name one contact"):
        body(1.0)[0].limb(contact([3, 6]))


def test_refuses_legs_that_cannot_be_compared() -> None:
    walker, contacts = body(1.0)
    with pytest.raises(SettingsError, match="2 contacts of the source and 1 of the target"):
        leg_ratio(walker, walker, contacts, contacts[:1])
    with pytest.raises(SettingsError, match="at least one"):
        leg_ratio(walker, walker, [], [])
    point = replace(walker, centres=np.zeros((7, 3)))
    with pytest.raises(SettingsError, match="legs of the source have no length"):
        leg_ratio(point, walker, [contact([0])], [contact([0])])
