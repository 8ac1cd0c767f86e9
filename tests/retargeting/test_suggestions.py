"""Suggested markers match corresponding tips; uncertain tips are not suggested."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import mixseq
from mixseq.errors import SettingsError
from mixseq.retargeting.markers import Markers
from mixseq.retargeting.suggestions import CoarseSurface, Extremities, match_extremities, suggest_markers
from mixseq.sequence.sequence import MeshSequence
from tests.meshes import rotation, torus, tube
from tests.retargeting.foxes import Fox, short, tall
from tests.retargeting.test_extremities import EARS, TIPS

pytestmark = pytest.mark.slow


def still(points: np.ndarray, faces: np.ndarray) -> MeshSequence:
    return MeshSequence.from_arrays(points[None], faces, fps=24)


@cache
def suggested() -> Markers:
    return suggest_markers(short().mesh, tall().mesh)


def joined_bones(source: Fox, target: Fox, found: Markers) -> list[tuple[str, str]]:
    return [(source.bones[s], target.bones[t]) for s, t in zip(found.source, found.target, strict=True)]


def test_tips_of_foxes_of_different_proportions_match() -> None:
    pairs = joined_bones(short(), tall(), suggested())
    assert all(one == other for one, other in pairs)
    assert {one for one, _ in pairs[:6]} == TIPS
    assert {one for one, _ in pairs[6:]} == EARS


def test_matching_works_in_both_directions() -> None:
    pairs = joined_bones(tall(), short(), suggest_markers(tall().mesh, short().mesh))
    assert all(one == other for one, other in pairs)
    assert {one for one, _ in pairs} >= TIPS


def test_a_transformed_copy_matches_itself() -> None:
    fox = short()
    moved = still(3 * fox.points @ rotation((0.4, -1.0, 0.3)).T + [9.0, 2.0, 1.0], fox.mesh.faces)
    found = mixseq.suggest_markers(fox.mesh, moved)
    assert len(found) >= 8
    assert np.array_equal(found.source, found.target)


def test_suggestions_are_sorted_by_margin() -> None:
    source, target = (
        Extremities.from_surface(CoarseSurface.from_mesh(fox.points, fox.topology)) for fox in (short(), tall())
    )
    margins = [each.margin for each in match_extremities(source, target)]
    assert margins[:6] == sorted(margins[:6], reverse=True)
    assert margins[6:] == sorted(margins[6:], reverse=True)
    assert min(margins[:6]) >= 0.1


@pytest.mark.parametrize("mesh", [torus(20, 12), tube(12, 30)])
def test_bodies_without_limbs_get_no_suggestions(mesh: tuple[np.ndarray, np.ndarray]) -> None:
    points, faces = mesh
    assert len(suggest_markers(still(points, faces), still(2 * points, faces))) == 0
    assert len(suggest_markers(short().mesh, still(points, faces))) == 0


def test_rest_is_a_frame_of_the_source() -> None:
    fox = short()
    moving = MeshSequence.from_arrays(np.stack([fox.points * [1, 0.3, 3], fox.points]), fox.mesh.faces, fps=24)
    at_rest = suggest_markers(moving, tall().mesh, rest=1)
    assert np.array_equal(at_rest.source, suggested().source)  # every time the same
    with pytest.raises(SettingsError, match="the source has no frame 2"):
        suggest_markers(moving, tall().mesh, rest=2)
