"""The glTF extension ``MIXSEQ_mesh_sequence``, reading: a mesh whose frames are the streams of a compressed model.

::

    "meshes": [{
        "primitives": [...],                 the first frame, for viewers that do not know the extension
        "extensions": {"MIXSEQ_mesh_sequence": {
            "version": 1,                    of compressed models
            "coding": 5,                     buffer view: the JSON text
            "streams": 6,                    buffer view: the index, then all streams
            "polygons": [0, 120, 1, 80]      if there are several primitives: the first 120 polygons are of primitive
        }}                                   0, the next 80 of primitive 1, and so on
    }]

Text and streams are, byte for byte, those of an HDF5 file. Vertices, faces, texture coordinates and hard edges are in
them; of the primitives a decoder needs the materials only. Schema and specification: ``docs/file-format.md``.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from mixseq.errors import AmbiguousError, FormatError
from mixseq_io.coded.stream_index import Container
from mixseq_io.gltf.containers import chunks, data_of_file
from mixseq_io.gltf.document import Document, load_document
from mixseq_io.gltf.json_fields import SEQUENCE_EXTENSION, Fields
from mixseq_io.memory import check_memory
from mixseq_io.reader import reading


def is_glb(path: Path) -> bool:
    """Whether a file name is that of a binary glTF file."""
    return path.suffix.lower() == ".glb"


def has_sequence(path: Path) -> bool:
    """Whether a .glb has a mesh sequence."""
    with reading(path, "glTF"):
        data = data_of_file(path)
        if data.read(0, 4) != b"glTF":
            return False  # the error is reported by its reader
        text, _ = chunks(path, data)
    if f'"{SEQUENCE_EXTENSION}"'.encode() not in text:  # most files are known by that, without being parsed
        return False
    return next(_sequences(load_document(path)), None) is not None


def read_container(path: Path) -> Container:
    """Read the text and streams of a .glb's mesh sequence."""
    document = load_document(path)
    extension = _only_one(document)
    return Container(
        text=_content(document, extension, "coding"),
        streams=_content(document, extension, "streams"),
        version=extension.integer("version"),
    )


def other_data(path: Path) -> int:
    """Return the size in bytes of a .glb without text and streams: a still, and images."""
    document = load_document(path)
    extension = _only_one(document)
    own = {extension.index(name) for name in ("coding", "streams")}
    views = document.items("bufferViews")
    return sum(view.integer("byteLength") for number, view in enumerate(views) if number not in own)


def _only_one(document: Document) -> Fields:
    found = list(_sequences(document))
    if not found:
        raise FormatError(f"{document.path} has no compressed model; make one with mixseq encode --max-error")
    if len(found) > 1:
        raise AmbiguousError(f"{document.path} has {len(found)} mesh sequences; files with one are read")
    return found[0]


def _sequences(document: Document) -> Iterator[Fields]:
    for mesh in document.items("meshes"):
        extensions = mesh.object("extensions")
        if SEQUENCE_EXTENSION in extensions:
            yield extensions.object(SEQUENCE_EXTENSION)


def _content(document: Document, extension: Fields, key: str) -> bytes:
    view = document.item("bufferViews", extension.integer(key))
    check_memory(document.path, view.integer("byteLength"), f"its {key}")
    with reading(document.path, "glTF"):
        return document.part(view)
