"""Read edit scripts: TOML files with one table per operation, applied to a model in order.

::

    [[edit]]
    operation = "repeat"
    start = 0.2
    end = 1.0
    times = 3

    [[edit]]
    operation = "transition"
    b = "slash.h5"          # a file, relative to the script
    at = 2.0
    duration = 0.25

Operations are functions ``model -> model`` of this package. The keys of a table are parameter names of the function;
parameter annotations determine the types of values. In a script that begins with ``unit = "frames"``, times and
durations are in frames of the edited model, or of the model that is entered (`mixseq.sequence.frame_rates`).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from inspect import Parameter, signature
from pathlib import Path
from types import UnionType
from typing import Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

import numpy as np

from mixseq.errors import FormatError, MissingFileError, MixseqError, SettingsError
from mixseq.operations.handles import Handle
from mixseq.operations.retiming import RetimingKeys, Unit, check_unit, parse_toml, read_retiming_keys
from mixseq.runtime.text_files import read_text
from mixseq.sequence.frame_rates import number_to_time
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.signals.pose import Plane
from mixseq.types import Float


class Readers(NamedTuple):
    """File readers, passed in because the core package reads no mesh file formats."""

    model: Callable[[Path], Model]
    mesh: Callable[[Path], MeshSequence]
    folders: tuple[Path, ...] = ()  # folders, with subfolders, whose files a script may read besides its own folder


ReadValue = Callable[[Any, Path, Readers], Any]
ToSeconds = Callable[[Any, SequenceHeader, Unit], Any]


class WrongTypeError(Exception):
    """Raised if a value has the wrong type for its key."""


class Key(NamedTuple):
    """A key of an edit table."""

    parameter: str  # name of the operation's parameter
    is_required: bool
    expected: str  # description of valid values, for messages
    # Converts a value to the argument, given the folder of relative paths and the readers; raises WrongTypeError.
    read: ReadValue
    # For times: converts the argument to seconds, given the model's frames per second and the script's unit.
    to_seconds: ToSeconds | None = None


def script_keys(function: Callable[..., Model]) -> dict[str, Key]:
    """Return the keys of an operation, one for each parameter after the model that a script can set."""
    hints, annotated = get_type_hints(function), get_type_hints(function, include_extras=True)
    _, *parameters = signature(function).parameters.values()
    keys = {}
    for parameter in parameters:
        name, is_required = parameter.name, parameter.default is Parameter.empty
        if name in PARSED_PARAMETERS:
            key, expected, read, to_seconds = PARSED_PARAMETERS[name]
            keys[key] = Key(name, is_required, expected, read, to_seconds)
        elif expected := _describe(hints[name]):
            to_seconds = _number_in_seconds if annotated[name] != hints[name] else None
            keys[name] = Key(name, is_required, expected, partial(_read_plain, hints[name]), to_seconds)
    return keys


def _read_plain(hint: Any, value: Any, folder: Path, readers: Readers) -> Any:
    if not _matches(value, hint):
        raise WrongTypeError
    return value


_TYPE_NAMES = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}


def _describe(hint: Any) -> str:
    """Describe the values that an annotation allows; return "" if TOML has no such values."""
    origin, choices = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return " or ".join(filter(None, map(_describe, choices)))
    if origin is Literal:
        return " or ".join(map(repr, choices))
    if origin in (Sequence, list) and choices == (int,):
        return "a list of whole numbers"
    return _TYPE_NAMES.get(hint, "")


def _matches(value: Any, hint: Any) -> bool:
    origin, choices = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return any(_matches(value, choice) for choice in choices)
    if origin is Literal:
        return value in list(choices)
    if origin in (Sequence, list):
        return isinstance(value, list) and all(_matches(item, choices[0]) for item in value)
    if hint is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    return type(value) is hint


def _find_file(value: Any, folder: Path, readers: Readers) -> Path:
    """Return the path of a file; it must be in the script's folder, in `readers.folders`, or in a subfolder."""
    if not isinstance(value, str) or "\0" in value:
        raise WrongTypeError
    path = folder / value
    target = path.resolve()  # a link is allowed if its target is
    if not any(target.is_relative_to(allowed.resolve()) for allowed in (folder, *readers.folders)):
        raise FormatError(
            f"{value!r} is not in the script's folder, {folder.resolve()}, or below; if you trust the script, name "
            "the folder where the file is: --files-from FOLDER"
        )
    if not path.is_file():
        raise FormatError(f"{path} is not a file") if path.exists() else MissingFileError(f"{path} does not exist")
    return path


