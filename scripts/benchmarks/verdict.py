"""Verdicts on transfers: those with markers set by hand must be good, and those that are spoilt on purpose must not.

Markers are spoilt by exchanging left for right on some limbs (hind, fore, arms) or on all, by exchanging the fore and
hind leg of the left, by moving one to the other foot or far away, or by exchanging two of them. The rest pose is spoilt
by frames of the source, the one farthest from it and the median one, sizes by a hundredfold target. A transfer that is
refused counts as not good. Spoilt transfers that move less than one in a hundred vertices by `MIN_DAMAGE_DIAGONALS`
from where the unspoilt transfer has them are listed, but not counted.

Usage: scripts/bench verdict [PAIR ...]   (animations of $MIXSEQ_DATA; pairs: see PAIRS)
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

import mixseq
from mixseq.errors import MixseqError, MixseqWarning
from mixseq.retargeting.markers import Markers
from mixseq.retargeting.proposals import MAX_POSES, propose_markers, sample_poses, similarity_residuals
from mixseq.retargeting.report import measure_transfer
from mixseq.retargeting.transfer import TransferSettings, plan_transfer
from mixseq.retargeting.verdict import judge_transfer
from mixseq.sequence.sequence import MeshSequence, bounding_diagonal
from mixseq.types import Float, Index, evenly_spaced
from mixseq_io.text.markers import read_markers
from scripts.benchmarks.common.harness import DATA, markdown_table
from scripts.benchmarks.markers import CHARACTERS, OWN, Character, box_coordinates
from scripts.benchmarks.transfer import first

HAND = {
    "horse-camel": (DATA / "markers/golevka_horse_camel.cons", False),
    "wolf-horse_glb": (OWN / "wolf_horse.txt", False),
    "horse_glb-wolf": (OWN / "wolf_horse.txt", True),
    "cat-lion": (DATA / "markers/markers-cat-lion.yml", False),
    "lion-cat": (DATA / "markers/markers-cat-lion.yml", True),
    "man-woman": (OWN / "man_woman.txt", False),
    "woman-man": (OWN / "man_woman.txt", True),
}
"""Marker files, and whether the target's vertices come first."""

CHOSEN = "horse-camel", "wolf-horse_glb", "horse_glb-wolf", "q_horse-q_alpaca", "cesium-figure", "figure-cesium"
"""Pairs on which limits were chosen; others are only reported."""

PAIRS = (*CHOSEN, "cat-lion", "lion-cat", "man-woman", "woman-man", "man2-man", "q_fox-stag", "stag-q_fox")
"""Pairs with markers set by hand; the others have proposed markers, at rest in the two frames that are most alike."""

MODELS = CHARACTERS | {
    "wolf": Character("gltf/Wolf.glb", animation="Gallop"),
    "horse_glb": Character("gltf/Horse.glb", animation="Gallop"),
}

MIN_DAMAGE_DIAGONALS = 0.02  # distance from the unspoilt transfer that 1 % of a spoilt one's points exceed
MAX_FRAMES = 26  # largest number of frames of a source


@dataclass(frozen=True, eq=False)
class Case:
    """A transfer to judge."""

    source: MeshSequence
    rest: int | MeshSequence  # frame or mesh at rest
    target: MeshSequence
    markers: Markers


