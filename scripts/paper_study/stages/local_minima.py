"""Random starts: whether it matters where the search for a mesh starts, in S_e and in S_m.

The paper (Section 3.3) has not observed local minima in S_m. Here every vertex of a start is moved by Gaussian noise;
the blended lengths and angles that methods search for stay the same.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from mixseq.shells.fitting import ShellProblem, ShellSettings, fit_shell, linear_initialisation
from mixseq.spaces.mixed.construction import MAX_STEPS, MIN_STEPS
from mixseq.types import Float
from scripts.benchmarks.common.harness import markdown_table
from scripts.paper_study.common.methods import Anchored, FromPose, Printed, strips
from scripts.paper_study.common.poses import Poses, between
from scripts.paper_study.common.record import Json, Results, Say, named, ratio_range

MESHES = ("lion", "cat", "horse")
NOISE = (0.05, 0.15, 0.5)
"""Standard deviations of the noise, in mean lengths of edges."""

STARTS = 5  # number of starts by noise and method
SAME = 0.01  # relative difference below which energies are the same

Search = Callable[[Callable[[Float], Float]], float]
"""Returns the energy that is found from a start ``(n, 3)`` that a function moves."""


def measure(poses: Poses, folder: Path, say: Say) -> Json:
    edge, method, cut = float(poses.lengths.mean()) / poses.diagonal, FromPose(poses), strips(poses, poses.segmented())
    problem, pose = method.problem((between(0.5) @ method.vectors)[: method.space.shape_dim])
    linear = linear_initialisation(problem.patch, problem.lengths, problem.angles, np.zeros_like(pose))
    searches = {
        "DSO, from a pose": fitted([(problem, pose)]),
        "DSO": fitted([(problem, linear)]),
        "MixIT, printed": fitted(joints(Printed(poses, cut))),
        "MixIT": relaxed(Anchored(poses, cut)),
    }
    found: Json = {}
    for name, search in searches.items():
        found[name] = energies(search, edge)
        say(f"{name}: " + ", ".join(f"{size}: {spread(each)}" for size, each in found[name].items()))
    return {"title": poses.title, "methods": found}


def energies(search: Search, edge: float) -> Json:
    """Return the energies that a search finds, by the size of the noise of its starts in edges."""
    rng = np.random.default_rng(0)

    def found(size: float) -> float:
        return search(lambda x: np.asarray(x + size * edge * rng.normal(size=x.shape)))

    return {"0": [found(0.0)]} | {f"{size:g}": [found(size) for _ in range(STARTS)] for size in NOISE}


def fitted(problems: list[tuple[ShellProblem, Float]]) -> Search:
    """Return the search by Gauss-Newton from the starts of problems, whose energies are summed."""
    return lambda move: sum(fit_shell(problem, move(start))[1].energy for problem, start in problems)


def joints(method: Printed) -> list[tuple[ShellProblem, Float]]:
    """Return the problems of all joints, which start from the first pose."""
    poses, frame, problems = method.poses, method.space.frame(between(0.5)), []
    for joint, patch in zip(method.decomposition.joints, method.patches, strict=True):
        weights = method.space.length_weights[joint.edge_ids]
        wanted = frame.lengths[joint.edge_ids], frame.angles[joint.hinge_ids]
        problem = ShellProblem(patch, *wanted, weights, ShellSettings().bending)
        problems.append((problem, poses.points[0][joint.vertices] / poses.diagonal))
    return problems


def relaxed(method: Anchored) -> Search:
    """Return the search by frames and steps of the whole mesh, as the product does, from posed vertices."""
    space, vector = method.space, (between(0.5) @ method.vectors)[None]
    joints, shell, steps = space.joint_projection, space.joint_projection.shell, space.projection.steps
    blocks, x = space.split(vector), space.skin(vector)[0]
    lengths, angles = blocks.lengths[0], blocks.angles[0]
    wanted = joints.mesh_targets(x, lengths, angles)

    def search(move: Callable[[Float], Float]) -> float:
        start = joints.project(move(x), lengths, angles, space.projection.share)
        return 2.0 * shell.energy(shell.relax(start, *wanted, steps).points, *wanted)

    return search


def spread(found: list[float]) -> str:
    """Say which energies were found."""
    low, high = min(found), max(found)
    least, most = (f"{energy:.3g}" if energy < 1000 else f"{energy:.0f}" for energy in (low, high))
    return least if high <= (1 + SAME) * low else f"{least} to {most}"


def page(results: Results) -> list[str]:
    blocks = [
        "Energies half-way that are found from starts whose vertices are moved by Gaussian noise, with a standard "
        f"deviation in mean edges; {STARTS} starts each. *DSO*: Gauss-Newton on the whole mesh. *MixIT, "
        "printed*: on every joint by itself, from the joint of the first pose, summed. *MixIT*: two rounds of "
        f"frames and {MIN_STEPS} to {MAX_STEPS} steps, so its energies are not those of a minimum, and it does not "
        "weigh angles as the others do: energies are to be compared along a row. Noise in its parts is "
        "lowered by the steps only, as frames rebuild joints."
    ]
    for mesh, result in results.items():
        rows = [(name, *map(spread, found.values())) for name, found in result["methods"].items()]
        heads = ("method", "no noise", *(f"{size:g} edges" for size in NOISE))
        blocks += [f"## {mesh}: {result['title']}", markdown_table(heads, rows)]
    grown = growth(results)
    ranges = [
        f"*{name}* "
        + ", ".join(f"{ratio_range(of[k] for of in found.values())} with {NOISE[k]:g} edges" for k in range(3))
        for name, found in grown.items()
    ]
    lower = [
        f"*{name}* on {named(mesh for mesh, r in results.items() if found_lower(r['methods'][name]))}" for name in grown
    ]
    return [
        *blocks,
        "The largest energy of all starts, over that without noise: " + "; ".join(ranges) + ".",
        "The paper has not observed local minima in S_m, and does not mention other starts. Here some start with "
        "noise finds a lower energy than the start without: " + "; ".join(lower) + ".",
    ]


def growth(results: Results) -> dict[str, dict[str, list[float]]]:
    """Return the largest energy by noise over that without, by method and mesh."""
    found: dict[str, dict[str, list[float]]] = {}
    for mesh, result in results.items():
        for name, of in result["methods"].items():
            found.setdefault(name, {})[mesh] = [max(of[f"{size:g}"]) / of["0"][0] for size in NOISE]
    return found


def found_lower(of: Json) -> bool:
    """Return whether some start with noise finds a lower energy than that without."""
    return any(min(of[f"{size:g}"]) < (1 - SAME) * of["0"][0] for size in NOISE)


def verdict(results: Results) -> list[str]:
    lines = [
        f"{name}: "
        + ", ".join(f"{mesh} " + " / ".join(f"{ratio:.2f}" for ratio in each) for mesh, each in found.items())
        for name, found in growth(results).items()
    ]
    sizes = " / ".join(f"{size:g}" for size in NOISE)
    return [f"Largest energy from starts with noise of {sizes} edges, over that without: {'; '.join(lines)}."]
