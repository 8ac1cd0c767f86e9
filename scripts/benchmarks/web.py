"""Compressed sequences on the web.

Usage: scripts/bench web [SECTION ...] [--names NAME ...]   (animations of $MIXSEQ_DATA/npz)

Sections, all of them by default:

decoding     what JavaScript takes to decode, beside Python
sizes        bytes of GLB files, beside morph targets, gltfpack, Draco and pages
first_frame  seconds until pages show the first frame, over a slow line

The last two take gltfpack and three.js from the folder node_modules that MIXSEQ_NODE_MODULES names, and DracoPy.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence

from scripts.benchmarks.common.section import markdown_table
from scripts.benchmarks.webs import decoding, first_frame, sizes

NAMES = ("q_man_run", "horse_gallop", "elephant_gallop", "abc_dembones_bone")

Rows = Callable[[str], Iterable[Sequence[str]]]
"""Measures an animation, and returns what there is to say of it, a row of the section's columns or several."""

SECTIONS: dict[str, tuple[Sequence[str], Rows]] = {
    "decoding": (decoding.COLUMNS, decoding.rows),
    "sizes": (sizes.COLUMNS, sizes.rows),
    "first_frame": (first_frame.COLUMNS, first_frame.rows),
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
