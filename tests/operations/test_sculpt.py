"""Sculpts: in the part's own frame the same everywhere, where they were made exactly what was made, else nothing."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.compression.numbering import walk_numbering
from mixseq.errors import InvalidSequenceError, MixseqWarning, SettingsError
from mixseq.mesh.measures import dihedral_angles, wrap_angles
from mixseq.mesh.rigid import kabsch
from mixseq.operations.sculpt import Where, check_edited_points, sculpt
from mixseq.operations.sections import smoothstep
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.detail import Detail, build_model, encode_sequence
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.signals.pose import PoseMap
from mixseq.spaces.base import ShapeSpace
from mixseq.spaces.pieces import register_parts
from mixseq.types import Float, Index
from tests.meshes import bar, bending, tube
from tests.operations.motions import first_frames

FRAMES = 9
SPACES = ["anchored", "free", "vertex"]


@cache
def model_of(kind: str = "anchored") -> Model:
    sequence = bar(sides=6, rings=21, frames=FRAMES)
    if kind == "vertex":
        return fit(sequence, exact=True, space="vertex")
    return fit(sequence, exact=True, placement="free" if kind == "free" else "anchored", parts=2)


def own_vertices(model: Model, part: int) -> Index:
    """Vertices that only one part knows of, and no joint."""
    parts = [vertices for number, vertices in enumerate(model.decomposition.parts) if number != part]
    joints = [joint.vertices for joint in model.decomposition.joints]
    return np.setdiff1d(model.decomposition.parts[part], np.concatenate([*parts, *joints]))


def bumped(points: Float, vertices: Index, height: float = 0.2) -> Float:
    """The vertices pushed in one direction, the more the nearer to the first of them."""
    result = points.copy()
    away = np.linalg.norm(points[vertices] - points[vertices[0]], axis=1)
    result[vertices] += height * np.exp(-(away**2))[:, None] * np.array([0.6, -0.5, 0.7])
    return result


@pytest.mark.parametrize("kind", SPACES)
@pytest.mark.parametrize("time", [0.3, 0.35])
def test_zero_sculpt_is_the_identity(kind: str, time: float) -> None:
    model = model_of(kind)
    same = sculpt(model, time, model(time))
    assert np.array_equal(same.shapes[-1], model.shapes[0])
    times = [0.0, 0.3, 0.33, 0.8]
    np.testing.assert_allclose(same.sample(times).points, model.sample(times).points, atol=1e-12)


@pytest.mark.parametrize("kind", SPACES)
@pytest.mark.parametrize("where", ["everywhere", "window", "similar"])
def test_edited_frame_equals_the_sculpted_mesh(kind: str, where: Where) -> None:
    model = model_of(kind)
    edited = bumped(model(0.3), np.arange(40, 60))  # over the joint
    end = 0.6 if where == "window" else None
    np.testing.assert_allclose(sculpt(model, 0.3, edited, where, end=end)(0.3), edited, atol=1e-9)


@pytest.mark.parametrize(("kind", "error"), [("anchored", 1e-9), ("free", 1e-2)])
@pytest.mark.parametrize("part", [0, 1])
def test_a_bump_keeps_its_shape_in_the_frame_of_its_part(kind: str, error: float, part: int) -> None:
    """Free parts are placed by lengths and angles next to it."""
    model = model_of(kind)
    own = own_vertices(model, part)
    rigid, bump = own[:12], own[-12:]
    edited = bumped(model(0.2), bump)
    sculpted = sculpt(model, 0.2, edited)
    for time in model.times:
        before, after = model(time), sculpted(time)
        inside = (after - before)[bump] @ turn_of(model, part, time)
        np.testing.assert_allclose(inside, (edited - model(0.2))[bump] @ turn_of(model, part, 0.2), atol=error)
        np.testing.assert_allclose(after[rigid], before[rigid], atol=error)


def turn_of(model: Model, part: int, time: float) -> Float:
    """How the part is turned: the rotation from its mean shape."""
    space = model.mixed
    rotation: Float = register_parts(space.shapes, space.decomposition.parts, model(time) / space.scale)[0][part]
    return rotation


def test_a_bump_turns_with_a_rigid_body_by_any_angle() -> None:
    """One part that turns by a right angle: the bump turns with it."""
    mesh = tube(6, 9)
    model = fit(bar(sides=6, rings=9, frames=2).with_points(bending(mesh, 2, angle=0.0, wobble=0.0)), exact=True)
    first, last = model(0.0), model(0.1)
    turn, shift = kabsch(first, last)
    edited = bumped(first, np.arange(10, 20))
    np.testing.assert_allclose(sculpt(model, 0.0, edited)(0.1), edited @ turn.T + shift, atol=1e-9)


def test_an_edit_between_frames_is_met_there() -> None:
    model = model_of()
    edited = bumped(model(0.23), own_vertices(model, 1)[-12:])
    np.testing.assert_allclose(sculpt(model, 0.23, edited)(0.23), edited, atol=1e-6)


def with_all_joints(share: float) -> Model:
    """The bar in few frames, lengths and angles of all its faces in the vector, followed as far as a share."""
    sequence = bar(sides=6, rings=21, frames=3)
    model = fit(sequence, exact=True, parts=2)
    projection = replace(model.mixed.projection, share=share)
    space = replace(model.mixed, joint_faces=np.ones(len(sequence.faces), dtype=bool), projection=projection)
    return build_model(encode_sequence(sequence, space), Detail())


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_an_edit_between_frames_is_met_by_lengths_and_angles(share: float) -> None:
    """There they are not those of posed vertices."""
    model = with_all_joints(share)
    time, vertices = 0.15, np.arange(40, 60)
    posed = model.mixed.skin(model.curve([time]))[0] * model.space.scale
    assert np.abs(posed - model(time)).max() > 1e-4
    edited = bumped(model(time), vertices, 0.1)
    np.testing.assert_allclose(sculpt(model, time, edited)(time), edited, atol=1e-9)


def test_two_sculpts_add_up() -> None:
    model = model_of()
    first, second = own_vertices(model, 0)[:10], own_vertices(model, 1)[-10:]
    once = sculpt(model, 0.2, bumped(model(0.2), first))
    twice = sculpt(once, 0.5, bumped(once(0.5), second))
    np.testing.assert_allclose(twice(0.5), bumped(once(0.5), second), atol=1e-9)
    np.testing.assert_allclose(twice(0.2)[first], once(0.2)[first], atol=1e-9)
    other = sculpt(model, 0.5, bumped(model(0.5), second))
    np.testing.assert_allclose(twice(0.7)[second], other(0.7)[second], atol=1e-9)


@pytest.mark.parametrize(("start", "end"), [(0.1, 0.5), (0.1, None), (None, 0.55), (0.123, 0.317)])
def test_outside_its_window_a_sculpt_does_nothing(start: float | None, end: float | None) -> None:
    model = model_of()
    edited = bumped(model(0.2), np.arange(40, 60))
    sculpted = sculpt(model, 0.2, edited, "window", start=start, end=end)
    dense = np.linspace(0.0, 0.8, 161)
    weight = sculpted.time(dense)[:, -1]
    outside = (dense <= (start or -1)) | (dense >= (end or 9))
    np.testing.assert_allclose(weight[outside], 0.0, atol=1e-10)
    np.testing.assert_allclose(sculpted.time(dense)[:, :-1], model.time(dense), atol=1e-10)
    expected = np.ones(len(dense))
    if start is not None:
        expected = expected * smoothstep(dense, start, 0.2)
    if end is not None:
        expected = expected * (1.0 - smoothstep(dense, 0.2, end))
    np.testing.assert_allclose(weight, expected, atol=1e-9)
    times = dense[outside][::10]
    np.testing.assert_allclose(sculpted.sample(times).points, model.sample(times).points, atol=1e-9)


def test_times_that_miss_a_frame_by_rounding_are_the_frame() -> None:
    """0.1 and 1/3 typed with few digits make no needle-thin pieces of the time signal."""
    model = model_of()
    sculpted = sculpt(model, 0.20002, model(0.2), "window", start=0.10003, end=0.59999)
    assert np.diff(sculpted.time.times).min() > 1e-3


def test_similar_shapes_are_sculpted_more() -> None:
    model = model_of()
    edited = bumped(model(0.3), own_vertices(model, 0)[:10])
    wide, narrow = (sculpt(model, 0.3, edited, "similar", radius=radius) for radius in (0.5, 0.1))
    times = model.times
    weight = wide.time(times)[:, -1]
    shapes = (model.time(times) - model.time([0.3])) @ model.pose.matrix @ model.shapes
    distance = np.linalg.norm(shapes * model.space.embedding_weights, axis=1)
    expected = np.exp(-0.5 * (distance / (0.5 * distance.max())) ** 2)
    np.testing.assert_allclose(weight, expected, atol=2e-3)  # the largest distance is looked for at some times
    assert weight[3] == 1.0
    assert (narrow.time(times)[:, -1] <= weight + 1e-12).all()
    default = sculpt(model, 0.3, edited, "similar")
    np.testing.assert_array_equal(default.time.values, sculpt(model, 0.3, edited, "similar", radius=0.25).time.values)


def test_what_does_not_move_is_similar_everywhere() -> None:
    sequence = bar(sides=5, rings=15, frames=1)
    still = sequence.with_points(sequence.points[:1])
    model = fit(still, exact=True)
    edited = bumped(model(0.0), np.arange(5))
    np.testing.assert_allclose(sculpt(model, 0.0, edited, "similar")(0.0), edited, atol=1e-9)


def test_sculpt_keeps_other_signals() -> None:
    model = fit(bar(sides=6, rings=21, frames=FRAMES), exact=True, parts=2)
    sculpted = sculpt(model, 0.2, bumped(model(0.2), np.arange(10)), "window", end=0.5)
    assert len(sculpted.shapes) == len(model.shapes) + 1
    np.testing.assert_array_equal(sculpted.shapes[:-1], model.shapes)
    np.testing.assert_array_equal(sculpted.placement.values, model.placement.values)
    np.testing.assert_array_equal(sculpted.times, model.times)
    assert isinstance(sculpted.pose, PoseMap)


def test_the_default_of_the_contract_is_the_difference_of_codes() -> None:
    model = model_of("vertex")
    before, after = model(0.1), bumped(model(0.1), np.arange(9))
    vector = model.curve([0.1])[0]
    difference = model.space.shape_difference(vector, before, after)
    np.testing.assert_allclose(ShapeSpace.shape_difference(model.space, vector, before, after), difference)


def test_angles_take_the_short_way() -> None:
    """A mesh turned inside out: all angles change sign, some of them by more than half a turn."""
    model = with_all_joints(0.0)
    space, points = model.mixed, 2.0 * model(0.2)
    folded = points * np.array([1.0, 1.0, -1.0])
    edges, hinges = space.block_sizes[:2]
    angles = space.shape_difference(model.curve([0.2])[0], points, folded)[edges : edges + hinges]
    before = dihedral_angles(points, space.topology.hinges[space.hinge_ids])
    np.testing.assert_allclose(angles, wrap_angles(-2.0 * before), atol=1e-9)
    assert (np.abs(angles) <= np.pi).all()
    assert np.abs(before).max() > np.pi / 2


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"where": "here"}, "where is 'here'; 'everywhere', 'window', 'similar' is expected"),
        ({"where": "window"}, "a window needs a start or an end"),
        ({"end": 0.5}, "start and end are of a window"),
        ({"radius": 0.5}, "radius is of where='similar'"),
        ({"where": "similar", "radius": 0.0}, "radius is 0.0; a positive fraction"),
        ({"where": "similar", "radius": np.nan}, "radius is nan"),
        ({"where": "window", "start": 0.3}, r"the window has start 0.3 s; the sculpted time, 0.2 s, must be within"),
        ({"where": "window", "start": 0.1, "end": 0.2}, r"start 0.1 s and end 0.2 s"),
        ({"where": "window", "start": -1.0}, r"start is -1 s; the model is from 0 to 0.8 s"),
        ({"time": 0.9}, "time is 0.9 s; the model is from 0 to 0.8 s"),
    ],
)
def test_settings_that_make_no_sense(settings: dict[str, object], message: str) -> None:
    model = model_of()
    given = {"time": 0.2, "points": model(0.2), **settings}
    with pytest.raises(SettingsError, match=message):
        sculpt(model, **given)  # type: ignore[arg-type]


def test_points_of_another_mesh() -> None:
    model = model_of()
    with pytest.raises(InvalidSequenceError, match=r"have shape \(127, 3\); \(128, 3\) is expected: move the vertices"):
        sculpt(model, 0.2, model(0.2)[:-1])
    broken = model(0.2).copy()
    broken[7, 1] = np.nan
    with pytest.raises(InvalidSequenceError, match="vertex 7 of the edited points is not finite"):
        sculpt(model, 0.2, broken)


def test_the_smooth_step() -> None:
    times = np.linspace(-1.0, 3.0, 401)
    step = smoothstep(times, 0.0, 2.0)
    assert (step[times <= 0] == 0).all()
    assert (step[times >= 2] == 1).all()
    assert (np.diff(step) >= 0).all()
    np.testing.assert_allclose(step + step[::-1], 1.0, atol=1e-15)
    second = np.diff(step, 2) / 0.01**2
    assert np.abs(np.diff(second)).max() < 0.1  # curvature has no jumps


@pytest.mark.realdata
def test_a_bump_on_the_flank_of_the_horse(data: Path) -> None:
    """In every frame of the gallop it is there, in the part's own frame the same to a millionth of the diagonal."""
    sequence = first_frames(mixseq.read(data / "npz" / "horse_gallop.npz"), 12)
    model = fit(sequence, exact=True)
    trunk = int(np.argmax([len(vertices) for vertices in model.decomposition.parts]))
    space, time = model.mixed, float(model.times[5])
    own = np.flatnonzero(space.rigid_part_of_vertex == trunk)  # others follow two parts
    own = np.setdiff1d(own, space.joint_projection.moving_vertex_ids)
    before = model(time)
    flank = own[before[own, 0].argmax()]  # x points to the side
    bump = own[np.argsort(np.linalg.norm(before[own] - before[flank], axis=1))[:80]]
    edited = bumped(before, bump[np.argsort(bump != flank)], 0.05)
    sculpted = sculpt(model, time, edited)
    inside = (edited - before)[bump] @ turn_of(model, trunk, time)
    assert np.linalg.norm(inside, axis=1).max() > 0.02 * sequence.diagonal
    for frame in range(0, 12, 3):
        now = float(model.times[frame])
        moved = (sculpted(now) - model(now))[bump] @ turn_of(model, trunk, now)
        np.testing.assert_allclose(moved, inside, atol=1e-6 * sequence.diagonal)


