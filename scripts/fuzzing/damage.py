"""Ways to damage a file: functions of its bytes that return what they did, and the damaged bytes."""

from __future__ import annotations

import io
import json
import re
import struct
import zipfile
from collections.abc import Callable, Iterator
from random import Random
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

Damage = Callable[[Random, bytes], tuple[str, bytes]]

NOT_POSSIBLE = (ValueError, TypeError, IndexError, OverflowError, zipfile.BadZipFile)
"""Errors of a damage that cannot be done to a file."""

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
PATTERNS = {
    "number": r"[-+]?\d[\d.eE+-]*",
    "word": r"[A-Za-z_:]{2,}",
    "quoted": r"(?<=\")[^\"\n]*(?=\")|(?<=@)[^@\n]*(?=@)",
    "nest": r"[\[{(=:-]",
}
"""Parts of a text that are replaced."""


def damage_bytes(rng: Random, sound: bytes) -> tuple[str, bytes]:
    """Flip a bit, cut, overwrite, write a number, leave out, or repeat."""
    data = bytearray(sound)
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
    return f"{kind} at {at}, {size}", bytes(data)


def damage_text(rng: Random, sound: bytes) -> tuple[str, bytes]:
    """Change a number, a word, a quoted name or a line, or nest brackets."""
    text = sound.decode("utf-8", "surrogateescape")
    kind = rng.choice(["number", "number", "number", "word", "quoted", "line", "line", "nest"])
    if kind == "line":
        lines = text.split("\n")
        at, how = rng.randrange(len(lines)), rng.choice([0, 2, 2000])
        lines[at : at + 1] = [lines[at]] * how
        return f"line {at}, {how} times", "\n".join(lines).encode("utf-8", "surrogateescape")
    found = list(re.finditer(PATTERNS[kind], text))
    if not found:
        raise ValueError(f"there is no {kind}")
    match = rng.choice(found[:20] if rng.random() < 0.4 else found)  # counts come first
    nested = rng.choice(["[", "{", "(", '{"a":', "- "]) * rng.choice([50, 2000, 100_000])
    new = nested if kind == "nest" else rng.choice([*WORDS, rng.choice(found).group()])
    changed = text[: match.start()] + new + text[match.end() :]
    label = f"{kind} {match.group()[:20]!r} at {match.start()} is {new[:30]!r}"
    return label, changed.encode("utf-8", "surrogateescape")


def damage_json(rng: Random, sound: bytes) -> tuple[str, bytes]:
    """Change a value of a JSON file, or of the JSON in a binary glTF file; it stays JSON."""
    is_binary = sound[:4] == b"glTF"
    tree, buffer = split_glb(sound) if is_binary else (json.loads(sound), b"")
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
    return f"{where} {kind}", join_glb(tree, buffer) if is_binary else json.dumps(tree).encode()


def split_glb(data: bytes) -> tuple[Any, bytes]:
    """Return the JSON of a binary glTF file, and its buffer."""
    end = 20 + int.from_bytes(data[12:16], "little")
    return json.loads(data[20:end]), data[end + 8 :]


def join_glb(document: Any, buffer: bytes) -> bytes:
    """Return a binary glTF file."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sIIII", b"glTF", 2, 28 + len(text) + len(buffer), len(text), 0x4E4F534A)
    return head + text + struct.pack("<I4s", len(buffer), b"BIN\0") + buffer


def _places(tree: Any, where: str) -> Iterator[tuple[Any, Any, str]]:
    """Yield all values: what holds them, by which key, and where that is."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in items:
        yield tree, key, f"{where}/{key}"
        yield from _places(value, f"{where}/{key}")


def damage_archive(rng: Random, sound: bytes) -> tuple[str, bytes]:
    """Change an entry of a zip archive, npz or usdz, whose checksums stay right."""
    with zipfile.ZipFile(io.BytesIO(sound)) as archive:
        entries = [(name, archive.read(name)) for name in archive.namelist()]
    at = rng.randrange(len(entries))
    name, data = entries[at]
    label = rng.choice(["gone", "again", "other name", "bytes", "array", "array", "array", "array"])
    if label == "array" and name.endswith(".npy"):
        label, array = _changed(rng, np.load(io.BytesIO(data), allow_pickle=False))
        stored = io.BytesIO()
        np.save(stored, array, allow_pickle=False)
        entries[at] = (name, stored.getvalue())
    elif label == "gone":
        del entries[at]
    elif label == "again":
        entries.append((name, data[: len(data) // 2]))
    elif label == "other name":
        entries[at] = (rng.choice(["..", "../x", "/etc/passwd", ESCAPES, "x" * 60_000, entries[0][0]]), data)
    else:
        label, data = damage_bytes(rng, data)
        entries[at] = (name, data)
    damaged = io.BytesIO()
    with zipfile.ZipFile(damaged, "w") as archive:
        for entry, content in entries:
            archive.writestr(zipfile.ZipInfo(entry, (1980, 1, 1, 0, 0, 0)), content)
    return f"{name} {label}", damaged.getvalue()


def damage_h5(rng: Random, sound: bytes) -> tuple[str, bytes]:
    """Change a dataset or an attribute of an HDF5 file, whose checksums stay right."""
    damaged = io.BytesIO(sound)
    with h5py.File(damaged, "r+", libver="latest") as opened:
        if opened.attrs and rng.random() < 0.25:
            label = _damage_attribute(rng, opened.attrs)
        else:
            datasets: list[str] = []
            opened.visititems(lambda name, each: datasets.append(name) if isinstance(each, h5py.Dataset) else None)
            name = rng.choice(datasets)
            what, array = ("gone", None) if rng.random() < 0.1 else _changed(rng, opened[name][...])
            label = f"{name} {what}"
            del opened[name]
            if array is not None:
                opened.create_dataset(name, data=array)
    return label, damaged.getvalue()


def _damage_attribute(rng: Random, attributes: h5py.AttributeManager) -> str:
    name = rng.choice(list(attributes))
    value = attributes[name]
    if not isinstance(value, bytes):
        attributes[name] = value = rng.choice([*INTEGERS, *FLOATS, "word", np.arange(5)])
        return f"@{name} is {value!r}"
    at = rng.randrange(len(value) or 1)
    word = rng.choice(WORDS).replace("\x00", "")[:60_000].encode()
    text = word if rng.random() < 0.5 else value[:at] + word[:1] + value[at + 1 :]
    # texts have a fixed length, and may be JSON
    attributes.create(name, text, dtype=h5py.string_dtype("utf-8", max(1, len(text))))
    return f"@{name} is {text[:30]!r}"


def _changed(rng: Random, array: NDArray[Any]) -> tuple[str, NDArray[Any]]:
    """Return what is changed, and another array."""
    kind = rng.choice(["value", "value", "value", "times", "type", "shape"])
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
