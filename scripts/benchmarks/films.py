"""Slow motion, vertex spline and model side by side, to be looked at: films, and sheets of the frames with most folds.

Usage: scripts/bench films [NAME ...]   (animations of $MIXSEQ_DATA/npz; six of them by default)

Every 4th frame is kept; films show them eight times slower, NAME.webp in out/films. Sheets (NAME.png) show the dropped
frames where hinges of either are off by most: the truth, the spline and the model, with faces at hinges that are off by
more than 90 degrees in red.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import mixseq
from mixseq.arrays import Float
from mixseq.geometry.lengths_angles import dihedral_angles, wrap
from mixseq.plots import CLAY
from mixseq.plots.video.film import FilmSettings, film
from mixseq.scene import SceneItem
from mixseq.topology import Topology
from scripts.benchmarks.common.inbetween import Motion, part, vertex_spline
from scripts.paper_study.common.pictures import Panel, gallery
from scripts.paper_study.common.poses import Poses

SHOWN = (
    "horse_gallop",
    "q_man_swordslash",
    "q_trex_run",
    "q_fox_gallopjump",
    "robotexpressive_dance",
    "fox_run",
)
EVERY, SLOWER = 4, 8
SECONDS = 8.0
"""Films end after so much of the sequence, slowed down."""

ROWS = 3
"""Frames on a sheet."""

RED = (0.85, 0.1, 0.1)


def main() -> int:
    folder = Path("out", "films")
    folder.mkdir(parents=True, exist_ok=True)
    for name in sys.argv[1:] or SHOWN:
        show(name, Path(os.environ.get("MIXSEQ_DATA", ""), "npz", f"{name}.npz"), folder)
    return 0


def show(name: str, path: Path, folder: Path) -> None:
    """Make the film and the sheet of a sequence, and print how many hinges are off."""
    truth = mixseq.read(path)
    keys = part(truth, np.arange(0, len(truth), EVERY))
    model = mixseq.fit(keys, exact=True)
    motions: tuple[Motion, ...] = (
        vertex_spline(keys),
        lambda times: model.sample(times).points.astype(np.float64),
    )
    last = min(keys.times[-1], keys.times[0] + SECONDS / SLOWER)
    times = np.arange(keys.times[0], last, 1 / (SLOWER * truth.fps))
    slow = keys.header.with_times((times - times[0]) * SLOWER)
    sides = [mixseq.MeshSequence.from_header(slow, motion(times)) for motion in motions]
    names = ("vertex spline", "mixseq")
    film(
        folder / f"{name}.webp",
        [SceneItem(*pair) for pair in zip(names, sides, strict=True)],
        FilmSettings(size=(960, 480)),
    )

    topology = Topology(truth.faces, truth.vertex_count)
    dropped = np.setdiff1d(np.arange(len(keys) * EVERY - EVERY + 1), np.arange(0, len(truth), EVERY))
    found = [motion(truth.times[dropped]) for motion in motions]
    folded = [
        [folds(topology, x, y) for x, y in zip(truth.points[dropped].astype(np.float64), each, strict=True)]
        for each in found
    ]
    counts = np.array([[int(mask.sum()) for mask in each] for each in folded])
    told = [f"{label} {n.mean():.1f} (at most {n.max()})" for label, n in zip(names, counts, strict=True)]
    print(f"{name}: faces at hinges off by more than 90 degrees, a frame: {', '.join(told)}", flush=True)
    worst = np.argsort(-counts.max(axis=0), kind="stable")[:ROWS]
    rows = [
        [
            Panel(f"frame {dropped[k]}", truth.points[dropped[k]].astype(np.float64)),
            *(
                Panel(f"{label}, {int(masks[k].sum())} faces", points[k], painted(masks[k]))
                for label, points, masks in zip(names, found, folded, strict=True)
            ),
        ]
        for k in worst
    ]
    poses = Poses(name, (0,), truth.points[:1].astype(np.float64), truth, topology)
    gallery(folder / f"{name}.png", poses, rows, name)


def folds(topology: Topology, x: Float, y: Float) -> NDArray[np.bool_]:
    """Mark the faces ``(F,)`` of hinges that are off by more than 90 degrees."""
    off = np.abs(wrap(dihedral_angles(y, topology.hinges) - dihedral_angles(x, topology.hinges)))
    mask = np.zeros(len(topology.faces), dtype=bool)
    mask[topology.hinge_faces[off > np.pi / 2]] = True
    return mask


def painted(mask: NDArray[np.bool_]) -> Float:
    """Return colours ``(F, 3)``."""
    return np.where(mask[:, None], RED, np.broadcast_to(CLAY, (len(mask), 3)))


if __name__ == "__main__":
    sys.exit(main())
