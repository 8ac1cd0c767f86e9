"""What a damage gets to work on."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path


class NotMadeError(Exception):
    """A damage that cannot be done to a file; another one is tried."""


@dataclass(frozen=True)
class Case:
    """A file that is to be damaged.

    Attributes
    ----------
    rng : Random
        Where all choices come from.
    file : Path
        The file, a copy that may be changed.
    others : sequence of Path
        Sound files of the same reader, to be spliced with.
    outside : sequence of str
        Absolute paths of files that must not be read.
    """

    rng: random.Random
    file: Path
    others: Sequence[Path]
    outside: Sequence[str]

    def out(self) -> str:
        """Return a path that leads out of the folder, absolute or relative, or to something that is no file."""
        path = self.rng.choice(self.outside)
        relative = f"../canary/{Path(path).name}"
        return self.rng.choice(
            [path, path, relative, relative, "/dev/zero", "/etc/passwd", ".", str(self.file)]
        )


Damage = Callable[[Case], str]
