"""Compressed sequences on the web.

Usage: scripts/bench web [SECTION ...] [--names NAME ...]   (animations of $MIXSEQ_DATA/npz)

Sections, all of them by default:

decoding      what JavaScript takes to decode, beside Python
connectivity  the same of polygons, and of texture coordinates
frames        how many frames a second a browser makes
sizes         bytes of GLB files, beside morph targets, gltfpack, Draco and pages
first_frame   seconds until pages show the first frame, over a slow line
pages         bytes and first frames of exported pages, beside those of before

sizes and first_frame take gltfpack and three.js from the folder node_modules that MIXSEQ_NODE_MODULES names, and
DracoPy.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence

from scripts.benchmarks.common.section import markdown_table
from scripts.benchmarks.webs import connectivity, decoding, first_frame, frames, pages, sizes

NAMES = ("q_man_run", "horse_gallop", "elephant_gallop", "abc_dembones_bone")

Rows = Callable[[str], Iterable[Sequence[str]]]
"""Measures an animation, and returns what there is to say of it, a row of the section's columns or several."""

SECTIONS: dict[str, tuple[Sequence[str], Sequence[str], Rows]] = {
    "decoding": (NAMES, decoding.COLUMNS, decoding.rows),
    "connectivity": (connectivity.NAMES, connectivity.COLUMNS, connectivity.rows),
    "frames": (frames.NAMES, frames.COLUMNS, frames.rows),
    "sizes": (NAMES, sizes.COLUMNS, sizes.rows),
    "first_frame": (NAMES, first_frame.COLUMNS, first_frame.rows),
    "pages": (pages.NAMES, pages.COLUMNS, pages.rows),
}
"""Animations, columns and rows of every section."""


def main() -> int:
    wanted, _, names = " ".join(sys.argv[1:]).partition("--names")
    for section in wanted.split() or SECTIONS:
        usual, columns, rows = SECTIONS[section]
        table = [row for name in names.split() or usual for row in rows(name)]
        print(f"## {section}\n\n{markdown_table(columns, table)}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
