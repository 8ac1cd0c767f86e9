r"""The projection by many scales (after Winkler, Drieseberg, Alexa and Hormann 2010, "MSGI").

A mesh is cut into small patches that overlap, which are merged to larger and larger ones (`hierarchy`). From below:

1. A leaf is rebuilt on its own from its lengths and angles (`reconstruction`): linear start, a few Gauss-Newton steps.
2. The children of a patch are registered, all at once, through the vertices they share (`registration`; Williams and
   Bennamoun 2000), and stitched by edge blending (`stitching`): an edge points where the children say, and has the
   length ``l_ij`` that is wanted,

   .. math:: \min_v \sum_{\text{children}} \sum_{ij} w_{ij} \Bigl| v_j - v_i -
             \frac{v'_j - v'_i}{|v'_j - v'_i|}\, l_{ij} \Bigr|^2 .

There is no optimisation of the whole mesh. The systems of all patches depend on connectivity only and are factored
once. Where lengths and angles belong to a mesh the result is that mesh.

The paper tells of overlaps by strips of triangles, of registration and of edge blending (Sections 1.1 and 2.1 to 2.3).
Ours are the hierarchy and all its numbers, how leaves are rebuilt, and the weights: those of the paper are 1, here an
edge counts the more the farther it is from the child's rim. A child knows little of its rim, where it lacks what lies
beyond; and weights that fade out blend from child to child instead of jumping.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from mixseq.errors import ReconstructionError
from mixseq.mesh.measures import clamp_lengths
from mixseq.mesh.topology import Topology
from mixseq.runtime.lazy import PickledWithoutCaches
from mixseq.segmentation.joints import make_joint
from mixseq.shells.fitting import Patch, ShellReport, ShellSettings, rebuild_patch
from mixseq.spaces.edge import ShellTargets
from mixseq.spaces.pieces import Pieces
from mixseq.types import Float, Index
from scripts.paper_study.common.registration import Overlaps, register
from scripts.paper_study.common.stitching import Seams, stitch
from scripts.paper_study.msgi.hierarchy import Region, divide

LEAF = 300
"""Leaves have at most so many faces, before they grow."""

GROUP = 6
"""So many patches are merged at once, at most."""

STRIPS = 3
"""Strips of triangles by which leaves grow; between far poses one alone doubles the errors of lengths at seams."""

STEPS = 10
"""Steps of Gauss-Newton in a leaf, at most: what the last ones gain is lost where leaves are merged."""

GAIN = 0.01
"""For the same reason a leaf is done when a step promises to lower its energy by less than this fraction."""

SWEEPS = 50
"""Rounds of a registration, at most: children fit each other only so well, and more changes nothing one could see."""

TOLERANCE = 1e-6
"""A registration ends when a round changes no entry of a rotation by more than this."""


@dataclass(frozen=True, eq=False)
class Leaf(PickledWithoutCaches):
    """A patch that is rebuilt from its lengths and angles.

    Attributes
    ----------
    vertices : (n,) int64
        Its vertices, ascending.
    edges, hinges : (e,), (h,) int64
        Numbers of its edges and hinges in the mesh.
    patch : Patch
        Connectivity, nothing fixed.
    """

    vertices: Index
    edges: Index
    hinges: Index
    patch: Patch

    @classmethod
    def of(cls, topology: Topology, faces: Index) -> Leaf:
        """Take some faces out of a mesh."""
        inside = np.zeros(len(topology.faces), dtype=bool)
        inside[faces] = True
        joint = make_joint(topology, inside, np.zeros(topology.vertex_count, dtype=bool))
        patch = Patch.from_joint(topology, joint, ~joint.free)
        return cls(joint.vertices, joint.edge_ids, joint.hinge_ids, patch)

    def rebuilt(
        self, lengths: Float, angles: Float, weights: Float, settings: ShellSettings
    ) -> tuple[Float, ShellReport]:
        """Return points ``(n, 3)`` from the lengths and angles of the mesh, and how it went."""
        settings = replace(
            settings, iterations=min(settings.iterations, STEPS), tolerance=max(settings.tolerance, GAIN)
        )
        nowhere = np.zeros((len(self.vertices), 3))
        own = lengths[self.edges], angles[self.hinges], weights[self.edges]
        return rebuild_patch(self.patch, *own, nowhere, settings)


@dataclass(frozen=True, eq=False)
class Merge(PickledWithoutCaches):
    """A patch that is put together from its children, the patches last made.

    Attributes
    ----------
    vertices : (n,) int64
        Its vertices, ascending.
    edges : (e,) int64
        Numbers of its edges in the mesh.
    children : int
        How many children it has.
    overlaps : Overlaps
        What these share.
    seams : Seams
        Their edges, with vertices and edges numbered as here.
    """

    vertices: Index
    edges: Index
    children: int
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
            vertex_count=len(vertices),
            weights=np.concatenate([_trust(topology, region, child) for child in region.children]),
        )
        # Shapes are not known here. Points in general position stand for them: three shared vertices hold.
        shapes = [np.cos(np.outer(mine + 1, np.sqrt([2.0, 3.0, 5.0]))) for mine in own]
        return cls(vertices, edges, len(own), Overlaps.of(own, shapes), seams)

    def merged(self, points: list[Float], lengths: Float) -> Float:
        """Return points ``(n, 3)`` from those of the children and the lengths of the mesh."""
        rows = np.concatenate(points)
        rotations, translations = register(self.overlaps, rows, SWEEPS, TOLERANCE)
        owner = np.repeat(np.arange(self.children), self.overlaps.sizes)
        placed = np.einsum("nij,nj->ni", rotations[owner], rows) + translations[owner]
        return stitch(self.seams, placed, lengths[self.edges])


@dataclass(frozen=True, eq=False)
class MultiScale(PickledWithoutCaches):
    """Rebuilds meshes patch by patch, as a projection of the edge space.

    Attributes
    ----------
    topology : Topology
        Connectivity of the mesh.
    pieces : Pieces
        Its hinge-connected pieces.
    leaf : int
        Leaves have at most so many faces before they grow.
    group : int
        So many patches are merged at once, at most.
    strips : int
        Strips of triangles by which leaves grow.

    Raises
    ------
    SettingsError
        When it is first used, if `leaf` or `strips` is below 1, or `group` below 2.
    """

    topology: Topology
    pieces: Pieces
    leaf: int = LEAF
    group: int = GROUP
    strips: int = STRIPS

    @cached_property
    def steps(self) -> tuple[tuple[Leaf | Merge, ...], ...]:
        """What is done for every piece, children before those they are merged to."""
        steps = []
        for faces in self.pieces.faces:
            whole = [divide(self.topology, faces, self.leaf, self.group, self.strips)] if len(faces) else []
            steps.append(tuple(step for region in whole for step in _steps(self.topology, region)))
        return tuple(steps)

    def fit(self, wanted: ShellTargets, settings: ShellSettings) -> tuple[Float, list[ShellReport]]:
        """Fit rows as `DiscreteShell.fit` does, with a report for every leaf."""
        lengths, angles, weights = wanted.lengths, wanted.angles, wanted.length_weights
        for name, values, of in (("length", lengths, "edge"), ("angle", angles, "hinge")):
            wrong = np.flatnonzero(~np.isfinite(values))
            if wrong.size:
                raise ReconstructionError(f"the {name} of {of} {wrong[0]} is {values[wrong[0]]}")
        lengths = clamp_lengths(lengths, weights)  # also of the seams: an edge has no negative length
        pieces, reports = [], []
        for vertices, steps in zip(self.pieces.vertices, self.steps, strict=True):
            made: list[Float] = [] if steps else [np.zeros((len(vertices), 3))]
            for step in steps:
                if isinstance(step, Leaf):
                    points, report = step.rebuilt(lengths, angles, weights, settings)
                    reports.append(report)
                else:
                    points = step.merged(made[-step.children :], lengths)
                    del made[-step.children :]
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
