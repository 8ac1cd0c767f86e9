"""Edits of a glTF document that is written again: detach nodes, remove unused data, embed images."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

from mixseq.errors import FormatError
from mixseq_io.blocks import warn
from mixseq_io.choosing import listed
from mixseq_io.gltf.buffers import Json, Layout, append
from mixseq_io.gltf.containers import data_of_uri
from mixseq_io.gltf.document import Document
from mixseq_io.gltf.json_fields import Fields
from mixseq_io.gltf.node_tree import Scene

_PRUNED = ("meshes", "accessors", "bufferViews")  # referrers before their targets

# Extensions that refer to none of these, or as is known here.
_HARMLESS = (
    "KHR_node_",
    "KHR_materials_",
    "KHR_texture_",
    "EXT_texture_",
    "KHR_lights_",
    "KHR_xmp",
)


def prune(path: Path, document: Json) -> None:
    """Remove unused meshes, accessors and buffer views from a document, and renumber the others.

    Unused skins stay without matrices: programs such as Blender use them to recognise bones.
    """
    unknown = sorted(name for name in used_extensions(document) if not name.startswith(_HARMLESS))
    if unknown:
        warn(
            f"{path}: the data of its old animation is kept, too, because {listed(unknown)} may refer to it; "
            "flatten=True writes the sequence without"
        )
        return
    bound = {node.get("skin") for node in document.get("nodes", ())}
    for number, skin in enumerate(document.get("skins", ())):
        if number not in bound:
            for key in (
                "inverseBindMatrices",
                "skeleton",
            ):  # the second may be wrong where meshes have left their place
                skin.pop(key, None)
    for kind in _PRUNED:
        _prune(document, kind)


def used_extensions(document: Json) -> set[str]:
    """Return the extensions used by objects of a document, declared or not."""
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
    """Yield each reference: its object, its member and the kind of entry it refers to."""
    for node in document.get("nodes", ()):
        yield from _members(node, {"mesh": "meshes"})
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


_OF_THE_MESH = ("name", "mesh", "extras")
_OF_THE_OLD_MESH = ("skin", "weights")
_WORTH_A_NODE = ("children", "camera", "extensions")
_OF_A_GROUP = {"name", "matrix", "translation", "rotation", "scale"}


def detach(document: Json, node: int, in_place: bool = False) -> int | None:
    """Take a node with a mesh out of the tree, without its transform; return the node left in its place, if any.

    A new node takes its place if it had children, a camera or a light, or was a joint.
    """
    entry = document["nodes"][node]
    rest = {key: entry.pop(key) for key in list(entry) if key not in _OF_THE_MESH}
    stays = {key: value for key, value in rest.items() if key not in _OF_THE_OLD_MESH}
    skins = [
        skin for skin in document.get("skins", ()) if node in skin["joints"] or node == skin.get("skeleton")
    ]
    place: list[int] = []
    if skins or any(key in stays for key in _WORTH_A_NODE):
        name = {"name": entry["name"]} if "name" in entry else {}
        place = [append(document, "nodes", {**name, **stays})]
    here = [node, *place] if in_place else place
    for each in document["nodes"]:
        _replace(each, "children", node, here)
    for each in document.get("scenes", ()):
        _replace(each, "nodes", node, here)
    for skin in skins:
        skin["joints"] = [place[0] if joint == node else joint for joint in skin["joints"]]
        if skin.get("skeleton") == node:
            skin["skeleton"] = place[0]
    return place[0] if place else None


def vacant(document: Json, scene: Scene, above: Collection[int]) -> int | None:
    """Return the former root of all detached nodes if it is now unused, such as that of `group`, else None."""
    if len(above) != 1 or min(above) < 0 or scene.parents[min(above)] >= 0:
        return None
    (node,) = above
    joints = {
        joint for skin in document.get("skins", ()) for joint in (*skin["joints"], skin.get("skeleton"))
    }
    return node if node not in joints and set(document["nodes"][node]) <= _OF_A_GROUP else None


def _replace(owner: Json, key: str, node: int, place: Sequence[int]) -> None:
    """Replace a node in a list of nodes by others; an empty list is removed where glTF forbids it."""
    if node in owner.get(key, ()):
        owner[key] = [new for old in owner[key] for new in (place if old == node else [old])]
        if not owner[key]:
            del owner[key]


_BEGINNINGS = {
    b"\x89PNG\r\n": "image/png",
    b"\xff\xd8\xff": "image/jpeg",
    b"RIFF": "image/webp",
    b"\xabKTX 20": "image/ktx2",
}


def embed_images(layout: Layout, document: Document) -> None:
    """Move images from files into the document's buffer, byte for byte."""
    images = document.top.objects("images")
    for entry, image in zip(layout.document.get("images", ()), images, strict=True):
        uri = image.text("uri", "data:")
        if uri.startswith("data:"):
            continue
        try:
            data, mime_type = content_of_image(image)
        except FormatError as error:
            warn(f"{error}; the image is not taken along, only the reference to it")
            continue
        del entry["uri"]
        entry.update(bufferView=layout.add([data], len(data)), mimeType=mime_type)


def content_of_image(image: Fields) -> tuple[bytes, str]:
    """Return the bytes that an image's URI refers to, and their MIME type."""
    uri = image.text("uri")
    file = data_of_uri(image, uri)
    data = file.read(0, file.size)
    mime_type = _type_of(data)
    if not mime_type:
        raise image.error(f"is in {uri[:80]!r}, which is no PNG, JPEG, WebP or KTX2 image")
    return data, mime_type


def _type_of(data: bytes) -> str:
    return next((kind for beginning, kind in _BEGINNINGS.items() if data.startswith(beginning)), "")