def _read_model(value: Any, folder: Path, readers: Readers) -> Model:
    return readers.model(_find_file(value, folder, readers))


def _read_mesh(value: Any, folder: Path, readers: Readers) -> MeshSequence:
    path = _find_file(value, folder, readers)
    mesh = readers.mesh(path)
    if mesh.frame_count != 1:
        raise SettingsError(f"{path} has {mesh.frame_count} frames; a file with one is expected")
    return mesh


def _read_pairs(value: Any, folder: Path, readers: Readers) -> Float:
    """Return pairs of numbers ``(N, 2)`` from a list of pairs or a CSV file."""
    if isinstance(value, list):
        pairs = _as_pairs(value)
        if pairs is None:
            raise WrongTypeError
        return pairs
    return read_pairs(_find_file(value, folder, readers))


def read_pairs(path: Path) -> Float:
    """Read pairs of numbers ``(N, 2)`` from a CSV file without a header."""
    lines = read_text(path, "a CSV file").splitlines()
    pairs = _as_pairs([line.split(",") for line in lines if line.strip()])
    if pairs is None:
        raise FormatError(f"{path} is not CSV with two numbers on each line")
    return pairs


def _read_position(value: Any, folder: Path, readers: Readers) -> Float:
    pairs = _as_pairs([value])
    if pairs is None:
        raise WrongTypeError
    return np.asarray(pairs[0])


def _as_pairs(rows: list[Any]) -> Float | None:
    try:
        pairs = np.array(rows, dtype=np.float64)
    except (ValueError, TypeError):
        return None
    return pairs if pairs.ndim == 2 and pairs.shape[1] == 2 else None


def _read_weight(value: Any, folder: Path, readers: Readers) -> float | Curve:
    if _matches(value, float):
        return float(value)
    pairs = _read_pairs(value, folder, readers)
    return Curve(pairs[:, 0], pairs[:, 1:])


def _read_keys(value: Any, folder: Path, readers: Readers) -> RetimingKeys:
    if isinstance(value, list):
        return RetimingKeys(_read_pairs(value, folder, readers), None)
    return read_retiming_keys(_find_file(value, folder, readers))


def _number_in_seconds(value: float, header: SequenceHeader, unit: Unit) -> float:
    return number_to_time(value, header.fps) if unit == "frames" else value


def _weight_in_seconds(value: float | Curve, header: SequenceHeader, unit: Unit) -> float | Curve:
    if isinstance(value, Curve) and unit == "frames":
        return Curve(value.times / header.fps, value.values)
    return value


def _read_handles(value: Any, folder: Path, readers: Readers) -> list[Handle]:
    """Return handles from a list of tables, or a CSV file of time, vertex, x, y and z."""
    if not isinstance(value, list):
        path = _find_file(value, folder, readers)
        try:
            rows = [line.split(",") for line in read_text(path, "a CSV file").splitlines() if line.strip()]
            return [Handle(float(time), [float(x) for x in point], int(vertex)) for time, vertex, *point in rows]
        except ValueError:
            raise FormatError(f"{path} is not CSV with time,vertex,x,y,z on each line") from None
    for table in value:
        if not isinstance(table, dict) or "time" not in table or set(table) - set(_HANDLE_TYPES):
            raise WrongTypeError
        if not all(_matches(entry, _HANDLE_TYPES[name]) for name, entry in table.items()):
            raise WrongTypeError
    return [Handle(**table) for table in value]


