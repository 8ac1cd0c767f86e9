"""What is asked for decides, not how it is stored: every operation on every representation of one motion.

The result equals that of the exact model, within the error of the representation times the gain of the operation. Or a
warning names what is lost, or an error says why it is refused. Nothing is lost in silence.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import mixseq
from mixseq import operations
from mixseq.choices import SPACES, SpaceName
from mixseq.compression.compressed_model import CompressedModel
from mixseq.errors import MixseqWarning, SettingsError
from mixseq.mesh.surface import CornerValues
from mixseq.operations.script import OPERATIONS
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.model import Model
from mixseq.types import Float
from tests.meshes import bar

FRAMES = bar(sides=5, rings=15, frames=9)
TIMES = FRAMES.times

BOUND = 1e-3
"""Bound of compressed files, in diagonals."""

RECOMPRESSED = 1e-4
"""Bound of compressing a representation, in diagonals."""

ROUNDING = 1e-9
"""Largest difference that is a rounding error, in diagonals."""

Source = Any
"""A representation: a model, a sequence or an open reader."""

Result = Any
"""A model, a sequence or an array of points."""


@cache
def original() -> MeshSequence:
    """The bar with colours, its own velocities, and axes and units that are not the defaults."""
    corners = np.random.default_rng(0).random((3 * len(FRAMES.faces), 4))
    surface = replace(FRAMES.surface, colours=CornerValues.from_corners(corners))
    velocities = np.gradient(FRAMES.points, TIMES, axis=0)
    return replace(FRAMES, velocities=velocities, surface=surface, up_axis="Z", metres_per_unit=0.01, provenance=None)


def has_parts(source: Source) -> bool:
    return isinstance(source, Model) and source.space.name == "mixed"


def limb(model: Source) -> int:
    """A part that hangs on another one."""
    return int(np.flatnonzero(model.mixed.articulation.parents >= 0)[0]) if has_parts(model) else 0


def raised(model: Source) -> Float:
    """A place near the first vertex at 0.3 s."""
    return np.asarray(model(0.3)[0] + 0.02 if isinstance(model, Model) else original().points[0, 0])


def moved(model: Source, time: float) -> Float:
    """A frame, some vertices moved."""
    points = np.array(model(time) if isinstance(model, Model) else original().points[0])
    points[:20] += 0.02
    return points


@cache
def vertex_space() -> Any:
    return mixseq.fit(FRAMES, exact=True, space="vertex").space


def place(model: Source, times: Float) -> Float:
    """Points of the embedding."""
    return np.asarray(model.embedding(times) if isinstance(model, Model) else np.zeros((len(times), 2)))


def sketched_frames(model: Source) -> Float:
    """Frames that a sketch passes; in between it is a guess, which depends on how far frames are apart in the plane."""
    places = place(model, TIMES[:4])
    sketch = operations.sketch(model, places, 1.0)
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1)))
    return np.asarray(sketch.sample(lengths / lengths[-1]).points, dtype=np.float64)


def by_key_poses(model: Source) -> Source:
    """The same body once more, by the key poses of the model."""
    herd = operations.with_body(model, operations.key_poses(model), "again")
    again = herd.body("again")
    return replace(again, header=replace(again.header, name=herd.header.name), bodies=())


def compressed(source: Source) -> MeshSequence:
    return CompressedModel.from_sequence(mixseq.compress(source, max_error=RECOMPRESSED)).sample()


def stored(source: Source, folder: Path) -> Result:
    """Save and load again; sequences with their velocities."""
    if isinstance(source, Model):
        mixseq.save(folder / "again.h5", source)
        return mixseq.load(folder / "again.h5")
    if isinstance(source, MeshSequence):
        mixseq.write(folder / "again.npz", source)
    else:
        mixseq.write_blocks(folder / "again.npz", source.header, source.blocks(), source.velocity_blocks())
    return mixseq.read(folder / "again.npz")


class Operation(NamedTuple):
    """An operation, and how it changes errors."""

    run: Callable[[Source], Result]
    gain: float  # largest ratio of the error of the result to that of the representation
    takes: str = "models"  # "models" (sequences are refused), "all", or "methods" (those of models)
    warns: str = ""  # what is lost of a sequence with velocities
    own_error: float = 0.0  # in diagonals


VELOCITIES = "'bar': velocities are left out; models compute them"

TABLE: Mapping[str, Operation] = {
    # Maps of time show the same frames: gain 1.
    "cut": Operation(lambda model: operations.cut(model, 0.1, 0.5), 1),
    "shift": Operation(lambda model: operations.shift(model, 1.0), 1),
    "speed": Operation(lambda model: operations.speed(model, 2.0), 1),
    "reverse": Operation(operations.reverse, 1),
    "retime": Operation(lambda model: operations.retime(model, [[0.0, 0.0], [1.0, 0.5]]), 1),
    "resample": Operation(lambda source: operations.resample(source, fps=24), 1, "all", VELOCITIES),
    "sample": Operation(lambda model: model.sample(), 1, "methods"),
    "fit": Operation(lambda source: mixseq.fit(source, exact=True).sample(), 1, "all", VELOCITIES),
    "compress": Operation(compressed, 1, "all", VELOCITIES, 2 * RECOMPRESSED),
    "save": Operation(lambda source: source, 1, "all"),  # replaced by `stored`, which needs a folder
    # Seams distribute differences of both ends, which may add up.
    "repeat": Operation(lambda model: operations.repeat(model, 0.2, 0.6), 2),
    "loop": Operation(operations.loop, 2),
    "concatenate": Operation(lambda model: operations.concatenate(model, model), 2),
    "transition": Operation(lambda model: operations.transition(model, model, 0.2, 0.3), 2),
    "blend": Operation(lambda model: operations.blend(model, model, 0.25), 2),
    # Splines of vertices pass frames only.
    "into": Operation(lambda model: operations.into(model, vertex_space()), 2),
    # Poses and places are changed by what is measured in the model.
    "in_place": Operation(operations.in_place, 2),
    "travel_of": Operation(lambda model: operations.travel_of(model)(TIMES[1:-1]), 2),
    "exaggerate": Operation(lambda model: operations.exaggerate(model, 1.1), 2),
    "exaggerate_part": Operation(lambda model: operations.exaggerate_part(model, limb(model), 1.1), 2),
    "hold": Operation(lambda model: operations.hold(model, limb(model), 0.2, 0.3, 0.4), 2),
    "smooth": Operation(lambda model: operations.smooth(model, 0.1), 2),
    "sculpt": Operation(lambda model: operations.sculpt(model, 0.3, moved(model, 0.3)), 2),
    "pose": Operation(lambda model: operations.pose(model, [operations.Handle(0.3, raised(model), 0)]), 2),
    "drag": Operation(lambda model: operations.drag(model, 0.3, place(model, TIMES[3:4])[0] + 0.01), 2),
    "sketch": Operation(sketched_frames, 2),
    "with_body": Operation(by_key_poses, 2),
    "transfer": Operation(
        lambda source: mixseq.transfer(source, replace(original(), velocities=None)), 2, "all", VELOCITIES
    ),
    "interpolate": Operation(
        lambda source: mixseq.interpolate(source, np.eye(9)[[0, 3]].mean(axis=0)), 2, "all", own_error=4e-4
    ),
    "velocity": Operation(lambda model: model.velocity(0.25) / model.header.fps, 2, "methods"),  # per frame
}
"""Operations, with gains that were measured on these representations and rounded up."""

MODELS = ("exact", "default", "rank-limited", "h5", "h5 saved", "edited", "transferred", "loaded")
SEQUENCES = ("sequence", "reader")


class Motion(NamedTuple):
    """A representation, the exact model of what it represents, and their largest distance."""

    source: Source
    exact: Model
    error: float  # in diagonals, at frames and between


@pytest.fixture(scope="session")
def motions(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Mapping[str, Motion]]:
    """All representations."""
    folder, frames = tmp_path_factory.mktemp("contract"), original()
    quiet = replace(frames, velocities=None)
    exact = mixseq.fit(quiet, exact=True)
    default = mixseq.fit(quiet)
    coded = mixseq.compress(quiet, max_error=BOUND)
    mixseq.write(folder / "bar.npz", frames)
    mixseq.save(folder / "loaded.h5", exact)
    mixseq.save(folder / "coded.h5", coded)
    mixseq.save(folder / "coded.glb", coded, still="none")
    h5, glb = mixseq.load(folder / "coded.h5"), mixseq.load(folder / "coded.glb")
    for found, expected_curve in zip(glb.curves, h5.curves, strict=True):
        np.testing.assert_array_equal(found.values, expected_curve.values)  # so that it is tried as one of them
    check_header(glb, h5)
    mixseq.save(folder / "h5 saved.h5", h5)
    edit = partial(operations.exaggerate, gain=1.2)
    made: dict[str, Source] = {
        "exact": exact,
        "default": default,
        "rank-limited": mixseq.fit(quiet, rank=4),
        "h5": h5,
        "h5 saved": mixseq.load(folder / "h5 saved.h5"),
        "edited": edit(default),
        "transferred": mixseq.fit(mixseq.transfer(exact, quiet), exact=True),
        "loaded": mixseq.load(folder / "loaded.h5"),
    }
    expected = {name: edit(exact) if name == "edited" else exact for name in made}
    times = np.linspace(exact.start, exact.end, 193)
    motions = {name: Motion(made[name], expected[name], 0.0) for name in made}
    motions = {
        name: motion._replace(error=distance(motion.source.sample(times), motion.exact.sample(times)))
        for name, motion in motions.items()
    }
    with mixseq.open_sequence(folder / "bar.npz") as reader:
        yield {"sequence": Motion(frames, exact, 0.0), "reader": Motion(reader, exact, 0.0), **motions}


def points(result: Result) -> Float:
    """Points of a result; of models also between frames."""
    if isinstance(result, Model):
        result = result.sample(np.linspace(result.start, result.end, 17))
    return np.asarray(result.points if isinstance(result, MeshSequence) else result)


def distance(result: Result, expected: Result) -> float:
    """Largest distance of a vertex in diagonals."""
    return float(np.linalg.norm(points(result) - points(expected), axis=-1).max()) / FRAMES.diagonal


@cache
def run_once(name: str, source: Source) -> Result:
    """Return the result of an operation."""
    return TABLE[name].run(source)


def check_header(result: Any, source: Any) -> None:
    """Check that the mesh, its surface and its parts are those of the source, and that no bound is stated wrongly."""
    if isinstance(result, np.ndarray):
        return
    header, before = result.header, source.header
    for name in ("name", "up_axis", "metres_per_unit", "vertex_count"):
        assert getattr(header, name) == getattr(before, name)
    np.testing.assert_array_equal(header.polygons.indices, before.polygons.indices)
    colours, expected = header.surface.colours, before.surface.colours
    assert (colours is None) == (expected is None)
    if colours is not None and expected is not None:
        np.testing.assert_array_equal(colours.at_corners, expected.at_corners)
    if has_parts(result) and has_parts(source):
        np.testing.assert_array_equal(result.parts, source.parts)
    stated = header.provenance and header.provenance.bounds and header.provenance.bounds[-1][1]
    if stated:
        np.testing.assert_allclose(header.times, TIMES, atol=1e-12)
        frames = result if isinstance(result, MeshSequence) else result.sample()
        assert distance(frames, FRAMES) <= stated * (1 + 1e-6)


def test_the_table_is_complete() -> None:
    others = {
        "Handle",
        "Moment",
        "Retiming",
        "read_retiming",
        "key_poses",
        "find_moments",
        "fit_shots",
    }  # no operations
    assert OPERATIONS.keys() | set(operations.__all__) == (TABLE.keys() | others) - {
        "sample",
        "velocity",
        "save",
        "fit",
        "compress",
        "transfer",
        "interpolate",
    }


def test_representations_state_their_errors(motions: Mapping[str, Motion]) -> None:
    for motion in motions.values():
        if isinstance(motion.source, Model):
            check_header(motion.source, motion.exact)
    assert ROUNDING < motions["rank-limited"].error < motions["default"].error < motions["h5"].error < 2 * BOUND


@pytest.mark.parametrize("form", SEQUENCES + MODELS)
@pytest.mark.parametrize("name", TABLE)
def test_operations_do_not_depend_on_the_form(
    name: str, form: str, motions: Mapping[str, Motion], tmp_path: Path
) -> None:
    operation, (source, exact, error) = TABLE[name], motions[form]
    run = operation.run if name != "save" else partial(stored, folder=tmp_path)
    if form in SEQUENCES and operation.takes == "methods":
        assert not hasattr(source, name)
        return
    if form in SEQUENCES and operation.takes == "models":
        with pytest.raises(TypeError, match=r"Model is expected \(mixseq\.fit makes one of a sequence"):
            run(source)
        return
    loss = operation.warns if form in SEQUENCES else ""
    with pytest.warns(MixseqWarning, match=loss) if loss else nullcontext():
        result = run(source) if name == "save" else run_once(name, source)
    check_header(result, source)
    if name == "save" and form in SEQUENCES:
        np.testing.assert_array_equal(result.points, points(original()))
        np.testing.assert_array_equal(result.velocities, original().velocities)
    else:
        expected = exact if name == "save" else run_once(name, exact)
        found = distance(result, expected)

        assert found <= operation.gain * error + operation.own_error + ROUNDING
        if isinstance(result, Model):
            np.testing.assert_allclose(result.times, expected.times, atol=1e-12)


IDENTITIES: Mapping[str, Callable[[Model], Result]] = {
    "shift": lambda model: operations.shift(model, 0.0),
    "speed": lambda model: operations.speed(model, 1.0),
    "reverse twice": lambda model: operations.reverse(operations.reverse(model)),
    "retime": lambda model: operations.retime(model, [[model.start, model.start], [model.end, model.end]]),
    "cut": lambda model: operations.cut(model, model.start, model.end),
    "exaggerate": lambda model: operations.exaggerate(model, 1.0),
    "resample": operations.resample,
    "sample": lambda model: model.sample(model.times),
    "fit": TABLE["fit"].run,
}


@pytest.mark.parametrize("form", MODELS)
@pytest.mark.parametrize("name", IDENTITIES)
def test_identities_change_nothing(name: str, form: str, motions: Mapping[str, Motion]) -> None:
    """Neither frames, nor what is between them; an exact fit makes that anew."""
    source = motions[form].source
    result = run_once(name, source) if name == "fit" else IDENTITIES[name](source)
    frames = result if isinstance(result, MeshSequence) else result.sample()
    assert distance(frames, source.sample()) <= ROUNDING
    np.testing.assert_allclose(frames.times, source.times, atol=1e-12)
    check_header(result, source)
    if isinstance(result, Model) and name != "fit":
        between = np.linspace(source.start, source.end, 17)[1::2]  # no frames
        assert distance(result.sample(between), source.sample(between)) <= ROUNDING


def test_saving_twice_changes_nothing(motions: Mapping[str, Motion], tmp_path: Path) -> None:
    for form in MODELS:
        again = stored(motions[form].source, tmp_path)
        if form == "h5":
            assert distance(again.sample(), motions[form].source.sample()) <= ROUNDING
        else:
            np.testing.assert_array_equal(points(again), points(motions[form].source))
            assert str(again.header.provenance) == str(motions[form].source.header.provenance)


WITHOUT_PARTS = {**dict.fromkeys(("exaggerate_part", "hold", "pose", "with_body"), r"space='mixed'|mixed space")}
"""Why spaces without parts, and models of modes, are refused."""


@cache
def in_space(space: SpaceName) -> Model:
    return mixseq.fit(bar(sides=4, rings=9, frames=9), exact=True, space=space)


@pytest.mark.parametrize("space", [space for space in SPACES if space != "mixed"])
@pytest.mark.parametrize("name", OPERATIONS)
def test_edits_stay_in_the_space(name: str, space: SpaceName, tmp_path: Path) -> None:
    model = in_space(space)
    refused = WITHOUT_PARTS.get(name) or ("no positions of bodies" if (name, space) == ("in_place", "vertex") else "")
    if refused:
        with pytest.raises(SettingsError, match=refused):
            TABLE[name].run(model)
        return
    edited = TABLE[name].run(model)
    if not isinstance(edited, Model):
        assert name == "sketch"
        np.testing.assert_allclose(edited, model.sample(frames=range(4)).points, atol=1e-5)
        return
    assert edited.space.name == space
    assert edited.header.provenance is not None
    assert edited.header.provenance.edited
    again, times = stored(edited, tmp_path), [edited.start, (edited.start + edited.end) / 2, edited.end]
    found = again.sample(times).points
    assert np.isfinite(found).all()
    np.testing.assert_array_equal(found, edited.sample(times).points)
