"""A shot through Blender and back: Blender exports a walker, mixseq works on it, Blender imports the results.

Every frame is compared with the scene itself at that moment, of which 120 frames per second are exported, too. With
``-s`` all rows are shown. The other tests need no Blender: what is asked of every frame, and that the comparison sees
what is wrong.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mixseq.types import Float
from tests.blender import rows
from tests.blender.environment import needs_blender, run
from tests.blender.gait import SPEED, STRIDE, place, turns
from tests.blender.rows import Row, Truth, by_itself, measured
from tests.blender.seen import MESHES, Seen, Surface
from tests.blender.tasks import END, START, TASKS, WAYS, loop, made, ramp, section, sixty, slow
from tests.meshes import grid


@pytest.mark.slow
@needs_blender
def test_a_shot_comes_back(tmp_path: Path) -> None:
    run("walker", tmp_path)
    found = [by_itself(way, tmp_path) for way in WAYS if not way.cache]
    for task in (make() for make in TASKS):
        truth = Truth.of(task, tmp_path)
        for way in WAYS:
            answer, said = made(task, way, tmp_path)
            row = measured(task, way, answer, truth, tmp_path) if answer.exists() else Row(way.name, task.name)
            row.notes[:0] = said
            found.append(row)
    print(*found, sep="\n")
    assert not [row for row in found if not row.passed]


def scene(frames: int = 4, order: slice = slice(None)) -> Seen:
    """Two sheets that fly off, each of two materials; their vertices in an order."""
    points, _ = grid(4, 4)
    number = np.arange(16)[order]
    place = np.argsort(number)
    corners = [[0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6]]
    arrays: dict[str, Float] = {"camera": np.repeat(np.eye(4)[None], frames, axis=0)}
    names: dict[str, Any] = {"objects": [["/rig", "EMPTY"]], "lenses": [35.0], "frame_start": 1, "frame_end": frames}
    names["meshes"] = {}
    for aside, name in enumerate(MESHES):
        moved = points[number] + [20.0 * aside, 0.0, 0.0] + np.arange(frames)[:, None, None] * [0.0, 0.0, 0.5]
        arrays[f"points/{name}"] = moved
        arrays[f"velocities/{name}"] = np.broadcast_to([0.0, 0.0, 12.0], moved.shape)
        names["meshes"][name] = {
            "path": f"/rig/{name}",
            "materials": ["skin", "skin", "cloth"],
            "corners": place[corners].tolist(),
            "uvs": {"UVMap": [[0.25 * corner, 0.5] for polygon in corners for corner in polygon]},
        }
    return Seen(arrays, names)


def test_every_task_stays_in_the_shot_and_begins_where_it_does() -> None:
    for make in TASKS:
        task = make()
        assert len(task.frames) == len(task.source) == len(task.speed)
        assert task.source.min() >= START - 1e-9
        assert task.source.max() <= END + 1e-9


def test_tasks_ask_for_the_moments_that_their_names_say() -> None:
    np.testing.assert_array_equal(sixty().frames[[0, -1]], [2503, 2740])  # 41.708 s is between two frames
    np.testing.assert_array_equal(slow().frames[[0, -1]], [1001, 1381])
    np.testing.assert_allclose(slow().source[[0, 4]] * 24, [1001, 1002])
    np.testing.assert_array_equal(section().frames, section().source * 24)
    np.testing.assert_allclose(ramp().source[[0, 24, 72, 96]] - START, [0, 1, 1.5, 2.5])
    assert len(loop().frames) == 25
    assert [make().retimed for make in TASKS] == [False, True, False, True, False]


def test_the_walk_repeats_itself_but_for_the_way_it_went() -> None:
    for time in (0.1, 0.63):
        for bone, angles in turns(time).items():
            np.testing.assert_allclose(turns(time + STRIDE)[bone], angles, atol=1e-12)
        np.testing.assert_allclose(np.subtract(place(time + STRIDE), place(time)), [0, -SPEED * STRIDE, 0], atol=1e-12)


def test_another_order_of_the_vertices_is_the_same_surface() -> None:
    truth, turned = scene(), scene(order=slice(None, None, -1))
    found = Surface.found(turned, truth)
    np.testing.assert_array_equal(found.vertices[:16], np.arange(16)[::-1])
    own = Surface.found(truth, truth)
    assert found.has_materials_of(own)
    assert found.has_uvs_of(own)
    row = Row("", "")
    rows._positions(row, found, truth)
    rows._velocities(row, turned, truth.together("velocities"))
    assert row.passed
    assert row.rms == row.velocities == 0


def _body(change: Callable[[dict[str, Any]], object]) -> Seen:
    seen = scene()
    change(seen.names["meshes"]["body"])
    return seen


@pytest.mark.parametrize(
    ("check", "seen"),
    [
        ("materials", _body(lambda mesh: mesh["materials"].reverse())),
        ("UVs", _body(lambda mesh: mesh["uvs"]["UVMap"].reverse())),
        ("UVs", _body(lambda mesh: mesh["uvs"].update(st=mesh["uvs"].pop("UVMap")))),
    ],
)
def test_what_is_lost_of_a_surface_is_seen(check: str, seen: Seen) -> None:
    truth = scene()
    own, original = Surface.found(seen, truth), Surface.found(truth, truth)
    same = {"materials": own.has_materials_of(original), "UVs": own.has_uvs_of(original)}
    assert not same.pop(check)
    assert all(same.values())


def test_errors_are_those_of_a_moved_scene() -> None:
    truth, seen = scene(), scene()
    diagonal = np.linalg.norm(np.ptp(truth.together("points")[0], axis=0))
    for name in MESHES:
        seen.arrays[f"points/{name}"] = seen.arrays[f"points/{name}"] + [0, 0.001 * diagonal, 0]
        seen.arrays[f"velocities/{name}"] = 1.02 * seen.arrays[f"velocities/{name}"]
    row = Row("", "")
    rows._positions(row, Surface.found(seen, truth), truth)
    rows._velocities(row, seen, truth.together("velocities"))
    assert row.rms == pytest.approx(0.001)
    assert row.largest == pytest.approx(0.001)
    assert row.velocities == pytest.approx(0.02)
    assert row.checks == {"positions": False, "vertices": True, "velocities": False}


def test_cameras_must_be_where_they_were() -> None:
    moved, other = scene(), replace(scene(), names=scene().names | {"lenses": [50.0]})
    moved.camera[:, 0, 3] += 1
    for seen, told in (
        (scene(), []),
        (moved, ["the camera is off by 1"]),
        (other, ["focal lengths of cameras: [50.0], of the original [35.0]"]),
    ):
        row = Row("", "")
        rows._camera(row, seen, scene())
        assert row.notes == told
        assert row.passed == (not told)


def test_ranges_of_frames_are_compared() -> None:
    row = Row("", "")
    rows._range(row, scene().scene_range, np.array([1.0, 4.0]))
    assert row.passed
    rows._range(row, scene().scene_range, np.array([1.0, 5.0]))
    assert row.notes == ["frames (1, 4), [1.0, 5.0] were asked for"]
    assert not row.passed