def _read_plane(value: Any, folder: Path, readers: Readers) -> Plane:
    if not isinstance(value, dict) or set(value) != set(Plane._fields):
        raise WrongTypeError
    try:
        plane = Plane(**{name: np.array(numbers, dtype=np.float64) for name, numbers in value.items()})
    except (ValueError, TypeError):
        raise WrongTypeError from None
    if plane.axes.shape != (*plane.origin.shape, 2) or plane.directions.shape[1:] != (2,):
        raise WrongTypeError
    return plane


def _handles_in_seconds(value: list[Handle], header: SequenceHeader, unit: Unit) -> list[Handle]:
    return [replace(handle, time=_number_in_seconds(handle.time, header, unit)) for handle in value]


_HANDLE_TYPES = {"time": float, "position": list[float], "vertex": int, "part": int, "rotation": list[float]}
_HANDLES_TEXT = (
    "tables of time, vertex or part, and position or rotation of the part, or a CSV file of time,vertex,x,y,z,"
)
_PLANE_TEXT = "a table of the lists origin, axes and directions, as the viewer writes it,"
_KEYS_TEXT = "pairs of output and source times, as a list or a CSV or TOML file,"
_WEIGHT_TEXT = "a number, or pairs of time and weight as a list or a CSV file,"

PARSED_PARAMETERS: Mapping[str, tuple[str, str, ReadValue, ToSeconds | None]] = {
    "b": ("b", "the file of a model", _read_model, None),
    "points": ("mesh", "the file of a mesh", _read_mesh, None),
    "curve": ("curve", "pairs of x and y, as a list or a CSV file,", _read_pairs, None),
    "handles": ("handles", _HANDLES_TEXT, _read_handles, _handles_in_seconds),
    "plane": ("plane", _PLANE_TEXT, _read_plane, None),
    "to": ("to", "a list of two numbers, x and y,", _read_position, None),
    "keys": ("keys", _KEYS_TEXT, _read_keys, lambda value, header, unit: value.in_seconds(header.fps, header, unit)),
    "weight": ("weight", _WEIGHT_TEXT, _read_weight, _weight_in_seconds),
}
"""Parameters of operations that plain values cannot set: key in a script, and the last three fields of `Key`."""


OPERATIONS: Mapping[str, str] = {
    "cut": "timeline:cut",
    "repeat": "timeline:repeat",
    "loop": "timeline:loop",
    "shift": "timeline:shift",
    "speed": "timeline:speed",
    "reverse": "timeline:reverse",
    "retime": "retiming:retime",
    "concatenate": "transitions:concatenate",
    "transition": "transitions:transition",
    "blend": "transitions:blend",
    "in_place": "timeline:in_place",
    "exaggerate": "filters:exaggerate",
    "exaggerate_part": "limbs:exaggerate_part",
    "hold": "limbs:hold",
    "smooth": "filters:smooth",
    "sculpt": "sculpt:sculpt",
    "pose": "handles:pose",
    "drag": "sketch:drag",
    "sketch": "sketch:sketch",
}
"""Module and function of every operation by name. Modules are imported on first use."""

RETIMING_OPERATIONS = frozenset({"repeat", "loop", "shift", "speed", "reverse", "retime", "concatenate", "transition"})
"""Operations that change the mapping between frames and model time."""


@dataclass(frozen=True)
class Edit:
    """An operation with its arguments, callable with a model."""

    number: int  # number of the table in the script, counted from 1
    operation: str
    arguments: Mapping[str, Any]  # arguments by parameter, with the contents of files
    unit: Unit = "seconds"  # unit of the times

    def __call__(self, model: Model) -> Model:
        """Return the edited model; error messages name the edit."""
        function, arguments = load_operation(self.operation), dict(self.arguments)
        try:
            for key in script_keys(function).values():
                name = key.parameter
                if key.to_seconds is not None and name in arguments:
                    clip = arguments["b"] if name == "enter" else model  # the model whose frames are counted
                    arguments[name] = key.to_seconds(arguments[name], clip.header, self.unit)
            return function(model, **arguments)
        except MixseqError as error:
            raise type(error)(f"edit {self.number} ({self.operation}): {error}") from error


