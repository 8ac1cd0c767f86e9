"""Random starts: whether it matters where the search for a mesh starts, in S_e and in S_m.

The paper (Section 3.3) has not observed local minima in S_m. Here starts are shaken: every vertex is moved by
Gaussian noise. What every method should find, the blended lengths and angles, stays what it is.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from mixseq.mesh.measures import dihedral_angles, edge_lengths
from mixseq.shells.fitting import ShellProblem, ShellSettings, fit_shell
from mixseq.spaces.edge import DiscreteShell, EdgeSettings
from mixseq.spaces.mixed.construction import MAX_STEPS, MIN_STEPS
from mixseq.types import Float, Index
from scripts.benchmarks.common.harness import markdown_table
from scripts.paper_study.common.methods import Anchored, Edge, Printed, strips
from scripts.paper_study.common.poses import Poses, between
from scripts.paper_study.common.record import Json, Results, named, ratio_range

MESHES = ("lion", "cat", "horse")
NOISE = (0.05, 0.15, 0.5)
"""Standard deviations of the noise, in mean lengths of edges."""

STARTS = 5
"""So many starts for each."""

SAME = 0.01
"""Energies that differ by less than this share are the same."""

Search = Callable[[float, np.random.Generator], float]
"""Returns the energy that is found from a start with so much noise."""


def measure(poses: Poses, folder: Path, say: Callable[[str], None]) -> Json:
    labels = poses.segmented()
    searches = {
        "DSO, from a pose": whole(poses, from_pose=True),
        "DSO": whole(poses, from_pose=False),
        "MixIT, printed": joints(poses, labels),
        "MixIT": relaxed(poses, labels),
    }
    found: Json = {}
    for name, search in searches.items():
        rng = np.random.default_rng(0)
        found[name] = {"0": [search(0.0, rng)]} | {
            f"{size:g}": [search(size, rng) for _ in range(STARTS)] for size in NOISE
        }
        say(f"{name}: " + ", ".join(f"{size}: {spread(each)}" for size, each in found[name].items()))
    return {"title": poses.title, "methods": found}


def shaken(x: Float, edge: float, size: float, rng: np.random.Generator) -> Float:
    """Move vertices ``(n, 3)``."""
    return np.asarray(x + size * edge * rng.normal(size=x.shape))


def whole(poses: Poses, from_pose: bool) -> Search:
    """Gauss-Newton on the whole mesh; without noise from the first pose, or from the linear start."""
    edge = Edge(poses, EdgeSettings("dso"))
    space, length = edge.space, float(poses.lengths.mean()) / poses.diagonal
    shell = space.discrete_shell
    (shape,), _, _ = space.split((between(0.5) @ edge.vectors)[None])
    wanted = space.targets(shape)
    (piece, *_) = (each for each in shell.shell_pieces if each is not None)
    problem = shell.problem(0, piece, wanted, space.shell)
    start = poses.points[0][shell.pieces.vertices[0]] / space.scale
    if not from_pose:
        linear = DiscreteShell(shell.topology, shell.pieces).fit(wanted, ShellSettings(iterations=0))[0]
        start = linear[piece.rows]

    def search(size: float, rng: np.random.Generator) -> float:
        return fit_shell(problem, shaken(start, length, size, rng), ShellSettings())[1].energy

    return search


def joints(poses: Poses, labels: Index) -> Search:
    """Gauss-Newton on every joint by itself, from the first pose: the sum of their energies."""
    method = Printed(poses, strips(poses, labels))
    length, frame = float(poses.lengths.mean()) / poses.diagonal, method.space.frame(between(0.5))
    problems = []
    for joint, patch in zip(method.decomposition.joints, method.patches, strict=True):
        weights = method.space.length_weights[joint.edge_ids]
        wanted = frame.lengths[joint.edge_ids], frame.angles[joint.hinge_ids]
        problem = ShellProblem(patch, *wanted, weights, ShellSettings().bending)
        problems.append((problem, poses.points[0][joint.vertices] / poses.diagonal))

    def search(size: float, rng: np.random.Generator) -> float:
        return sum(
            fit_shell(problem, shaken(start, length, size, rng), ShellSettings())[1].energy
            for problem, start in problems
        )

    return search


def relaxed(poses: Poses, labels: Index) -> Search:
    """Frames and steps of the whole mesh, from where vertices are posed."""
    method = Anchored(poses, strips(poses, labels))
    space, length = method.space, float(poses.lengths.mean()) / poses.diagonal
    vector = (between(0.5) @ method.vectors)[None]
    joints, shell, steps = space.joint_projection, space.joint_projection.shell, space.projection.steps
    blocks, x = space.split(vector), space.skin(vector)[0]
    wanted = edge_lengths(x, poses.topology.edges), dihedral_angles(x, poses.topology.hinges)
    wanted[0][space.edge_ids], wanted[1][space.hinge_ids] = blocks.lengths[0], blocks.angles[0]

    def search(size: float, rng: np.random.Generator) -> float:
        start = joints.project(shaken(x, length, size, rng), blocks.lengths[0], blocks.angles[0], 1.0)
        return 2.0 * shell.energy(shell.relax(start, *wanted, steps).points, *wanted)

    return search


def spread(energies: list[float]) -> str:
    """Say which energies were found."""
    low, high = min(energies), max(energies)
    return f"{low:.3g}" if high <= (1 + SAME) * low else f"{low:.3g} to {high:.3g}"


def page(results: Results) -> list[str]:
    blocks = [
        "Energies half-way that are found from starts whose vertices are moved by Gaussian noise, with a standard "
        f"deviation of so many mean edges; {STARTS} starts each. *DSO*: Gauss-Newton on the whole mesh. *MixIT, "
        "printed*: on every joint by itself, from the joint of the first pose, summed. *MixIT*: two rounds of "
        f"frames and {MIN_STEPS} to {MAX_STEPS} steps, so its energies are not those of a minimum, and it does not "
        "weigh angles as the "
        "others do: energies are to be compared along a row."
    ]
    for mesh, result in results.items():
        rows = [(name, *(spread(energies) for energies in found.values())) for name, found in result["methods"].items()]
        heads = ("method", "no noise", *(f"{size:g} edges" for size in NOISE))
        blocks += [f"## {mesh}: {result['title']}", markdown_table(heads, rows)]
    growth = [
        f"*{name}* "
        + ", ".join(
            ratio_range(max(r["methods"][name][f"{size:g}"]) / r["methods"][name]["0"][0] for r in results.values())
            + f" with {size:g} edges"
            for size in NOISE
        )
        for name in next(iter(results.values()))["methods"]
    ]
    lower = [
        f"*{name}* on {named(mesh for mesh, r in results.items() if found_lower(r['methods'][name]))}"
        for name in next(iter(results.values()))["methods"]
    ]
    return [
        *blocks,
        "The largest energy of all starts, over that without noise: " + "; ".join(growth) + ".",
        "The paper has not observed local minima in S_m, and does not tell of other starts. Here some start with "
        "noise finds a lower energy than the start without: " + "; ".join(lower) + ".",
    ]


def found_lower(energies: Json) -> bool:
    """Return whether some start with noise finds a lower energy than that without."""
    without = energies["0"][0]
    return any(min(energies[f"{size:g}"]) < (1 - SAME) * without for size in NOISE)


def verdict(results: Results) -> list[str]:
    lines = []
    for name in next(iter(results.values()))["methods"]:
        worst = [
            f"{mesh} " + " / ".join(f"{max(found[f'{size:g}']) / found['0'][0]:.2f}" for size in NOISE)
            for mesh, result in results.items()
            for found in [result["methods"][name]]
        ]
        lines.append(f"{name}: {', '.join(worst)}")
    told = " / ".join(f"{size:g}" for size in NOISE)
    return [f"Largest energy from starts with noise of {told} edges, over that without: {'; '.join(lines)}."]
