"""Proposed markers: how many pairs of bodies are accepted, whether the proposals are right, and how exact they are.

A proposal is right if no marker at a tip is on another side of the body: corresponding tips are compared in the
bounding boxes of both bodies, in their mean pose, which stand alike (upright ones not forwards, as their arms swing).
Distances of all markers from the truth are in diagonals of the source. The truth is exact where both are motions of one
mesh, of which the target is decimated to other triangles. Elsewhere it is the correspondence from markers set by hand.
Coverage is the share of the target's area within a tenth of its diagonal of a marker.

Usage: scripts/bench markers [PAIR ...]   (animations of $MIXSEQ_DATA; pairs such as horse-camel, see PAIRS)
"""

from __future__ import annotations

import sys
import warnings
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np

import mixseq
from mixseq.errors import MixseqWarning
from mixseq.mesh.decimation import decimate
from mixseq.mesh.topology import Topology
from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.retargeting.proposals import Proposal, propose_markers, sample_poses
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float, Index
from mixseq_io.text.markers import read_markers
from scripts.benchmarks.common.harness import DATA, markdown_table

OWN = Path(__file__).parent / "markers"


@dataclass(frozen=True)
class Character:
    """A file, and the signed axes (1 to 3) to the left, upwards and forwards."""

    file: str
    axes: tuple[int, int, int] = (1, 2, 3)
    animation: str = ""

    def read(self) -> MeshSequence:
        """Read the motion."""
        return mixseq.read(DATA / self.file, **({"animation": self.animation} if self.animation else {}))


CHARACTERS = {
    "horse": Character("npz/horse_poses.npz"),
    "camel": Character("npz/camel_poses.npz"),
    "cat": Character("npz/cat_poses.npz"),
    "lion": Character("npz/lion_poses.npz"),
    "gallop": Character("npz/horse_gallop.npz"),
    "elephant": Character("npz/elephant_gallop.npz"),
    "cow": Character("npz/cow.npz"),
    "q_horse": Character("npz/q_horse_gallop.npz"),
    "q_horse2": Character("npz/q_horse_eating.npz"),
    "q_wolf": Character("npz/q_wolf_gallop.npz"),
    "q_wolf2": Character("npz/q_wolf_attack.npz"),
    "q_fox": Character("npz/q_fox_gallopjump.npz"),
    "q_alpaca": Character("npz/q_alpaca_gallop.npz"),
    "stag": Character("gltf/Stag.glb", animation="Gallop"),
    "fox": Character("npz/fox_run.npz"),
    "fox2": Character("npz/fox_survey.npz"),
    "trex": Character("npz/q_trex_run.npz"),
    "man": Character("npz/q_man_run.npz", (1, 3, -2)),
    "man2": Character("npz/q_man_swordslash.npz", (1, 3, -2)),
    "woman": Character("npz/q_woman_run.npz", (1, 3, -2)),
    "cesium": Character("gltf/CesiumMan.glb", (-3, 2, 1)),
    "figure": Character("gltf/RiggedFigure.glb"),
}

HAND_MARKERS = {
    "horse-camel": DATA / "markers/golevka_horse_camel.cons",
    "gallop-camel": DATA / "markers/golevka_horse_camel.cons",
    "cat-lion": DATA / "markers/markers-cat-lion.yml",
    "q_wolf-q_horse": OWN / "wolf_horse.txt",
    "man-woman": OWN / "man_woman.txt",
}

QUADRUPEDS = "q_horse", "q_wolf", "q_fox", "q_alpaca", "stag", "fox"
HUMANS = "man", "woman", "cesium", "figure"
SAME_MESH = {"q_horse-q_horse2", "q_wolf-q_wolf2", "man-man2", "fox-fox2", "horse-gallop"}

PAIRS = (
    *HAND_MARKERS,
    *(f"{a}-{b}" for k, a in enumerate(HUMANS) for b in HUMANS[k + 1 :] if (a, b) != ("man", "woman")),
    *(f"{a}-{b}" for k, a in enumerate(QUADRUPEDS) for b in QUADRUPEDS[k + 1 :] if (a, b) != ("q_horse", "q_wolf")),
    *sorted(SAME_MESH),
    *("horse-q_horse", "cow-gallop", "elephant-gallop", "cat-q_fox", "lion-q_wolf"),  # of different authors
    *("trex-man", "man-q_horse", "cesium-horse", "trex-q_wolf"),  # of different kinds; to be refused
)

MAX_BOX_DISTANCE = 0.45  # largest distance of right tips, as a share of the boxes, upwards and forwards
MIDDLE = 0.1  # half the width of the middle of a body, which is on no side, as a share of the box


