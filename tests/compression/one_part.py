"""Coding of meshes that are one part, for tests of what has nothing to do with parts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mixseq.compression.bitstream import spatial_basis
from mixseq.compression.bitstream.signal_graph import SignalGraph, path_graph
from mixseq.compression.bitstream.spatial_basis import BasisKind, SpatialBasis
from mixseq.compression.encoder.components import PrincipalComponents, shape_components, trajectory_components
from mixseq.compression.encoder.trial import Candidate, code_basis, order_coefficients, round_basis
from mixseq.sequence.sequence import FrameStore
from mixseq.types import Float


def principal_components(sequence: FrameStore, kind: BasisKind, least: float) -> PrincipalComponents:
    return (
        trajectory_components(sequence, least)
        if kind == "trajectories"
        else shape_components(trajectory_components(sequence, 0.0), least)
    )


def candidate_of(components: PrincipalComponents, graph: SignalGraph) -> Candidate:
    no_faces, one_part = np.zeros((0, 3), dtype=np.int32), np.zeros(graph.size, dtype=np.int64)
    return Candidate.from_labels(components, one_part, no_faces, graph)


def write_basis(components: PrincipalComponents, step: float, graph: SignalGraph) -> tuple[Float, tuple[bytes, ...]]:
    candidate = candidate_of(components, graph)
    [(vectors, signals)] = round_basis(candidate.parts, step)
    return vectors, code_basis([signals], vectors.shape[1], candidate.labels, graph)


def read_basis(streams: Sequence[bytes], rank: int, coordinates: int, step: float, graph: SignalGraph) -> Float:
    no_faces = np.zeros((0, 3), dtype=np.int32)
    [vectors], _ = spatial_basis.read_basis(streams, [rank], coordinates, step, no_faces, graph)
    return vectors


def basis_of(kind: BasisKind, vectors: Float, frame_count: int) -> SpatialBasis:
    return spatial_basis.assemble_basis(kind, [vectors], [np.arange(vectors.shape[2])], frame_count)


def least_squares(basis: SpatialBasis, sequence: FrameStore) -> Float:
    """Coefficients ``(T, K, d)`` of the varying vectors that are nearest to a sequence."""
    components = principal_components(sequence, basis.kind, 0.0)
    [part] = candidate_of(components, path_graph(basis.vertex_count)).parts
    nearest = order_coefficients(basis, [part.fit(basis.part_bases[0]).coefficients])
    return nearest / basis.norms[basis.varying, None]