def test_meshes_with_other_edges_are_refused() -> None:
    """Renumbered vertices are told by the faces; triangulated polygons and numbers of compressed files are fine."""
    sequence = bar(sides=5, rings=15, frames=4)
    model = fit(sequence, exact=True, space="vertex")
    frame = MeshSequence.from_arrays(sequence.points[:1], sequence.polygons)
    same = sculpt(model, float(model.times[0]), frame)
    np.testing.assert_allclose(same.sample().points, sequence.points, atol=1e-9)
    free = walk_numbering(sequence.polygons, [sequence.vertex_count], vertices=True)
    assert free.order == "free"
    moved = sequence.points[:1] + 0.1 * np.random.default_rng(0).normal(size=sequence.points[:1].shape)
    edited = MeshSequence.from_arrays(moved, sequence.polygons)
    with pytest.warns(MixseqWarning, match="^vertices of .* have other numbers in"):
        np.testing.assert_array_equal(check_edited_points(free.renumber_frames(edited), model.header), moved[0])
    order = np.random.default_rng(0).permutation(sequence.vertex_count)
    place = np.argsort(order)
    renumbered = MeshSequence.from_arrays(sequence.points[:1, order], place[sequence.faces])
    with pytest.raises(
        InvalidSequenceError,
        match=r"other edges than the model, polygon \d+ of the edited mesh \(.*\) is .* the model; export it again",
    ):
        sculpt(model, 0.0, renumbered)
    with pytest.raises(SettingsError, match="has 4 frames; one is expected"):
        sculpt(model, 0.0, sequence)


def test_a_mesh_that_is_not_the_frame_is_doubted() -> None:
    sequence = bar(sides=5, rings=15, frames=4)
    model = fit(sequence, exact=True, space="vertex")
    turned = sequence.points[0][:, [0, 2, 1]]
    with pytest.warns(MixseqWarning, match=r"vertices moved, by up to .* diagonals; is the mesh the frame at 0 s"):
        sculpt(model, 0.0, turned)
