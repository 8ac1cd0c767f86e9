"""Damage to any file: its bytes."""

from __future__ import annotations

import struct
from random import Random

from scripts.fuzzing.case import Case, NotMadeError

_NUMBERS = (
    0,
    1,
    -1,
    2,
    255,
    256,
    65535,
    65536,
    2**24,
    2**30,
    2**31 - 1,
    2**31,
    2**32 - 1,
    2**40,
    2**62,
    2**63 - 1,
)
_BITS = (
    0x7FC00000,
    0x7F800000,
    0x7FF8000000000000,
    0x7FF0000000000000,
    1,
)  # nan and infinity, and next to nothing


def damage_bytes(case: Case) -> str:
    """Flip, cut, overwrite, repeat or splice."""
    data = case.file.read_bytes()
    if not data:
        raise NotMadeError
    how = case.rng.choices([_flip, _cut, _overwrite, _number, _chunk], [6, 2, 3, 5, 2])[0]
    if case.others and case.rng.random() < 0.05:
        label, changed = _splice(data, case.rng.choice(list(case.others)).read_bytes(), case.rng)
    else:
        label, changed = how(data, case.rng)
    case.file.write_bytes(changed)
    return label


def _place(data: bytes, rng: Random) -> int:
    """A place; structure is at the ends of most files."""
    near = min(len(data), 1024)
    return rng.choice(
        [
            rng.randrange(len(data)),
            rng.randrange(near),
            len(data) - 1 - rng.randrange(near),
            rng.randrange(len(data)),
        ]
    )


def _flip(data: bytes, rng: Random) -> tuple[str, bytes]:
    changed, count = bytearray(data), rng.choice([1, 1, 1, 2, 8])
    places = [(_place(data, rng), rng.randrange(8)) for _ in range(count)]
    for place, bit in places:
        changed[place] ^= 1 << bit
    return f"bits {' '.join(f'{place}.{bit}' for place, bit in places)}", bytes(changed)


def _cut(data: bytes, rng: Random) -> tuple[str, bytes]:
    end = _place(data, rng)
    return f"cut to {end} of {len(data)}", data[:end]


def _overwrite(data: bytes, rng: Random) -> tuple[str, bytes]:
    start = _place(data, rng)
    size = min(rng.choice([1, 4, 16, 100, 1000, 10_000]), len(data) - start)
    kind = rng.choice(["zeros", "ones", "chance"])
    new = {"zeros": bytes(size), "ones": b"\xff" * size}.get(kind) or rng.randbytes(size)
    return f"{kind} at {start}, {size}", data[:start] + new + data[start + size :]


def _number(data: bytes, rng: Random) -> tuple[str, bytes]:
    width = rng.choice([1, 2, 4, 4, 8, 8])
    value = rng.choice(_NUMBERS + (_BITS if width > 2 else ())) % (1 << (8 * width))
    start = min(_place(data, rng), max(0, len(data) - width))
    start -= start % width if rng.random() < 0.6 else 0
    order = rng.choice(["<", ">"])
    packed = struct.pack(order + {1: "B", 2: "H", 4: "I", 8: "Q"}[width], value)
    changed = data[:start] + packed + data[start + width :]
    return f"{value} as {order}u{width} at {start}", changed[: len(data)]


def _chunk(data: bytes, rng: Random) -> tuple[str, bytes]:
    start = _place(data, rng)
    size = min(rng.choice([1, 7, 64, 1024]), len(data) - start)
    chunk = data[start : start + size]
    if rng.random() < 0.5:
        return f"without {size} at {start}", data[:start] + data[start + size :]
    return f"{size} at {start} twice", data[:start] + chunk + data[start:]


def _splice(data: bytes, other: bytes, rng: Random) -> tuple[str, bytes]:
    start = _place(data, rng)
    begin = rng.choice([start, rng.randrange(len(other) + 1)])
    return f"to {start}, then another from {begin}", data[:start] + other[begin:]
