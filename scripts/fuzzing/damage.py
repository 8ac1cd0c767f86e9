"""Ways to damage a file: functions that change it as a generator of random numbers has it, and return what they did."""

from __future__ import annotations

import io
import json
import re
import struct
import warnings
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

Damage = Callable[[Random, Path], str]

ESCAPES = "\x1b]0;gone\x07\x1b[2J\x1b[31m\r\x9b1m\u202e"
"""Control characters that terminals obey: another title, a cleared screen, red, right to left."""

FLOATS = (float("nan"), float("inf"), -1.0, 0.0, 0.5, 1e308, -1e308, 1e-310, 1e160, 1e38)
INTEGERS = (0, 1, -1, 2, 255, 65536, 2**31 - 1, -(2**31), 2**31, 2**32 - 1, 2**40, 2**62, 2**63 - 1)
TYPES = ("f2", "f4", "f8", ">f8", "i1", "u1", "i8", "u8", ">i4", "c16", "S3", "?")
WORDS = (
    "nan", "-inf", "-1", "0", "2147483648", "9" * 25, "9" * 5000, "1e400", "1e308", "1e-310", "0x10", "1_000",
    "1.5", "true", "null", "", "word", "two words", "\x00", "'", '"', "[", "}", "(", ",", "#", "\\", "\n",
    "\uff11\uff12", "a" * 5000, ESCAPES, "\ufeff", "%s%n", "../../x", "/etc/passwd", "1/2/3/4", "-1//-1",
)  # fmt: skip
JSON_VALUES: tuple[Any, ...] = (
    *INTEGERS, *FLOATS, 10**30, True, None, "", "word", ESCAPES, "x" * 100_000, "../x", "SCALAR", "MAT4", 5120,
    [], {}, [0], [[]], [None], {"a": 1}, [1e308] * 16, [float("nan")] * 3, [0] * 4,
)  # fmt: skip


class NotDamagedError(Exception):
    """A damage that cannot be done to a file."""


def damage_bytes(rng: Random, file: Path) -> str:
    """Flip a bit, cut, overwrite, write a number, leave out, or repeat."""
    data = bytearray(file.read_bytes())
    if not data:
        raise NotDamagedError
    near = min(len(data), 1024)  # structure is at the ends of most files
    at = rng.choice([rng.randrange(len(data)), rng.randrange(near), len(data) - 1 - rng.randrange(near)])
    size = min(rng.choice([1, 4, 16, 100, 1000]), len(data) - at)
    kind = rng.choice(["bit", "bit", "bit", "cut", "zeros", "ones", "chance", "number", "number", "without", "twice"])
    if kind == "bit":
        data[at] ^= 1 << rng.randrange(8)
    elif kind == "cut":
        del data[at:]
    elif kind == "number":
        width = rng.choice([1, 2, 4, 8])
        number = rng.choice(INTEGERS) % (1 << 8 * width)
        data[at : at + width] = number.to_bytes(width, rng.choice(["little", "big"]))
    else:
        chunk = data[at : at + size]
        new = {"zeros": bytes(size), "ones": b"\xff" * size, "without": b"", "twice": 2 * chunk}
        data[at : at + size] = new[kind] if kind in new else rng.randbytes(size)
    file.write_bytes(data)
    return f"{kind} at {at}, {size}"


def damage_text(rng: Random, file: Path) -> str:
    """Change a number, a word, a quoted name or a line, or nest brackets."""
    text = file.read_bytes().decode("utf-8", "surrogateescape")
    kind = rng.choice(["number", "number", "number", "word", "quoted", "line", "line", "nest"])
    if kind == "line":
        lines = text.split("\n")
        at, how = rng.randrange(len(lines)), rng.choice([0, 2, 2000])
        lines[at : at + 1] = [lines[at]] * how
        changed, label = "\n".join(lines), f"line {at}, {how} times"
    else:
        pattern = {
            "number": r"[-+]?\d[\d.eE+-]*",
            "word": r"[A-Za-z_:]{2,}",
            "quoted": r"(?<=\")[^\"\n]*(?=\")|(?<=@)[^@\n]*(?=@)",
            "nest": r"[\[{(=:-]",
        }[kind]
        found = list(re.finditer(pattern, text))
        if not found:
            raise NotDamagedError
        match = rng.choice(found[:20] if rng.random() < 0.4 else found)  # counts come first
        nested = rng.choice(["[", "{", "(", '{"a":', "- "]) * rng.choice([50, 2000, 100_000])
        new = nested if kind == "nest" else rng.choice([*WORDS, rng.choice(found).group()])
        changed = text[: match.start()] + new + text[match.end() :]
        label = f"{kind} {match.group()[:20]!r} at {match.start()} is {new[:30]!r}"
    file.write_bytes(changed.encode("utf-8", "surrogateescape"))
    return label


def damage_json(rng: Random, file: Path) -> str:
    """Change a value of a JSON file, or of the JSON in a binary glTF file; it stays JSON."""
    data, binary = file.read_bytes(), b""
    if data[:4] == b"glTF":
        data, binary = split_glb(data)
    try:
        tree = json.loads(data)
    except ValueError:
        raise NotDamagedError from None
    holder, key, where = rng.choice(list(_places(tree, "")))
    value = holder[key]
    kind = rng.choice(["value", "value", "value", "near", "near", "gone", "often"])
    if kind == "near" and isinstance(value, int | float):
        holder[key] = rng.choice([value + 1, value - 1, -value, 2 * value, value * 1000, value + 0.5])
    elif kind == "often" and isinstance(value, list):
        holder[key] = (value * 5000)[:20_000]
    elif kind == "gone":
        del holder[key]
    else:
        holder[key] = rng.choice(JSON_VALUES)
    text = json.dumps(tree).encode()
    file.write_bytes(join_glb(text, binary) if binary else text)
    return f"{where} {kind}"


