"""Solvers for poses: least squares, and stills whose parts turn about their joints."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from mixseq.errors import MixseqWarning, SettingsError
from mixseq.mesh.measures import edge_lengths
from mixseq.operations import Handle, key_poses, pose, with_body
from mixseq.operations.pose_solvers import JointRotations, PoseSolver, StillSolver, minimise
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.types import Float
from tests.meshes import bent, rotation
from tests.operations.chains import JOINTS, MESH, bone, chain, labels

TIP = int(MESH[0][:, 2].argmax())
BASE = [0, 2, 5]
"""Vertices at the lower end, which stay."""

HALVES = (MESH[0][MESH[1]][:, :, 2].mean(axis=1) > JOINTS[0]).astype(np.int64)


@cache
def still(parts: int = 2) -> Model:
    """A straight tube of two or three parts."""
    sequence = MeshSequence.from_arrays(MESH[0][None], MESH[1], fps=10)
    return fit(sequence, exact=True, parts=HALVES if parts == 2 else labels())


def hinged(angle: float) -> Float:
    return np.asarray(bent(MESH[0], angle, middle=JOINTS[0], blend=0.3))


def test_least_squares_of_a_linear_system() -> None:
    matrix, right = np.random.default_rng(0).normal(size=(2, 7, 3))
    found = minimise(
        np.zeros(3), lambda x: matrix @ x - right[:, 0], lambda x: matrix, lambda x, step: np.asarray(x + step)
    )
    np.testing.assert_allclose(found, np.linalg.lstsq(matrix, right[:, 0], rcond=None)[0], atol=1e-6)


@pytest.mark.parametrize("angle", [-0.6, 0.2, 0.5])
def test_the_tip_of_a_still_hinge_determines_its_angle(angle: float) -> None:
    target = hinged(angle)
    posed = pose(still(), [Handle(0.5, target[TIP], TIP)], keep=BASE, softness=1e-4)
    points, scale = posed(0.5), still().space.scale
    assert np.linalg.norm(points[TIP] - target[TIP]) < 2e-3 * scale
    straight = np.abs(MESH[0][:, 2] - JOINTS[0]) > 1.0
    assert np.linalg.norm((points - target)[straight], axis=1).max() < 0.03 * scale
    strain = (
        edge_lengths(points, still().mixed.topology.edges) / edge_lengths(MESH[0], still().mixed.topology.edges) - 1
    )
    assert np.sqrt(np.square(strain).mean()) < 0.1


def test_a_still_and_its_poses_become_a_motion() -> None:
    first, second = hinged(0.4)[TIP], hinged(-0.4)[TIP]
    posed = pose(still(), [Handle(0.5, first, TIP), Handle(1.5, second, TIP)], keep=BASE)
    np.testing.assert_array_equal(posed.times, [0.0, 0.5, 1.5])
    np.testing.assert_allclose(posed(0.0), MESH[0], atol=1e-6)
    for time, target in ((0.5, first), (1.5, second)):
        assert np.linalg.norm(posed(time)[TIP] - target) < 0.01 * posed.space.scale


def test_handles_at_their_places_change_nothing() -> None:
    posed = pose(still(3), [Handle(1.0, MESH[0][vertex], vertex) for vertex in (TIP, *BASE)])
    np.testing.assert_allclose(posed(1.0), MESH[0], atol=1e-6)


def test_a_rigid_motion_of_handles_moves_the_body() -> None:
    turn, shift = rotation((0.4, -1.1, 0.3)), np.array([1.0, -2.0, 0.5])
    moved = MESH[0] @ turn.T + shift
    posed = pose(still(3), [Handle(1.0, moved[vertex], vertex) for vertex in (TIP, 7, 200, 300)])
    np.testing.assert_allclose(posed(1.0), moved, atol=1e-2)


def test_exact_handles_of_a_still_arrive() -> None:
    target = hinged(0.5)[TIP] + [0.0, 0.3, 0.6]
    with pytest.warns(MixseqWarning, match="misses its target"):
        pose(still(), [Handle(0.5, target, TIP)], keep=BASE)
    posed = pose(still(), [Handle(0.5, target, TIP)], keep=BASE, exact=True)
    np.testing.assert_allclose(posed(0.5)[[TIP, *BASE]], [target, *MESH[0][BASE]], atol=1e-6)


def test_the_centre_of_a_part_of_a_still_is_a_handle() -> None:
    expected, model = hinged(0.4), still()
    part = int(model.decomposition.part_of_face[HALVES.argmax()])
    vertex_ids = model.decomposition.parts[part]
    posed = pose(model, [Handle(0.5, expected[vertex_ids].mean(axis=0), part=part)], keep=BASE, softness=1e-4)
    assert np.linalg.norm((posed(0.5) - expected)[bone(2)], axis=1).max() < 0.05 * model.space.scale


def functions_of(solver: PoseSolver | StillSolver, *arguments: Any) -> dict[str, Any]:
    """What a solver gives to `minimise`."""
    given: dict[str, Any] = {}

    def capture(*functions: Any) -> Any:
        given.update(zip(("state", "residuals", "jacobian", "after_step"), functions, strict=True))
        return functions[0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mixseq.operations.pose_solvers.minimise", capture)
        solver._minimise(*arguments)
    return given


@pytest.mark.parametrize("form", ["model", "still"])
def test_derivatives_are_those_of_differences(form: str) -> None:
    """Of positions of a vertex and of the middle of a part, and of the moments by which a part is turned."""
    model = still(3) if form == "still" else chain()
    points, generator = model(model.start), np.random.default_rng(1)
    handles = Handle(0.0, [0, 0, 0], TIP), Handle(0.0, [0, 0, 0], part=1, rotation=[10, 20, 30])
    rows = [row for handle in handles for row in handle.targets(model, points)[0]]
    targets = generator.normal(size=(len(rows), 3))
    if form == "still":
        chained = StillSolver(model, rows, 0.01, is_free=True)
        turns = rotation((0.3, -0.5, 0.2)), rotation((-0.4, 0.1, 0.6)), rotation((0.2, 0.7, -0.1))
        shifts = np.where(chained.is_root[:, None], generator.normal(size=(3, 3)), 0.0)
        given = functions_of(chained, 0.3, targets, chained.unchanged(), JointRotations(np.stack(turns), shifts))
    else:
        solver = PoseSolver(model, rows, 0.01, is_free=True)
        prior = solver.unchanged()
        change = prior._replace(scores=generator.normal(size=prior.scores.shape), moves=prior.moves + 0.1)
        given = functions_of(solver, 0.3, targets, prior, change)
    count, state, step = 3 * len(rows), given["state"], 1e-6  # rows of rotations are exact at small rotations only
    slopes = given["jacobian"](state)[:count]
    for column, direction in enumerate(np.eye(slopes.shape[1])):
        ends = [given["residuals"](given["after_step"](state, sign * step * direction))[:count] for sign in (1, -1)]
        np.testing.assert_allclose(
            (ends[0] - ends[1]) / (2 * step), slopes[:, column], atol=1e-4 * np.abs(slopes).max()
        )


@pytest.mark.parametrize("angles", [(25.0, 0.0, 0.0), (-10.0, 15.0, 5.0)])
def test_a_rotation_turns_a_part_of_a_still(angles: tuple[float, float, float]) -> None:
    model = still()
    part = int(model.decomposition.part_of_face[HALVES.argmax()])
    posed = pose(model, [Handle(0.5, part=part, rotation=angles)], keep=BASE, softness=1e-4)(0.5)
    before, after = MESH[0][bone(2)], posed[bone(2)]
    expected = (before - before.mean(axis=0)) @ rotation(tuple(np.radians(angles))).T
    assert np.abs(after - after.mean(axis=0) - expected).max() < 0.01 * model.space.scale
    assert np.linalg.norm(posed[BASE] - MESH[0][BASE], axis=1).max() < 0.005 * model.space.scale


def test_solutions_start_from_the_one_before() -> None:
    """The shorter way of a dragged handle: one round from a near pose is the pose of all rounds from the start."""
    model, rows = still(3), Handle(0.0, [0, 0, 0], TIP).targets(still(3), MESH[0])[0]
    solver = StillSolver(model, rows, 0.005, is_free=False)
    near, target = (np.asarray(MESH[0][[TIP]] + [0.0, shift, -0.2 * shift]) for shift in (0.95, 1.0))
    dragged, found = solver.solve(0.0, target, start=solver.solve(0.0, near), rounds=1), solver.solve(0.0, target)
    np.testing.assert_allclose(solver.points(0.0, dragged)[TIP], solver.points(0.0, found)[TIP], atol=1e-2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"fade": 0.1}, "no motion to fade into"),
        ({"start": 0.0}, "no motion to fade into"),
        ({"end": 0.0}, "no motion to fade into"),
        ({"softness": 0.0}, "softness is 0"),
    ],
)
def test_refusals(options: dict[str, float], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        pose(still(), [Handle(0.5, MESH[0][TIP], TIP)], **options)  # type: ignore[arg-type]


def test_stills_that_cannot_bend_are_refused() -> None:
    sequence = replace(still().sample())
    handle = Handle(0.5, MESH[0][TIP], TIP)
    with pytest.raises(SettingsError, match="a still of one part"):
        pose(fit(sequence, parts=1), [handle])
    with pytest.raises(SettingsError, match="placement='anchored'"):
        pose(fit(sequence, parts=2, placement="free"), [handle])
    herd = with_body(still(), key_poses(still()), "other")
    with pytest.raises(SettingsError, match="a still of several bodies"):
        pose(herd, [handle])
    with pytest.raises(SettingsError, match="a finite number of seconds"):
        pose(still(), [replace(handle, time=np.nan)])
