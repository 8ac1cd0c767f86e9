"""The glTF extension ``MIXSEQ_mesh_sequence``, writing: a .glb with a compressed sequence, its first frame as a still.

See `mixseq_io.gltf.sequence_extension` for the layout. Text and streams come first, before textures, for slow loading.
"""

from __future__ import annotations

from pathlib import Path

from mixseq.arrays import FloatArray
from mixseq.choices import StillName
from mixseq.coding.bitstream.compressed_sequence import CompressedSequence, to_model
from mixseq.sequence import SequenceHeader
from mixseq_io.atomic import replacing
from mixseq_io.coded.packing import pack
from mixseq_io.coded.stream_index import Container
from mixseq_io.gltf.buffers import GENERATOR, Layout, append, glb_size, writing_buffer
from mixseq_io.gltf.carried_materials import carried_materials
from mixseq_io.gltf.compression import DRACO
from mixseq_io.gltf.document_edits import used_extensions
from mixseq_io.gltf.json_fields import SEQUENCE_EXTENSION
from mixseq_io.gltf.new_document import material_name, named, upright
from mixseq_io.gltf.still import add_still, as_one_mesh, runs_of_polygons

_TEXT = 1000
"""Maximum size of a text in bytes, apart from long names."""

_FINER = 1.02
"""Largest ratio of the size of a decoded frame's still to that of the frame itself."""


def write_sequence(path: Path, coded: CompressedSequence, still: StillName) -> None:
    """Write a compressed sequence as a .glb."""
    write_container(path, pack(coded), coded.header, to_model(coded)(coded.header.times[0]), still)


def write_container(
    path: Path, container: Container, header: SequenceHeader, points: FloatArray, still: StillName
) -> None:
    """Write text, streams, and a still of `points` ``(V, 3)``; see `write_sequence`."""
    layout = _layout(header, points, container, still)
    with replacing(path) as temporary, writing_buffer(path, temporary, layout):
        pass


def other_bytes(header: SequenceHeader, points: FloatArray, still: StillName) -> int:
    """Return an upper bound in bytes of a .glb without its streams: points ``(V, 3)``."""
    layout = _layout(header, points, Container(bytes(_TEXT + 6 * len(header.name)), b""), still)
    return int(_FINER * glb_size(layout))


def _layout(header: SequenceHeader, points: FloatArray, container: Container, still: StillName) -> Layout:
    layout = Layout({"asset": {"version": "2.0", "generator": GENERATOR}})
    coding = layout.add([container.text], len(container.text))
    streams = layout.add([container.streams], len(container.streams))
    mesh = as_one_mesh(header)
    names = {material_name(each) for each in mesh.face_sets}
    materials = carried_materials(layout, names, header.surface.origin)
    primitives = add_still(layout, mesh, points, still, materials)
    runs = runs_of_polygons(mesh) if len(primitives) > 1 else None
    extension = {
        "version": container.version,
        "coding": coding,
        "streams": streams,
        **({} if runs is None else {"polygons": runs}),
    }
    document = layout.document
    entry = {**named(header.name), "primitives": primitives, "extensions": {SEQUENCE_EXTENSION: extension}}
    node = {**named(header.name), "mesh": append(document, "meshes", entry), **upright(header)}
    document["scene"], document["scenes"] = 0, [{"nodes": [append(document, "nodes", node)]}]
    document["extensionsUsed"] = sorted(used_extensions(document))
    needed = [DRACO] if still == "draco" else [SEQUENCE_EXTENSION] if still == "none" else []
    if needed:
        document["extensionsRequired"] = needed
    return layout
