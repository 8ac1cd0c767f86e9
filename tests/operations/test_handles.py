"""Poses by handles: a hinge turns by the angle that its tip tells, kept vertices stay, exact handles arrive."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.errors import MixseqWarning, SettingsError
from mixseq.operations import Handle, pose
from mixseq.operations.handles import DraggedPose, weight_row
from mixseq.operations.pose_solvers import PoseSolver
from mixseq.operations.script import Readers, read_script
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.curve import Curve
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.signals.pose import PoseMap
from mixseq.types import Float
from tests.meshes import bent, rotation
from tests.operations.chains import JOINTS, MESH, bone, chain

ANGLES = np.linspace(-0.8, 0.8, 9)
TIP = int(MESH[0][:, 2].argmax())
LABELS = (MESH[0][MESH[1]][:, :, 2].mean(axis=1) > JOINTS[0]).astype(np.int64)
BASE = [0, 2, 5]
"""Vertices at the lower end, which stay."""

TIME, DENSE = 0.4, np.linspace(0.0, 0.8, 33)


def hinged(angle: float) -> Float:
    """Two bones whose joint is bent by an angle."""
    return np.asarray(bent(MESH[0], angle, middle=JOINTS[0], blend=0.3))


@cache
def hinge() -> Model:
    """Two bones, with a frame at each of the angles."""
    sequence = MeshSequence.from_arrays(np.stack([hinged(angle) for angle in ANGLES]), MESH[1], fps=10)
    return fit(sequence, exact=True, parts=LABELS)


@cache
def lifted() -> Model:
    """The chain, its tip moved at one time and a vertex of the first bone kept."""
    return pose(chain(), [Handle(TIME, lifted_target(), TIP)], keep=[0, 5], fade=0.2)


def lifted_target() -> Float:
    return np.asarray(chain()(TIME)[TIP] + [0.05, 0.1, 0.0])


def distances(first: Model, second: Model, times: Float = DENSE) -> Float:
    """Largest distance of a vertex at every time, in diagonals."""
    return np.asarray(np.linalg.norm(first(times) - second(times), axis=2).max(axis=1) / first.space.scale)


@pytest.mark.parametrize("angle", [-0.5, 0.1, 0.35, 0.7])
def test_the_tip_of_a_hinge_determines_its_angle(angle: float) -> None:
    expected, model = hinged(angle), hinge()
    posed = pose(model, [Handle(0.2, expected[TIP], TIP)], keep=BASE, softness=1e-4)(0.2)
    assert np.linalg.norm(posed[TIP] - expected[TIP]) < 1e-4 * model.space.scale
    straight = np.abs(MESH[0][:, 2] - JOINTS[0]) > 0.5
    assert np.linalg.norm((posed - expected)[straight], axis=1).max() < 2e-3 * model.space.scale


def test_the_centre_of_a_part_is_a_handle() -> None:
    model, expected = hinge(), hinged(0.3)
    part = int(model.decomposition.part_of_face[LABELS.argmax()])
    centre = expected[model.decomposition.parts[part]].mean(axis=0)
    posed = pose(model, [Handle(0.2, centre, part=part)], keep=BASE, softness=1e-4)(0.2)
    assert np.linalg.norm((posed - expected)[bone(2)], axis=1).max() < 2e-3 * model.space.scale


@pytest.mark.parametrize("angle", [-0.5, 0.35])
def test_a_rotation_determines_the_angle_of_a_hinge(angle: float) -> None:
    """The frame at 0.4 s is straight, and the hinge turns about the x axis; its blend belongs to the part, too."""
    model, expected = hinge(), hinged(angle)
    part = int(model.decomposition.part_of_face[LABELS.argmax()])
    posed = pose(model, [Handle(TIME, part=part, rotation=np.degrees([angle, 0, 0]))], keep=BASE, softness=1e-4)(TIME)
    end = MESH[0][:, 2] > JOINTS[0] + 0.5
    assert turned(MESH[0][end], posed[end]) == pytest.approx(abs(angle), rel=0.05)
    assert turned(expected[end], posed[end]) < 0.05 * abs(angle)  # the same way


def test_rotations_that_are_not_in_the_motion_are_exact_on_request() -> None:
    model, part = chain(), 2
    vertices = model.decomposition.parts[part]
    before = model(TIME)[vertices]
    posed = pose(model, [Handle(TIME, before.mean(axis=0), part=part, rotation=[0, 0, 60])], exact=True)(TIME)[vertices]
    expected = (before - before.mean(axis=0)) @ rotation((0, 0, np.pi / 3)).T + before.mean(axis=0)
    moments = (before - before.mean(axis=0)).T @ np.stack([posed, expected], axis=1).reshape(len(vertices), -1)
    np.testing.assert_allclose(moments[:, :3], moments[:, 3:], atol=1e-6 * np.abs(moments).max())
    np.testing.assert_allclose(posed.mean(axis=0), before.mean(axis=0), atol=1e-6)


def test_a_part_keeps_its_directions_while_another_moves() -> None:
    model, vertices = chain(), chain().decomposition.parts[2]
    handles = [Handle(TIME, lifted_target(), TIP), Handle(TIME, part=2, rotation=[0, 0, 0])]
    level, exact = (pose(model, handles, keep=[0, 5], fade=0.2, exact=each) for each in (False, True))
    free, near, none = (turned(model(TIME)[vertices], each(TIME)[vertices]) for each in (lifted(), level, exact))
    assert near < 0.5 * free
    assert none < 1e-6


def turned(before: Float, after: Float) -> float:
    """The angle by which points are turned."""
    u, _, v = np.linalg.svd((before - before.mean(axis=0)).T @ (after - after.mean(axis=0)))
    return float(np.arccos(np.clip((np.trace(u @ v) - 1) / 2, -1, 1)))


def test_handles_at_their_places_change_nothing() -> None:
    points = chain()(TIME)
    posed = pose(chain(), [Handle(TIME, points[vertex], vertex) for vertex in (TIP, 7, 200)], keep=[3])
    assert distances(posed, chain()).max() < 1e-12


def test_a_rigid_motion_of_everything_moves_the_result_only() -> None:
    turn, shift = rotation((0.4, -1.1, 0.3)), np.array([1.0, -2.0, 0.5])
    sequence = chain().sample()
    moved = fit(sequence.with_points(sequence.points @ turn.T + shift), exact=True, parts=chain().parts)
    handles = [Handle(TIME, chain()(TIME)[v] + [0.1, 0.05, 0.0], v) for v in (TIP, 100, 200)]
    expected = pose(chain(), handles)(TIME) @ turn.T + shift
    handles = [replace(handle, position=turn @ np.asarray(handle.position) + shift) for handle in handles]
    assert np.abs(pose(moved, handles)(TIME) - expected).max() < 1e-5 * moved.space.scale


def test_the_result_does_not_depend_on_the_coordinates_of_pose_space() -> None:
    target, model = hinged(0.3)[TIP] + [0.01, 0.0, 0.01], hinge()
    turn = np.eye(model.pose.dim) + 0.5 * np.eye(model.pose.dim, k=1)
    time = Curve(model.time.times, model.time.values @ np.linalg.inv(turn))
    other = replace(model, pose=PoseMap(model.pose.offset, turn @ model.pose.matrix), time=time)
    first, second = (pose(each, [Handle(0.2, target, TIP)], keep=BASE) for each in (model, other))
    assert np.abs(first(0.2) - second(0.2)).max() < 1e-5 * first.space.scale


def test_derivatives_lead_to_a_minimum() -> None:
    model, target = chain(), lifted_target()
    rows = [weight_row(len(MESH[0]), np.array([v]), np.ones(1)) for v in (TIP, 7, 200)]
    solver = PoseSolver(model, rows, 1 / 500, is_free=True)
    targets = np.stack([target, *model(TIME)[[7, 200]]])
    change = solver.solve(TIME, targets)
    best = energy(solver, targets, change.scores, change.moves)
    generator = np.random.default_rng(0)
    for _ in range(20):
        scores, moves = 0.02 * generator.normal(size=change.scores.shape), 1e-4 * generator.normal(size=(1, 6))
        assert energy(solver, targets, change.scores + scores, change.moves + moves) > best


def energy(solver: PoseSolver, targets: Float, scores: Float, moves: Float) -> float:
    """The energy of the module's docstring."""
    change = solver.unchanged()._replace(scores=scores, moves=moves)
    points = solver.space.decode(solver.vectors(TIME, change))[0]
    misses = (solver.positions(points) - targets) / (solver.space.scale * solver.softness)
    radii = solver.space.articulation.body_radii
    bodies = (radii[:, None] * moves[:, :3]) ** 2, moves[:, 3:] ** 2
    return float(np.square(misses).sum() + np.square(scores).sum() + sum(square.sum() for square in bodies))


