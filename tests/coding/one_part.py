"""Coding of meshes that are one part, for tests of what has nothing to do with parts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mixseq.arrays import Float
from mixseq.coding import streams as module
from mixseq.coding.basis import Basis
from mixseq.coding.coded import FactorName
from mixseq.coding.factors import Factors
from mixseq.coding.graph import SignalGraph, path_graph
from mixseq.coding.parts import whole


def write_fields(
    factors: Factors, step: float, graph: SignalGraph, dry: bool = False
) -> tuple[Float, tuple[bytes, ...]]:
    [fields], streams = module.write_fields([factors], step, whole(graph), graph, dry)
    return fields, streams


def read_fields(
    streams: Sequence[bytes], rank: int, coordinates: int, step: float, graph: SignalGraph
) -> Float:
    no_faces = np.zeros((0, 3), dtype=np.int32)
    [fields], _ = module.read_fields(streams, [rank], coordinates, step, no_faces, graph)
    return fields


def basis_of(name: FactorName, fields: Float, frame_count: int) -> Basis:
    return module.basis_of(name, [fields], whole(path_graph(fields.shape[2])), frame_count)
