"""Skins with the same number of bones: in a tree, as `mixseq.fit_skin` makes them, free of each other, py-dem-bones'.

Usage: scripts/bench rigs [NAME ...]   (animations of $MIXSEQ_DATA/npz; five by default)
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from functools import partial

import numpy as np

import mixseq
from mixseq.mesh.polygons import label_vertices
from mixseq.rigging.decomposition import decompose_tracks
from mixseq.runtime.parallel import one_blas_thread
from mixseq.segmentation.methods import segment
from mixseq.types import Float
from scripts.benchmarks.common.dembones import fit_peer
from scripts.benchmarks.common.harness import animation, compile_skins, cpu_timed, print_table

NAMES = ("q_man_run", "q_wolf_gallop", "horse_gallop", "cat_poses", "abc_dembones_bone")
BONES = (10, 20, 40)
ROUNDS = 60
"""What `mixseq.fit_skin` does by default."""

COLUMNS = (
    "sequence", "bones", "free, KG %", "tree, KG %", "tree beside free", "py-dem-bones, KG %", "largest: free", "tree",
    "py-dem-bones", "seconds: free", "tree",
)  # fmt: skip


def rows(name: str) -> Iterator[tuple[str, ...]]:
    """Fit skins of all sizes to an animation."""
    sequence = animation(name)
    for bones in BONES:
        seconds, points = zip(*(cpu_timed(partial(fit, sequence, bones)) for fit in (fit_free, fit_tree)), strict=True)
        free, tree = (mixseq.compare(sequence, sequence.with_points(each)) for each in points)
        peer = fit_peer(name, bones)
        yield (
            name,
            str(bones),
            f"{free.kg_percent:.3g}",
            f"{tree.kg_percent:.3g}",
            f"{tree.kg_percent / free.kg_percent:.2f}",
            f"{peer.kg_percent:.3g}" if peer else "not installed",
            f"{free.max_error:.2g}",
            f"{tree.max_error:.2g}",
            f"{peer.max_error:.2g}" if peer else "",
            *(f"{each:.1f}" for each in seconds),
        )


def fit_tree(sequence: mixseq.MeshSequence, bones: int) -> Float:
    """Return the frames ``(T, V, 3)`` of a skin whose bones are a tree."""
    return np.asarray(mixseq.fit_skin(sequence, bones).points())


def fit_free(sequence: mixseq.MeshSequence, bones: int) -> Float:
    """Return the frames ``(T, V, 3)`` of a skin whose bones turn and move independently."""
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
    return np.asarray(diagonal * shown.reshape(sequence.vertex_count, -1, 3).swapaxes(0, 1) + centres[:, None])


if __name__ == "__main__":
    compile_skins()
    sys.exit(print_table(COLUMNS, rows, NAMES))
