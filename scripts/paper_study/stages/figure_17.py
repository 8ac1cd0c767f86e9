"""Figure 17: two far poses of the cat, where discrete shells that start from a pose are trapped."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mixseq.mesh.measures import dihedral_angles, edge_lengths, wrap_angles
from mixseq.shells.fitting import ShellSettings
from mixseq.types import Float
from scripts.paper_study.common.errors import error_table, errors, folded
from scripts.paper_study.common.methods import METHODS
from scripts.paper_study.common.pictures import BRIGHTEST, Panel, gallery, length_errors
from scripts.paper_study.common.poses import Poses, between
from scripts.paper_study.common.record import Json, Results, Say

MESHES = ("cat",)
FAR = (3, 5)
"""Of all pairs of the cat's poses, the one where discrete shells from the first pose end with the highest energy."""

OTHER = (4, 6)
"""A pair where the linear start does worse."""

COLUMNS = {"energy": lambda found: f"{found['energy']:.3g}", "iterations": lambda found: str(found["iterations"])}
SHOWN = ("DSO, from a pose", "DSO", "MixIT, printed", "MixIT")


def measure(poses: Poses, folder: Path, say: Say) -> Json:
    far, rows = blends_of(poses.only(*FAR), say)
    gallery(folder / f"figure-17-{poses.mesh}.png", poses.only(*FAR), rows, far["title"])
    return {"far": far, "other": blends_of(poses.only(*OTHER), say)[0]}


def blends_of(far: Poses, say: Say) -> tuple[Json, list[list[Panel]]]:
    """Blend two poses by all methods; also return the panels of a picture."""
    labels = far.segmented()
    found: Json = {}
    rows = [[Panel("first pose", far.points[0]), Panel("second pose", far.points[1])], [], []]
    for name, make in METHODS.items():
        blend = make(far, labels).at(between(0.5))
        found[name] = {
            **errors(far, between(0.5), blend.points).summary(),
            "energy": energy(far, blend.points),
            "iterations": sum(report.iterations for report in blend.reports),
        }
        say(f"{far.title}, {name}: energy {found[name]['energy']:.3g}")
        if name in SHOWN:
            rows[1].append(Panel(f"{name}, w = 0.5", blend.points))
            rows[2].append(Panel("length errors", blend.points, length_errors(far, blend.points)))
    return {"title": far.title, "methods": found}, rows


def energy(poses: Poses, points: Float) -> float:
    """Return the energy that discrete shells lower, over the whole mesh, half way."""
    lengths, angles = poses.target(between(0.5))
    topology, typical = poses.topology, poses.lengths.mean(axis=0)
    strain = (edge_lengths(points, topology.edges) - lengths) / typical
    bend = ShellSettings().bending * wrap_angles(dihedral_angles(points, topology.hinges) - angles)
    return float(strain @ strain + bend @ bend)


def page(results: Results) -> list[str]:
    blocks = [
        "Half way between two poses. The energy is what discrete shells lower, here of the whole mesh for every "
        f"method. In the lowest row errors of lengths, from violet (0) to yellow ({BRIGHTEST:.0%} and more)."
    ]
    for mesh, result in results.items():
        blocks += [
            f"## {result['far']['title']}",
            "Chosen for it: poses between which *DSO, from a pose* is trapped. The paper does not name its poses.",
            f"![Two far poses and blends, {mesh}](figure-17-{mesh}.png)",
            error_table("method", result["far"]["methods"], COLUMNS),
            "The paper shows one picture of DSO that got trapped, and of MixIT that did not. " + ordered(result["far"]),
            f"## {result['other']['title']}",
            error_table("method", result["other"]["methods"], COLUMNS),
            "The linear start is no guarantee. " + ordered(result["other"]),
        ]
    pairs = [result[which] for result in results.values() for which in ("far", "other")]
    return [*blocks, folded({f"*{name}* on {p['title']}": f for p in pairs for name, f in p["methods"].items()})]


def ordered(result: Json) -> str:
    """Say which method ends with how much energy."""
    found = sorted(result["methods"].items(), key=lambda each: each[1]["energy"])
    return f"Energies, from the lowest: {energies((f'*{name}*', each) for name, each in found)}."


def energies(found: Iterable[tuple[str, Json]]) -> str:
    """Return the energies of methods."""
    return ", ".join(f"{name} {each['energy']:.3g}" for name, each in found)


def verdict(results: Results) -> list[str]:
    return [
        f"Energy half way, {each['title']}: {energies(each['methods'].items())}."
        for result in results.values()
        for each in (result["far"], result["other"])
    ]
