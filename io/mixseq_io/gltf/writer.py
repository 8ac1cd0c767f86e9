"""Writer of glTF files with frames as morph targets, in a new document or in a copy of the original.

A copy keeps all contents outside the sequence. Meshes of the sequence get world-space positions, and new normals if
they had normals; skins, morph targets and tangents are removed. Primitives and vertex order stay. The nodes of these
meshes get the inverse of their parents' transform. If a parent is animated or shears, the node becomes the first root
of the scene, or several such nodes get a common root; former children stay in place. The sequence replaces all
animations. If the file has a single one, that of other nodes (cameras, lights, other meshes) is kept with its times,
resampled at the frames, so that both have equal durations. Unreferenced data are removed: rewriting grows no file.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence, Set
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.errors import FormatError
from mixseq.mesh.measures import NO_ORIGIN
from mixseq.mesh.polygons import Polygons
from mixseq.sequence.header import SequenceHeader
from mixseq.types import Float, FloatArray, Index
from mixseq_io.gltf.animation import Channel, read_channels, read_extra_number
from mixseq_io.gltf.buffers import (
    ELEMENT_ARRAY_BUFFER,
    GENERATOR_NAME,
    Json,
    Layout,
    add_channels,
    append,
    open_buffer_writer,
)
from mixseq_io.gltf.codecs import load_plain_document
from mixseq_io.gltf.document import MALFORMED_JSON_ERRORS, Document, Fields, collect_extensions, read_uri
from mixseq_io.gltf.new_document import (
    MorphFrameWriter,
    MovingMesh,
    MovingPrimitive,
    add_frame_animation,
    add_vertex_numbers,
    assign_face_sets,
    choose_start,
    create_scene,
    group_nodes,
    has_own_primitive,
    material_name,
    node_transform,
)
from mixseq_io.gltf.primitives import TRIANGLES_MODE, Primitive, Weld, weld_vertices
from mixseq_io.gltf.scene import WORLD_SPACE_MARK, Scene, invert_transform, read_scene
from mixseq_io.reader import translate_read_errors, validate_blocks, warn
from mixseq_io.scene_meshes import (
    SceneMesh,
    describe_difference_up_to_winding,
    format_names,
    match_meshes,
    open_original_file,
    split_meshes,
    warn_of_unretimed_motion,
)
from mixseq_io.surfaces import RoundingMonitor, lost_colours, lost_subdivision, warn_of_losses

_MAX_BROWSER_FRAMES = 1000
"""Usual limit of morph targets in WebGL: 1024 or 4096 uniforms for weights, 2048 texture layers for targets."""

_REPLACED_ATTRIBUTES = ("POSITION", "NORMAL", "TANGENT", "JOINTS_", "WEIGHTS_", "_VERTEX")


@dataclass(frozen=True, eq=False)
class MeshMatch:
    """Mesh of the sequence, and the node of the matching mesh in the file."""

    scene_mesh: SceneMesh
    node: int
    weld: Weld
    mirrored: bool  # whether triangles of the file are reversed
    corners: Index  # (C,) the sequence's corner of each corner in the file


def find_matches(scene: Scene, header: SequenceHeader) -> list[MeshMatch]:
    """Match the meshes of a sequence to a file by path, else by triangles if only one mesh in the file fits."""
    meshes = {path: node for node, path in scene.paths.items() if "mesh" in scene.nodes[node]}

    @cache
    def weld(node: int) -> Weld:
        return weld_vertices(scene.document, scene.nodes[node].integer("mesh"))

    return match_meshes(
        scene.document.path,
        header,
        meshes,
        lambda scene_mesh, node: _match(scene_mesh, node, weld(node)),
        lambda scene_mesh, node: _describe_difference(scene_mesh, weld(node)),
    )


def _match(scene_mesh: SceneMesh, node: int, weld: Weld) -> MeshMatch | None:
    """Match a mesh of the sequence with a node's mesh; return None if vertices or triangles differ."""
    has_vertices = weld.primitives and all(map(len, weld.vertex_ids))
    same_count = weld.vertex_count == scene_mesh.vertex_count
    if not (has_vertices and same_count and scene_mesh.polygons.only_triangles):
        return None
    for mirrored in (False, True):
        found = scene_mesh.match(Polygons.from_triangles(_orient(weld.triangles, mirrored)))
        if found is not None:
            renumbered, match = found
            return MeshMatch(renumbered, node, weld, mirrored, match.corners)
    return None


