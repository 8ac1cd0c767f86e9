"""Taking out of a glTF document what nothing refers to any more: meshes, skins, accessors, buffer views."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mixseq_io.blocks import warn
from mixseq_io.choosing import listed
from mixseq_io.gltf.buffers import Json

_DRACO = "KHR_draco_mesh_compression"
_PRUNED = ("meshes", "skins", "accessors", "bufferViews")  # what refers before what is referred to

# Extensions that refer to none of these, or as is known here. (meshopt refers to buffers.)
_HARMLESS = (
    _DRACO,
    "KHR_node_",
    "KHR_materials_",
    "KHR_texture_",
    "EXT_texture_",
    "KHR_lights_",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "KHR_xmp",
)


def prune(path: Path, document: Json) -> None:
    """Take unused meshes, skins, accessors and buffer views out of a document, and renumber the others.

    Parameters
    ----------
    path : Path
        The file that it comes from, for messages.
    document : dict
        The document; it is changed, unless it has extensions that may refer to these in ways of their own.

    Warns
    -----
    MixseqWarning
        If it has such extensions.
    """
    unknown = sorted(name for name in used_extensions(document) if not name.startswith(_HARMLESS))
    if unknown:
        warn(
            f"{path}: the data of its old animation is kept, too, because {listed(unknown)} may refer to it; "
            "flatten=True writes the sequence without"
        )
        return
    for kind in _PRUNED:
        _prune(document, kind)


def used_extensions(document: Json) -> set[str]:
    """Return the extensions that have objects anywhere in a document, declared or not."""
    found: set[str] = set()
    waiting: list[Any] = [document]
    while waiting:
        each = waiting.pop()
        if isinstance(each, dict):
            extensions = each.get("extensions")
            found |= set(extensions) if isinstance(extensions, dict) else set()
            waiting += each.values()
        elif isinstance(each, list):
            waiting += each
    return found


def _prune(document: Json, kind: str) -> None:
    references = [(owner, key) for owner, key, of in _references(document) if of == kind]
    used = sorted({owner[key] for owner, key in references})
    renumbered = {old: new for new, old in enumerate(used)}
    for owner, key in references:
        owner[key] = renumbered[owner[key]]
    entries = [document[kind][old] for old in used]
    document.pop(kind, None)  # empty lists are not allowed
    if entries:
        document[kind] = entries


def _references(document: Json) -> Iterator[tuple[Json, str, str]]:
    """Yield every reference: the object and the member it is in, and what it refers to."""
    for node in document.get("nodes", ()):
        yield from _members(node, {"mesh": "meshes", "skin": "skins"})
    for mesh in document.get("meshes", ()):
        for primitive in mesh["primitives"]:
            yield from _members(primitive, {"indices": "accessors"})
            compressed = primitive.get("extensions", {}).get(_DRACO, {})
            yield from _members(compressed, {"bufferView": "bufferViews"})
            for attributes in (primitive["attributes"], *primitive.get("targets", ())):
                yield from _members(attributes, dict.fromkeys(attributes, "accessors"))
    for skin in document.get("skins", ()):
        yield from _members(skin, {"inverseBindMatrices": "accessors"})
    for accessor in document.get("accessors", ()):
        sparse = accessor.get("sparse", {})
        for owner in (accessor, sparse.get("indices", {}), sparse.get("values", {})):
            yield from _members(owner, {"bufferView": "bufferViews"})
    for image in document.get("images", ()):
        yield from _members(image, {"bufferView": "bufferViews"})


def _members(owner: Json, kinds: dict[str, str]) -> Iterator[tuple[Json, str, str]]:
    for key, kind in kinds.items():
        if key in owner:
            yield owner, key, kind
