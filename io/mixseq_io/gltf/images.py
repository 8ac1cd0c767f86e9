"""Taking the images that lie beside a glTF file along, since what is written may lie elsewhere."""

from __future__ import annotations

from mixseq.errors import FormatError
from mixseq_io.blocks import warn
from mixseq_io.gltf.buffers import Layout
from mixseq_io.gltf.containers import data_of_uri
from mixseq_io.gltf.data import Data
from mixseq_io.gltf.document import Document

_BEGINNINGS = {
    b"\x89PNG\r\n": "image/png",
    b"\xff\xd8\xff": "image/jpeg",
    b"RIFF": "image/webp",
    b"\xabKTX 20": "image/ktx2",
}


def embed_images(layout: Layout, document: Document) -> None:
    """Put the images of a document that are files into its buffer, byte for byte.

    Warns
    -----
    MixseqWarning
        If an image is missing, of an unknown type, or not in the folder of the file; the reference to it stays.
    """
    images = document.top.objects("images")
    for entry, image in zip(layout.document.get("images", ()), images, strict=True):
        uri = image.text("uri", "data:")
        if uri.startswith("data:"):
            continue
        try:
            data = _content(data_of_uri(image, uri))
            mime_type = _type_of(data)
            if not mime_type:
                raise image.error(f"is in {uri[:80]!r}, which is no PNG, JPEG, WebP or KTX2 image")
        except FormatError as error:
            warn(f"{error}; the image is not taken along, only the reference to it")
            continue
        del entry["uri"]
        entry.update(bufferView=layout.add([data], len(data)), mimeType=mime_type)


def _content(data: Data) -> bytes:
    return data.read(0, data.size)


def _type_of(data: bytes) -> str:
    return next((kind for beginning, kind in _BEGINNINGS.items() if data.startswith(beginning)), "")
