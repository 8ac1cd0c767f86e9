"""Damage to HDF5 files that h5py writes itself, so that all checksums are right: what a stranger would send."""

from __future__ import annotations

import os
from collections.abc import Callable
from random import Random
from typing import Any

import h5py
import numpy as np

from scripts.fuzzing.case import Case, NotMadeError
from scripts.fuzzing.damage.of_text import ESCAPES

_FLOATS = (float("nan"), float("inf"), -1.0, 0.0, 1e308, -1e308, 1e-310, 1e160, 1e38, 2.0**31)
_INTEGERS = (-1, 0, 1, 2**31 - 1, -(2**31), 2**31, 2**62)
_TYPES = ("f2", "f4", "f8", ">f8", "i1", "u1", "i8", "u8", ">i4", "c16", "S3", "?")
_ATTRIBUTES: tuple[Any, ...] = (
    *(
        float("nan"),
        float("inf"),
        -1,
        0,
        2**62,
        -(2**62),
        1e308,
        1e-310,
        "word",
        "",
        "x" * 60_000,
        "1e400",
        ESCAPES,
    ),
    *(
        np.arange(5),
        np.ones((3, 3)),
        np.bytes_(b"\xff\xfe\x00x"),
        h5py.Empty("f"),
        "{" * 5000,
        "[1e999]",
        "9" * 5000,
    ),
)


def damage_h5(case: Case) -> str:
    """Change one to three things."""
    labels = []
    try:
        with h5py.File(case.file, "r+", libver="latest") as file, np.errstate(all="ignore"):
            for _ in range(case.rng.choice([1, 1, 1, 2, 3])):
                labels.append(_change(file, case))
    except (OSError, RuntimeError, ValueError, TypeError, KeyError, OverflowError, AttributeError):
        raise NotMadeError from None
    return ", ".join(labels)


def _change(file: h5py.File, case: Case) -> str:
    datasets: list[str] = []
    file.visititems(lambda name, each: datasets.append(name) if isinstance(each, h5py.Dataset) else None)
    attributes = list(file.attrs)
    rng = case.rng
    if attributes and rng.random() < 0.25:
        return _attribute(file, rng.choice(attributes), rng)
    name = rng.choice(datasets)
    change = rng.choices([_values, _shape, _type, _storage, _link], [6, 4, 3, 2, 3])[0]
    return f"{name} {change(file, name, case)}"


def _attribute(file: h5py.File, name: str, rng: Random) -> str:
    old = file.attrs[name]
    del file.attrs[name]
    if rng.random() < 0.1:
        return f"@{name} is gone"
    if rng.random() < 0.1:
        file.attrs.create(name, file.ref, dtype=h5py.ref_dtype)
        return f"@{name} is a reference"
    value = rng.choice(_ATTRIBUTES)
    if isinstance(old, bytes) and isinstance(value, str):  # texts have a fixed length
        if rng.random() < 0.4:  # one thing in a text that may be JSON
            at = rng.randrange(len(old) or 1)
            value = (
                old[:at].decode("utf-8", "replace")
                + rng.choice(["", "9", "}", "[", '"', "nan", "-"])
                + old[at + 1 :].decode("utf-8", "replace")
            )
        data = value.encode()
        file.attrs.create(name, data, dtype=h5py.string_dtype("utf-8", max(1, len(data))))
    else:
        file.attrs[name] = value
    return f"@{name} is {str(value)[:30]!r}"


def _replace(file: h5py.File, name: str, array: Any, **storage: Any) -> None:
    del file[name]
    file.create_dataset(name, data=array, **storage)


def _values(file: h5py.File, name: str, case: Case) -> str:
    array, rng = file[name][...], case.rng
    if array.dtype.kind not in "fiu" or not array.size:
        raise NotMadeError
    if rng.random() < 0.2:
        factor = rng.choice([1e-300, 1e-30, 1e30, 1e150, 1e300, -1, 0])
        _replace(file, name, np.asarray(array * factor).astype(array.dtype))
        return f"times {factor}"
    value = rng.choice(_FLOATS if array.dtype.kind == "f" else _INTEGERS)
    at = rng.choice([0, array.size - 1, rng.randrange(array.size)])
    wide = array.astype("f8" if array.dtype.kind == "f" else "i8")
    wide.reshape(-1)[at] = value
    _replace(file, name, wide.astype(array.dtype) if rng.random() < 0.8 else wide)
    return f"has {value} at {at}"


