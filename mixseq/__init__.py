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

from mixseq.forwarding import Facade, connect, forwarded
from mixseq.version import __version__

if TYPE_CHECKING:
    from mixseq import operations
    from mixseq.coding.encoder.compress import compress
    from mixseq.correspondence.correspond import correspond
    from mixseq.correspondence.dense import Correspondence
    from mixseq.correspondence.markers import Markers
    from mixseq.correspondence.suggestions import suggest_markers
    from mixseq.metrics import Comparison, compare
    from mixseq.operations.interpolation import interpolate
    from mixseq.operations.segmenting import segment
    from mixseq.retargeting.transfer import transfer
    from mixseq.rigging import Morph, Skeleton, Skin, fit_morph, fit_skin
    from mixseq.sequence import MeshSequence, Polygons, SequenceHeader
    from mixseq.signals import Curve, Model, PoseMap, fit
    from mixseq.topology import Topology
    from mixseq.unit_conversion import convert_units
    from mixseq_io import open_sequence, read, read_bind_pose, read_skeleton, write, write_blocks, write_rig
    from mixseq_io.correspondence.markers import read_markers
    from mixseq_io.loading import load
    from mixseq_io.saving import save
    from mixseq_io.vat.writer import write_vat
    from mixseq_io.verification import Verification, verify

_HOME = {
    "Comparison": "mixseq.metrics",
    "Correspondence": "mixseq.correspondence.dense",
    "Curve": "mixseq.signals.curve",
    "Markers": "mixseq.correspondence.markers",
    "MeshSequence": "mixseq.sequence",
    "Model": "mixseq.signals.model",
    "Morph": "mixseq.rigging",
    "Polygons": "mixseq.sequence",
    "PoseMap": "mixseq.signals.pose",
    "SequenceHeader": "mixseq.sequence",
    "Skeleton": "mixseq.rigging",
    "Skin": "mixseq.rigging",
    "Topology": "mixseq.topology",
    "Verification": "mixseq_io.verification",
    "compare": "mixseq.metrics",
    "compress": "mixseq.coding.encoder.compress",
    "convert_units": "mixseq.unit_conversion",
    "correspond": "mixseq.correspondence.correspond",
    "fit": "mixseq.signals.fitting",
    "fit_morph": "mixseq.rigging",
    "fit_skin": "mixseq.rigging",
    "interpolate": "mixseq.operations.interpolation",
    "load": "mixseq_io.loading",
    "open_sequence": "mixseq_io",
    "read": "mixseq_io",
    "read_markers": "mixseq_io.correspondence.markers",
    "read_bind_pose": "mixseq_io",
    "read_skeleton": "mixseq_io",
    "save": "mixseq_io.saving",
    "segment": "mixseq.operations.segmenting",
    "suggest_markers": "mixseq.correspondence.suggestions",
    "transfer": "mixseq.retargeting.transfer",
    "verify": "mixseq_io.verification",
    "write": "mixseq_io",
    "write_blocks": "mixseq_io",
    "write_rig": "mixseq_io",
    "write_vat": "mixseq_io.vat.writer",
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
    "Skeleton",
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
    "read_bind_pose",
    "read_markers",
    "read_skeleton",
    "save",
    "segment",
    "suggest_markers",
    "transfer",
    "verify",
    "write",
    "write_blocks",
    "write_rig",
    "write_vat",
]


_home = forwarded(__name__, _HOME)


def __getattr__(name: str) -> Any:
    return import_module("mixseq.operations") if name == "operations" else _home(name)


connect(Facade(__getattr__, lambda name, types: import_module("mixseq_io.given").reader_of(name, types)))


def __dir__() -> list[str]:
    return __all__
