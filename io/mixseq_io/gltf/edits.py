"""Edits of the original glTF document that a sequence is written into: nodes, unused data, images, other animation.

The animation of nodes outside the sequence (cameras, lights, other meshes) keeps its times. It is resampled at the
frames of the sequence, so that both have equal durations. It is kept only if the file has a single animation.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import FormatError
from mixseq.sequence.header import SequenceHeader
from mixseq_io.gltf.animation import Channel, read_channels, read_extra_number
from mixseq_io.gltf.codecs import Json, Layout, add_channels, append
from mixseq_io.gltf.document import Fields, collect_extensions, read_uri
from mixseq_io.gltf.scene import Scene
from mixseq_io.originals import warn_of_unretimed_motion
from mixseq_io.reader import warn
from mixseq_io.scene_meshes import format_names

_PRUNED_LISTS = ("meshes", "accessors", "bufferViews")  # each list refers to the next

_PRUNABLE_PREFIXES = ("KHR_node_", "KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "KHR_xmp")
"""Prefixes of extensions whose references to the pruned lists, if any, are in `iterate_references`."""


def prune(path: Path, document: Json) -> None:
    """Remove unused meshes, accessors and buffer views from a document, and renumber the remaining ones.

    Unused skins keep their joints, since programs such as Blender recognise bones by them.
    """
    unknown = sorted(name for name in collect_extensions(document) if not name.startswith(_PRUNABLE_PREFIXES))
    if unknown:
        warn(
            f"{path}: the data of its old animation is kept, too, because {format_names(unknown)} may refer to it; "
            "flatten=True writes the sequence without"
        )
        return
    bound = {node.get("skin") for node in document.get("nodes", ())}
    for index, skin in enumerate(document.get("skins", ())):
        if index not in bound:
            skin.pop("inverseBindMatrices", None)
            skin.pop("skeleton", None)  # may be wrong after nodes have moved
    for kind in _PRUNED_LISTS:
        _prune_list(document, kind)


def _prune_list(document: Json, kind: str) -> None:
    references = [
        (owner, key)
        for list_name in ("nodes", "meshes", "skins", "accessors", "images")
        for entry in document.get(list_name, ())
        for owner, key, target in iterate_references(list_name, entry)
        if target == kind
    ]
    used = sorted({owner[key] for owner, key in references})
    new_indices = {old: new for new, old in enumerate(used)}
    for owner, key in references:
        owner[key] = new_indices[owner[key]]
    entries = [document[kind][old] for old in used]
    document.pop(kind, None)  # glTF forbids empty lists
    if entries:
        document[kind] = entries


def iterate_references(kind: str, entry: Json) -> Iterator[tuple[Json, str, str]]:
    """Yield the references of an entry of a list to meshes and materials, as owner, member and the other list."""
    references: list[tuple[Json, str, str]] = []
    if kind == "nodes":
        references = [(entry, "mesh", "meshes")]
    elif kind == "meshes":
        for primitive in entry["primitives"]:
            references.append((primitive, "indices", "accessors"))
            for attributes in (primitive["attributes"], *primitive.get("targets", ())):
                references += [(attributes, name, "accessors") for name in attributes]
    elif kind == "skins":
        references = [(entry, "inverseBindMatrices", "accessors")]
    elif kind == "accessors":
        sparse = entry.get("sparse", {})
        owners = (entry, sparse.get("indices", {}), sparse.get("values", {}))
        references = [(owner, "bufferView", "bufferViews") for owner in owners]
    elif kind == "images":
        references = [(entry, "bufferView", "bufferViews")]
    elif kind == "textures":
        references = [(owner, "source", "images") for owner in (entry, *entry.get("extensions", {}).values())]
        references.append((entry, "sampler", "samplers"))
    elif kind == "materials":
        stack = [entry]
        while stack:
            members = {key: value for key, value in stack.pop().items() if isinstance(value, dict)}
            references += [(value, "index", "textures") for key, value in members.items() if key.endswith("Texture")]
            stack += members.values()
    return ((owner, key, target) for owner, key, target in references if key in owner)


_KEPT_MEMBERS = ("name", "mesh", "extras")
_DEFORMATION_MEMBERS = ("skin", "weights")
_CONTENT_MEMBERS = ("children", "camera", "extensions")
_GROUP_MEMBERS = {"name", "matrix", "translation", "rotation", "scale"}


def detach_node(document: Json, node: int, in_place: bool = False) -> int | None:
    """Remove a node with a mesh from the tree, or only its transform if `in_place`; return its substitute, if any.

    A new node substitutes a node that has children, a camera or a light, or is a joint.
    """
    entry = document["nodes"][node]
    removed = {key: entry.pop(key) for key in list(entry) if key not in _KEPT_MEMBERS}
    contents = {key: value for key, value in removed.items() if key not in _DEFORMATION_MEMBERS}
    skins = [skin for skin in document.get("skins", ()) if node in (*skin["joints"], skin.get("skeleton"))]
    substitutes: list[int] = []
    if skins or any(key in contents for key in _CONTENT_MEMBERS):
        name = {"name": entry["name"]} if "name" in entry else {}
        substitutes = [append(document, "nodes", {**name, **contents})]
    replacement = [node, *substitutes] if in_place else substitutes
    for each in document["nodes"]:
        _replace_node(each, "children", node, replacement)
    for each in document.get("scenes", ()):
        _replace_node(each, "nodes", node, replacement)
    for skin in skins:
        skin["joints"] = [substitutes[0] if joint == node else joint for joint in skin["joints"]]
        if skin.get("skeleton") == node:
            skin["skeleton"] = substitutes[0]
    return substitutes[0] if substitutes else None


def find_unused_root(document: Json, scene: Scene, parents: Collection[int]) -> int | None:
    """Return the only former parent of detached nodes if it is an empty root, for `group_nodes`; else None."""
    if len(parents) != 1 or min(parents) < 0 or scene.parents[min(parents)] >= 0:
        return None
    (node,) = parents
    if any(node in (*skin["joints"], skin.get("skeleton")) for skin in document.get("skins", ())):
        return None
    return node if set(document["nodes"][node]) <= _GROUP_MEMBERS else None


def _replace_node(owner: Json, key: str, node: int, replacement: Sequence[int]) -> None:
    """Replace a node in an owner's list of nodes; remove the list if it becomes empty, since glTF forbids that."""
    if node in owner.get(key, ()):
        owner[key] = [new for old in owner[key] for new in (replacement if old == node else [old])]
        if not owner[key]:
            del owner[key]


