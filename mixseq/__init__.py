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
from mixseq.version import __version__ as __version__

if TYPE_CHECKING:
    from mixseq.compression.bitstream.compressed_sequence import CompressedSequence as CompressedSequence
    from mixseq.compression.compressed_model import CompressedModel as CompressedModel
    from mixseq.compression.encoder.compress import compress as compress
    from mixseq.mesh.polygons import Polygons as Polygons
    from mixseq.mesh.topology import Topology as Topology
    from mixseq.metrics import Comparison as Comparison
    from mixseq.metrics import compare as compare
    from mixseq.metrics import measure_between as measure_between
    from mixseq.operations.interpolation import interpolate as interpolate
    from mixseq.operations.interpolation import segment as segment
    from mixseq.retargeting.correspond import correspond as correspond
    from mixseq.retargeting.markers import Correspondence as Correspondence
    from mixseq.retargeting.markers import Markers as Markers
    from mixseq.retargeting.proposals import suggest_markers as suggest_markers
    from mixseq.retargeting.transfer import transfer as transfer
    from mixseq.rigging.fitting import fit_morph as fit_morph
    from mixseq.rigging.fitting import fit_skin as fit_skin
    from mixseq.rigging.rigs import Morph as Morph
    from mixseq.rigging.rigs import Skeleton as Skeleton
    from mixseq.rigging.rigs import Skin as Skin
    from mixseq.sequence.header import SequenceHeader as SequenceHeader
    from mixseq.sequence.sequence import MeshSequence as MeshSequence
    from mixseq.sequence.sequence import convert_units as convert_units
    from mixseq.signals.curve import Curve as Curve
    from mixseq.signals.fitting import fit as fit
    from mixseq.signals.model import Model as Model
    from mixseq.signals.pose import PoseMap as PoseMap
    from mixseq_io.model_files import load as load
    from mixseq_io.model_files import save as save
    from mixseq_io.registry import open_sequence as open_sequence
    from mixseq_io.registry import read as read
    from mixseq_io.registry import write as write
    from mixseq_io.registry import write_blocks as write_blocks
    from mixseq_io.rig_files import read_bind_pose as read_bind_pose
    from mixseq_io.rig_files import read_skeleton as read_skeleton
    from mixseq_io.rig_files import write_rig as write_rig
    from mixseq_io.text.markers import read_markers as read_markers
    from mixseq_io.vat.writer import write_vat as write_vat
    from mixseq_io.verification import Verification as Verification
    from mixseq_io.verification import verify as verify

_NAMES_BY_MODULE = {
    "mixseq.compression.bitstream.compressed_sequence": ("CompressedSequence",),
    "mixseq.compression.compressed_model": ("CompressedModel",),
    "mixseq.compression.encoder.compress": ("compress",),
    "mixseq.mesh.polygons": ("Polygons",),
    "mixseq.mesh.topology": ("Topology",),
    "mixseq.metrics": ("Comparison", "compare", "measure_between"),
    "mixseq.operations.interpolation": ("interpolate", "segment"),
    "mixseq.retargeting.correspond": ("correspond",),
    "mixseq.retargeting.markers": ("Correspondence", "Markers"),
    "mixseq.retargeting.proposals": ("suggest_markers",),
    "mixseq.retargeting.transfer": ("transfer",),
    "mixseq.rigging.fitting": ("fit_morph", "fit_skin"),
    "mixseq.rigging.rigs": ("Morph", "Skeleton", "Skin"),
    "mixseq.sequence.header": ("SequenceHeader",),
    "mixseq.sequence.sequence": ("MeshSequence", "convert_units"),
    "mixseq.signals.curve": ("Curve",),
    "mixseq.signals.fitting": ("fit",),
    "mixseq.signals.model": ("Model",),
    "mixseq.signals.pose": ("PoseMap",),
    "mixseq_io": ("open_sequence", "read", "read_bind_pose", "read_skeleton", "write", "write_blocks", "write_rig"),
    "mixseq_io.model_files": ("load", "save"),
    "mixseq_io.text.markers": ("read_markers",),
    "mixseq_io.vat.writer": ("write_vat",),
    "mixseq_io.verification": ("Verification", "verify"),
}
"""Public names by the module from which they are imported at first use."""

_MODULES_BY_NAME = {name: module for module, names in _NAMES_BY_MODULE.items() for name in names}

__all__ = sorted([*_MODULES_BY_NAME, "__version__", "operations"])

_find = lazy_getattr(__name__, _MODULES_BY_NAME)


def __getattr__(name: str) -> Any:
    return import_module("mixseq.operations") if name == "operations" else _find(name)


connect(__getattr__, lambda name, types: import_module("mixseq_io.path_arguments").argument_reader(name, types))


def __dir__() -> list[str]:
    return __all__
