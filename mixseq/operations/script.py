"""Edit scripts: operations on a model as tables in a TOML file, applied in order.

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

Operations are functions ``model -> model`` of this package, and the keys of a table are the names of their
parameters, see `mixseq.operations.arguments`. A script that begins with ``unit = "frames"`` gives times, and how long
things last, as numbers of frames of the model that is edited (`mixseq.frame_numbers`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

from mixseq.errors import FormatError, MixseqError, SettingsError
from mixseq.operations.arguments import InSeconds, Readers, WrongTypeError, keys_of
from mixseq.operations.retiming_files import Unit, checked_unit
from mixseq.operations.toml_text import parse_toml
from mixseq.signals.model import Model

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
    "in_place": "travel:in_place",
    "exaggerate": "exaggeration:exaggerate",
    "exaggerate_part": "limb_edits:exaggerate_part",
    "hold": "limb_edits:hold",
    "smooth": "filters:smooth",
    "sculpt": "sculpt:sculpt",
    "drag": "dragging:drag",
    "sketch": "sketch:sketch",
    "swap_key": "hand_edits:swap_key",
}
"""Modules of this package and functions in them, by the names of operations; imported on first use."""

RETIMING = frozenset({"repeat", "loop", "shift", "speed", "reverse", "retime", "concatenate", "transition"})
"""Operations that change the mapping between frames and model time."""


@dataclass(frozen=True)
class Edit:
    """An operation and its arguments; call it with a model."""

    number: int  # which table of the script it is, from 1 on
    operation: str  # its name
    arguments: Mapping[str, Any]  # arguments by the names of the parameters, files read
    # Those of them that are times: what makes seconds of them.
    times: Mapping[str, InSeconds] = field(default_factory=dict)
    unit: Unit = "seconds"  # what times are in

    def __call__(self, model: Model) -> Model:
        """Return the edited model; errors name the edit."""
        seconds = {
            name: made(self.arguments[name], model.header.fps, self.unit) for name, made in self.times.items()
        }
        try:
            edited: Model = function_of(self.operation)(model, **{**self.arguments, **seconds})
        except MixseqError as error:
            raise type(error)(f"edit {self.number} ({self.operation}): {error}") from error
        return edited


def read_script(path: Path, readers: Readers) -> list[Edit]:
    """Read an edit script and the files that it names."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise FormatError(f"{path} cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise FormatError(f"{path} is not a TOML file: {error}") from error
    script = parse_toml(path, text)
    unit = checked_unit(script.pop("unit", None), f"{path}") or "seconds"
    tables = script.pop("edit", [])
    if script:
        raise SettingsError(
            f"{path}: the key {next(iter(script))!r} is outside the tables [[edit]], which hold all"
        )
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables) or not tables:
        raise SettingsError(
            f"{path} has no edits; write each as a table [[edit]] with operation = and its settings"
        )
    return [_edit(number, table, path.parent, readers, unit) for number, table in enumerate(tables, start=1)]


def function_of(operation: str) -> Callable[..., Model]:
    """Return the function of an operation."""
    module, name = OPERATIONS[operation].split(":")
    function: Callable[..., Model] = getattr(import_module(f"mixseq.operations.{module}"), name)
    return function


def _edit(number: int, table: Mapping[str, Any], folder: Path, readers: Readers, unit: Unit) -> Edit:
    where = f"edit {number}"
    if "operation" not in table:
        raise SettingsError(f"{where} has no key 'operation'; it is one of {', '.join(OPERATIONS)}")
    operation = table["operation"]
    if operation not in list(OPERATIONS):
        raise SettingsError(
            f"{where}: the operation {operation!r} is not known; known are {', '.join(OPERATIONS)}"
        )
    where = f"{where} ({operation})"
    keys = keys_of(function_of(operation))
    arguments = {}
    for key, value in table.items():
        if key == "operation":
            continue
        if key not in keys:
            known = f"its keys are {', '.join(keys)}" if keys else "it has none"
            raise SettingsError(f"{where}: the key {key!r} is not known; {known}")
        try:
            arguments[keys[key].parameter] = keys[key].read(value, folder, readers)
        except WrongTypeError:
            raise SettingsError(f"{where}: {key} is {value!r}; {keys[key].holds} is expected") from None
        except MixseqError as error:
            raise type(error)(f"{where}: {key}: {error}") from error
    for key, expected in keys.items():
        if expected.required and expected.parameter not in arguments:
            raise SettingsError(f"{where}: the key {key!r} is missing; {expected.holds} is expected")
    times = {each.parameter: each.in_seconds for each in keys.values() if each.in_seconds is not None}
    given = {name: made for name, made in times.items() if name in arguments}
    return Edit(number, operation, arguments, given, unit)
