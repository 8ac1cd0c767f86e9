"""Coding of meshes that are one part, for tests of what has nothing to do with parts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mixseq.arrays import Float
from mixseq.coding.bitstream import spatial_basis
from mixseq.coding.bitstream.signal_graph import SignalGraph, path_graph
from mixseq.coding.bitstream.spatial_basis import BasisKind, SpatialBasis, whole
from mixseq.coding.encoder import trial
from mixseq.coding.encoder.principal_components import PrincipalComponents


def write_basis(
    components: PrincipalComponents, step: float, graph: SignalGraph, dry: bool = False
) -> tuple[Float, tuple[bytes, ...]]:
    [vectors], streams = trial.write_basis([components], step, whole(graph), graph, dry)
    return vectors, streams


def read_basis(
    streams: Sequence[bytes], rank: int, coordinates: int, step: float, graph: SignalGraph
) -> Float:
    no_faces = np.zeros((0, 3), dtype=np.int32)
    [vectors], _ = spatial_basis.read_basis(streams, [rank], coordinates, step, no_faces, graph)
    return vectors


def basis_of(kind: BasisKind, vectors: Float, frame_count: int) -> SpatialBasis:
    return spatial_basis.assemble_basis(kind, [vectors], whole(path_graph(vectors.shape[2])), frame_count)
