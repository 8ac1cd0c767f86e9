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
    from mixseq.coding.encoder.compress import compress
    from mixseq.correspondence.correspond import correspond
    from mixseq.correspondence.dense import Correspondence
    from mixseq.correspondence.markers import Markers
    from mixseq.metrics import Comparison, compare
    from mixseq.operations.interpolation import interpolate
    from mixseq.operations.segmenting import segment
    from mixseq.retargeting.transfer import transfer
    from mixseq.rigging import Morph, Skin, fit_morph, fit_skin
    from mixseq.sequence import MeshSequence, Polygons, SequenceHeader
    from mixseq.signals import Curve, Model, PoseMap, fit
    from mixseq.topology import Topology
    from mixseq.unit_conversion import convert_units
    from mixseq_io import open_sequence, read, write, write_blocks, write_rig
    from mixseq_io.correspondence.markers import read_markers
    from mixseq_io.hdf5.model_files import load, save
    from mixseq_io.verification import Verification, verify

_HOME = {
    "Comparison": "mixseq.metrics",
    "Correspondence": "mixseq.correspondence.dense",
    "Curve": "mixseq.signals",
    "Markers": "mixseq.correspondence.markers",
    "MeshSequence": "mixseq.sequence",
    "Model": "mixseq.signals",
    "Morph": "mixseq.rigging",
    "Polygons": "mixseq.sequence",
    "PoseMap": "mixseq.signals",
    "SequenceHeader": "mixseq.sequence",
    "Skin": "mixseq.rigging",
    "Topology": "mixseq.topology",
    "Verification": "mixseq_io.verification",
    "compare": "mixseq.metrics",
    "compress": "mixseq.coding.encoder.compress",
    "convert_units": "mixseq.unit_conversion",
    "correspond": "mixseq.correspondence.correspond",
    "fit": "mixseq.signals",
    "fit_morph": "mixseq.rigging",
    "fit_skin": "mixseq.rigging",
    "interpolate": "mixseq.operations.interpolation",
    "load": "mixseq_io.hdf5.model_files",
    "open_sequence": "mixseq_io",
    "read": "mixseq_io",
    "read_markers": "mixseq_io.correspondence.markers",
    "save": "mixseq_io.hdf5.model_files",
    "segment": "mixseq.operations.segmenting",
    "transfer": "mixseq.retargeting.transfer",
    "verify": "mixseq_io.verification",
    "write": "mixseq_io",
    "write_blocks": "mixseq_io",
    "write_rig": "mixseq_io",
}

__all__ = [
    "Comparison",
    "Correspondence",
    "Curve",
    "Markers",
    "MeshSequence",
    "Model",
    "Morph",
    "Polygons",
    "PoseMap",
    "SequenceHeader",
    "Skin",
    "Topology",
    "Verification",
    "__version__",
    "compare",
    "compress",
    "convert_units",
    "correspond",
    "fit",
    "fit_morph",
    "fit_skin",
    "interpolate",
    "load",
    "open_sequence",
    "operations",
    "read",
    "read_markers",
    "save",
    "segment",
    "transfer",
    "verify",
    "write",
    "write_blocks",
    "write_rig",
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
