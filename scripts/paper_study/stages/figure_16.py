"""Figure 16: noise on vertices, and a local self-intersection in a rigid part."""

from __future__ import annotations

from collections.abc import Callable
from operator import itemgetter
from pathlib import Path

import numpy as np

from mixseq.pictures.scene import three_quarter_view
from mixseq.spaces.edge import EdgeSettings
from mixseq.types import Float, Index
from scripts.benchmarks.common.harness import markdown_table
from scripts.paper_study.common.damage import BEYOND, SIZE, noisy, pushed
from scripts.paper_study.common.errors import error_table, errors, folds, text
from scripts.paper_study.common.methods import METHODS, Edge, Method, Mixed, strips
from scripts.paper_study.common.pictures import Panel, gallery, heat, held
from scripts.paper_study.common.poses import PAPER, Poses, apart, between
from scripts.paper_study.common.record import Json, Results, Say, by_mesh, named, ratio_range

MESHES = PAPER
NOISE, SEEDS = 0.01, (0, 1, 2)
LARGE = 20_000  # meshes with more vertices have one seed only
VOLUME = 10.0
FAR = 2.0  # distance from the undamaged blend, in mean edge lengths, that has the brightest colour

ALL_METHODS: dict[str, Callable[[Poses, Index], Method]] = {
    **METHODS,
    "DSO, volume": lambda poses, _: Edge(poses, EdgeSettings("dso", volume=VOLUME)),
}
SHOWN = ("MSGI", "DSO, from a pose", "MixIT, printed", "MixIT")
COMPARED = ("MSGI", "DSO", "MixIT, printed", "MixIT, free", "MixIT")
HALF, AWAY = between(0.5), "away outside of the patch, rms / largest"


def measure(poses: Poses, folder: Path, say: Say) -> Json:
    labels = poses.segmented()
    clean = {name: make(poses, labels).at(HALF).points for name, make in ALL_METHODS.items()}
    edge = float(poses.lengths.mean())
    noise: Json = {}
    seeds = SEEDS if poses.sequence.vertex_count <= LARGE else SEEDS[:1]
    for name in METHODS:
        before = errors(poses, HALF, clean[name]).at(0.999)
        after, away = [], []
        for seed in seeds:
            other = noisy(poses, NOISE, seed)
            blend = METHODS[name](other, labels).at(HALF).points
            after.append(errors(other, HALF, blend).at(0.999))
            away.append(rms_and_largest(apart(blend, clean[name]) / edge))
        means = {"after": np.mean(after, axis=0).tolist(), "away": np.mean(away, axis=0).tolist()}
        noise[name] = {"before": before, **means}
        say(f"noise, {name}: {text(before)} to {text(noise[name]['after'])}, {text(noise[name]['away'])} edges away")
    local, rows = intersected(poses, labels, clean, say)
    gallery(folder / f"figure-16-{poses.mesh}.png", poses, rows, poses.title)
    return {"title": poses.title, "noise": noise, **local}


def rms_and_largest(distances: Float) -> list[float]:
    """Return the root mean square and the largest of distances ``(n,)``."""
    return [float(np.sqrt(np.mean(distances**2))), float(distances.max())]


def intersected(poses: Poses, labels: Index, clean: dict[str, Float], say: Say) -> tuple[Json, list[list[Panel]]]:
    """Push a patch through the surface, and compare with the undamaged blends outside of it."""
    cut, edge = strips(poses, labels), float(poses.lengths.mean())
    in_joint = np.concatenate([joint.vertices for joint in cut.joints])
    part_only = np.setdiff1d(np.concatenate(cut.parts), in_joint)
    damage = pushed(poses, part_only, three_quarter_view(poses.points[0], poses.sequence.up_axis))
    outside = np.setdiff1d(np.arange(len(poses.points[0])), damage.vertices)
    found: Json = {}
    close, bad = damage.middle, damage.poses
    whole = Panel("parts and joints", poses.points[1], held(cut.part_of_face, cut.joint_of_face < 0))
    pair = (("second pose", poses.points[1]), ("with the patch pushed", bad.points[1]))
    rows: list[list[Panel]] = [[whole, *(Panel(*each, close=close) for each in pair)], [], []]
    in_patch = np.isin(poses.sequence.faces, damage.vertices).all(axis=1)
    for name, make in ALL_METHODS.items():
        method = make(bad, labels)
        blend = method.at(HALF).points
        distances = apart(blend, clean[name], outside)
        found[name] = {"away": rms_and_largest(distances[outside] / edge), **errors(bad, HALF, blend).summary()}
        if isinstance(method, Mixed):
            found[name]["joints"] = float(1 - method.rigid[in_patch].mean())
        say(f"self-intersection, {name}: {text(found[name]['away'])} edges away outside of the patch")
        if name in SHOWN:
            shown = np.where(np.isin(np.arange(len(blend)), outside), distances, 0.0)
            rows[1].append(Panel(f"{name}, w = 0.5", blend, close=close))
            rows[2].append(Panel("distance from undamaged", blend, heat(poses, shown, FAR * edge)))
    return {"local": found, "moved": len(damage.vertices), "thickness": damage.thickness / edge}, rows