def _describe_difference(scene_mesh: SceneMesh, weld: Weld) -> str:
    if weld.vertex_count != scene_mesh.vertex_count or not weld.primitives:
        return f"it has {weld.vertex_count} vertices, the sequence {scene_mesh.vertex_count}"
    return describe_difference_up_to_winding(scene_mesh.polygons, Polygons.from_triangles(weld.triangles), "the file")


def _orient(triangles: NDArray[Any], mirrored: bool) -> NDArray[Any]:
    return triangles[:, [0, 2, 1]] if mirrored else triangles


def overlay_sequence(
    document: Document, header: SequenceHeader, origin: Float = NO_ORIGIN, sources: ArrayLike | None = None
) -> tuple[Layout, list[MovingMesh], OtherMotion]:
    """Return a copy of a document with its data, the meshes to write relative to an origin, and the other animation."""
    scene = read_scene(document)
    matches = find_matches(scene, header)
    nodes = [match.node for match in matches]
    copied = deepcopy(document.json)
    others = read_other_motion(scene, nodes)
    others.warn_if_unretimed(document.path, header, sources)
    _remove_animations(copied, scene, nodes)
    meshes = [_add_mesh(copied, document, match) for match in matches]
    roots = {scene.lineage(node)[-1] for node in nodes}
    scenes = [each for each in copied.get("scenes", ()) if roots.intersection(each.get("nodes", ()))]
    parents = {scene.parents[node] for node in nodes}
    animated = {channel.node for channel in others.channels}
    inverses = [None if node_transform(header) else _find_inverse(scene, node, animated, origin) for node in nodes]
    in_place = None not in inverses
    others = others.replace_nodes({node: detach_node(copied, node, in_place) for node in nodes})
    for node, inverse in zip(nodes, inverses, strict=True):
        _set_transform(copied["nodes"][node], inverse if in_place else None)
    if not in_place:
        root = group_nodes(copied, nodes, header, origin, find_unused_root(copied, scene, parents))
        for each in scenes:
            each["nodes"] = [root, *(node for node in each.get("nodes", ()) if node != root)]
    copied["asset"]["generator"] = GENERATOR_NAME
    json.dumps(copied, allow_nan=False)  # raises an error for NaN early; readers accept NaN
    prune(document.path, copied)
    layout = _copy_buffers(copied, document)
    for match, mesh in zip(matches, meshes, strict=True):
        for primitive, moving in zip(match.weld.primitives, mesh.primitives, strict=True):
            add_vertex_numbers(layout, moving, match.weld.vertex_count)
            if match.mirrored:
                corners = _orient(primitive.triangles, mirrored=True).astype(np.uint32).reshape(-1)
                indices = layout.add_array(corners, target=ELEMENT_ARRAY_BUFFER)
                moving.entry.update(indices=indices, mode=TRIANGLES_MODE)
    return layout, meshes, others


def _find_inverse(scene: Scene, node: int, animated: Set[int], origin: Float) -> Json | None:
    """Return the transform of a node whose points are relative to an origin; None if hidden or without TRS inverse."""
    parent = scene.parents[node]
    if node in scene.hidden or not animated.isdisjoint(scene.lineage(parent)):
        return None
    if not isinstance(scene.nodes[node].values.get("extras", {}), dict):
        return None  # no member for the mark can be added
    from_world = np.eye(4)
    from_world[:3, 3] = -origin
    return invert_transform(from_world @ scene.world_matrices([parent], {})[parent][0])


