"""What all this is about: `mixseq.compress`, by KG error and by largest error."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

import mixseq
from mixseq.types import Float
from scripts.benchmarks.common.child import MIXSEQ, run
from scripts.benchmarks.peers.coder import ERROR_TARGETS, KG_TARGETS, as_file

FILE = "coded.h5"

Setting = tuple[str, float]


class Ours:
    name = "ours"
    title = "mixseq"
    packages: tuple[str, ...] = ()

    def settings(self, sequence: mixseq.MeshSequence) -> Iterable[Setting]:
        """Return bounds: the argument of `mixseq.compress` and its value."""
        return (*(("kg", kg) for kg in KG_TARGETS), *(("max_error", error) for error in ERROR_TARGETS))

    def encode(self, sequence: mixseq.MeshSequence, setting: Setting) -> bytes:
        bound: dict[str, Any] = dict([setting])
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, FILE)
            mixseq.save(path, mixseq.compress(sequence, **bound))
            return path.read_bytes()

    def signals(self, mesh: mixseq.Topology, data: bytes) -> int:
        with as_file(data, FILE) as path:
            facts = json.loads(run(*MIXSEQ, "info", path, "--json").output)
        return int(facts["bytes"]["signals"])

    def decode(self, mesh: mixseq.Topology, data: bytes) -> Float:
        with as_file(data, FILE) as path:
            model = mixseq.load(path)
            return np.concatenate(list(model.blocks(model.times))).astype(np.float64)
