"""Compressed sequences on the web.

Usage: scripts/bench web [SECTION ...] [--names NAME ...]   (animations of $MIXSEQ_DATA/npz)

Sections, all of them by default:

decoding   what JavaScript takes to decode, beside Python
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence

from scripts.benchmarks.common.section import markdown_table
from scripts.benchmarks.webs import decoding

NAMES = ("q_man_run", "horse_gallop", "elephant_gallop", "abc_dembones_bone")

Rows = Callable[[str], Iterable[Sequence[str]]]
"""Measures an animation, and returns what there is to say of it, a row of the section's columns or several."""

SECTIONS: dict[str, tuple[Sequence[str], Rows]] = {
    "decoding": (decoding.COLUMNS, decoding.rows),
}


def main() -> int:
    wanted, _, names = " ".join(sys.argv[1:]).partition("--names")
    for section in wanted.split() or SECTIONS:
        columns, rows = SECTIONS[section]
        table = [row for name in names.split() or NAMES for row in rows(name)]
        print(f"## {section}\n\n{markdown_table(columns, table)}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