def read_script(path: Path, readers: Readers) -> list[Edit]:
    """Read an edit script and the files that it names."""
    script = parse_toml(path, read_text(path, "a TOML file"))
    unit = check_unit(script.pop("unit", None), f"{path}") or "seconds"
    tables = script.pop("edit", [])
    if script:
        raise SettingsError(f"{path}: {next(iter(script))!r} is outside the tables [[edit]]; move it there")
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables) or not tables:
        raise SettingsError(f"{path} has no edits; write each as a table [[edit]] with operation = and keys")
    return [_make_edit(number, table, path.parent, readers, unit) for number, table in enumerate(tables, 1)]


def format_script(edits: Sequence[Callable[[Model], Model]]) -> str:
    """Return the text of a script with operations, or `functools.partial` objects of them with their arguments."""
    if not edits:
        raise SettingsError("there are no edits yet; make one")
    tables = []
    for edit in edits:
        function, arguments = (edit.func, edit.keywords) if isinstance(edit, partial) else (edit, {})
        names = {key.parameter: name for name, key in script_keys(function).items()}
        given = {names[parameter]: value for parameter, value in arguments.items() if value is not None}
        entries = {"operation": function.__name__, **given}
        tables.append("\n".join(["[[edit]]", *(f"{name} = {_format_value(value)}" for name, value in entries.items())]))
    return "\n\n".join(tables) + "\n"


def _format_value(value: Any) -> str:
    """Format a value as TOML."""
    if isinstance(value, bool | str):
        return json.dumps(value)
    if isinstance(value, int | float | np.number):
        return repr(value.item() if isinstance(value, np.number) else value)
    if isinstance(value, Handle):
        value = {name: entry for name, entry in vars(value).items() if entry is not None}
    elif isinstance(value, Plane):
        value = value._asdict()
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name} = {_format_value(entry)}" for name, entry in value.items()) + "}"
    return "[" + ", ".join(map(_format_value, value)) + "]"


def load_operation(operation: str) -> Callable[..., Model]:
    """Import the function of an operation."""
    module, name = OPERATIONS[operation].split(":")
    function: Callable[..., Model] = getattr(import_module(f"mixseq.operations.{module}"), name)
    return function


def _make_edit(number: int, table: Mapping[str, Any], folder: Path, readers: Readers, unit: Unit) -> Edit:
    where = f"edit {number}"
    if "operation" not in table:
        raise SettingsError(f"{where} has no key 'operation'; it is one of {', '.join(OPERATIONS)}")
    operation = table["operation"]
    if operation not in list(OPERATIONS):
        raise SettingsError(f"{where}: unknown operation {operation!r}; use one of {', '.join(OPERATIONS)}")
    where = f"{where} ({operation})"
    keys = script_keys(load_operation(operation))
    arguments = {}
    for name, value in table.items():
        if name == "operation":
            continue
        if name not in keys:
            known = f"its keys are {', '.join(keys)}" if keys else "it has none"
            raise SettingsError(f"{where}: unknown key {name!r}; {known}")
        try:
            arguments[keys[name].parameter] = keys[name].read(value, folder, readers)
        except WrongTypeError:
            raise SettingsError(f"{where}: {name} is {value!r}; {keys[name].expected} is expected") from None
        except MixseqError as error:
            raise type(error)(f"{where}: {name}: {error}") from error
    for name, key in keys.items():
        if key.is_required and key.parameter not in arguments:
            raise SettingsError(f"{where}: the key {name!r} is missing; {key.expected} is expected")
    return Edit(number, operation, arguments, unit)
