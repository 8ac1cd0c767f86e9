"""Read files that are passed as arguments of public functions; an argument's name and types select the reader."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from mixseq.errors import SettingsError
from mixseq.sequence.frame_rates import snap_to_ntsc
from mixseq_io.isolation import import_function
from mixseq_io.registry import open_sequence, read

Arguments = Mapping[str, Any]
"""Arguments of a function by name; the first argument is the sequence or model."""

ArgumentReader = Callable[[str, Arguments], Any]
"""Function from a path and the preceding arguments to the value that replaces the path."""


def argument_reader(name: str, types: Collection[str]) -> ArgumentReader | None:
    """Return the reader for an argument's name and type names, or None if the argument cannot be a file."""
    if name in _READERS_BY_NAME and set(types) - {"int", "NoneType"}:  # counts are not read from files
        return _READERS_BY_NAME[name]
    if {"Frames", "Model"} <= set(types):
        return partial(_read_frames, open_frames=open_sequence)  # which may be a rig
    if {"Frames", "MeshSequence"} & set(types):
        return _read_frames
    return _read_model if "Model" in types else None


def _reader(reference: str) -> ArgumentReader:
    """Return a reader that calls ``"module:function"`` with the path and ignores other arguments."""
    return lambda path, _: import_function(reference)(path)


_read_model = _reader("mixseq_io.model_files:load")


def _read_frames(path: str, arguments: Arguments, open_frames: Callable[[str], Any] = read) -> Any:
    """Load a model, or read a sequence, which the caller closes if it is opened."""
    from mixseq_io.model_files import is_model

    return _read_model(path, arguments) if is_model(Path(path)) else open_frames(path)


def _read_mesh(path: str, _: Arguments) -> Any:
    mesh = read(path)
    if mesh.frame_count != 1:
        raise SettingsError(f"{path} has {mesh.frame_count} frames; a file with one is expected")
    return mesh


def _read_map(path: str, _: Arguments) -> Any:
    """Read a map, which is converted into a correspondence as soon as both meshes are known."""
    from mixseq_io.text.maps import read_map, to_correspondence

    return partial(to_correspondence, read_map(path))


def _read_labels(path: str, arguments: Arguments) -> Any:
    from mixseq_io.text.label_files import read_labels

    return read_labels(path, next(iter(arguments.values()))).part_of_face


def _read_keys(path: str, arguments: Arguments) -> Any:
    """Read keys in seconds, or in frames of the model."""
    from mixseq.operations.retiming import read_retiming_keys

    header = next(iter(arguments.values())).header
    return read_retiming_keys(path).in_seconds(header.fps, header)


def _read_retiming(path: str, arguments: Arguments) -> Any:
    """Read a retiming in seconds, or in frames of the source and of the output."""
    from mixseq.operations.retiming import Retiming, read_retiming_keys

    header, fps = next(iter(arguments.values())).header, arguments.get("fps")
    output_fps = header.fps if fps is None else snap_to_ntsc(float(fps), header.fps)
    keys = read_retiming_keys(path).in_seconds(output_fps, header, hold=bool(arguments.get("hold")))
    return Retiming.through(*keys.T)


def _read_pairs(path: str, _: Arguments) -> Any:
    from mixseq.operations.script import read_pairs

    return read_pairs(Path(path))


def _read_weight(path: str, arguments: Arguments) -> Any:
    from mixseq.signals.curve import Curve

    pairs = _read_pairs(path, arguments)
    return Curve(pairs[:, 0], pairs[:, 1:])


_READERS_BY_NAME: dict[str, ArgumentReader] = {
    "markers": _reader("mixseq_io.text.markers:read_markers"),
    "mapping": _read_map,
    "contacts": _reader("mixseq_io.text.markers:read_contacts"),
    "parts": _read_labels,
    "bones": _read_labels,
    "points": _read_mesh,
    "skeleton": _reader("mixseq_io.rig_files:read_skeleton"),
    "bind_pose": _reader("mixseq_io.rig_files:read_bind_pose"),
    "keys": _read_keys,
    "retiming": _read_retiming,
    "curve": _read_pairs,
    "weight": _read_weight,
}