def split_glb(data: bytes) -> tuple[bytes, bytes]:
    """Return the JSON of a binary glTF file, and the chunk of its buffer."""
    end = 20 + int.from_bytes(data[12:16], "little")
    return data[20:end], data[end:]


def join_glb(text: bytes, binary: bytes) -> bytes:
    """Return a binary glTF file of what `split_glb` returned."""
    text += b" " * (-len(text) % 4)
    return struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(binary), len(text), 0x4E4F534A) + text + binary


def _places(tree: Any, where: str) -> Iterator[tuple[Any, Any, str]]:
    """Yield all values: what holds them, by which key, and where that is."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in items:
        yield tree, key, f"{where}/{key}"
        yield from _places(value, f"{where}/{key}")


def damage_archive(rng: Random, file: Path) -> str:
    """Change an entry of a zip archive, npz or usdz, whose checksums stay right."""
    try:
        with zipfile.ZipFile(file) as archive:
            entries = [(name, archive.read(name)) for name in archive.namelist()]
    except zipfile.BadZipFile:
        raise NotDamagedError from None
    at = rng.randrange(len(entries))
    name, data = entries[at]
    kind = rng.choice(["gone", "again", "other name", "bytes", "array", "array", "array", "array"])
    if kind == "array" and name.endswith(".npy"):
        label, array = _changed(rng, np.load(io.BytesIO(data), allow_pickle=False))
        stored = io.BytesIO()
        np.save(stored, array, allow_pickle=False)
        entries[at] = (name, stored.getvalue())
    elif kind == "gone":
        label = entries.pop(at)[0] and "gone"
    elif kind == "again":
        label = "again"
        entries.append((name, data[: len(data) // 2]))
    elif kind == "other name":
        label = "other name"
        entries[at] = (rng.choice(["..", "../x", "/etc/passwd", ESCAPES, "x" * 60_000, entries[0][0]]), data)
    else:
        inner = file.with_name("entry")
        inner.write_bytes(data)
        label = damage_bytes(rng, inner)
        entries[at] = (name, inner.read_bytes())
        inner.unlink()
    with warnings.catch_warnings(), zipfile.ZipFile(file, "w") as archive:
        warnings.simplefilter("ignore")  # of names that come twice
        for each in entries:
            archive.writestr(zipfile.ZipInfo(each[0], (1980, 1, 1, 0, 0, 0)), each[1])
    return f"{name} {label}"


def damage_h5(rng: Random, file: Path) -> str:
    """Change a dataset or an attribute of an HDF5 file, whose checksums stay right."""
    with h5py.File(file, "r+", libver="latest") as opened:
        datasets: list[str] = []
        opened.visititems(lambda name, each: datasets.append(name) if isinstance(each, h5py.Dataset) else None)
        if opened.attrs and rng.random() < 0.25:
            name = rng.choice(list(opened.attrs))
            value = opened.attrs[name]
            if isinstance(value, bytes):  # texts have a fixed length, and may be JSON
                at = rng.randrange(len(value) or 1)
                word = rng.choice(WORDS).replace("\x00", "")[:60_000].encode()
                text = word if rng.random() < 0.5 else value[:at] + word[:1] + value[at + 1 :]
                opened.attrs.create(name, text, dtype=h5py.string_dtype("utf-8", max(1, len(text))))
                return f"@{name} is {text[:30]!r}"
            opened.attrs[name] = value = rng.choice([*INTEGERS, *FLOATS, "word", np.arange(5)])
            return f"@{name} is {value!r}"
        name = rng.choice(datasets)
        label, array = ("gone", None) if rng.random() < 0.1 else _changed(rng, opened[name][...])
        del opened[name]
        if array is not None:
            opened.create_dataset(name, data=array)
    return f"{name} {label}"


def _changed(rng: Random, array: NDArray[Any]) -> tuple[str, Any]:
    """Return another array, and what it is."""
    kind = rng.choice(["value", "value", "value", "times", "type", "shape"])
    try:
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if kind == "value" and array.size and array.dtype.kind in "fiu":
                value = rng.choice(FLOATS if array.dtype.kind == "f" else INTEGERS)
                changed = array.astype("f8" if array.dtype.kind == "f" else "i8")
                changed.reshape(-1)[rng.randrange(array.size)] = value
                return f"has {value}", changed.astype(array.dtype)
            if kind == "times" and array.dtype.kind in "fiu":
                factor = rng.choice([1e-300, 1e-30, 1e30, 1e150, 1e300, -1, 0])
                return f"times {factor}", np.asarray(array * factor).astype(array.dtype)
            if kind == "type":
                other = rng.choice(TYPES)
                return f"as {other}", array.astype(other)
            double = np.concatenate([array] * 2)
            return kind, rng.choice([array[:0], array[:-1], double, array.reshape(-1), array[None], array.T])
    except (ValueError, TypeError, IndexError, OverflowError):
        raise NotDamagedError from None
