"""Deforming mesh sequences in the mixed shape space: encode, store, resample, decode.

::

    import mixseq

    sequence = mixseq.read("walk.usdc")         # points (T, V, 3), faces, times, units
    model = mixseq.fit(sequence)                # parts, joints, registration, signals
    mixseq.save("walk.h5", model)
    twice = mixseq.load("walk.h5").sample(fps=48)
    mixseq.write("walk48.usdc", twice)

Public names are imported at first use, so that ``import mixseq`` is quick.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from mixseq.runtime.lazy import connect, lazy_getattr
from mixseq.version import __version__

if TYPE_CHECKING:
    from mixseq.compression.bitstream.compressed_sequence import CompressedSequence
    from mixseq.compression.compressed_model import CompressedModel
    from mixseq.compression.encoder.compress import compress
    from mixseq.mesh.polygons import Polygons
    from mixseq.mesh.topology import Topology
    from mixseq.metrics import Comparison, compare, measure_between
    from mixseq.operations.interpolation import interpolate, segment
    from mixseq.retargeting.correspond import correspond
    from mixseq.retargeting.markers import Correspondence, Markers
    from mixseq.retargeting.suggestions import suggest_markers
    from mixseq.retargeting.transfer import transfer
    from mixseq.rigging.fitting import fit_morph, fit_skin
    from mixseq.rigging.rigs import Morph, Skeleton, Skin
    from mixseq.sequence.header import SequenceHeader
    from mixseq.sequence.sequence import MeshSequence, convert_units
    from mixseq.signals.curve import Curve
    from mixseq.signals.fitting import fit
    from mixseq.signals.model import Model
    from mixseq.signals.pose import PoseMap
    from mixseq_io.loading import load
    from mixseq_io.registry import open_sequence, read, write, write_blocks
    from mixseq_io.rig_files import read_bind_pose, read_skeleton, write_rig
    from mixseq_io.saving import save
    from mixseq_io.text.markers import read_markers
    from mixseq_io.vat.writer import write_vat
    from mixseq_io.verification import Verification, verify


_MODULES = {
    "Comparison": "mixseq.metrics",
    "CompressedModel": "mixseq.compression.compressed_model",
    "CompressedSequence": "mixseq.compression.bitstream.compressed_sequence",
    "Correspondence": "mixseq.retargeting.markers",
    "Curve": "mixseq.signals.curve",
    "Markers": "mixseq.retargeting.markers",
    "MeshSequence": "mixseq.sequence.sequence",
    "Model": "mixseq.signals.model",
    "Morph": "mixseq.rigging.rigs",
    "Polygons": "mixseq.mesh.polygons",
    "PoseMap": "mixseq.signals.pose",
    "SequenceHeader": "mixseq.sequence.header",
    "Skeleton": "mixseq.rigging.rigs",
    "Skin": "mixseq.rigging.rigs",
    "Topology": "mixseq.mesh.topology",
    "Verification": "mixseq_io.verification",
    "compare": "mixseq.metrics",
    "compress": "mixseq.compression.encoder.compress",
    "convert_units": "mixseq.sequence.sequence",
    "correspond": "mixseq.retargeting.correspond",
    "fit": "mixseq.signals.fitting",
    "fit_morph": "mixseq.rigging.fitting",
    "fit_skin": "mixseq.rigging.fitting",
    "interpolate": "mixseq.operations.interpolation",
    "load": "mixseq_io.loading",
    "measure_between": "mixseq.metrics",
    "open_sequence": "mixseq_io",
    "read": "mixseq_io",
    "read_markers": "mixseq_io.text.markers",
    "read_bind_pose": "mixseq_io",
    "read_skeleton": "mixseq_io",
    "save": "mixseq_io.saving",
    "segment": "mixseq.operations.interpolation",
    "suggest_markers": "mixseq.retargeting.suggestions",
    "transfer": "mixseq.retargeting.transfer",
    "verify": "mixseq_io.verification",
    "write": "mixseq_io",
    "write_blocks": "mixseq_io",
    "write_rig": "mixseq_io",
    "write_vat": "mixseq_io.vat.writer",
}

__all__ = [
    "Comparison",
    "CompressedModel",
    "CompressedSequence",
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
    "measure_between",
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


_find = lazy_getattr(__name__, _MODULES)


def __getattr__(name: str) -> Any:
    return import_module("mixseq.operations") if name == "operations" else _find(name)


connect(__getattr__, lambda name, types: import_module("mixseq_io.path_arguments").argument_reader(name, types))


def __dir__() -> list[str]:
    return __all__
