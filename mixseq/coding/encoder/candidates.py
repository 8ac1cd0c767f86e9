"""Candidates to try: kinds of basis, and numbers of parts, first on a coarse mesh and then on the whole one."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Index
from mixseq.coding.bitstream.signal_graph import SignalGraph, mesh_graph
from mixseq.coding.bitstream.spatial_basis import BasisKind
from mixseq.coding.encoder.coarse_mesh import coarse_mesh
from mixseq.coding.encoder.part_merging import vertex_parts
from mixseq.coding.encoder.part_refinement import refined
from mixseq.coding.encoder.principal_components import PrincipalComponents, shapes
from mixseq.coding.encoder.trial import Candidate
from mixseq.frame_store import FrameStore

SHAPES = 1.65
"""Ratio of unpredicted bits up to which shapes are tried against trajectories, as they are predicted better."""

PARTS = (3, 6, 12)
"""Numbers of parts that are tried."""

NODES, LARGE = 8000, 1.5
"""Vertices of the coarse mesh for comparing candidates, used if the mesh has more than `LARGE` times as many."""

KINDS: tuple[BasisKind, ...] = ("trajectories", "shapes")

Way = tuple[BasisKind, int]
"""Kind of basis, and number of parts."""


class Ways:
    """Candidates on a coarse mesh and on the whole one."""

    def __init__(
        self,
        sequence: FrameStore,
        graph: SignalGraph,
        components: PrincipalComponents,
        least: float,
        error: float,
    ) -> None:
        faces, one_part = sequence.header.faces, np.zeros(graph.size, dtype=np.int64)
        self._components, self._least, self._error = components, least, error
        self._mesh = _Mesh(np.arange(graph.size), faces, graph, 1.0)
        self._coarse_mesh = self._mesh
        if graph.size > LARGE * NODES:
            vertices, coarse_faces = coarse_mesh(faces, graph.size, NODES)
            coarse_graph = mesh_graph(coarse_faces, len(vertices))
            self._coarse_mesh = _Mesh(vertices, coarse_faces, coarse_graph, len(vertices) / graph.size)
        self._labels = {1: one_part}
        if "trajectories" in KINDS:
            self._labels |= vertex_parts(sequence, PARTS)
        self._one = self._candidate(components, one_part, self._mesh)
        self._step = step_of(self._one, error)

    @property
    def numbers(self) -> list[int]:
        """Numbers of parts, increasing."""
        return list(self._labels)

    @cached_property
    def _shapes(self) -> PrincipalComponents:
        return shapes(self._components, 3**0.5 * self._least)

    def shapes_may_pay(self) -> bool:
        """Return whether shapes are not clearly worse than trajectories."""
        other = self._candidate(self._shapes, self._labels[1], self._mesh)
        return _bits(other, step_of(other, self._error)) < SHAPES * _bits(self._one, self._step)

    def coarse(self, way: Way) -> Candidate:
        """Return a candidate on the coarse mesh."""
        return self._on(self._coarse_mesh, way)

    def whole(self, way: Way) -> Candidate:
        """Return a candidate on the whole mesh."""
        return self._on(self._mesh, way)

    def _on(self, mesh: _Mesh, way: Way) -> Candidate:
        kind, number = way
        components = self._components if kind == "trajectories" else self._shapes
        components, labels = _at(components, mesh.vertices), self._labels[number][mesh.vertices]
        if number > 1:
            labels = refined(components, labels, mesh.faces, self._step)
        return self._candidate(components, labels, mesh)

    def _candidate(self, components: PrincipalComponents, labels: Index, mesh: _Mesh) -> Candidate:
        least = self._least * mesh.share**0.5
        return Candidate.of(components, labels, mesh.faces, mesh.graph, least, mesh.share)


class _Mesh(NamedTuple):
    """Some vertices ``(n,)`` of a mesh, triangles of these, their graph, and their share of all vertices."""

    vertices: Index
    faces: NDArray[np.integer]
    graph: SignalGraph
    share: float


def _at(components: PrincipalComponents, vertices: Index) -> PrincipalComponents:
    """Return components ``(K, c, V)`` at some vertices."""
    if len(vertices) == components.vectors.shape[2]:
        return components
    mean = components.mean if components.kind == "trajectories" else components.mean[:, vertices]
    return replace(components, mean=mean, vectors=components.vectors[..., vertices])


def expected_error(candidate: Candidate, step: float) -> float:
    """Return the root of the expected squared error: s^2 / 12 per number of a vector, or all of it if that is less."""
    squares, rows = 0.0, candidate.components.curves[0].size
    for part in candidate.parts:
        numbers = part.width / candidate.share + rows
        squares += float(np.minimum(np.square(part.norms) / candidate.share, numbers * step**2 / 12).sum())
    return float(np.sqrt(squares))


def step_of(candidate: Candidate, error: float) -> float:
    """Return the step with a given expected error."""
    low, high = 1e-12 * error, error
    for _ in range(60):
        step = float(np.sqrt(low * high))
        low, high = (step, high) if expected_error(candidate, step) < error else (low, step)
    return low


def _bits(candidate: Candidate, step: float) -> float:
    """Return the bits of one part if only the norms of its components are known."""
    [part] = candidate.parts
    return float(part.width * np.log2(np.maximum(part.norms / (step * part.width**0.5), 1.0)).sum())
