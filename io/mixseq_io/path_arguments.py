"""Files given for arguments of public functions: each is read according to the argument's name and type."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from mixseq.errors import SettingsError
from mixseq.sequence.frame_rates import snap_to_ntsc
from mixseq_io.isolation import import_function
from mixseq_io.registry import read

Given = Mapping[str, Any]
"""All arguments of a function by name; the first one is the sequence or model."""

Read = Callable[[str, Given], Any]
"""Reader of a value, given the path and the other arguments."""


def argument_reader(name: str, types: Collection[str]) -> Read | None:
    """Return the reader of an argument with this name and these type names; None if there is none."""
    if name in _BY_NAME and set(types) - {"int", "NoneType"}:  # a number of parts is in no file
        return _BY_NAME[name]
    if "Model" in types:
        return _motion if "Frames" in types else _model
    return _sequence if {"Frames", "MeshSequence"} & set(types) else None


def _by_path(reference: str) -> Read:
    """Return a reader that needs the path only, "module:function", imported at first use."""
    return lambda path, _: import_function(reference)(path)


_sequence, _model = _by_path("mixseq_io.registry:read"), _by_path("mixseq_io.loading:load")


def _motion(path: str, given: Given) -> Any:
    """Load a model, or read a sequence."""
    from mixseq_io.loading import is_model

    return _model(path, given) if is_model(Path(path)) else read(path)


def _mesh(path: str, _: Given) -> Any:
    mesh = read(path)
    if mesh.frame_count != 1:
        raise SettingsError(f"{path} has {mesh.frame_count} frames; a file with one is expected")
    return mesh


def _map(path: str, _: Given) -> Any:
    """Read a map; it becomes a correspondence when both meshes are known."""
    from mixseq_io.text.maps import read_map, to_correspondence

    return partial(to_correspondence, read_map(path))


def _labels(path: str, given: Given) -> Any:
    from mixseq_io.text.label_files import read_labels

    return read_labels(path, next(iter(given.values()))).part_of_face


def _keys(path: str, given: Given) -> Any:
    """Read keys in seconds, or in frames of the model."""
    from mixseq.operations.retiming import read_retiming_keys

    fps = next(iter(given.values())).header.fps
    return read_retiming_keys(path).in_seconds(fps, fps)


def _retiming(path: str, given: Given) -> Any:
    """Read a retiming in seconds, or in frames of the source and of the output."""
    from mixseq.operations.retiming import read_retiming

    source = next(iter(given.values())).header.fps
    output = source if given.get("fps") is None else snap_to_ntsc(float(given["fps"]), source)
    return read_retiming(path, output_fps=output, source_fps=source)


def _pairs(path: str, _: Given) -> Any:
    from mixseq.operations.script import read_pairs

    return read_pairs(Path(path))


def _weight(path: str, given: Given) -> Any:
    from mixseq.signals.curve import Curve

    pairs = _pairs(path, given)
    return Curve(pairs[:, 0], pairs[:, 1:])


_BY_NAME: dict[str, Read] = {
    "markers": _by_path("mixseq_io.text.markers:read_markers"),
    "mapping": _map,
    "contacts": _by_path("mixseq_io.text.markers:read_contacts"),
    "parts": _labels,
    "bones": _labels,
    "points": _mesh,
    "skeleton": _by_path("mixseq_io.rig_files:read_skeleton"),
    "bind_pose": _by_path("mixseq_io.rig_files:read_bind_pose"),
    "keys": _keys,
    "retiming": _retiming,
    "curve": _pairs,
    "weight": _weight,
}
