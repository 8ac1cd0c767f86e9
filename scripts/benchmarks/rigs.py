"""Skins of as many bones: in a tree, as `mixseq.fit_skin` makes them, free of each other, and by py-dem-bones.

Usage: scripts/bench rigs [NAME ...] [--bones N,N,...]   (some of the animations in $MIXSEQ_DATA/npz; five by default)
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import mixseq
from mixseq.rigging.bones import label_vertices
from mixseq.rigging.decomposition import decompose_tracks
from mixseq.runtime.parallel import one_blas_thread
from mixseq.segmentation.methods import segment
from mixseq.types import Float
from scripts.benchmarks.common.animations import animation
from scripts.benchmarks.common.child import run_module

NAMES = ("q_man_run", "q_wolf_gallop", "horse_gallop", "cat_poses", "abc_dembones_bone")
BONES = (10, 20, 40)
ROUNDS = 60
"""What `mixseq.fit_skin` does by default."""

COLUMNS = ("sequence", "bones", "fitted by", "KG %", "beside free", "max error", "seconds (processor)")


@dataclass(frozen=True)
class Fitted:
    """Bones that a fit has, its errors (KG in percent, the largest in diagonals) and processor seconds."""

    bones: int
    kg: float
    largest: float
    seconds: float


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=NAMES)
    parser.add_argument("--bones", type=lambda text: [int(each) for each in text.split(",")], default=BONES)
    options = parser.parse_args()
    _compile()
    print("| " + " | ".join(COLUMNS) + " |\n|" + len(COLUMNS) * "---|")
    for name in options.names:
        sequence = animation(name)
        for bones in options.bones:
            free = _timed(_free, sequence, bones)
            rows = {
                "mixseq, free bones": free,
                "mixseq, tree": _timed(_tree, sequence, bones),
                "py-dem-bones": _peer(name, bones),
            }
            for way, found in rows.items():
                print(_line(name, way, found, free), flush=True)
    return 0


def _line(name: str, way: str, found: Fitted | None, free: Fitted) -> str:
    if found is None:
        cells = ["", way, *["not installed"] * 4]
    else:
        beside = f"{found.kg / free.kg:.2f}" if free.kg > 0 else ""
        cells = [
            f"{found.bones}",
            way,
            f"{found.kg:.3g}",
            beside,
            f"{found.largest:.2g}",
            f"{found.seconds:.1f}",
        ]
    return f"| {name} | " + " | ".join(cells) + " |"


def _timed(
    fit: Callable[[mixseq.MeshSequence, int], tuple[int, Float]], sequence: mixseq.MeshSequence, bones: int
) -> Fitted:
    start = time.process_time()
    count, points = fit(sequence, bones)
    seconds = time.process_time() - start
    found = mixseq.compare(sequence, sequence.with_points(points))
    return Fitted(count, found.kg_percent, found.max_error, seconds)


def _tree(sequence: mixseq.MeshSequence, bones: int) -> tuple[int, Float]:
    skin = mixseq.fit_skin(sequence, bones)
    return skin.bone_count, skin.points()


def _free(sequence: mixseq.MeshSequence, bones: int) -> tuple[int, Float]:
    """Bones that know nothing of each other: every one turns and moves as fits best."""
    points = sequence.points.astype(np.float64)
    centres = points.mean(axis=1)
    diagonal = sequence.diagonal
    with one_blas_thread():
        centred = (points - centres[:, None]) / diagonal
        topology = mixseq.Topology(sequence.faces, sequence.vertex_count)
        labels = segment(centred, topology, parts=bones)
        of_vertex = label_vertices(sequence.faces.astype(np.int64), labels, sequence.vertex_count)
        tracks = np.ascontiguousarray(centred.swapaxes(0, 1).reshape(sequence.vertex_count, -1))
        binding, motions = decompose_tracks(tracks, of_vertex, bones, ROUNDS, lambda done: None)
        shown = binding.matrix(len(motions)) @ motions.reshape(4 * len(motions), -1)
    frames = shown.reshape(sequence.vertex_count, -1, 3).swapaxes(0, 1)
    return len(motions), diagonal * frames + centres[:, None]


def _peer(name: str, bones: int) -> Fitted | None:
    found = json.loads(run_module("common.dembones", name, bones).output.splitlines()[-1])
    if found is None:
        return None
    return Fitted(found["bones"], found["kg_percent"], found["max_error"], min(found["seconds"]))


def _compile() -> None:
    """Fit something small, so that no row has the time of the compiler in it."""
    from mixseq.creature import walk_cycle

    mixseq.fit_skin(walk_cycle(frames=3), 4, rounds=2)


if __name__ == "__main__":
    sys.exit(main())