def box_coordinates(character: Character, sequence: MeshSequence) -> Float:
    """Return positions ``(V, 3)`` in the box of the mean pose, from -1/2 to 1/2: to the left, upwards, forwards."""
    mean = np.asarray(sequence.points[:], np.float64).mean(axis=0)
    turned = np.stack([np.sign(axis) * mean[:, abs(axis) - 1] for axis in character.axes], axis=1)
    low, high = turned.min(axis=0), turned.max(axis=0)
    box = (turned - (low + high) / 2) / (high - low)
    is_upright = high[1] - low[1] > 1.5 * (high[2] - low[2])
    return np.asarray(box * [1.0, 1.0, 0.0] if is_upright else box)


def count_false(boxes: tuple[Float, Float], pairs: Index) -> int:
    """Count pairs ``(n, 2)`` that are on different sides of the bodies."""
    x, y = boxes[0][pairs[:, 0]], boxes[1][pairs[:, 1]]
    is_exchanged = (x[:, 0] * y[:, 0] < 0) & (np.minimum(np.abs(x[:, 0]), np.abs(y[:, 0])) > MIDDLE)
    return int((is_exchanged | (np.abs(x - y)[:, 1:] > MAX_BOX_DISTANCE).any(axis=1)).sum())


def find_truth(name: str, source: MeshSequence, target: MeshSequence, kept: Index) -> Float | None:
    """Return the source points ``(V', 3)`` of the target's vertices at rest, or None if they are not known."""
    if name in SAME_MESH:
        return np.asarray(source.points[0][kept], np.float64)
    if name not in HAND_MARKERS:
        return None
    mapping = mixseq.correspond(source, target, read_markers(HAND_MARKERS[name]))
    return np.asarray(mapping.interpolate(source.points[:1])[0])


def measure(name: str) -> tuple[str, ...]:
    """Return a row of the table."""
    characters = [CHARACTERS[each] for each in name.split("-")]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MixseqWarning)
        source, target = (each.read() for each in characters)
        kept = np.arange(target.vertex_count)
        if name in SAME_MESH:
            count = min(int(0.7 * len(kept)), 4000)
            kept, faces = decimate(np.asarray(target.points[0], np.float64), target.faces.astype(np.int64), count)
            target = MeshSequence.from_arrays(target.points[:, kept], faces)
        truth = find_truth(name, source, target, kept)
    start = process_time()
    proposal = propose_markers(sample_poses(source), sample_poses(target))
    seconds = process_time() - start
    boxes = box_coordinates(characters[0], source), box_coordinates(characters[1], target)
    return name, *_figures(proposal, boxes, source, target, truth), f"{seconds:.1f}"


def _figures(
    proposal: Proposal, boxes: tuple[Float, Float], source: MeshSequence, target: MeshSequence, truth: Float | None
) -> tuple[str, ...]:
    figures = f"{proposal.score:.3f}", f"{proposal.margin:.3f}"
    is_right = "false" if count_false(boxes, proposal.tips) else "right"
    if proposal.doubt:
        return f"refused (best {is_right}): {proposal.doubt}", *figures, "", "", "", "", ""
    pairs = np.stack([proposal.markers.source, proposal.markers.target], axis=1)
    x, y = (np.asarray(sequence.points[0], np.float64) for sequence in (source, target))
    mesh = TriangleMesh(y, Topology(target.faces, target.vertex_count))
    near = np.linalg.norm(y[:, None] - y[pairs[:, 1]], axis=2).min(axis=1) < 0.1 * np.linalg.norm(np.ptp(y, axis=0))
    errors = ("", "")
    if truth is not None:
        distances = np.linalg.norm(truth[pairs[:, 1]] - x[pairs[:, 0]], axis=1) / np.linalg.norm(np.ptp(x, axis=0))
        errors = f"{100 * np.median(distances):.2f} %", f"{100 * (distances < 0.05).mean():.0f} %"
    coverage = f"{100 * mesh.vertex_areas @ near / mesh.vertex_areas.sum():.0f} %"
    other_side = f"{count_false(boxes, pairs[proposal.tip_count :])}"
    return (
        is_right,
        *figures,
        f"{proposal.tip_count} + {len(pairs) - proposal.tip_count}",
        other_side,
        coverage,
        *errors,
    )


def main() -> int:
    columns = "pair", "answer", "score", "margin", "markers", "elsewhere", "coverage", "median", "within 5 %", "CPU s"
    print(markdown_table(columns, []))
    accepted = false = 0
    names = sys.argv[1:] or PAIRS
    for name in names:
        row = measure(name)
        accepted += not row[1].startswith("refused")
        false += row[1] == "false"
        print(f"| {' | '.join(row)} |", flush=True)
    print(f"\n{accepted} of {len(names)} accepted, {false} of them false")
    return int(false > 0)


if __name__ == "__main__":
    sys.exit(main())