def _set_transform(entry: Json, inverse: Json | None) -> None:
    """Add an inverse transform to a node and mark the node in its extras; None and {} add nothing."""
    extras = entry.pop("extras", {})
    if isinstance(extras, dict):
        mark = {WORLD_SPACE_MARK: True} if inverse else {}
        extras = {key: value for key, value in extras.items() if key != WORLD_SPACE_MARK} | mark
    entry.update(inverse or {})
    if extras != {}:
        entry["extras"] = extras


def _remove_animations(copied: Json, scene: Scene, nodes: Sequence[int]) -> None:
    """Remove all animations, with a warning if there are several."""
    animations = copied.pop("animations", [])
    if len(animations) < 2:
        return
    others = sorted(find_animated_nodes(scene) - {*nodes})
    names = [each.get("name") or f"animation {index}" for index, each in enumerate(animations)]
    static = format_names([scene.paths[node] for node in others])
    rest = f"; other objects that they moved will stand still: {static}" if others else ""
    warn(f"{scene.document.path}: the sequence takes the place of all its animations, {format_names(names)}{rest}")


def _add_mesh(copied: Json, document: Document, match: MeshMatch) -> MovingMesh:
    """Assign a node a new copy of its mesh, without data that depend on positions."""
    if match.weld.skipped:
        warn(f"{document.path}: points or lines in the mesh {match.scene_mesh.path!r} are left out")
    node = copied["nodes"][match.node]
    old = copied["meshes"][node["mesh"]]
    moving, corner = [], 0
    for primitive, vertex_ids in zip(match.weld.primitives, match.weld.vertex_ids, strict=True):
        entry = deepcopy(old["primitives"][primitive.index])
        corners = slice(corner, corner + primitive.triangles.size)
        normal_ids = _normal_ids(match, primitive, corners) if "NORMAL" in entry["attributes"] else None
        if match.mirrored:
            entry.pop("indices", None)
        moving.append(MovingPrimitive(_remove_positions(entry), vertex_ids, normal_ids))
        corner = corners.stop
    mesh = {key: value for key, value in old.items() if key != "weights"}
    mesh["primitives"] = [each.entry for each in moving]
    if isinstance(mesh.get("extras"), dict):
        mesh["extras"] = {key: value for key, value in mesh["extras"].items() if key != "targetNames"}
    node["mesh"] = append(copied, "meshes", mesh)
    return MovingMesh(match.node, match.scene_mesh, moving)


def _normal_ids(match: MeshMatch, primitive: Primitive, corners: slice) -> NDArray[np.int32]:
    """Return the index of the shared normal of every vertex ``(n,)`` of a primitive."""
    normal_ids = np.zeros(len(primitive.positions), dtype=np.int32)
    vertex_ids = _orient(primitive.triangles, match.mirrored).reshape(-1)
    normal_ids[vertex_ids] = match.scene_mesh.normal_groups[match.corners[corners]]
    return normal_ids


def _remove_positions(entry: Json) -> Json:
    """Return a primitive without morph targets and without the attributes that the writer replaces."""
    attributes = entry["attributes"].items()
    kept = {name: accessor for name, accessor in attributes if not name.startswith(_REPLACED_ATTRIBUTES)}
    return {key: value for key, value in entry.items() if key != "targets"} | {"attributes": kept}


def _copy_buffers(copied: Json, document: Document) -> Layout:
    """Return a layout of the copied document, with all buffer views and images in one buffer."""
    views = copied.pop("bufferViews", [])
    layout = Layout(copied)
    for index, view in enumerate(views):
        data = document.read_view(Fields(document.path, f"bufferViews[{index}]", view))
        for key in ("buffer", "byteOffset", "byteLength"):
            view.pop(key, None)
        layout.add([data], len(data), **view)
    for entry, image in zip(copied.get("images", ()), document.top.objects("images"), strict=True):
        if not image.text("uri", "data:").startswith("data:"):
            embed_image(layout, entry, image)
    return layout


_PRUNED_LISTS = ("meshes", "accessors", "bufferViews")  # each list refers to the next

