"""Damage to what JSON says, in files of it and in glTF: counts, offsets, references, paths. It stays JSON."""

from __future__ import annotations

import copy
import json
import struct
from collections.abc import Iterator
from typing import Any

from scripts.fuzzing.case import Case, NotMadeError
from scripts.fuzzing.damage.of_text import ESCAPES

_VALUES: tuple[Any, ...] = (
    *(0, 1, -1, 2, 5, 127, 65536, 2**31 - 1, 2**31, 2**32, 2**40, 2**53, 2**63, 10**30, 0.5, -0.0),
    *(
        float("nan"),
        float("inf"),
        1e308,
        -1e308,
        1e-310,
        1e38,
        1e160,
        True,
        None,
        "",
        "word",
        ESCAPES,
        "x" * 100_000,
    ),
    *(
        [],
        {},
        [0],
        [[]],
        [None],
        {"a": 1},
        [1e308] * 16,
        [float("nan")] * 3,
        [0] * 4,
        "SCALAR",
        "MAT4",
        5120,
        5126,
    ),
)


def damage_json(case: Case) -> str:
    """Change one to three values of a file of JSON."""
    try:
        tree = json.loads(case.file.read_text(encoding="utf-8"))
    except ValueError:
        raise NotMadeError from None
    label = _damage(tree, case)
    case.file.write_text(json.dumps(tree), encoding="utf-8")
    return label


def damage_gltf(case: Case) -> str:
    """Change one to three values of the JSON of a glTF file, binary or not."""
    if case.file.suffix == ".gltf":
        return damage_json(case)
    data = case.file.read_bytes()
    (size,) = struct.unpack_from("<I", data, 12)
    tree = json.loads(data[20 : 20 + size])
    label = _damage(tree, case)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + size :]
    head = struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A)
    case.file.write_bytes(head + text + rest)
    return label


def _damage(tree: Any, case: Case) -> str:
    labels = []
    for _ in range(case.rng.choice([1, 1, 1, 2, 3])):
        places = list(_places(tree, ""))
        if not places:
            raise NotMadeError
        holder, key, where = case.rng.choice(places)
        labels.append(f"{where} {_change(holder, key, case)}")
    return ", ".join(labels)


def _places(tree: Any, where: str) -> Iterator[tuple[Any, Any, str]]:
    """Yield all values: what holds them, by which key, and where that is."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in items:
        yield tree, key, f"{where}/{key}"
        yield from _places(value, f"{where}/{key}")


def _change(holder: Any, key: Any, case: Case) -> str:
    rng, value = case.rng, holder[key]
    kind = rng.choices(["value", "near", "out", "without", "twice", "deep", "other"], [8, 5, 2, 2, 2, 1, 2])[
        0
    ]
    if kind == "near" and isinstance(value, int | float) and not isinstance(value, bool):
        holder[key] = rng.choice([value + 1, value - 1, -value, 2 * value, value * 1000, value + 0.5])
    elif kind == "out" and isinstance(value, str):
        holder[key] = case.out()
    elif kind == "without":
        del holder[key]
        return "is gone"
    elif kind == "twice" and isinstance(value, list):
        holder[key] = (value * 5000)[:20_000]
        return "repeated"
    elif kind == "deep":
        deep: list[Any] = []
        holder[key] = deep
        for _ in range(rng.choice([50, 500])):  # json itself cannot write much deeper
            deep.append([])
            deep = deep[0]
        return "nested"
    elif kind == "other" and isinstance(holder, list):
        holder[key] = copy.deepcopy(rng.choice(holder))
    else:
        holder[key] = rng.choice(_VALUES)
    return f"is {str(holder[key])[:30]!r}"
