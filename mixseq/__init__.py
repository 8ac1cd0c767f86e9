"""Deforming mesh sequences in the mixed shape space: encode, store, resample, decode.

::

    import mixseq

    sequence = mixseq.read("walk.usdc")         # points (T, V, 3), faces, times, units
    model = mixseq.fit(sequence)                # parts, joints, registration, signals
    mixseq.save("walk.h5", model)
    twice = mixseq.load("walk.h5").sample(fps=48)
    mixseq.write("walk48.usdc", twice)

Names are imported when they are first used, so that ``import mixseq`` is quick.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from mixseq.version import __version__

if TYPE_CHECKING:
    from mixseq import operations
    from mixseq.metrics import Comparison, compare
    from mixseq.operations.interpolation import interpolate
    from mixseq.operations.segmenting import segment
    from mixseq.sequence import MeshSequence, Polygons, SequenceHeader
    from mixseq.signals import Curve, Model, PoseMap, fit
    from mixseq.topology import Topology
    from mixseq_io import open_sequence, read, write, write_blocks
    from mixseq_io.hdf5.model import load, save

_HOME = {
    "Comparison": "mixseq.metrics",
    "Curve": "mixseq.signals",
    "MeshSequence": "mixseq.sequence",
    "Model": "mixseq.signals",
    "Polygons": "mixseq.sequence",
    "PoseMap": "mixseq.signals",
    "SequenceHeader": "mixseq.sequence",
    "Topology": "mixseq.topology",
    "compare": "mixseq.metrics",
    "fit": "mixseq.signals",
    "interpolate": "mixseq.operations.interpolation",
    "load": "mixseq_io.hdf5.model",
    "open_sequence": "mixseq_io",
    "read": "mixseq_io",
    "save": "mixseq_io.hdf5.model",
    "segment": "mixseq.operations.segmenting",
    "write": "mixseq_io",
    "write_blocks": "mixseq_io",
}

__all__ = [
    "Comparison",
    "Curve",
    "MeshSequence",
    "Model",
    "Polygons",
    "PoseMap",
    "SequenceHeader",
    "Topology",
    "__version__",
    "compare",
    "fit",
    "interpolate",
    "load",
    "open_sequence",
    "operations",
    "read",
    "save",
    "segment",
    "write",
    "write_blocks",
]


def __getattr__(name: str) -> Any:
    if name == "operations":
        return import_module("mixseq.operations")
    if name not in _HOME:
        raise AttributeError(f"module 'mixseq' has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