def page(results: Results) -> list[str]:
    blocks = [
        "## Vertex noise",
        f"Normal noise on every coordinate of both poses, its deviation {NOISE:.0%} of the mean edge length; "
        f"means of {len(SEEDS)} seeds, or one of the elephant, w = 0.5. Errors at 99.9 % against the lengths "
        "and angles of the noisy poses; distances from the blend without noise, after registering both, in "
        f"mean edge lengths, rms / largest. The noise itself is {100 * NOISE * np.sqrt(1.5):.1f} % rms in the "
        "mean of two poses. Parts are those of the animation without noise.",
    ]
    columns = ("method", "lengths", "with noise", "ratio", "degrees", "with noise", "ratio", "away")
    for mesh, result in results.items():
        rows = []
        for name, n in result["noise"].items():
            pairs = zip(n["before"], n["after"], strict=True)
            grown = (each for a, b in pairs for each in (text([a]), text([b]), f"{b / a:.2f}"))
            rows.append((name, *grown, text(n["away"])))
        blocks += [f"### {mesh}: {result['title']}", markdown_table(columns, rows)]
    blocks += [
        "## A local self-intersection",
        "A patch of a rigid part, in the thinnest place that holds all of it on the side that faces the camera, is "
        f"pushed through the other side of the limb, in the second pose only: its middle by {BEYOND:g} times "
        f"what the limb is thick there, along its normal, fading out at {SIZE:g} times that. What the rest of "
        "the mesh should do is known, the blend of the poses without the patch; distances from it outside of "
        f"the patch, in mean edge lengths. In the lowest row they go from violet (0) to yellow ({FAR:g} edge "
        f"lengths and more). *DSO, volume* has the volume term that the paper names (weight {VOLUME:g}).",
    ]
    for mesh, result in results.items():
        blocks += [
            f"### {mesh}: {result['title']}",
            f"{result['moved']} vertices moved, the limb is {result['thickness']:.1f} mean edge lengths thick.",
            f"![A patch pushed through the surface, and blends, {mesh}](figure-16-{mesh}.png)",
            error_table("method", result["local"], {AWAY: lambda found: text(found["away"])}),
        ]
    calm = {mesh: min((away(r, "noise", name), name) for name in METHODS)[1] for mesh, r in results.items()}
    return [
        *blocks,
        "## What it shows",
        "The paper says that MixIT is more robust than MSGI against noise, and against self-intersections in "
        "rigid parts, and gives no numbers.",
        "- Self-intersections: the paper's MixIT moves the rest less than MSGI on "
        f"{fewer(results, 'local', 'MixIT, printed', 'MSGI')}: by {least(results, 'MixIT, printed')} of an edge, MSGI "
        f"by {least(results, 'MSGI')}. S_e has no parts, and angles that fold over push their surroundings aside: DSO "
        f"by {least(results, 'DSO')} from the linear start, {least(results, 'DSO, from a pose')} from a pose, "
        f"{least(results, 'DSO, volume')} with the volume term. *MixIT* moves the rest less than DSO on "
        f"{fewer(results, 'local', 'MixIT', 'DSO')}, less than MSGI on {fewer(results, 'local', 'MixIT', 'MSGI')}; "
        f"*MixIT, free* less than DSO on {fewer(results, 'local', 'MixIT, free', 'DSO')}, less than MSGI on "
        f"{fewer(results, 'local', 'MixIT, free', 'MSGI')}. For *MixIT* the patch bends: its joints hold "
        + ", ".join(f"{r['local']['MixIT']['joints']:.0%} of the patch of {mesh}" for mesh, r in results.items())
        + ".\n- Noise: less than MSGI move "
        + "; ".join(
            f"*{name}* on {fewer(results, 'noise', name, 'MSGI')}"
            for name in ("MixIT, printed", "MixIT, free", "MixIT")
        )
        + ". Least of all methods moves "
        + "; ".join(
            f"*{name}* on {named(m for m in calm if calm[m] == name)}" for name in METHODS if name in calm.values()
        )
        + ".",
        folds(results, itemgetter("local")),
    ]


def away(result: Json, kind: str, name: str) -> float:
    """Return how far a blend moves, rms in edges: by noise, or by a patch ("local")."""
    return float(result[kind][name]["away"][0])


def fewer(results: Results, kind: str, mine: str, other: str) -> str:
    """Name the meshes that a method moves less than another does."""
    return named(mesh for mesh, r in results.items() if away(r, kind, mine) < away(r, kind, other))


def least(results: Results, name: str) -> str:
    """Say how far a method moves what is outside of the patch, from mesh to mesh."""
    return ratio_range(away(result, "local", name) for result in results.values())


def verdict(results: Results) -> list[str]:
    def moved(kind: str) -> str:
        return by_mesh(results, lambda r: ", ".join(f"{name} {away(r, kind, name):.2g}" for name in COMPARED), "; ")

    return [
        f"Noise of {NOISE:.0%} of an edge moves the blend, in edge lengths (rms): {moved('noise')}.",
        f"A patch that is pushed through the surface moves the rest, in edge lengths (rms): {moved('local')}.",
    ]
