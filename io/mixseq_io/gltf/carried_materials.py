"""Materials of a glTF file in another document: by name, with their textures, samplers and images."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from copy import deepcopy
from pathlib import Path

from mixseq.errors import FormatError
from mixseq.surface import Origin
from mixseq_io.blocks import warn
from mixseq_io.gltf.buffers import Json, Layout, append
from mixseq_io.gltf.document import Document, load_document
from mixseq_io.gltf.document_edits import content_of_image
from mixseq_io.gltf.json_fields import Fields
from mixseq_io.reader import reading

_DAMAGE = (KeyError, IndexError, TypeError, ValueError, AttributeError, RecursionError)


def carried_materials(layout: Layout, names: Collection[str], origin: Origin | None) -> dict[str, int]:
    """Copy materials into a document."""
    if origin is None or origin.format != "glTF" or not names:
        return {}
    path = Path(origin.path)
    try:
        with reading(path, "glTF", *_DAMAGE):
            copy = _Copy(layout, load_document(path))
            return copy.materials(names)
    except FormatError as error:
        warn(f"{error}; materials are plain, with the names that they had")
        return {}


class _Copy:
    """Copier between two documents that copies each entry once."""

    def __init__(self, layout: Layout, original: Document) -> None:
        self._layout, self._original = layout, original
        self._copied: dict[tuple[str, int], int] = {}

    def materials(self, names: Collection[str]) -> dict[str, int]:
        """Copy the first material of each name."""
        found: dict[str, int] = {}
        for number, each in enumerate(self._original.items("materials")):
            name = each.text("name") or f"material {number}"
            if name in names and name not in found:
                found[name] = self._entry("materials", number)
        return found

    def _entry(self, kind: str, number: int) -> int:
        """Copy an entry of a list and all it refers to; return its new index."""
        if (kind, number) not in self._copied:
            original = self._original.top.objects(kind)[number]
            entry = deepcopy(dict(original.values))
            if kind == "images":
                self._embed(entry, original)
            for owner, key, of in _references(kind, entry):
                owner[key] = self._entry(of, Fields(original.file, original.place, owner).integer(key))
            self._copied[kind, number] = append(self._layout.document, kind, entry)
        return self._copied[kind, number]

    def _embed(self, entry: Json, image: Fields) -> None:
        if "bufferView" in image:
            content = self._original.part(self._original.item("bufferViews", image.integer("bufferView")))
        else:
            try:
                content, entry["mimeType"] = content_of_image(image)
            except FormatError as error:
                warn(f"{error}; the image is not taken along, only the reference to it")
                return
        entry.pop("uri", None)
        entry["bufferView"] = self._layout.add([content], len(content))


def _references(kind: str, entry: Json) -> Iterator[tuple[Json, str, str]]:
    """Yield each reference of a material or texture: its object, its member and the kind of entry it refers to."""
    if kind == "textures":
        for owner in (entry, *entry.get("extensions", {}).values()):
            if "source" in owner:
                yield owner, "source", "images"
        if "sampler" in entry:
            yield entry, "sampler", "samplers"
    elif kind == "materials":
        waiting = [entry]
        while waiting:
            each = waiting.pop()
            for key, value in each.items():
                if isinstance(value, dict):
                    waiting.append(value)
                    if key.endswith("Texture") and "index" in value:
                        yield value, "index", "textures"
