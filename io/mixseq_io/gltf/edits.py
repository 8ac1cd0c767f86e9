"""Edits of a glTF document that a sequence is laid over: detached nodes, pruned data, embedded images, other motion.

Other motion (cameras, lights, other meshes) keeps its own times, and gets keys at the frames of the sequence, so that
the animation lasts as long. The file must have a single animation, since with several the matching one is unknown.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import FormatError
from mixseq.sequence.header import SequenceHeader
from mixseq_io.gltf.animation import Channel, read_channels, told_by
from mixseq_io.gltf.codecs import Json, Layout, append
from mixseq_io.gltf.document import Document, Fields, read_uri
from mixseq_io.gltf.scene import Scene
from mixseq_io.originals import warn_of_unretimed_motion
from mixseq_io.reader import warn
from mixseq_io.scene_meshes import format_names

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
            f"{path}: the data of its old animation is kept, too, because {format_names(unknown)} may refer to it; "
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
    file = read_uri(image, uri)
    data = file.read(0, file.size)
    mime_type = next((kind for beginning, kind in _BEGINNINGS.items() if data.startswith(beginning)), "")
    if not mime_type:
        raise image.error(f"is in {uri[:80]!r}, which is no PNG, JPEG, WebP or KTX2 image")
    return data, mime_type


_SEEN = ("mesh", "camera", "extensions")


@dataclass(frozen=True, eq=False)
class OtherMotion:
    """Channels of a file that go on beside the sequence."""

    things: Sequence[str] = ()
    channels: Sequence[Channel] = ()
    start: float = 0.0

    def instead(self, stand_ins: Mapping[int, int | None]) -> OtherMotion:
        """Replace animated nodes by others, without their morph weights; None drops their channels."""
        channels = []
        for channel in self.channels:
            node = stand_ins.get(channel.node, channel.node)
            if node is not None and not (channel.node in stand_ins and channel.name == "weights"):
                channels.append(replace(channel, node=node))
        return replace(self, channels=channels)

    def animate(self, layout: Layout, animation: Json, header: SequenceHeader) -> None:
        """Add the channels to the sequence's animation, whose first sampler has a key at every frame."""
        keys = animation["samplers"][0]["input"]
        for channel in self.channels:
            values = channel.at(header.times - self.start)
            if channel.name == "rotation":
                values /= np.linalg.norm(values, axis=1, keepdims=True)
            if channel.name == "weights":
                values = values.reshape(-1)
            sampler = {
                "input": keys,
                "output": layout.add_array(values.astype(np.float32)),
                "interpolation": "STEP" if channel.interpolation == "STEP" else "LINEAR",
            }
            target = {"node": channel.node, "path": channel.name}
            animation["channels"].append({"sampler": len(animation["samplers"]), "target": target})
            animation["samplers"].append(sampler)

    def warn_of_times(self, path: Path, header: SequenceHeader, sources: ArrayLike | None) -> None:
        """Warn of other motion if the sequence shows other times, or the motion outlasts it by more than a frame."""
        ends = [channel.times[[0, -1]] + self.start for channel in self.channels if channel.moves]
        if ends:
            span = float(np.min(ends)), float(np.max(ends))
            warn_of_unretimed_motion(path, header, dict.fromkeys(self.things, span), sources)


NOTHING = OtherMotion()


def other_motion(document: Document, scene: Scene, taken: Collection[int]) -> OtherMotion:
    """Return the other motion of a file with one animation, given the nodes `taken` by the sequence."""
    animations = document.items("animations")
    if len(animations) != 1:
        return NOTHING
    moved = moved_by_animations(document.json, document.json["animations"], scene) - {*taken}
    bearers = [bearer for node in moved for bearer in _bearers(document.json, node)]
    channels = read_channels(document, animations[0], scene.with_ancestors(bearers))
    return OtherMotion(
        [scene.paths[node] for node in sorted(moved)], channels, told_by(animations[0], "start") or 0.0
    )


def moved_by_animations(document: Json, animations: Sequence[Json], scene: Scene) -> set[int]:
    """Return the nodes with visible contents that animations move: meshes, cameras, lights."""
    targets = {channel["target"].get("node") for each in animations for channel in each["channels"]}
    return {
        node
        for node in scene.paths
        if any(key in document["nodes"][node] for key in _SEEN)
        and any(not targets.isdisjoint(scene.lineage(bearer)) for bearer in _bearers(document, node))
    }


def _bearers(document: Json, node: int) -> list[int]:
    """Return a node and its skin's joints."""
    entry = document["nodes"][node]
    return [node, *(document["skins"][entry["skin"]]["joints"] if "skin" in entry else ())]