_PRUNABLE_PREFIXES = ("KHR_node_", "KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "KHR_xmp")
"""Prefixes of extensions whose references to the pruned lists, if any, are in `iterate_references`."""


def prune(path: Path, document: Json) -> None:
    """Remove unused meshes, accessors and views, and renumber others; unused skins keep joints, which mark bones."""
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
    """Remove a node with a mesh, or only its transform if `in_place`; return the node that takes its other contents."""
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


def write_gltf(
    path: Path,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None = None,
    flatten: bool = False,
    onto: str | os.PathLike[str] | None = None,
    keep_start: bool = False,
    sources: ArrayLike | None = None,
    rounding: RoundingMonitor | None = None,
) -> None:
    """Write a glTF file without velocities; options as in `FORMATS`, `sources` ``(T,)`` in s."""
    rounding = rounding or RoundingMonitor(path, "glTF", header)
    origin = rounding.origin

    def load_original(file: Path) -> tuple[Layout, list[MovingMesh], OtherMotion]:
        with translate_read_errors(file, "glTF", *MALFORMED_JSON_ERRORS):
            return overlay_sequence(load_plain_document(file), header, origin, sources)

    overlay = open_original_file(path, header, flatten, onto, "glTF", load_original)
    layout, meshes, others = overlay or (*create_scene(header, origin), NO_OTHER_MOTION)
    lost = [] if overlay else standalone_losses(header)
    warn_of_changes(path, header, [*(["velocities"] if velocities is not None else []), *lost], keep_start)
    if header.frame_count > _MAX_BROWSER_FRAMES:
        warn(
            f"{path}: each of the {header.frame_count} frames is a morph target, of which browsers usually show about "
            f"{_MAX_BROWSER_FRAMES} at most; resample the sequence for them"
        )
    if animation := add_frame_animation(layout, meshes, header, keep_start):
        others.add_to(animation, layout, header)
    morphs = MorphFrameWriter(layout, meshes, header)
    _, numbered = validate_blocks(header, blocks, velocities)
    with open_buffer_writer(path, layout) as writer:
        for first, block, _ in numbered:
            # Frames are written one by one, since a block may be the whole sequence.
            for frame, points in enumerate(block, start=first):
                written = morphs.write(frame, points - origin if origin.any() else points, writer)
                rounding.measure(frame, points, written + origin)


def standalone_losses(header: SequenceHeader) -> list[str]:
    """Describe the contents of a sequence that a new document cannot hold."""
    lost = []
    if not header.polygons.only_triangles:
        lost.append("polygons other than triangles (they are cut)")
    lost += lost_colours(header)
    subdivision = lost_subdivision(header.surface)
    if subdivision:
        lost.append(subdivision)
    meshes = split_meshes(header)
    if any(_has_overlaps(mesh) for mesh in meshes):
        lost.append("face sets that overlap")
    if any(face_set.name != material_name(face_set) for mesh in meshes for face_set in mesh.face_sets):
        lost.append("names of face sets other than their materials'")
    empty = [mesh.name for mesh in meshes if not mesh.polygons.counts.size]
    if empty:
        lost.append(f"objects without polygons ({', '.join(map(repr, empty[:20]))})")
    return lost


def warn_of_changes(path: Path, header: SequenceHeader, lost: Sequence[str], keep_start: bool = False) -> None:
    """Warn of lost contents, and of axes, units or times that differ from the sequence in the file."""
    warn_of_losses(path, "glTF files", lost)
    if node_transform(header):
        warn(
            f"{path}: glTF is in metres with Y up; the points stay as they are, in {header.metres_per_unit:g} metres "
            f"per unit with {header.up_axis} up, under a node that turns and scales them; convert_units "
            "(--convert-axes Y, --convert-units m) turns and scales the points"
        )
    start = choose_start(header, keep_start)
    if start and (keep_start or header.frame_count == 1):  # otherwise the start is stored in the file
        warn(f"{path}: glTF's times begin at 0; all times are moved by {-start:g} s")


def _has_overlaps(mesh: SceneMesh) -> bool:
    owner = assign_face_sets(mesh)
    return any(
        (owner[face_set.polygons] != index).any()
        for index, face_set in enumerate(mesh.face_sets)
        if has_own_primitive(face_set, mesh)
    )
