"""Public functions take paths for what files hold, and name arguments of wrong types."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import ArrayLike

import mixseq as mixseq_typed
from mixseq import operations as operations_typed
from mixseq.errors import FormatError, MixseqWarning, SettingsError
from mixseq.retargeting.markers import Correspondence
from mixseq.runtime.public import public
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq_io.text.maps import write_map
from tests.meshes import bar
from tests.operations.motions import bar_motion

mixseq: Any = mixseq_typed  # annotations know of no paths
operations: Any = operations_typed

SOURCE = bar(sides=5, rings=15, frames=9)
TALL = MeshSequence.from_arrays(SOURCE.points[:1] * [1.0, 1.0, 1.2], SOURCE.faces)


# Types ----------------------------------------------------------------------------------------------------


@public
def tried(
    number: float = 1.0,
    count: int = 1,
    text: Literal["a", "b"] = "a",
    flag: bool = False,
    some: ArrayLike | None = None,
    *,
    tell: Any = None,
) -> tuple[object, ...]:
    return number, count, text, flag, some, tell


@pytest.mark.parametrize(
    "given",
    [
        {"number": 2, "count": np.int64(3), "text": "c", "flag": np.True_},
        {"number": np.float32(2), "some": [1, 2]},
        {"number": np.array(0.5), "some": np.zeros(3)},
        {"some": 3, "tell": object()},
        {"some": (1.0, 2.0)},
    ],
)
def test_what_fits_goes_through(given: dict[str, Any]) -> None:
    found = dict(zip(("number", "count", "text", "flag", "some", "tell"), tried(**given), strict=True))
    assert all(found[name] is value for name, value in given.items())


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"number": "2"}, "tried: number is of type str; number is expected"),
        ({"number": None}, "tried: number is of type NoneType; number is expected"),
        ({"number": np.zeros(2)}, "tried: number is of type ndarray; number is expected"),
        ({"count": 2.0}, "tried: count is of type float; whole number is expected"),
        ({"text": 3}, "tried: text is of type int"),
        ({"flag": "yes"}, "tried: flag is of type str; True or False is expected"),
        ({"some": "walk"}, "tried: some is of type str; number or array is expected"),
        ({"some": {}}, "tried: some is of type dict; number or array is expected"),
        ({"other": 1}, "unexpected keyword argument 'other'"),
    ],
)
def test_other_types_are_named(given: dict[str, Any], message: str) -> None:
    with pytest.raises(TypeError, match=message):
        tried(**given)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: mixseq.fit(SOURCE.points),
            "fit: sequence is of type ndarray; .* MeshSequence.from_arrays makes",
        ),
        (lambda: mixseq.fit(SOURCE, workers=2), "fit: workers is of type int; Executor is expected"),
        (
            lambda: mixseq.save("walk.h5", SOURCE),
            "save: model is of type MeshSequence; Model or .*mixseq.fit makes",
        ),
        (lambda: mixseq.read(3), "read: path is of type int; text or path is expected"),
        (
            lambda: mixseq.write_rig("walk.glb", SOURCE),
            "write_rig: rig is of type MeshSequence; Skin or Morph",
        ),
        (
            lambda: mixseq.transfer(SOURCE, TALL, contacts=[0]),
            "transfer: contacts is of type list; Mapping is",
        ),
        (lambda: operations.cut(SOURCE, 0.0, 0.1), "cut: model is of type MeshSequence; Model is expected"),
        (
            lambda: operations.blend(bar_motion(), SOURCE, 0.5),
            "blend: b is of type MeshSequence; Model is expected",
        ),
    ],
)
def test_public_functions_name_them(call: Any, message: str) -> None:
    with pytest.raises(TypeError, match=message):
        call()


def test_all_public_functions_are_checked() -> None:
    functions = [getattr(home, name) for home in (mixseq, operations) for name in home.__all__]
    plain = {each.__name__ for each in functions if callable(each) and not isinstance(each, type)}
    assert {each.__name__ for each in functions if hasattr(each, "__wrapped__")} == plain


# Models and sequences -------------------------------------------------------------------------------------


def test_a_model_is_sampled_where_a_sequence_is_wanted(tmp_path: Path) -> None:
    model = bar_motion()
    mixseq.write(tmp_path / "walk.npz", model)
    np.testing.assert_array_equal(mixseq.read(tmp_path / "walk.npz").points, model.sample().points)
    assert mixseq.compare(model, model.sample()).max_error == 0.0


def test_a_sequence_is_fitted_to_be_resampled() -> None:
    found = operations.resample(SOURCE, fps=20.0)
    expected = operations.resample(mixseq.fit(SOURCE, exact=True), fps=20.0)
    np.testing.assert_array_equal(found.points, expected.points)


# Paths ----------------------------------------------------------------------------------------------------


@cache
def other() -> Model:
    return operations_typed.reverse(bar_motion())


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    mixseq.write("walk.npz", SOURCE)
    mixseq.write("tall.npz", TALL)
    mixseq.save("walk.h5", bar_motion())
    mixseq.save("back.h5", other())
    Path("markers.json").write_text(json.dumps([[number, number] for number in range(0, 77, 4)]))
    Path("feet.json").write_text('{"end": [76]}')
    Path("pairs.csv").write_text("0,0\n0.8,1\n")
    write_map("map.npz", Correspondence.identity(SOURCE.vertex_count, len(SOURCE.faces)), SOURCE.faces, TALL.faces)
    labels = np.arange(len(SOURCE.faces)) * 2 // len(SOURCE.faces)
    np.savez("labels.npz", labels=labels)
    return tmp_path


@pytest.mark.parametrize("path", [str, Path])
def test_sequences_and_models_are_read(folder: Path, path: Any) -> None:
    assert mixseq.compare(path("walk.npz"), SOURCE).max_error == 0.0
    assert mixseq.fit(path("walk.npz"), rank=2).header.vertex_count == SOURCE.vertex_count
    from_model = operations.resample(path("walk.h5"), fps=20.0)  # a model and a sequence, by what is in the file
    np.testing.assert_allclose(operations.resample(path("walk.npz"), fps=20.0).points, from_model.points, atol=1e-6)
    both = operations.concatenate(bar_motion(), path("back.h5"))
    np.testing.assert_array_equal(
        both.sample().points, operations.concatenate(bar_motion(), mixseq.load("back.h5")).sample().points
    )


@pytest.mark.parametrize(
    ("argument", "file"),
    [("markers", "markers.json"), ("mapping", "map.npz"), ("rest", "walk.npz"), ("parts", "labels.npz")],
)
def test_transfers_take_files(folder: Path, argument: str, file: str) -> None:
    values = {
        "markers": [[number, number] for number in range(0, 77, 4)],
        "mapping": Correspondence.identity(SOURCE.vertex_count, len(SOURCE.faces)),
        "rest": mixseq.read("walk.npz"),
        "parts": np.load("labels.npz")["labels"],
    }
    expected = mixseq.transfer(SOURCE, TALL, **{argument: values[argument]})
    found = mixseq.transfer("walk.npz", "tall.npz", **{argument: file})
    np.testing.assert_allclose(found.points, expected.points, atol=1e-6)


def test_contacts_are_read(folder: Path) -> None:
    with pytest.warns(MixseqWarning, match="contact 'end' never rests on the ground"):
        expected = mixseq.transfer(SOURCE, TALL, contacts={"end": [76]}, parts=2)
    with pytest.warns(MixseqWarning, match="contact 'end' never rests on the ground"):
        found = mixseq.transfer(SOURCE, TALL, contacts="feet.json", parts=2)
    np.testing.assert_array_equal(found.points, expected.points)


def test_edits_take_files(folder: Path) -> None:
    model, pairs = bar_motion(), np.array([[0.0, 0.0], [0.8, 1.0]])
    weight = operations.blend(model, other(), "pairs.csv")
    expected = operations.blend(model, other(), Curve(pairs[:, 0], pairs[:, 1:]))
    np.testing.assert_array_equal(weight.sample().points, expected.sample().points)
    Path("keys.csv").write_text("0,0\n1.6,0.8\n")
    slow = operations.retime(model, "keys.csv")
    np.testing.assert_array_equal(slow.times, operations.retime(model, [[0, 0], [1.6, 0.8]]).times)
    mixseq.write("frame.npz", model.sample(times=[0.4]))
    sculpted = operations.sculpt(model, 0.4, "frame.npz")
    np.testing.assert_allclose(sculpted.sample().points, model.sample().points, atol=1e-6)
    with pytest.raises(SettingsError, match=r"walk.npz has 9 frames; a file with one is expected"):
        operations.sculpt(model, 0.4, "walk.npz")


def test_files_that_are_not_there_are_told() -> None:
    with pytest.raises(FormatError, match=r"none\.npz does not exist"):
        mixseq.fit("none.npz")
    with pytest.raises(FormatError, match=r"none\.json"):
        mixseq.transfer(SOURCE, TALL, markers="none.json")


def test_type_checkers_accept_paths(bent_bar: MeshSequence, tmp_path: Path) -> None:
    path = tmp_path / "bar.npz"
    mixseq_typed.write(path, bent_bar)
    assert mixseq_typed.compare(path, str(path)).max_error == 0
    model = mixseq_typed.fit(path, parts=2)
    assert model.header.vertex_count == 77
    assert mixseq_typed.compare(model, path).max_error < 1e-3  # models stand for their frames