def test_a_change_fades_and_kept_vertices_stay_on_their_paths() -> None:
    posed, model = lifted(), chain()
    assert np.linalg.norm(posed(TIME)[TIP] - lifted_target()) < 2e-3 * model.space.scale
    off = distances(posed, model)
    away = np.abs(DENSE - TIME) > 0.2 + 1e-9
    assert off[away].max() < 1e-12 and off[~away].max() > 0.01
    kept = np.linalg.norm(posed(DENSE)[:, [0, 5]] - model(DENSE)[:, [0, 5]], axis=2)
    assert kept.max() < 2e-3 * model.space.scale
    loose = pose(model, [Handle(TIME, lifted_target(), TIP)], fade=0.2, move_bodies=True)
    assert np.linalg.norm(loose(TIME)[0] - model(TIME)[0]) > 3 * kept.max()


@pytest.mark.parametrize(("keep", "exact", "slack"), [([], False, 1e-4), ([], True, 5e-3), ([0, 5], False, 1e-2)])
def test_a_dragged_pose_is_that_of_its_last_target(keep: list[int], exact: bool, slack: float) -> None:
    """But for smooth displacements of the pose before, and for kept vertices, which `pose` solves for once more."""
    model, before = chain(), chain()(TIME)
    dragged = DraggedPose(model, [Handle(TIME, before[TIP], TIP)], keep, exact)
    for share in np.linspace(0.1, 1.0, 10):
        points = dragged.points((before[TIP] + share * (lifted_target() - before[TIP]))[None])
    expected = pose(model, [Handle(TIME, lifted_target(), TIP)], keep=keep, fade=0.2, exact=exact)(TIME)
    assert np.linalg.norm(points - expected, axis=1).max() < slack * model.space.scale
    if not exact:
        np.testing.assert_allclose(dragged.moved_model()(TIME), points, atol=1e-9)