def _shape(file: h5py.File, name: str, case: Case) -> str:
    array = file[name][...]
    shapes: dict[str, Callable[[], Any]] = {
        "empty": lambda: array[:0],
        "one less": lambda: array[:-1],
        "twice": lambda: np.concatenate([array, array]),
        "flat": lambda: array.reshape(-1),
        "deeper": lambda: array[None],
        "turned": lambda: array.T,
        "backwards": lambda: array[::-1],
        "a number": lambda: np.float64(1),
        "null": lambda: h5py.Empty("f8"),
        "of rank 30": lambda: np.zeros((1,) * 30),
    }
    kind = case.rng.choice(list(shapes))
    _replace(file, name, shapes[kind]())
    return kind


def _type(file: h5py.File, name: str, case: Case) -> str:
    array, rng = file[name][...], case.rng
    kind = rng.choice([*_TYPES, "texts", "compound", "lists", "references", "triples"])
    match kind:
        case "texts":
            _replace(file, name, [str(each) for each in array.reshape(-1)[:50]], dtype=h5py.string_dtype())
        case "compound":
            _replace(file, name, np.zeros(array.shape, [("a", "f8"), ("b", "i4")]))
        case "lists" | "references" | "triples":
            types = {
                "lists": h5py.vlen_dtype("f8"),
                "references": h5py.ref_dtype,
                "triples": np.dtype(("f8", 3)),
            }
            del file[name]
            file.create_dataset(name, shape=array.shape, dtype=types[kind])
        case _:
            _replace(file, name, array.astype(kind))
    return f"as {kind}"


def _storage(file: h5py.File, name: str, case: Case) -> str:
    """Sizes that the file has no bytes for, and chunks too large to unpack."""
    array, rng = file[name][...], case.rng
    shape = array.shape or (1,)
    del file[name]
    if rng.random() < 0.3:
        chunk = (200_000_000 // array.dtype.itemsize, *shape[1:])
        file.create_dataset(name, data=array, maxshape=(None,) * len(shape), chunks=chunk, compression="gzip")
        return "in one huge chunk"
    axis, size = rng.randrange(len(shape)), rng.choice([10**6, 10**9, 2**40])
    huge = tuple(size if number == axis else max(1, each) for number, each in enumerate(shape))
    chunks = tuple(min(each, 64) for each in huge)
    file.create_dataset(name, shape=huge, dtype=array.dtype, chunks=chunks, compression="gzip", fillvalue=1)
    return f"of shape {huge}, unwritten"


def _link(file: h5py.File, name: str, case: Case) -> str:
    array, rng = file[name], case.rng
    shape, dtype = array.shape, array.dtype
    other = rng.choice([path for path in case.outside if path.endswith(".h5")])
    if rng.random() < 0.3:
        other = os.path.relpath(other, case.file.parent)
    kind = rng.choice(
        ["gone", "a group", "soft", "to itself", "external", "stored elsewhere", "virtual", "of itself"]
    )
    del file[name]
    match kind:
        case "a group":
            file.create_group(name)
        case "soft":
            file[name] = h5py.SoftLink(rng.choice(["/nowhere", "/points", "/"]))
        case "to itself":
            file[name] = rng.choice([h5py.SoftLink(f"/{name}"), file["/"]])
        case "external":
            file[name] = h5py.ExternalLink(other, rng.choice(["/points", "/times", f"/{name}"]))
        case "stored elsewhere":
            elsewhere = rng.choice(list(case.outside))
            file.create_dataset(name, shape=shape, dtype=dtype, external=[(elsewhere, 0, h5py.h5f.UNLIMITED)])
        case "virtual" | "of itself":
            layout = h5py.VirtualLayout(shape, dtype)
            source = "." if kind == "of itself" else other
            layout[...] = h5py.VirtualSource(
                source, name if kind == "of itself" else "points", shape, dtype=dtype
            )
            file.create_virtual_dataset(name, layout)
    return kind
