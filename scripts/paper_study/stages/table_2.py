"""Table 2: dimensions of S_e and S_m, as printed, as defined, and as stored."""

from __future__ import annotations

from pathlib import Path

import mixseq
from mixseq.segmentation.joints import Decomposition
from mixseq.spaces.mixed.mixed_space import MixedSpace
from scripts.benchmarks.common.harness import markdown_table
from scripts.paper_study.common.methods import Anchored, Edge, Free, strips
from scripts.paper_study.common.poses import ALL, PAPER, Poses
from scripts.paper_study.common.printed import TABLE_2, edge_dimension
from scripts.paper_study.common.record import Json, Results, Say, by_mesh

MESHES = PAPER
STRIPS, DEFAULT = "the paper's strips", "default of `fit`"
MIXED = (STRIPS, "MixIT, free", "MixIT", DEFAULT)


def measure(poses: Poses, folder: Path, say: Say) -> Json:
    edges, vertices = len(poses.topology.edges), poses.sequence.vertex_count
    labels, edge = poses.segmented(), Edge(poses).space
    counts = {"edges": edges, "vertices": vertices, "printed way": edge_dimension(edges, vertices)}
    cut, model = strips(poses, labels), mixseq.fit(poses.sequence)
    assert isinstance(model.space, MixedSpace)
    return {
        **counts,
        "defined": edge.paper_dimension,
        "stored": edge.dim,
        STRIPS: row_of(strips(poses, labels, full=True), None),
        "MixIT, free": row_of(cut, Free(poses, cut).space.dim),
        "MixIT": row_of(cut, Anchored(poses, cut).space.dim),
        DEFAULT: row_of(model.space.decomposition, model.space.dim),
    }


def row_of(cut: Decomposition, stored: int | None) -> Json:
    """Return the dimensions of a mixed space, as defined and as stored."""
    counts = {"parts": len(cut.parts), "joints": len(cut.joints)}
    return {**counts, "defined": cut.paper_dimension, "stored": stored}


def page(results: Results) -> list[str]:
    edge, mixed = [], list[tuple[str, ...]]()
    for mesh, r in results.items():
        printed = TABLE_2[ALL[mesh].printed]
        counts = (r["vertices"], r["edges"], printed.edge, r["printed way"], r["defined"], r["stored"])
        edge.append((mesh, *(f"{n:,}" for n in counts)))
        ratio = f"{r['defined'] / printed.mixed:.1f}"
        mixed.append((f"**{mesh}**", "the paper", "", "", f"{printed.mixed:,}", "", f"{printed.ratio:.1f}", ratio, ""))
        for name in MIXED:
            m = r[name]
            stored = (f"{m['stored']:,}", f"{r['stored'] / m['stored']:.2f}") if m["stored"] else ("", "")
            ratios = (f"{r[way] / m['defined']:.2f}" for way in ("printed way", "defined"))
            parts = str(m["parts"]), str(m["joints"])
            mixed.append((mesh, name, *parts, f"{m['defined']:,}", stored[0], *ratios, stored[1]))
    return [
        "## S_e",
        markdown_table(("mesh", "V", "E", "printed", "2E + 3V + 6", "defined: 2E + 6", "stored by us"), edge),
        "The paper defines S_e by a length and an angle for every edge, and a pose: 2E + 6. The numbers it prints are "
        "larger by 3V, for all six meshes and to the last digit; so it counts the vertices as well, and the printed "
        "ratios are larger than those of the definitions. We store no angle for edges at a boundary, which have none.",
        "## S_m",
        markdown_table(
            (
                *("mesh", "which", "p", "q", "defined: 2 sum E_k + 3 sum V_i + 6", "stored by us"),
                *("S_e / S_m, printed way of S_e", "both as defined", "both as stored"),
            ),
            mixed,
        ),
        "What parts and joints share counts twice by the definition. We store an edge or hinge only if no "
        "part has all its vertices: the others follow from the part.",
        f"*{STRIPS}*: joints of width 3 around every boundary of our parts, which are not the paper's. *MixIT, free* "
        "and *MixIT*: strips as wide as they bend; stored are lengths and angles of all faces that posed vertices "
        f"get wrong half-way between the two poses. *{DEFAULT}*: `mixseq.fit` of the whole animation; its correction "
        "is not counted.",
    ]


def verdict(results: Results) -> list[str]:
    ratios = [
        f"{mesh} {r['printed way'] / r[STRIPS]['defined']:.2f} ({TABLE_2[ALL[mesh].printed].ratio:g})"
        for mesh, r in results.items()
    ]
    stored = by_mesh(results, lambda r: f"{r['stored'] / r[DEFAULT]['stored']:.2f}")
    same = all(r["printed way"] == TABLE_2[ALL[mesh].printed].edge for mesh, r in results.items())
    return [
        ("The printed dimensions of S_e are 2E + 3V + 6, on our meshes to the last digit. " if same else "")
        + "dim S_e / dim S_m counted like that, with the paper's strips on our parts (the paper's): "
        f"{', '.join(ratios)}. What `mixseq.fit` stores of S_e over what it stores of S_m by default: {stored}."
    ]
