r"""The projection by many scales (after Winkler, Drieseberg, Alexa and Hormann 2010, "MSGI").

A mesh is cut into small patches that overlap, which are merged to larger and larger ones (`hierarchy`). From below:

1. A leaf is rebuilt on its own from its lengths and angles (`reconstruction`): linear start, a few Gauss-Newton steps.
2. The children of a patch are registered, all at once, through the vertices they share (`registration`; Williams and
   Bennamoun 2000), and stitched by edge blending (`stitching`): an edge points where the children say, and has the
   length ``l_ij`` that is wanted.

There is no optimisation of the whole mesh. The systems of all patches depend on connectivity only and are factored
once. Where lengths and angles belong to a mesh the result is that mesh.

The paper describes overlaps by strips of triangles, registration and edge blending (Sections 1.1 and 2.1 to 2.3). The
hierarchy and all its numbers, how leaves are rebuilt, and the weights are chosen here (docs/paper/methods.md): weights
of the paper are 1, here they grow with the distance from the child's rim.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from mixseq.mesh.measures import clamp_lengths
from mixseq.mesh.topology import Topology
from mixseq.segmentation.joints import make_joint
from mixseq.shells.fitting import Patch, ShellReport, ShellSettings, rebuild_patch
from mixseq.spaces.edge import ShellTargets
from mixseq.spaces.pieces import Pieces
from mixseq.types import Float, Index, index_mask
from scripts.paper_study.common.registration import Overlaps, register
from scripts.paper_study.common.stitching import Seams, stitch
from scripts.paper_study.msgi.hierarchy import Region, divide

LEAF, GROUP = 300, 6
"""Largest number of faces of leaves, before they grow, and of patches that are merged at once."""

STRIPS = 3
"""Strips of triangles by which leaves grow; between far poses one alone doubles the errors of lengths at seams."""

LEAF_FIT = ShellSettings(iterations=10, tolerance=0.01)
"""Few Gauss-Newton steps: what further ones gain is lost where leaves are merged."""

SWEEPS, TOLERANCE = 50, 1e-6
"""Largest number of rounds of a registration, and the change of entries of rotations that ends it."""


@dataclass(frozen=True, eq=False)
class Leaf:
    """A patch that is rebuilt from its lengths and angles: ids of its edges and hinges, and its connectivity."""

    edges: Index
    hinges: Index
    patch: Patch

    @classmethod
    def of(cls, topology: Topology, faces: Index) -> Leaf:
        """Take some faces out of a mesh."""
        inside = index_mask(faces, len(topology.faces))
        joint = make_joint(topology, inside, np.zeros(topology.vertex_count, dtype=bool))
        return cls(joint.edge_ids, joint.hinge_ids, Patch.from_joint(topology, joint, ~joint.free))

    def rebuilt(self, lengths: Float, angles: Float, weights: Float) -> tuple[Float, ShellReport]:
        """Return points ``(n, 3)`` from the lengths and angles of the mesh, and how it went."""
        nowhere = np.zeros((len(self.patch.fixed_mask), 3))
        own = lengths[self.edges], angles[self.hinges], weights[self.edges]
        return rebuild_patch(self.patch, *own, nowhere, LEAF_FIT)


@dataclass(frozen=True, eq=False)
class Merge:
    """A patch that is put together from its children, the patches last made: ids of its edges, vertices they share."""

    edges: Index
    overlaps: Overlaps
    seams: Seams

    @classmethod
    def of(cls, topology: Topology, region: Region) -> Merge:
        """Find what the children of a patch share."""
        own = [np.unique(topology.faces[child.faces]).astype(np.int64) for child in region.children]
        own_edges = [np.unique(topology.face_edges[child.faces]) for child in region.children]
        vertices, edges = np.unique(np.concatenate(own)), np.unique(np.concatenate(own_edges)).astype(np.int64)
        starts = np.cumsum([0, *(len(each) for each in own)])
        rows = [
            start + np.searchsorted(mine, topology.edges[those])
            for start, mine, those in zip(starts[:-1], own, own_edges, strict=True)
        ]
        seams = Seams(
            vertex=np.searchsorted(vertices, np.concatenate(own)),
            rows=np.concatenate(rows),
            edge=np.searchsorted(edges, np.concatenate(own_edges)),
            weights=np.concatenate([_trust(topology, region, child) for child in region.children]),
            vertex_count=len(vertices),
        )
        # Shapes are not known here. Points in general position stand for them: three shared vertices hold.
        shapes = [np.cos(np.outer(mine + 1, np.sqrt([2.0, 3.0, 5.0]))) for mine in own]
        return cls(edges, Overlaps.of(own, shapes), seams)

    def merged(self, points: list[Float], lengths: Float) -> Float:
        """Return points ``(n, 3)`` from those of the children and the lengths of the mesh."""
        rows = np.concatenate(points)
        placed = self.overlaps.move(rows, *register(self.overlaps, rows, SWEEPS, TOLERANCE))
        return stitch(self.seams, placed, lengths[self.edges])


@dataclass(frozen=True, eq=False)
class MultiScale:
    """Rebuilds hinge-connected pieces of meshes patch by patch, as a projection of the edge space."""

    topology: Topology
    pieces: Pieces
    leaf: int = LEAF
    group: int = GROUP
    strips: int = STRIPS

    @cached_property
    def steps(self) -> tuple[tuple[Leaf | Merge, ...], ...]:
        """Patches of every piece, children before those they are merged to."""
        steps = []
        for faces in self.pieces.faces:
            whole = [divide(self.topology, faces, self.leaf, self.group, self.strips)] if len(faces) else []
            steps.append(tuple(step for region in whole for step in _steps(self.topology, region)))
        return tuple(steps)

    def fit(self, wanted: ShellTargets) -> tuple[Float, list[ShellReport]]:
        """Fit rows as `DiscreteShell.fit` does, with a report for every leaf."""
        lengths, angles, weights = wanted.lengths, wanted.angles, wanted.length_weights
        lengths = clamp_lengths(lengths, weights)  # also of the seams: an edge has no negative length
        pieces, reports = [], []
        for vertices, steps in zip(self.pieces.vertices, self.steps, strict=True):
            made: list[Float] = [] if steps else [np.zeros((len(vertices), 3))]
            for step in steps:
                if isinstance(step, Leaf):
                    points, report = step.rebuilt(lengths, angles, weights)
                    reports.append(report)
                else:
                    children = len(step.overlaps.sizes)
                    points = step.merged(made[-children:], lengths)
                    del made[-children:]
                made.append(points)
            pieces.extend(made)
        return np.concatenate(pieces), reports


def _steps(topology: Topology, region: Region) -> Iterator[Leaf | Merge]:
    for child in region.children:
        yield from _steps(topology, child)
    yield Merge.of(topology, region) if region.children else Leaf.of(topology, region.faces)


def _trust(topology: Topology, region: Region, child: Region) -> Float:
    """Weights ``(e,)`` of a child's edges: 1 at its rim, and 1 more for every step that an end is away from it."""
    beyond = np.setdiff1d(region.faces, child.faces, assume_unique=True)
    vertices = np.unique(topology.faces[child.faces])
    rim = np.flatnonzero(np.isin(vertices, topology.faces[beyond]))
    edges = np.searchsorted(vertices, topology.edges[np.unique(topology.face_edges[child.faces])])
    if not rim.size:
        return np.ones(len(edges))
    size = (len(vertices), len(vertices))
    graph = sparse.coo_array((np.ones(len(edges)), tuple(edges.T)), shape=size).tocsr()
    away = csgraph.dijkstra(graph, directed=False, indices=rim, unweighted=True, min_only=True)
    return np.asarray(1.0 + away[edges].sum(axis=1))
