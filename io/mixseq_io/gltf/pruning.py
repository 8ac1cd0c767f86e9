"""Taking out of a glTF document what nothing refers to any more: meshes, skins, accessors, buffer views."""

from __future__ import annotations

from collections.abc import Iterator

from mixseq_io.gltf.buffers import Json

_PRUNED = ("meshes", "skins", "accessors", "bufferViews")  # what refers before what is referred to

# Extensions that refer to none of these.
_HARMLESS = (
    "KHR_materials_",
    "KHR_texture_",
    "EXT_texture_",
    "KHR_lights_",
    "KHR_mesh_quantization",
    "KHR_xmp",
)


def prune(document: Json) -> Json:
    """Return a document without unused meshes, skins, accessors and buffer views, with the others renumbered.

    A document with extensions that may refer to them in ways of their own is returned as it is.

    Parameters
    ----------
    document : dict
        A document; it is changed.
    """
    if all(name.startswith(_HARMLESS) for name in document.get("extensionsUsed", ())):
        for kind in _PRUNED:
            _prune(document, kind)
    return document


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