def test_exact_handles_arrive_at_all_times() -> None:
    model, part = chain(), 2
    vertices = model.decomposition.parts[part]
    targets = model(0.2)[TIP] + [0.5, 0.5, 0.0], model(0.6)[vertices].mean(axis=0) + 0.1
    handles = [Handle(0.2, targets[0], TIP), Handle(0.6, targets[1], part=part)]
    posed = pose(model, handles, fade=0.1, exact=True)
    np.testing.assert_allclose(posed(0.2)[TIP], targets[0], atol=1e-9)
    np.testing.assert_allclose(posed(0.6)[vertices].mean(axis=0), targets[1], atol=1e-9)
    assert distances(posed, model, np.array([0.0, 0.05, 0.75, 0.8])).max() < 1e-12


def test_a_change_is_full_from_start_to_end() -> None:
    model, target = hinge(), hinged(0.1)[TIP]
    turned = pose(model, [Handle(0.4, target, TIP)], start=0.2, end=0.6, fade=0.1)
    change = turned.time(DENSE) - model.time(DENSE)
    inside = (DENSE > 0.2) & (DENSE < 0.6)
    np.testing.assert_allclose(change[inside], np.tile(change[16], (inside.sum(), 1)), atol=1e-9)


def test_a_missed_handle_is_warned_about() -> None:
    with pytest.warns(MixseqWarning, match=r"at 0\.4 s a handle misses its target by [\d.]+ diagonals"):
        pose(hinge(), [Handle(TIME, [9.0, 9.0, 9.0], TIP)])


