"""Pictures of parts: numbers where parts are seen, a legend that counts."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mixseq.errors import SettingsError
from mixseq.pictures.colours import JOINT_RED, part_colours
from mixseq.pictures.models import MAX_LEGEND_PARTS, _number_positions, draw_parts, draw_parts_legend, legend_rows
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from tests.meshes import grid

pytest.importorskip("matplotlib")


def test_numbers_are_in_the_middle_of_what_is_seen() -> None:
    points, faces = grid(4, 8)
    part = (points[faces, 0].mean(axis=1) > 4).astype(np.int64)
    places = _number_positions(points, faces.astype(np.int32), part, (-1.0, 9.0, -1.0, 5.0))
    np.testing.assert_allclose(places[0], (2, 2), atol=0.1)
    np.testing.assert_allclose(places[1], (6, 2), atol=0.1)


def test_hidden_parts_and_joints_have_no_number() -> None:
    points, faces = grid(4, 8)
    before = points + np.array([0, 0, 1])
    both = np.concatenate([faces, faces + len(points)]).astype(np.int32)
    part = np.repeat([300, -1], len(faces))  # a joint in front of a part
    limits = (-1.0, 9.0, -1.0, 5.0)
    assert _number_positions(np.concatenate([points, before]), both, part, limits) == {}
    behind = _number_positions(np.concatenate([before, points]), both, part, limits)
    assert list(behind) == [300]


def test_parts_too_small_for_a_number_have_none() -> None:
    points, faces = grid(2, 2)
    part = np.zeros(len(faces), dtype=np.int64)
    assert _number_positions(points, faces.astype(np.int32), part, (-500.0, 500.0, -500.0, 500.0)) == {}


def test_picture_of_the_parts(bar_model: Model, bent_bar: MeshSequence) -> None:
    from matplotlib.figure import Figure

    panels = Figure(figsize=(8, 3)).subplots(1, 2)
    draw_parts(list(panels), bar_model, bent_bar.points[0])
    assert panels[0].get_title(loc="center") == "Parts; joints paler, red where parts meet"
    numbers = {text.get_text() for panel in panels for text in panel.texts}
    assert numbers == {str(part) for part in range(len(bar_model.decomposition.parts))}


def test_vertex_models_have_no_parts(bent_bar: MeshSequence) -> None:
    model = fit(bent_bar, exact=True, space="vertex")
    with pytest.raises(SettingsError, match="the vertex space has no parts"):
        draw_parts([], model, bent_bar.points[0])


def legend(ax: Any) -> dict[str, Any]:
    found = ax.get_legend()
    colours = [handle.get_facecolor() for handle in found.legend_handles]
    return dict(zip([text.get_text() for text in found.get_texts()], colours, strict=True))


def test_legend_counts_vertices(bar_model: Model, ax: Any) -> None:
    parts = bar_model.decomposition
    draw_parts_legend(ax, parts, 5)
    entries = legend(ax)
    expected = [f"part {number}: {len(part)} vertices" for number, part in enumerate(parts.parts)]
    free = sum(int(joint.free.sum()) for joint in parts.joints)
    assert list(entries) == [*expected, f"1 joint: {free} free vertices"]
    np.testing.assert_allclose(entries[expected[0]][:3], part_colours(1)[0])
    np.testing.assert_allclose(list(entries.values())[-1][:3], JOINT_RED)
    assert legend_rows(parts, 5) == 1


def test_legend_of_very_many_parts(bar_model: Model, ax: Any) -> None:
    parts = bar_model.decomposition
    count = MAX_LEGEND_PARTS + 7
    sizes = [1 + (number % 7 == 0) for number in range(count)]
    many = replace(
        parts, part_of_face=np.arange(len(parts.part_of_face)) % count, parts=tuple(map(np.arange, sizes)), joints=()
    )
    draw_parts_legend(ax, many, 5)
    entries = list(legend(ax))
    assert len(entries) == MAX_LEGEND_PARTS + 1 <= 12 - 2  # others are of joints, and of vertices in no triangle
    assert entries[0] == "part 0: 2 vertices"
    assert "part 14: 2 vertices" in entries
    assert entries[-1] == "and 7 smaller parts"
    assert legend_rows(many, 5) == 3


def test_legend_tells_of_unused_vertices(bar_model: Model, ax: Any) -> None:
    parts = bar_model.decomposition
    draw_parts_legend(ax, replace(parts, parts=(*parts.parts, np.arange(3))), 5)
    assert list(legend(ax))[-2] == "in no triangle: 3 vertices"
