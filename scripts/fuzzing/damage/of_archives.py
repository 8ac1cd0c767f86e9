"""Damage to zip archives with right checksums: npz and usdz. Headers that promise too much, names, bombs."""

from __future__ import annotations

import io
import re
import struct
import warnings
import zipfile
import zlib
from random import Random
from typing import Any

import numpy as np

from scripts.fuzzing.case import Case, NotMadeError
from scripts.fuzzing.damage.of_bytes import damage_bytes
from scripts.fuzzing.damage.of_text import ESCAPES

Entries = list[tuple[str, bytes]]

_TYPES = ("f2", ">f4", "f8", "i1", "u8", "c16", "?", "S3", "U5", "M8[s]", "V8", "f4,i4")
_VALUES = (float("nan"), float("inf"), 1e308, -1e308, 1e-310, 1e160, 1e38, -1, 0, 2**31, 2**62)
_BOMB, _HEAD, _PIECE = 3 << 30, 128, 1 << 20
_BOMB_CHECKSUM = 0x7A037CC4
"""CRC-32 of the header of an array of `_BOMB` bytes, and zeros."""


def damage_archive(case: Case) -> str:
    """Change one entry, and store all with right checksums."""
    try:
        with zipfile.ZipFile(case.file) as archive:
            entries = [(name, archive.read(name)) for name in archive.namelist()]
    except zipfile.BadZipFile:
        raise NotMadeError from None
    at = case.rng.randrange(len(entries))
    name, data = entries[at]
    if name.endswith(".npy") and case.rng.random() < 0.75:
        label, entries[at] = _array(name, data, case.rng)
    else:
        label = _entry(entries, at, case)
    _store(case, entries, bomb=label.endswith("bomb"))
    return f"{name} {label}"


def _entry(entries: Entries, at: int, case: Case) -> str:
    name, data = entries[at]
    kind = case.rng.choice(["gone", "again", "other name", "empty", "damaged", "bomb"])
    match kind:
        case "gone":
            del entries[at]
        case "again":
            entries.append((name, data[: len(data) // 2]))
        case "other name":
            new = case.rng.choice([case.out(), "..", "", ESCAPES, "x" * 60_000, case.rng.choice(entries)[0]])
            entries[at] = (new, data)
        case "empty":
            entries[at] = (name, b"")
        case "damaged":
            inner = case.file.with_name("entry")
            inner.write_bytes(data)
            kind = damage_bytes(Case(case.rng, inner, (), case.outside))
            entries[at] = (name, inner.read_bytes())
            inner.unlink()
        case "bomb":
            entries[at] = (name, b"")
    return kind


def _array(name: str, data: bytes, rng: Random) -> tuple[str, tuple[str, bytes]]:
    """Another array under the same name, or a header that does not fit."""
    array = np.load(io.BytesIO(data), allow_pickle=False)
    kind = rng.choice(["shape", "header", "values", "values", "type", "cut", "axes", "many"])
    if kind == "header":
        words = {
            "shape": f"({10 ** rng.randrange(1, 20)},)",
            "descr": rng.choice(["'|O'", "'<f4', 'x'", *_TYPES]),
        }
        key = rng.choice(list(words))
        text = data[:1000].decode("latin-1")
        text = re.sub(rf"('{key}': )(\([^)]*\)|'[^']*')", lambda found: found[1] + words[key], text, count=1)
        return f"{key} {words[key]}", (name, text.encode("latin-1") + data[1000:])
    with np.errstate(all="ignore"):
        label, changed = _changed(array, kind, rng)
    stored = io.BytesIO()
    np.save(stored, changed, allow_pickle=False)
    return label, (name, stored.getvalue())


def _changed(array: np.ndarray[Any, Any], kind: str, rng: Random) -> tuple[str, np.ndarray[Any, Any]]:
    if kind == "values" and array.size and array.dtype.kind in "fiu":
        value = rng.choice(_VALUES)
        if rng.random() < 0.3:
            return f"times {value}", array.astype(np.float64) * value
        wide = (
            array.astype(np.float64)
            if isinstance(value, float) or abs(value) > 2**31
            else array.astype(np.int64)
        )
        wide.reshape(-1)[rng.randrange(wide.size)] = value
        return f"has {value}", wide if rng.random() < 0.2 else wide.astype(array.dtype)
    if kind == "type":
        other = rng.choice(_TYPES)
        try:
            return f"as {other}", array.astype(other)
        except (ValueError, TypeError):
            return f"zeros as {other}", np.zeros(array.shape, other)
    if kind == "cut" and array.ndim:
        return "one less", array[:-1]
    if kind == "axes":
        return "other axes", rng.choice([array[None], array.reshape(-1), array.T])
    if kind == "many" and array.ndim:
        return "often", np.concatenate([array] * 50)
    if array.dtype.kind == "U":
        return "another text", np.array(rng.choice([ESCAPES, "x" * 100_000, "\x00", ""]))
    return "empty", rng.choice(
        [np.zeros(0), np.zeros((0, *array.shape[1:])), np.array(0.0), np.zeros((3, 0, 3))]
    )


def _store(case: Case, entries: Entries, bomb: bool) -> None:
    compression = case.rng.choice([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
    with warnings.catch_warnings(), zipfile.ZipFile(case.file, "w", compression) as archive:
        warnings.simplefilter("ignore")  # of names that come twice
        for name, data in entries:
            info = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            try:
                archive.writestr(
                    info, data or (_bomb() if bomb else b""), compression if data else zipfile.ZIP_STORED
                )
            except (ValueError, struct.error):
                raise NotMadeError from None
            if bomb and not data:  # what was stored is deflated already
                info.compress_type, info.CRC, info.file_size = zipfile.ZIP_DEFLATED, _BOMB_CHECKSUM, _BOMB


def _bomb() -> bytes:
    """A deflated array of zeros, put together from the same piece again and again."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        head, {"descr": "|u1", "fortran_order": False, "shape": (_BOMB - _HEAD,)}
    )
    first = packer.compress(head.getvalue()) + packer.flush(zlib.Z_FULL_FLUSH)
    piece = packer.compress(bytes(_PIECE)) + packer.flush(zlib.Z_FULL_FLUSH)
    count, rest = divmod(_BOMB - _HEAD, _PIECE)
    return first + piece * count + packer.compress(bytes(rest)) + packer.flush()
