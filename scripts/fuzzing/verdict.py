"""Which class a case is of, by what the process did, printed, opened and wrote."""

from __future__ import annotations

import pickle
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from scripts.fuzzing.canary import MARK
from scripts.fuzzing.sandbox import Ended
from scripts.fuzzing.uses import OUT

Kind = Literal[
    "same",
    "sound",
    "refused",
    "traceback",
    "signal",
    "hang",
    "memory",
    "outside read",
    "silent change",
    "escape",
]
"""In the file's favour: what was found is what was there before; it differs, but is valid; an error of ours and exit
code 2. Then defects: a traceback or another exit code; death by a signal; no end; too much memory; a file outside was
opened or its text told; damage under a checksum that nobody noticed, or what is no valid sequence; control characters
that a terminal obeys."""

KINDS: tuple[Kind, ...] = get_args(Kind)
GOOD: tuple[Kind, ...] = ("same", "sound", "refused")

MOST_MEGABYTES = 2048

Found = Literal["same", "differs", "invalid", "nothing"]

_ERROR = re.compile(r"^mixseq: error: \S", re.MULTILINE)
_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


def classify(ended: Ended, found: Found, opened: Sequence[str], told: bool, noticed: bool) -> Kind:
    """Return the class.

    Parameters
    ----------
    ended : Ended
        The process.
    found : str
        What it found in comparison with the sound file.
    opened : sequence of str
        Files outside that it opened and had no reason to.
    told : bool
        Whether text of them is in what it printed or wrote.
    noticed : bool
        Whether any change must be noticed.
    """
    if opened or told:
        return "outside read"
    if ended.hung:
        return "hang"
    if ended.megabytes > MOST_MEGABYTES or "not enough memory" in ended.text:
        return "memory"
    if ended.code < 0:
        return "signal"
    if "Traceback" in ended.text or ended.code not in (0, 2):
        return "traceback"
    if _CONTROL.search(ended.text):
        return "escape"
    if ended.code == 2:
        return "refused" if _ERROR.search(ended.text) else "traceback"
    if found == "same":
        return "same"
    return "silent change" if noticed or found in ("invalid", "nothing") else "sound"


def compare(folder: Path, expected: Path) -> Found:
    """Compare what a use found with what it found in the sound file."""
    out = folder / OUT
    if not out.exists():
        return "nothing"
    ours, theirs = _loaded(out), _loaded(expected)
    if isinstance(ours, dict):
        points = ours.get("points")
        if points is not None and not (points.size and np.isfinite(points).all()):
            return "invalid"
        same = ours.keys() == theirs.keys() and all(_equal(ours[name], theirs[name]) for name in ours)
    else:
        same = ours == theirs
    return "same" if same else "differs"


def tells(ended: Ended, folder: Path) -> bool:
    """Whether the text of a file outside is in what was printed or written."""
    mark = MARK.encode()
    return MARK in ended.text or any(
        mark in file.read_bytes() for file in folder.rglob("*") if file.is_file() and not file.is_symlink()
    )


def _loaded(file: Path) -> Any:
    data = file.read_bytes()
    if data[:2] != b"PK":
        return repr(pickle.loads(data))
    with np.load(file) as archive:
        # where a sequence is from is another folder every time
        return {name: archive[name] for name in archive.files if "origin" not in name}


def _equal(ours: np.ndarray[Any, Any], theirs: np.ndarray[Any, Any]) -> bool:
    return ours.dtype == theirs.dtype and ours.shape == theirs.shape and bool(np.array_equal(ours, theirs))
