"""Figure 15, on all articulated animations: is every segmentation valid, and does MixIT interpolate on it?

The results are of one "mesh" only, the first: all animations are measured at once.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mixseq
from mixseq.mesh.topology import Topology
from mixseq.segmentation.methods import METHODS as SEGMENTATIONS
from mixseq.segmentation.methods import adjusted_rand_index, segment, segment_by_labels
from scripts.benchmarks.common.section import markdown_table
from scripts.paper_study.common.errors import errors, text
from scripts.paper_study.common.methods import METHODS, Clock, Free, Strips, strips
from scripts.paper_study.common.poses import ARTICULATED, Poses, between
from scripts.paper_study.common.record import Json, Results
from scripts.paper_study.stages.figure_15 import valid

MESHES = ("lion",)
SKELETONS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("gltf/CesiumMan.glb", {}),
    ("usd/CesiumMan.usdz", {}),
    ("gltf/KhronosFox.glb", {"animation": "Run"}),
)
HALF = between(0.5)
LIKE = 1.5
"""A blend has no artefacts of its own if its length errors at 99.9 % are below so many times those in S_e; ours."""

SMALL = 0.02
"""Errors of lengths below this are none that one could see."""


def measure(poses: Poses, folder: Path, say: Callable[[str], None]) -> Json:
    found: Json = {}
    for name in ARTICULATED:
        pair = Poses.farthest(name)
        found[name] = measured(pair)
        say(f"{pair.title} done")
    return {"animations": found, "skeletons": [skeleton(path, options) for path, options in SKELETONS]}


def measured(pair: Poses) -> Json:
    """Segment an animation by every method, and blend two of its frames."""
    result: Json = {"title": pair.title, "components": int(pair.topology.component_count)}
    for name in ("DSO", "MSGI"):
        method = METHODS[name](pair, pair.segmented(1))
        method.prepare()
        result[name] = errors(pair, HALF, method.at(HALF).points).at(0.999)
    for name in SEGMENTATIONS:
        clock = Clock()
        labels = segment(pair.telling, pair.topology, name)
        row: Json = {
            "parts": int(labels.max()) + 1,
            "valid": valid(pair, labels),
            "segmentation": clock.lap(),
        }
        cut = strips(pair, labels)
        for kind, method in (("strips", Strips(pair, cut)), ("free", Free(pair, cut))):
            method.prepare()
            blend, seconds = method.timed(HALF)
            row[kind] = {"errors": errors(pair, HALF, blend.points).at(0.999), "seconds": sum(seconds)}
        result[name] = row
    return result


def skeleton(path: str, options: dict[str, Any]) -> Json:
    """Compare the parts that a skeleton makes with as many by motion."""
    from mixseq_io.text.label_files import read_labels

    file = Path(os.environ.get("MIXSEQ_DATA", ""), path)
    whole = mixseq.read(file, **options)
    topology = Topology(whole.faces, whole.vertex_count)
    bones = segment_by_labels(read_labels(file, whole, "skeleton", **options).part_of_face, topology)
    motion = segment(whole.points, topology, "motion", int(bones.max()) + 1)
    return {"file": path, "parts": int(bones.max()) + 1, "agreement": adjusted_rand_index(bones, motion)}


def clear(pair: Json, kind: str, method: str, edges: tuple[str, ...]) -> bool:
    """Whether a blend has no artefacts of its own, next to the worst of some methods in S_e."""
    least = max(pair[edge][0] for edge in edges)
    return bool(pair[method][kind]["errors"][0] <= max(LIKE * least, SMALL))


def page(results: Results) -> list[str]:
    blocks = []
    for result in results.values():
        rows = []
        for pair in result["animations"].values():
            for name in filter(pair.__contains__, SEGMENTATIONS):  # a method may be newer than what was measured
                row = pair[name]
                rows.append(
                    (
                        pair["title"],
                        name,
                        str(row["parts"]),
                        "yes" if row["valid"] else "**no**",
                        f"{row['segmentation']:.2f}",
                        *(f"{1e3 * row[kind]['seconds']:.0f}" for kind in ("strips", "free")),
                        *(text(row[kind]["errors"]) for kind in ("strips", "free")),
                        *(text(pair[edge]) for edge in ("MSGI", "DSO")),
                    )
                )
        blocks += [
            "The first frame of every animation and the one that is farthest from it, half way. "
            "Segmentations are of the whole animation; errors at 99.9 %, lengths / degrees. A segmentation "
            "is valid if every triangle has a part, parts are numbered without gaps, and each is connected "
            "across edges.",
            markdown_table(
                (
                    "animation",
                    "segmentation",
                    "parts",
                    "valid",
                    "segmentation, s",
                    "free, strips: ms",
                    "free: ms",
                    "free, strips: errors",
                    "free: errors",
                    "MSGI",
                    "DSO",
                ),
                rows,
            ),
            "Times are without what is done once for two poses.",
            "## Skeletons",
            "Parts that the weights of a skeleton make, against as many by motion:",
            markdown_table(
                ("file", "parts", "adjusted Rand index"),
                [(each["file"], str(each["parts"]), f"{each['agreement']:.2f}") for each in result["skeletons"]],
            ),
        ]
    return blocks


def verdict(results: Results) -> list[str]:
    lines = []
    for result in results.values():
        pairs = result["animations"].values()
        measured = [name for name in SEGMENTATIONS if all(name in pair for pair in pairs)]
        fine = sum(pair[name]["valid"] for pair in pairs for name in measured)
        total = len(pairs) * len(measured)
        counts = [
            f"{shown} {sum(clear(pair, kind, name, edges) for pair in pairs for name in measured)}"
            for edges in (("DSO", "MSGI"), ("DSO",))
            for kind, shown in (("free", "MixIT, free"), ("strips", "MixIT, free, strips"))
        ]
        skeletons = ", ".join(f"{each['file']} {each['agreement']:.2f}" for each in result["skeletons"])
        lines.append(
            f"{fine} of {total} segmentations (animations times methods) are valid. Length errors at 99.9 % "
            f"half way are below {LIKE:g} times those of the worse of DSO and MSGI (or below {SMALL:g}): "
            f"{counts[0]}, {counts[1]}; below {LIKE:g} times those of DSO: {counts[2]}, {counts[3]}. Adjusted "
            f"Rand index of skeleton and motion: {skeletons}."
        )
    return lines
