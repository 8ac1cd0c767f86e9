"""Compressed sequences on the web.

Usage: scripts/bench web [SECTION ...] [--names NAME ...]   (animations of $MIXSEQ_DATA/npz)

Sections, all of them by default:

decoding   what JavaScript takes to decode, beside Python
sizes      bytes of GLB files, beside morph targets, gltfpack, Draco and pages
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from scripts.benchmarks.common.harness import Rows, markdown_table
from scripts.benchmarks.webs import decoding, sizes

NAMES = ("q_man_run", "horse_gallop", "elephant_gallop", "abc_dembones_bone")

SECTIONS: dict[str, tuple[Sequence[str], Rows]] = {
    "decoding": (decoding.COLUMNS, decoding.rows),
    "sizes": (sizes.COLUMNS, sizes.rows),
}
"""Columns and rows of every section."""


def main() -> int:
    wanted, _, names = " ".join(sys.argv[1:]).partition("--names")
    for section in wanted.split() or SECTIONS:
        columns, rows = SECTIONS[section]
        table = [row for name in names.split() or NAMES for row in rows(name)]
        print(f"## {section}\n\n{markdown_table(columns, table)}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