def read_case(name: str) -> tuple[Case, Float]:
    """Read a transfer that is not spoilt, and the place ``(V', 3)`` of the target's vertices in its box."""
    characters = [MODELS[each] for each in name.split("-")]
    source, target = (each.read() for each in characters)
    if name in HAND:
        file, is_reversed = HAND[name]
        markers = read_markers(file, reverse=is_reversed)
        rest, still = (
            mixseq.read(DATA / each.file, animation="none") if each.file.endswith(".glb") else first(sequence)
            for each, sequence in zip(characters, (source, target), strict=True)
        )
        case = Case(source, rest, still, markers)
    else:
        proposal = propose_markers(sample_poses(source), sample_poses(target))
        samples = zip((source, target), proposal.poses, strict=True)
        frames = [int(evenly_spaced(x.frame_count, MAX_POSES)[k]) for x, k in samples]
        still = MeshSequence.from_header(target.header.with_times([0.0]), target.points[frames[1] : frames[1] + 1])
        case = Case(source, first_at(source, frames[0]), still, proposal.markers)
    step = -(-source.frame_count // MAX_FRAMES)
    fewer = MeshSequence.from_header(source.header.with_times(source.times[::step], source.fps), source.points[::step])
    return replace(case, source=fewer), box_coordinates(characters[1], case.target)


def first_at(sequence: MeshSequence, frame: int) -> MeshSequence:
    """Return a frame as a mesh at rest."""
    return MeshSequence.from_header(sequence.header.with_times([0.0]), sequence.points[frame : frame + 1])


def spoil(case: Case, box: Float) -> Iterator[tuple[str, Case]]:
    """Yield spoilt transfers with their names: box ``(V', 3)``."""
    samples = evenly_spaced(case.source.vertex_count, 400)
    rest = case.rest.points[0] if isinstance(case.rest, MeshSequence) else case.source.points[case.rest]
    residuals = similarity_residuals(np.asarray(case.source.points[:, samples], np.float64), rest[samples])
    order = np.argsort(residuals)
    for name, frame in (("worst rest", order[-1]), ("median rest", order[len(order) // 2])):
        yield name, replace(case, rest=int(frame))
    places = box[case.markers.target]
    is_aside, is_low, ahead = np.abs(places[:, 0]) > 0.1, places[:, 1] < -0.1, places[:, 2]
    masks = {"all": is_aside, "legs": is_aside & is_low}
    if np.ptp(box[:, 2]) > 0:
        masks |= {"hind legs": is_aside & is_low & (ahead < 0), "fore legs": is_aside & is_low & (ahead > 0)}
    else:
        masks |= {"arms": is_aside & (places[:, 1] > 0)}
    for name, mask in masks.items():
        yield f"{name} exchanged", retarget(case, np.flatnonzero(mask), mirror(box, case.markers.target[mask], 0))
    left = np.flatnonzero(places[:, 0] > 0.1)
    if "arms" not in masks:
        legs = left[is_low[left]]
        yield "fore for hind", retarget(case, legs, mirror(box, case.markers.target[legs], 2))
    foot, top = left[places[left, 1].argmin()], int(places[:, 1].argmax())
    vertex = case.markers.target[foot]
    yield "on the other foot", retarget(case, np.array([foot]), mirror(box, np.array([vertex]), 0))
    yield "far away", retarget(case, np.array([foot]), np.linalg.norm(box - box[vertex], axis=1).argmax()[None])
    yield "two exchanged", retarget(case, np.array([foot, top]), case.markers.target[[top, foot]])
    large = MeshSequence.from_header(case.target.header, 100.0 * case.target.points)
    yield "hundredfold", replace(case, target=large)


def mirror(box: Float, vertices: Index, axis: int) -> Index:
    """Return the vertices nearest to the mirror images of vertices ``(n,)`` in the box."""
    images = box[vertices] * np.where(np.arange(3) == axis, -1.0, 1.0)
    return np.array([int(np.linalg.norm(box - image, axis=1).argmin()) for image in images], np.int64)


def retarget(case: Case, marker_ids: Index, vertices: Index) -> Case:
    """Move markers to other vertices ``(n,)`` of the target; of markers at one vertex the first is kept."""
    target = case.markers.target.copy()
    target[marker_ids] = vertices
    kept = np.sort(np.unique(target, return_index=True)[1])
    return replace(case, markers=Markers(case.markers.source[kept], target[kept]))


def judge(case: Case) -> tuple[Float | None, str]:
    """Return the points of a transfer ``(T, V', 3)``, or None if it is refused, and the verdict."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MixseqWarning)
        try:
            planned = plan_transfer(case.source, case.target, TransferSettings(case.markers, rest=case.rest))
        except MixseqError as error:
            return None, f"refused: {error}"
    points = np.concatenate(list(planned.blocks()))
    return points, judge_transfer(planned, measure_transfer(planned, [points])).text


def damage(points: Float, unspoilt: Float, diagonal: float) -> float:
    """Return the distance between two transfers that 1 % of their points exceed, in diagonals, after translations."""
    offsets = points - unspoilt
    distances = np.linalg.norm(offsets - offsets.mean(axis=1, keepdims=True), axis=2)
    return float(np.percentile(distances, 99)) / diagonal


def main() -> int:
    counts = {is_chosen: np.zeros(5, int) for is_chosen in (True, False)}
    for name in sys.argv[1:] or PAIRS:
        case, box = read_case(name)
        unspoilt, text = judge(case)
        count = counts[name in CHOSEN]
        is_hand = name in HAND
        count[:2] += is_hand, is_hand and text.startswith("good")
        print(f"{name}: {text}", flush=True)
        for kind, spoilt in spoil(case, box):
            points, text = judge(spoilt)
            moved = np.inf  # refused, or of another size
            if points is not None and unspoilt is not None and kind != "hundredfold":
                moved = damage(points, unspoilt, bounding_diagonal(case.target.points[0]))
            is_bad = moved > MIN_DAMAGE_DIAGONALS
            count[2:] += is_bad, is_bad and text.startswith("good"), not is_bad
            print(f"  {kind}, {100 * moved:.1f} % off: {text}", flush=True)
    columns = "pairs", "by hand", "good", "spoilt", "good though spoilt", "spoilt without effect"
    names = {True: "limits chosen", False: "reported"}
    print(markdown_table(columns, [(names[key], *map(str, row)) for key, row in counts.items()]))
    return int(any(row[3] or row[1] < row[0] for row in counts.values()))


if __name__ == "__main__":
    sys.exit(main())
