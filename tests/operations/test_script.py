"""Edit scripts: what they do, and what they say when something is wrong."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import replace
from inspect import signature
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from numpy.typing import ArrayLike

from mixseq import operations
from mixseq.errors import FormatError, SettingsError
from mixseq.operations import blend, drag, exaggerate, repeat, retime, reverse, script, shift, transition
from mixseq.operations.script import OPERATIONS, Edit, Readers, load_operation, read_pairs, read_script, script_keys
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from tests.meshes import bar
from tests.operations.motions import bar_motion


def load(path: Path) -> Model:
    if path.name != "other.h5":
        raise FormatError(f"{path} does not exist")
    return bar_motion("vertex")


def read(path: Path) -> MeshSequence:
    return bar(sides=5, rings=15, frames=1 if path.name == "one.obj" else 3)


@pytest.fixture
def edits(tmp_path: Path) -> Callable[[str], list[Edit]]:
    """Read a script with this text."""

    def read_text(text: str) -> list[Edit]:
        (tmp_path / "edits.toml").write_text(text, encoding="utf-8")
        for name in ("other.h5", "one.obj", "many.obj"):
            (tmp_path / name).touch()
        return read_script(tmp_path / "edits.toml", Readers(load, read))

    return read_text


Edits = Callable[[str], list[Edit]]


def table(text: str) -> str:
    return f"[[edit]]\n{text}\n"


def apply(edits: list[Edit], model: Model) -> Model:
    for edit in edits:
        model = edit(model)
    return model


def same(one: Model, other: Model) -> None:
    np.testing.assert_array_equal(one.times, other.times)
    np.testing.assert_allclose(one.vectors, other.vectors, atol=1e-12)


def test_edits_are_applied_in_order(edits: Edits) -> None:
    found = edits(
        table('operation = "repeat"\nstart = 0.2\nend = 0.6\ntimes = 3\nfade = 0.1\ntravel = true')
        + table('operation = "exaggerate"\ngain = 2\nmodes = [0, 1]')
        + table('operation = "reverse"')
        + table('operation = "shift"\nseconds = 1.5')
    )
    assert [(edit.number, edit.operation) for edit in found] == [
        (1, "repeat"),
        (2, "exaggerate"),
        (3, "reverse"),
        (4, "shift"),
    ]
    model = exaggerate(repeat(bar_motion(), 0.2, 0.6, 3, 0.1, travel=True), 2.0, [0, 1])
    same(apply(found, bar_motion()), shift(reverse(model), 1.5))


def test_models_are_read(edits: Edits) -> None:
    found = edits(table('operation = "transition"\nb = "other.h5"\nat = 0.1\nduration = 0.3'))
    same(apply(found, bar_motion("vertex")), transition(bar_motion("vertex"), bar_motion("vertex"), 0.1, 0.3))


@pytest.mark.parametrize("weight", ["0.3", "[[0, 0.3], [0.8, 0.3]]", '"weight.csv"'])
def test_weights_are_numbers_lists_or_files(edits: Edits, tmp_path: Path, weight: str) -> None:
    (tmp_path / "weight.csv").write_text("0, 0.3\n\n0.8,0.3\n")
    found = edits(table(f'operation = "blend"\nb = "other.h5"\nweight = {weight}'))
    model = exaggerate(bar_motion("vertex"), 2)
    same(apply(found, model), blend(model, bar_motion("vertex"), 0.3))


def test_places_are_two_numbers(edits: Edits) -> None:
    found = edits(table('operation = "drag"\ntime = 0.4\nto = [0.1, 0]\nreach = 0.2'))
    same(apply(found, bar_motion()), drag(bar_motion(), 0.4, [0.1, 0.0], 0.2))


@pytest.mark.parametrize("keys", ["[[0, 0.8], [1.6, 0]]", '"keys.csv"', '"keys.toml"'])
def test_keys_of_a_retiming_are_lists_or_files(edits: Edits, tmp_path: Path, keys: str) -> None:
    (tmp_path / "keys.csv").write_text("source,output\n0.8,0  # backwards\n0,1.6\n")
    (tmp_path / "keys.toml").write_text("output = [0, 1.6]\nsource = [0.8, 0]\n")
    found = edits(table(f'operation = "retime"\nkeys = {keys}\nsmooth = false'))
    same(apply(found, bar_motion()), retime(bar_motion(), [[0.0, 0.8], [1.6, 0.0]], smooth=False))


def test_keys_beyond_the_source_are_named_in_their_unit(edits: Edits, tmp_path: Path) -> None:
    end = bar_motion().header.frame_numbers.partition(" to ")[2]
    (tmp_path / "keys.csv").write_text('unit = "frames"\n0,0\n# a comment\n9,50\n')
    for keys, place, asked in (
        ('"keys.csv"', r"keys\.csv, line 4", f"source frame 50, but the last is {end}"),
        ("[[0, 0], [1, -2]]", "point 2", "source time -2 s, but the first is 0 s"),
    ):
        found = edits(table(f'operation = "retime"\nkeys = {keys}'))
        with pytest.raises(SettingsError, match=rf"edit 1 \(retime\): .*{place}: {asked}; change it$"):
            apply(found, bar_motion())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has no edits; write each as a table"),
        ("edit = 3", "has no edits; write each as a table"),
        ("edit = [3]", "has no edits; write each as a table"),
        ('[edit]\noperation = "loop"', "has no edits; write each as a table"),
        ('name = "walk"\n' + table('operation = "loop"'), "'name' is outside the tables"),
        (table("times = 3"), "edit 1 has no key 'operation'; it is one of cut, "),
        (table('operation = "lop"'), "edit 1: unknown operation 'lop'; use one of cut, "),
        (table("operation = [3]"), r"edit 1: unknown operation \[3\]; use one of cut"),
        (
            table('operation = "loop"') + table('operation = "loop"\nfad = 1'),
            r"edit 2 \(loop\): unknown key 'fad'; its keys are fade, travel$",
        ),
        (table('operation = "reverse"\nfade = 1'), "unknown key 'fade'; it has none"),
        (table('operation = "loop"\nmodel = "a"'), "unknown key 'model'"),
        (
            table('operation = "repeat"\nstart = 0'),
            r"edit 1 \(repeat\): the key 'end' is missing; a number is expected",
        ),
        (table('operation = "repeat"\nstart = "0"\nend = 1'), r"edit 1 \(repeat\): start is '0'; a number is expected"),
        (table('operation = "repeat"\nstart = true\nend = 1'), "start is True; a number is expected"),
        (table('operation = "repeat"\nstart = 0\nend = 1\ntimes = 2.0'), "times is 2.0; a whole number is"),
        (table('operation = "repeat"\nstart = 0\nend = 1\ntravel = 1'), "travel is 1; true or false is"),
        (table('operation = "exaggerate"\ngain = 1\nmodes = 1'), "modes is 1; a list of whole numbers"),
        (table('operation = "exaggerate"\ngain = 1\nmodes = [1.5]'), "a list of whole numbers is expected"),
        (table('operation = "concatenate"\nb = 3'), "b is 3; the file of a model is expected"),
        (table('operation = "blend"\nb = "other.h5"\nweight = [1, 2]'), "a number, or pairs of time and"),
        (table('operation = "blend"\nb = "other.h5"\nweight = [[0, 1], [0]]'), "a number, or pairs of time"),
        (table('operation = "drag"\ntime = 0\nto = 3'), "to is 3; a list of two numbers, x and y, is expected"),
        (table('operation = "drag"\ntime = 0\nto = [1, 2, 3]'), "a list of two numbers, x and y, is expected"),
        (table('operation = "drag"\ntime = 0\nto = [0, 0]\nplan = 1'), "its keys are time, to, reach, plane$"),
        *(
            (table(f'operation = "drag"\ntime = 0\nto = [0, 0]\nplane = {plane}'), "a table of the lists origin, axes")
            for plane in (
                "1",
                "{origin = [1], axes = [[1, 0]]}",
                "{origin = [1], axes = [['x', 0]], directions = [[1, 0]]}",
                "{origin = [1], axes = [[1, 0, 2]], directions = [[1, 0]]}",
            )
        ),
        (table('operation = "retime"\nkeys = [0, 1]'), r"keys is \[0, 1\]; pairs of output and source times"),
        (
            table('operation = "blend"\nb = "other.h5"\nweight = [[1, 1], [0, 1]]'),
            r"\(blend\): weight: the knots of a curve must be finite and increase",
        ),
    ],
)
def test_invalid_scripts_are_refused(edits: Edits, text: str, message: str) -> None:
    with pytest.raises(SettingsError, match=message) as caught:
        edits(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[[edit]", "edits.toml is not a TOML file"),
        (table('operation = "concatenate"\nb = "none.h5"'), r"edit 1 \(concatenate\): b: .*none.h5 does not"),
        (table('operation = "retime"\nkeys = "none.csv"'), r"edit 1 \(retime\): keys: .*none.csv does not exist"),
        (table('operation = "blend"\nb = "other.h5"\nweight = "none.csv"'), "weight: .*none.csv does not exist"),
        (
            table('operation = "blend"\nb = "other.h5"\nweight = "edits.toml"'),
            "edits.toml is not CSV with two numbers on each line",
        ),
    ],
)
def test_files_that_cannot_be_read(edits: Edits, text: str, message: str) -> None:
    with pytest.raises(FormatError, match=message):
        edits(text)


@pytest.mark.parametrize(
    "table",
    [
        'operation = "retime"\nkeys = "{}"',
        'operation = "concatenate"\nb = "{}"',
        'operation = "blend"\nb = "other.h5"\nweight = "{}"',
        'operation = "sculpt"\ntime = 0.1\nmesh = "{}"',
        'operation = "sketch"\ncurve = "{}"',
    ],
)
def test_files_elsewhere_are_not_read(tmp_path: Path, table: str) -> None:
    (tmp_path / "elsewhere").mkdir()
    secret = tmp_path / "elsewhere" / "secret.csv"
    secret.write_text("name,password\n")
    (tmp_path / "script" / "below").mkdir(parents=True)
    (tmp_path / "script" / "link.csv").symlink_to(secret)
    (tmp_path / "script" / "other.h5").touch()
    os.mkfifo(tmp_path / "script" / "pipe.csv")
    script = tmp_path / "script" / "edits.toml"
    for name in ("../elsewhere/secret.csv", str(secret), "below/../../elsewhere/secret.csv", "link.csv"):
        script.write_text("[[edit]]\n" + table.format(name))
        with pytest.raises(FormatError, match=r"is not in the script's folder, .*--files-from") as caught:
            read_script(script, Readers(load, read))
        assert "password" not in str(caught.value)
    for name, message in (("pipe.csv", "pipe.csv is not a file"), ("below", "below is not a file")):
        script.write_text("[[edit]]\n" + table.format(name))
        with pytest.raises(FormatError, match=message):
            read_script(script, Readers(load, read))


def test_files_elsewhere_are_read_where_that_is_allowed(tmp_path: Path) -> None:
    (tmp_path / "script").mkdir()
    (tmp_path / "keys.csv").write_text("0,0\n1,2\n")
    (script := tmp_path / "script" / "edits.toml").write_text('[[edit]]\noperation = "retime"\nkeys = "../keys.csv"\n')
    (edit,) = read_script(script, Readers(load, read, (tmp_path,)))
    np.testing.assert_array_equal(edit.arguments["keys"].points, [[0, 0], [1, 2]])


@pytest.mark.parametrize(
    ("seconds", "frames"),
    [
        ('operation = "cut"\nstart = 0.2\nend = 0.6\nat = 1.0', 'operation = "cut"\nstart = 2\nend = 6\nat = 10'),
        (
            'operation = "transition"\nb = "other.h5"\nat = 0.4\nduration = 0.2',
            'operation = "transition"\nb = "other.h5"\nat = 4\nduration = 2',
        ),
        ('operation = "retime"\nkeys = [[0.0, 0.0], [1.2, 0.4]]', 'operation = "retime"\nkeys = [[0, 0], [12, 4]]'),
        (
            'operation = "blend"\nb = "other.h5"\nweight = [[0.0, 0.0], [0.8, 1.0]]',
            'operation = "blend"\nb = "other.h5"\nweight = [[0, 0.0], [8, 1.0]]',
        ),
        ('operation = "exaggerate"\ngain = 2.0', 'operation = "exaggerate"\ngain = 2'),
    ],
)
def test_scripts_may_speak_in_frames(edits: Edits, seconds: str, frames: str) -> None:
    motion = bar_motion("vertex")
    assert motion.header.fps == 10
    one, other = (apply(edits(table(seconds)), motion), apply(edits('unit = "frames"\n' + table(frames)), motion))
    np.testing.assert_allclose(other.times, one.times, rtol=0, atol=1e-12)
    np.testing.assert_allclose(other.sample().points, one.sample().points, atol=1e-9)


def test_a_time_of_another_model_counts_its_frames() -> None:
    motion = bar_motion("vertex")
    other = replace(motion, header=replace(motion.header, fps=20.0))
    arguments = {"b": other, "at": 2, "duration": 2, "enter": 4}
    found = Edit(1, "transition", arguments, "frames")(motion)
    np.testing.assert_array_equal(found.times, transition(motion, other, at=0.2, duration=0.2, enter=0.2).times)


def test_key_files_have_their_own_unit(edits: Edits, tmp_path: Path) -> None:
    motion = bar_motion("vertex")
    (tmp_path / "seconds.csv").write_text('unit = "seconds"\n0,0\n1.2,0.4\n')
    (tmp_path / "frames.csv").write_text("unit = frames\n0,0\n12,4\n")
    (tmp_path / "plain.csv").write_text("0,0\n12,4\n")
    text = table('operation = "retime"\nkeys = "{}.csv"')
    expected = apply(edits(text.format("seconds")), motion)
    for unit, name in (("frames", "seconds"), ("seconds", "frames"), ("frames", "plain")):
        found = apply(edits(f'unit = "{unit}"\n' + text.format(name)), motion)
        np.testing.assert_allclose(found.times, expected.times, rtol=0, atol=1e-12)


def test_all_times_may_be_frames() -> None:
    """Those in seconds are marked in the signatures."""
    told = {
        (name, key.parameter)
        for name in OPERATIONS
        for key in script_keys(load_operation(name)).values()
        if key.to_seconds is not None
    }
    named = {"start", "end", "at", "enter", "time", "duration", "fade", "seconds", "reach", "keys", "weight", "handles"}
    every = {(name, each) for name in OPERATIONS for each in signature(load_operation(name)).parameters}
    assert told == {(name, each) for name, each in every if each in named}


def test_unknown_units_are_refused(edits: Edits) -> None:
    with pytest.raises(SettingsError, match=r"edits.toml: the unit is 'hours'; 'seconds' or 'frames' is"):
        edits('unit = "hours"\n' + table('operation = "reverse"'))


def test_script_and_curve_with_byte_order_marks(edits: Edits, tmp_path: Path) -> None:
    (tmp_path / "speed.csv").write_text("\ufeff0,1\n0.5,2\n", encoding="utf-8")
    plain = edits(table('operation = "shift"\nseconds = 0.25'))
    marked = edits("\ufeff" + table('operation = "shift"\nseconds = 0.25'))
    assert plain == marked
    assert read_pairs(tmp_path / "speed.csv").tolist() == [[0, 1], [0.5, 2]]


def test_scripts_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"none.toml does not exist"):
        read_script(tmp_path / "none.toml", Readers(load, read))
    (tmp_path / "bad.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(FormatError, match=r"bad.toml cannot be read as a TOML file: its text is UTF-16"):
        read_script(tmp_path / "bad.toml", Readers(load, read))


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("a = " + "[" * 100_000, "nested too deeply"),
        ("a = " + "[" * 30 + "]" * 30, "nested too deeply"),
        ("a" + ".b" * 30 + " = 1", "nested too deeply"),
        (table(f'operation = "exaggerate"\ngain = 1{"0" * 400}'), "1000.* has more than 64 bits"),
        (table(f'operation = "retime"\nkeys = [[0, 0], [1, -1{"0" * 400}]]'), "-1000.* has more than 64 bits"),
    ],
)
def test_scripts_that_go_too_far(edits: Edits, text: str, what: str) -> None:
    with pytest.raises(FormatError, match=f"edits.toml is not a TOML file: .*{what}"):
        edits(text)


def test_errors_of_operations_name_the_edit(edits: Edits) -> None:
    found = edits(table('operation = "loop"') + table('operation = "cut"\nstart = 0\nend = 9'))
    with pytest.raises(SettingsError, match=r"edit 2 \(cut\): end is 9 s; the model is from 0 to 0.8 s"):
        apply(found, bar_motion())


# Keys -----------------------------------------------------------------------------------------------------


def operation(
    model: Model,
    points: ArrayLike,
    curve: ArrayLike,
    part: int,
    where: Literal["here", "there"] = "here",
    start: float | None = None,
    names: Sequence[str] = (),
    progress: Callable[[], None] | None = None,
) -> Model:
    return model


def test_keys_are_parameters_and_their_types(tmp_path: Path) -> None:
    keys = script_keys(operation)
    assert {key: (k.parameter, k.is_required, k.expected) for key, k in keys.items()} == {
        "mesh": ("points", True, "the file of a mesh"),
        "curve": ("curve", True, "pairs of x and y, as a list or a CSV file,"),
        "part": ("part", True, "a whole number"),
        "where": ("where", False, "'here' or 'there'"),
        "start": ("start", False, "a number"),
    }
    for name in ("one.obj", "three.obj"):
        (tmp_path / name).touch()
    readers = Readers(load, read)
    mesh = keys["mesh"].read("one.obj", tmp_path, readers)
    np.testing.assert_array_equal(mesh.points[0], bar(5, 15, frames=1).points[0])
    with pytest.raises(SettingsError, match=r"three.obj has 3 frames; a file with one is expected"):
        keys["mesh"].read("three.obj", tmp_path, readers)
    np.testing.assert_array_equal(keys["curve"].read([[0, 1], [2.5, 3]], tmp_path, readers), [[0, 1], [2.5, 3]])
    assert keys["where"].read("there", tmp_path, readers) == "there"


def test_weights_become_curves(tmp_path: Path) -> None:
    weight = script_keys(blend)["weight"].read([[0, 0.5], [1, 1]], tmp_path, Readers(load, read))
    assert isinstance(weight, Curve)
    np.testing.assert_array_equal(weight.values, [[0.5], [1]])


def test_the_example_is_a_script() -> None:
    """The one at the head of the module."""
    text = (script.__doc__ or "").split("::\n")[1].split("\n\nOperations")[0]
    for edit in tomllib.loads(text.replace("\n    ", "\n"))["edit"]:
        assert set(edit) - {"operation"} <= set(script_keys(load_operation(edit["operation"])))


@pytest.mark.parametrize("name", OPERATIONS)
def test_scripts_can_give_all_that_an_operation_needs(name: str) -> None:
    function = load_operation(name)
    assert getattr(operations, name) is function
    given = {key.parameter for key in script_keys(function).values()}
    _, *parameters = signature(function).parameters.values()
    assert {p.name for p in parameters if p.default is p.empty} <= given
