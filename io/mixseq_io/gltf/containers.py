"""Bytes of a glTF file in a .glb chunk, its JSON, or files beside it; files are read on demand.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html#glb-file-format-specification
"""

from __future__ import annotations

import base64
import binascii
import io
import os
import struct
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote

from mixseq.errors import FormatError
from mixseq_io.gltf.json_fields import Fields
from mixseq_io.reader import reading


class _File(io.FileIO):
    """File closed with its last reader; it stays the opened one if another file takes its name."""

    def __del__(self) -> None:
        self.close()


@dataclass(frozen=True, eq=False)
class Data:
    """Range of bytes in a file or in memory."""

    source: _File | bytes
    start: int
    size: int

    def part(self, start: int, size: int) -> Data:
        """Return a range within this one."""
        return Data(self.source, self.start + start, size)

    def read(self, start: int, size: int) -> bytes:
        """Return `size` bytes, fewer only at the end; raise `FormatError` if the file was cut since it was opened."""
        size = max(0, min(size, self.size - start))
        at = self.start + start
        if isinstance(self.source, bytes):
            return self.source[at : at + size]
        self.source.seek(at)
        parts = []
        while size:
            part = self.source.read(size)
            if not part:
                raise FormatError(
                    f"{self.source.name} ends in the middle; was it written anew while it was read?"
                )
            parts.append(part)
            size -= len(part)
        return b"".join(parts)


def data_of_file(path: Path) -> Data:
    """Return the bytes of a file."""
    file = _File(path)
    return Data(file, 0, os.fstat(file.fileno()).st_size)


def data_in_memory(content: bytes) -> Data:
    """Return bytes held in memory."""
    return Data(content, 0, len(content))


def chunks(path: Path, data: Data) -> tuple[bytes, Data | None]:
    """Return the JSON and the binary chunk of a .glb."""
    if data.size < 20:
        raise FormatError(f"{path} has {data.size} bytes, too few for a .glb; it is truncated")
    version, length = struct.unpack("<II", data.read(4, 8))
    if version != 2:
        raise FormatError(f"{path} is a .glb of version {version}; version 2 is read, convert it first")
    if length > data.size:
        raise FormatError(f"{path} has {data.size} bytes of {length}; it is truncated")
    found: list[tuple[bytes, Data]] = []
    offset = 12
    while offset + 8 <= length and len(found) < 2:
        size, kind = struct.unpack("<I4s", data.read(offset, 8))
        if offset + 8 + size > length:
            raise FormatError(f"{path}: a chunk of {size} bytes goes beyond the end; the file is damaged")
        found.append((kind, data.part(offset + 8, size)))
        offset += 8 + size
    if not found or found[0][0] != b"JSON":
        raise FormatError(f"{path} has no JSON where a .glb begins; it is damaged")
    text = found[0][1]
    return text.read(0, text.size), found[1][1] if len(found) > 1 and found[1][0] == b"BIN\0" else None


def data_of_uri(buffer: Fields, uri: str) -> Data:
    """Return the bytes of a data URI or of a file beside the document."""
    if uri.startswith("data:"):
        header, _, data = uri.partition(",")
        if not header.endswith(";base64"):
            raise buffer.error("is a data URI without base64; it is damaged")
        try:
            return data_in_memory(base64.b64decode(data, validate=True))
        except (binascii.Error, ValueError):
            raise buffer.error("is a data URI that is not base64; it is damaged") from None
    name, folder = unquote(uri), buffer.file.parent.resolve()
    # No scheme, drive or root, and not even a link out of the folder.
    if ":" in name or "\\" in name or "\0" in name or name.startswith("/") or ".." in name.split("/"):
        raise buffer.error(f"is in {name[:80]!r}; only files in the folder of the glTF file are read")
    with reading(folder / name, "the buffer of a glTF file"):
        file = (folder / name).resolve()
        if not file.is_relative_to(folder):
            raise buffer.error(
                f"is in {name[:80]!r}, a link; only files in the folder of the glTF file are read"
            )
        if not file.is_file():
            raise buffer.error(
                f"is in {name[:80]!r}, which is not a file beside {buffer.file.name}; put it there"
            )
        return data_of_file(file)
