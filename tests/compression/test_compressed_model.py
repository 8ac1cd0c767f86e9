"""Compressed models: streams at the frames, an exact model in S_m between them and in edits."""

from __future__ import annotations

import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mixseq
from mixseq.choices import OrderName
from mixseq.compression.bitstream.compressed_sequence import CompressedSequence, decode
from mixseq.compression.compressed_model import CompressedModel
from mixseq.errors import FormatError, MixseqWarning, SegmentationError, SettingsError
from mixseq.operations import exaggerate_part, key_poses, reverse, with_body
from mixseq.operations.interpolation import PoseInterpolator
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.curve import Curve
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.spaces.mixed.mixed_space import MixedSpace
from mixseq.types import IntArray
from tests.meshes import bar


@cache
def coded() -> CompressedSequence:
    return mixseq.compress(bar(sides=5, rings=15, frames=6), max_error=1e-4)


@cache
def exact() -> Model:
    """The exact model of the decoded frames."""
    return fit(decode(coded()).sample(), exact=True, parts=coded().parts)


@pytest.fixture
def model(monkeypatch: pytest.MonkeyPatch) -> CompressedModel:
    """A model that has not been fitted."""
    return CompressedModel.from_sequence(coded())


def test_frames_are_those_of_the_streams_and_nothing_is_fitted(
    model: CompressedModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mixseq.signals.fitting.fit", None)
    np.testing.assert_array_equal(model.sample().points, decode(coded()).sample().points)
    np.testing.assert_array_equal(model(model.times[2] * (1 + 1e-15)), model(model.times[2]))
    assert (model.start, model.end) == (model.times[0], model.times[-1])
    assert repr(model) == "CompressedModel('bar': 0 to 0.5 s, 6 frames)"
    with pytest.raises(SettingsError, match="outside"):
        model(0.6)


def test_between_frames_it_is_the_exact_model(model: CompressedModel) -> None:
    times = np.array([0.0, 0.03, 0.1, 0.25, 0.5])  # some are frames
    points = np.concatenate(list(model.blocks(times, size=2)))
    np.testing.assert_array_equal(points[[1, 3]], exact().sample(times[[1, 3]]).points)
    np.testing.assert_array_equal(points[[0, 2, 4]], decode(coded()).sample(times[[0, 2, 4]]).points)
    np.testing.assert_allclose(points, exact().sample(times).points, atol=1e-10)
    moving = model.sample(times, velocities=True)
    np.testing.assert_array_equal(moving.points, points)
    np.testing.assert_array_equal(moving.velocities, exact().sample(times, velocities=True).velocities)


def test_motion_does_not_stop_at_frames(model: CompressedModel) -> None:
    time, step = model.times[3], 1e-6
    difference = (model(time + step) - model(time - step)) / (2 * step)
    np.testing.assert_allclose(difference, model.velocity(time), atol=1e-4 * np.abs(difference).max())


def test_signals_are_those_of_the_exact_model(model: CompressedModel) -> None:
    assert isinstance(model.space, MixedSpace)
    for mine, other in zip(model.curves, exact().curves, strict=True):
        np.testing.assert_array_equal(mine.values, other.values)
    np.testing.assert_array_equal(model.shapes, exact().shapes)
    np.testing.assert_array_equal(model.embedding([0.2]), exact().embedding([0.2]))


def test_edits_are_plain_models(model: CompressedModel) -> None:
    edited = replace(model, placement=Curve(model.placement.times, model.placement.values + 0.0))
    assert type(edited) is Model
    assert type(model.edited(time=model.time)) is Model


def test_it_is_fitted_once(model: CompressedModel, monkeypatch: pytest.MonkeyPatch) -> None:
    fits = []

    def counted(*args: object, **options: object) -> Model:
        fits.append(args)
        return fit(*args, **options)  # type: ignore[arg-type]

    monkeypatch.setattr("mixseq.signals.fitting.fit", counted)
    with ThreadPoolExecutor(3) as pool:
        spaces = list(pool.map(lambda _: model.space, range(3)))
    model(0.03)
    assert len(fits) == 1
    assert all(space is spaces[0] for space in spaces)
    copy = pickle.loads(pickle.dumps(model))
    np.testing.assert_array_equal(copy(0.03), model(0.03))
    assert len(fits) == 1


def test_a_single_frame_stands_still() -> None:
    model = CompressedModel.from_sequence(mixseq.compress(bar(sides=5, rings=15, frames=1), max_error=1e-4))
    points, velocities = next(model.moving_blocks(model.times))
    assert not velocities.any()
    np.testing.assert_array_equal(points, model.sample().points)


def test_it_is_a_sequence_where_one_is_expected(model: CompressedModel) -> None:
    again = mixseq.compress(model, max_error=1e-3)
    assert mixseq.compare(model.sample(), CompressedModel.from_sequence(again).sample()).max_error <= 1e-3


# Parts ------------------------------------------------------------------------------------------------------


def uneven_halves(sequence: MeshSequence) -> IntArray:
    """Labels of two parts that no segmentation finds."""
    along = sequence.points[0][sequence.faces].mean(axis=1)[:, np.ptp(sequence.points[0], axis=0).argmax()]
    return np.asarray(along > np.quantile(along, 0.2), dtype=np.int64)


def test_parts_are_those_of_the_original() -> None:
    sequence = bar(sides=5, rings=15, frames=6)
    expected = mixseq.segment(sequence)
    assert expected.max() > 0
    np.testing.assert_array_equal(coded().parts, expected)
    np.testing.assert_array_equal(CompressedModel.from_sequence(coded()).decomposition.part_of_face, expected)


def test_given_parts_are_kept(tmp_path: Path) -> None:
    sequence = bar(sides=5, rings=15, frames=6)
    labels = uneven_halves(sequence)
    for suffix in ("h5", "glb"):
        file = tmp_path / f"halves.{suffix}"
        mixseq.save(file, mixseq.compress(sequence, max_error=1e-3, parts=labels), still="none")
        model = mixseq.load(file)
        np.testing.assert_array_equal(model.parts, labels)
        np.testing.assert_array_equal(model.decomposition.part_of_face, labels)


@pytest.mark.parametrize("order", ["vertices", "free"])
def test_given_parts_follow_the_order(order: OrderName) -> None:
    sequence = bar(sides=5, rings=15, frames=6)
    shuffled = np.random.default_rng(0).permutation(len(sequence.faces))  # so that another order takes fewer bytes
    sequence = mixseq.MeshSequence.from_arrays(sequence.points, sequence.faces[shuffled])
    labels = uneven_halves(sequence)
    coded = mixseq.compress(sequence, max_error=1e-3, order=order, parts=labels)
    assert coded.order == order and coded.parts is not None
    points = decode(coded).sample().points[0]
    centres, expected = points[coded.header.faces].mean(axis=1), sequence.points[0][sequence.faces].mean(axis=1)
    nearest = np.square(centres[:, None] - expected).sum(axis=2).argmin(axis=1)
    np.testing.assert_array_equal(coded.parts, labels[nearest])


def test_parts_of_a_model_are_taken_along(tmp_path: Path) -> None:
    sequence = bar(sides=5, rings=15, frames=6)
    labels = uneven_halves(sequence)
    model = fit(sequence, exact=True, parts=labels)
    mixseq.save(tmp_path / "model.h5", model)
    sources: tuple[Any, ...] = model, tmp_path / "model.h5"
    for source in sources:
        coded = mixseq.compress(source, max_error=1e-3)
        np.testing.assert_array_equal(coded.parts, labels)
        np.testing.assert_array_equal(mixseq.segment(source), labels)
        np.testing.assert_array_equal(fit(source, rank=1).parts, labels)
        assert fit(source, space="vertex").parts is None
    with mixseq.open_sequence(tmp_path / "model.h5") as reader:
        np.testing.assert_array_equal(mixseq.compress(reader, max_error=1e-3).parts, labels)
        found = PoseInterpolator.from_poses(reader).space
        assert isinstance(found, MixedSpace)
        np.testing.assert_array_equal(found.decomposition.part_of_face, labels)
    again: Any = CompressedModel.from_sequence(coded)
    np.testing.assert_array_equal(mixseq.compress(again, kg=1.0).parts, labels)


def test_labels_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    sequence = bar(sides=5, rings=15, frames=6)
    with pytest.raises(SegmentationError, match="labels have shape"):
        mixseq.compress(sequence, max_error=1e-3, parts=[0, 1])


def test_too_many_parts_are_told() -> None:
    sequence = bar(sides=5, rings=15, frames=6)
    labels = np.arange(len(sequence.faces))  # a part for every triangle
    with pytest.warns(MixseqWarning, match="128 can be stored"):
        assert mixseq.compress(sequence, max_error=1e-3, parts=labels).parts is None


def test_damaged_labels_name_the_file(tmp_path: Path) -> None:
    labels, file = coded().labels, tmp_path / "damaged.h5"
    assert labels is not None
    mixseq.save(file, replace(coded(), labels=replace(labels, count=labels.count + 1)))
    with pytest.raises(FormatError, match=r"^damaged\.h5: the labels of the mesh are damaged"):
        _ = mixseq.load(file).parts


def test_sizes_include_the_labels() -> None:
    sequence = bar(sides=5, rings=15, frames=6)
    coded = mixseq.compress(sequence, size=900)
    assert coded.labels is not None
    motion = [*coded.basis, *(stream for chunk in coded.chunks for stream in (chunk.coefficients, chunk.residuals))]
    assert sum(map(len, motion)) + len(coded.labels.data) <= 900


def test_compressed_sequences_are_played_as_their_files(bent_bar: MeshSequence, tmp_path: Path) -> None:
    coded = mixseq.compress(bent_bar, max_error=1e-3)
    mixseq.save(tmp_path / "bar.h5", coded)
    loaded = mixseq.load(tmp_path / "bar.h5")
    np.testing.assert_array_equal(coded.sample(fps=20).points, loaded.sample(fps=20).points)
    np.testing.assert_array_equal(coded([0.0, 0.05]), loaded([0.0, 0.05]))
    assert 0 < coded.nbytes < (tmp_path / "bar.h5").stat().st_size
    assert repr(coded).endswith(f", {coded.nbytes} bytes of signals, within 0.001 diagonals)")


# Several bodies ---------------------------------------------------------------------------------------------


STEPS: list[int] = []  # of the progress with which the herd is compressed


@cache
def herd() -> CompressedSequence:
    """A bar, a large one, and one that bends alike and has other vertices."""
    thin = fit(bar(sides=5, rings=15, frames=6), exact=True)
    keys = key_poses(thin)
    order = np.random.default_rng(0).permutation(keys.vertex_count)
    other = mixseq.MeshSequence.from_arrays(1.5 * keys.points[:, order], np.argsort(order)[keys.faces], fps=1.0)
    large = with_body(thin, keys.with_points(2.0 * keys.points), "large")
    model = with_body(large, other, "other", thin.parts)
    return mixseq.compress(model, max_error=1e-4, progress=lambda done, total, what: STEPS.append(done))


def test_every_body_is_what_its_streams_decode_to(monkeypatch: pytest.MonkeyPatch) -> None:
    model = CompressedModel.from_sequence(herd())
    monkeypatch.setattr("mixseq.signals.fitting.fit", None)
    model = pickle.loads(pickle.dumps(model))
    assert model.body_names == ("bar", "large", "other")
    assert model.body("large").body_names == ("large", "bar", "other")
    assert repr(model.body("other")).endswith("6 frames, bodies other, bar, large)")
    thin = bar(sides=5, rings=15, frames=6).points
    for factor, body in zip((1.0, 2.0), herd().all_bodies, strict=False):
        frames = model.body(body.header.name).sample().points
        np.testing.assert_array_equal(frames, decode(body).sample().points)
        assert body.parameters.max_error == 1e-4 and body.parameters.promised
        assert np.linalg.norm(frames - factor * thin, axis=2).max() <= 1e-4 * body.parameters.diagonal
    with pytest.raises(SettingsError, match="there is no body 'camel'; bodies are 'bar', 'large', 'other'"):
        model.body("camel")


def test_the_progress_of_bodies_goes_on() -> None:
    herd()
    assert sorted(STEPS) == STEPS and STEPS[-1] > 250  # of 300


def test_between_frames_a_body_is_fitted_as_if_it_were_alone() -> None:
    alone = CompressedModel.from_sequence(herd().bodies[0])
    np.testing.assert_allclose(CompressedModel.from_sequence(herd()).body("large")(0.03), alone(0.03), atol=1e-9)


def test_edits_play_on_all_bodies() -> None:
    model = CompressedModel.from_sequence(herd())
    back = reverse(model.body("other"))
    assert type(back) is Model and back.body_names == ("other", "bar", "large")
    for body in herd().all_bodies:
        expected = decode(body).sample().points[::-1]
        np.testing.assert_allclose(back.body(body.header.name).sample().points, expected, atol=1e-5)
    stiff = exaggerate_part(model, 1, 0.0).body("large").sample().points
    assert np.linalg.norm(stiff - decode(herd().bodies[0]).sample().points, axis=2).max() > 1e-2


def test_bodies_that_do_not_belong_together_are_refused() -> None:
    with pytest.raises(SettingsError, match="two bodies have the same name, 'bar'"):
        replace(coded(), bodies=(coded(),))
    other = mixseq.compress(replace(bar(sides=5, rings=15, frames=5), name="short"), max_error=1e-3)
    with pytest.raises(SettingsError, match="the body 'short' has other times than 'bar'"):
        replace(coded(), bodies=(other,))
    with pytest.raises(SettingsError, match="size is for one body, and the model has several"):
        mixseq.compress(CompressedModel.from_sequence(herd()), size=4000)
    with pytest.raises(SettingsError, match="labels are for one body, and the model has several; leave out parts"):
        mixseq.compress(CompressedModel.from_sequence(herd()), max_error=1e-3, parts=[0, 1])