_IMAGE_SIGNATURES = {
    b"\x89PNG\r\n": "image/png",
    b"\xff\xd8\xff": "image/jpeg",
    b"RIFF": "image/webp",
    b"\xabKTX 20": "image/ktx2",
}


def embed_image(layout: Layout, entry: Json, image: Fields) -> None:
    """Copy what an image's URI refers to into the document's buffer, byte for byte; warn if it cannot be read."""
    uri = image.text("uri")
    try:
        file = read_uri(image, uri)
        data = file.read(0, file.size)
        mime_type = next((kind for start, kind in _IMAGE_SIGNATURES.items() if data.startswith(start)), "")
        if not mime_type:
            raise image.error(f"is in {uri[:80]!r}, which is no PNG, JPEG, WebP or KTX2 image")
    except FormatError as error:
        warn(f"{error}; the image is not copied, only the reference to it")
        return
    del entry["uri"]
    entry.update(bufferView=layout.add([data], len(data)), mimeType=mime_type)


_VISIBLE_MEMBERS = ("mesh", "camera", "extensions")


@dataclass(frozen=True, eq=False)
class OtherMotion:
    """Animation of nodes outside the sequence: node paths, channels, and the time in s at key time 0."""

    paths: Sequence[str] = ()
    channels: Sequence[Channel] = ()
    start: float = 0.0

    def replace_nodes(self, substitutes: Mapping[int, int | None]) -> OtherMotion:
        """Return the animation for substitutes of nodes, without morph weights; the substitute None drops channels."""
        channels = []
        for channel in self.channels:
            node = substitutes.get(channel.node, channel.node)
            if node is not None and not (channel.node in substitutes and channel.name == "weights"):
                channels.append(replace(channel, node=node))
        return replace(self, channels=channels)

    def add_to(self, animation: Json, layout: Layout, header: SequenceHeader) -> None:
        """Add the channels, resampled at all frames, to the sequence's animation, whose first sampler has the times."""
        keys = animation["samplers"][0]["input"]
        for channel in self.channels:
            values = channel.evaluate(header.times - self.start)
            if channel.name == "rotation":
                values /= np.linalg.norm(values, axis=1, keepdims=True)
            if channel.name == "weights":
                values = values.reshape(-1)
            interpolation = "STEP" if channel.interpolation == "STEP" else "LINEAR"
            output = layout.add_array(values.astype(np.float32))
            add_channels(animation, keys, output, [channel.node], channel.name, interpolation)

    def warn_if_unretimed(self, path: Path, header: SequenceHeader, sources: ArrayLike | None) -> None:
        """Warn if the sequence is retimed, or extends beyond this animation by more than a frame."""
        ends = [channel.times[[0, -1]] + self.start for channel in self.channels if channel.is_animated]
        if ends:
            span = float(np.min(ends)), float(np.max(ends))
            warn_of_unretimed_motion(path, header, dict.fromkeys(self.paths, span), sources)


NO_OTHER_MOTION = OtherMotion()


def read_other_motion(scene: Scene, excluded: Collection[int]) -> OtherMotion:
    """Return the animation of nodes except `excluded` if the file has a single animation, else `NO_OTHER_MOTION`."""
    animations = scene.document.items("animations")
    if len(animations) != 1:
        return NO_OTHER_MOTION
    animated = find_animated_nodes(scene) - {*excluded}
    influencing = {each for node in animated for each in _influencing_nodes(scene, node)}
    channels = read_channels(scene.document, animations[0], influencing)
    paths = [scene.paths[node] for node in sorted(animated)]
    return OtherMotion(paths, channels, read_extra_number(animations[0], "start") or 0.0)


def find_animated_nodes(scene: Scene) -> set[int]:
    """Return the nodes with visible contents (meshes, cameras, lights) that any animation moves."""
    animations = scene.document.json.get("animations", ())
    targets = {channel["target"].get("node") for each in animations for channel in each["channels"]}
    return {
        node
        for node in scene.paths
        if any(key in scene.nodes[node] for key in _VISIBLE_MEMBERS)
        and not targets.isdisjoint(_influencing_nodes(scene, node))
    }


def _influencing_nodes(scene: Scene, node: int) -> set[int]:
    """Return a node, the nodes whose matrices move its mesh, and all ancestors of these nodes."""
    return scene.with_ancestors([node, *scene.transform_nodes(node)])