@pytest.mark.parametrize(
    ("handles", "options", "message"),
    [
        ([], {}, "no handles"),
        ([Handle(0.4, [0, 0, 0], 10**6)], {}, "handle: there is no vertex 1000000; the model has"),
        ([Handle(0.4, [0, 0, 0], -1)], {}, "no vertex -1"),
        ([Handle(0.4, [0, 0, 0], part=9)], {}, "no part 9"),
        ([Handle(0.4, [0, 0, 0])], {}, "give one"),
        ([Handle(0.4, [0, 0, 0], 1, 1)], {}, "give one"),
        ([Handle(0.4, part=1)], {}, "part 1 at 0.4 s has no position and no rotation"),
        ([Handle(0.4, vertex=1, rotation=[0, 0, 0])], {}, "vertex 1 cannot be turned, only a part"),
        ([Handle(0.4, part=1, rotation=[0, 90])], {}, "part 1 at 0.4 s has the rotation"),
        ([Handle(0.9, [0, 0, 0], 1)], {}, "time is 0.9 s"),
        ([Handle(0.4, [0, 0, np.nan], 1)], {}, "vertex 1 at 0.4 s has the position"),
        ([Handle(0.4, [0, 0], 1)], {}, "three finite numbers"),
        ([Handle(0.4, [0, 0, 0], 1), Handle(0.4, [0, 0, 1], 1)], {}, "vertex 1 has two targets at 0.4 s"),
        ([Handle(0.4, [0, 0, 0], 1)], {"keep": [1]}, "vertex 1 has two targets"),
        ([Handle(0.4, [0, 0, 0], 1)], {"keep": [-2]}, "keep: there is no vertex -2"),
        ([Handle(0.4, [0, 0, 0], 1)], {"start": 0.5}, "outside the interval"),
        ([Handle(0.4, [0, 0, 0], 1)], {"fade": 0.0}, "fade is 0 s"),
        ([Handle(0.4, [0, 0, 0], 1)], {"softness": -1.0}, "softness is -1.0"),
    ],
)
def test_refusals(handles: list[Handle], options: dict[str, float], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        pose(hinge(), handles, **options)  # type: ignore[arg-type]


def test_models_without_poses_are_refused() -> None:
    sequence = hinge().sample()
    still = sequence.with_points(np.repeat(sequence.points[:1], 9, axis=0))
    for model, message in (
        (fit(sequence, space="vertex"), "no parts"),
        (fit(sequence, placement="free", parts=LABELS), "placement='anchored'"),
        (fit(still, parts=LABELS), "single pose"),
    ):
        with pytest.raises(SettingsError, match=message):
            pose(model, [Handle(TIME, [0, 0, 0], TIP)])


@pytest.mark.parametrize("source", ["tables", "file", "frames"])
def test_scripts_have_tables_or_files(tmp_path: Path, source: str) -> None:
    model, target = chain(), lifted_target()
    x, y, z = target.tolist()
    time = 4 if source == "frames" else TIME
    handles = f"[{{time = {time}, vertex = {TIP}, position = [{x}, {y}, {z}]}}]"
    if source == "file":
        (tmp_path / "handles.csv").write_text(f"{TIME},{TIP},{x},{y},{z}\n")
        handles = '"handles.csv"'
    unit = 'unit = "frames"\n' if source == "frames" else ""
    (tmp_path / "edits.toml").write_text(f'{unit}[[edit]]\noperation = "pose"\nhandles = {handles}\n')
    (edit,) = read_script(tmp_path / "edits.toml", Readers(mixseq.load, mixseq.read))
    expected = pose(model, [Handle(TIME, target, TIP)])
    np.testing.assert_array_equal(edit(model).time.values, expected.time.values)


@pytest.mark.parametrize(
    "handles",
    ["[1, 2]", "[{part = 1}]", "[{time = 0.4, position = [0, 0, 'x']}]", "[{time = 0, position = [0], foot = 1}]", "1"],
)
def test_other_values_in_scripts_are_refused(tmp_path: Path, handles: str) -> None:
    (tmp_path / "edits.toml").write_text(f'[[edit]]\noperation = "pose"\nhandles = {handles}\n')
    with pytest.raises(SettingsError, match="tables of time, vertex or part, and position or rotation"):
        read_script(tmp_path / "edits.toml", Readers(mixseq.load, mixseq.read))


def test_no_warning_where_handles_arrive() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", MixseqWarning)
        pose(hinge(), [Handle(0.2, hinged(0.3)[TIP], TIP)], keep=BASE)
