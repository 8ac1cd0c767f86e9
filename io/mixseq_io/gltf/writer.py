"""glTF, writing: morph targets in a document of its own, or in that of the original, whose other contents are kept.

In the original's document, meshes of the sequence get new world-space positions, and new normals where they had some;
they lose skins, morph targets and tangents. Primitives and vertex order stay. Their nodes get the inverse transform of
their parents; where a parent moves or shears, they become a root of the scene, or several below one root, which comes
first. Former children keep their place. All animations are replaced by the sequence and by other motion of the file,
and unreferenced data are removed, so that repeated writing does not grow the file.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Sequence, Set
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.mesh.polygons import Polygons, difference
from mixseq.sequence.header import SequenceHeader
from mixseq.types import FloatArray, Index
from mixseq_io.files import atomic_file
from mixseq_io.gltf.codecs import (
    ELEMENT_ARRAY_BUFFER,
    GENERATOR_NAME,
    Json,
    Layout,
    append,
    decompress_document,
    open_buffer_writer,
)
from mixseq_io.gltf.document import MALFORMED_JSON_ERRORS, Document, Fields, load_document
from mixseq_io.gltf.edits import (
    NOTHING,
    OtherMotion,
    detach,
    embed_images,
    moved_by_animations,
    other_motion,
    prune,
    vacant,
)
from mixseq_io.gltf.new_document import (
    MorphFrameWriter,
    MovingMesh,
    MovingPrimitive,
    add_vertex_numbers,
    axis_conversion,
    create_scene,
    distinguishes,
    group,
    material_name,
    owners,
    time_shift,
)
from mixseq_io.gltf.primitives import Primitive, Weld, weld
from mixseq_io.gltf.scene import WORLD_SPACE_MARK, Scene, invert_transform, read_scene
from mixseq_io.originals import match_meshes, open_original_file
from mixseq_io.reader import as_float32, translate_read_errors, validate_blocks, warn
from mixseq_io.scene_meshes import SceneMesh, format_names, split_meshes
from mixseq_io.surfaces import lost_colours, lost_subdivision, warn_of_losses

_REPLACED = ("POSITION", "NORMAL", "TANGENT", "JOINTS_", "WEIGHTS_", "_VERTEX")
_TRIANGLES = 4


@dataclass(frozen=True, eq=False)
class Place:
    """Node and primitives of the file that a mesh of the sequence belongs to."""

    scene_mesh: SceneMesh
    node: int
    weld: Weld
    mirrored: bool
    corners: Index

    def triangles(self, primitive: Primitive) -> NDArray[np.int32]:
        """Return the triangles ``(F, 3)`` of a primitive in the sequence's order, by the primitive's vertices."""
        return _turned(primitive.triangles, self.mirrored)


def find_places(document: Document, scene: Scene, header: SequenceHeader) -> list[Place]:
    """Find the meshes of a sequence in a file: by path, else by triangles if a single mesh has the same."""
    meshes = {path: node for node, path in scene.paths.items() if scene.nodes[node].index("mesh") is not None}

    def welded(node: int) -> Weld:
        return weld(document, scene.nodes[node].index("mesh") or 0)

    return match_meshes(
        document.path,
        header,
        meshes,
        lambda scene_mesh, node: _fitted(scene_mesh, node, welded(node)),
        lambda scene_mesh, node: _difference(scene_mesh, welded(node)),
    )


def _fitted(scene_mesh: SceneMesh, node: int, welded: Weld) -> Place | None:
    """Match a mesh of the sequence with one of the file; None if vertices or triangles differ."""
    same_count = welded.count == scene_mesh.vertex_count
    if not (same_count and scene_mesh.polygons.only_triangles and all(map(len, welded.of_primitive))):
        return None
    theirs = _triangles(welded)
    for mirrored in (False, True):
        read = Polygons.from_triangles(_turned(theirs, mirrored))
        found = scene_mesh.match(read)
        if found is not None:
            ours, match = found
            return Place(ours, node, welded, mirrored, match.corners)
    return None


def _difference(scene_mesh: SceneMesh, welded: Weld) -> str:
    if welded.count != scene_mesh.vertex_count:
        return f"it has {welded.count} vertices, the sequence {scene_mesh.vertex_count}"
    theirs = Polygons.from_triangles(_triangles(welded))
    return difference(scene_mesh.polygons, theirs, ("the sequence", "the file"))


def _triangles(welded: Weld) -> NDArray[np.int64]:
    """Return the triangles ``(F, 3)`` of all primitives by vertices of the mesh."""
    both = zip(welded.primitives, welded.of_primitive, strict=True)
    return np.concatenate([vertices[each.triangles] for each, vertices in both if len(vertices)])


def _turned(triangles: NDArray[Any], mirrored: bool) -> NDArray[Any]:
    return triangles[:, [0, 2, 1]] if mirrored else triangles


def lay_over(
    document: Document, header: SequenceHeader, sources: ArrayLike | None = None
) -> tuple[Layout, list[MovingMesh], OtherMotion]:
    """Return the file's document with its data, the meshes that follow the sequence, and other motion.

    `sources` ``(T,)`` are the times of the file that the frames show, in seconds.
    """
    scene = read_scene(document)
    places = find_places(document, scene, header)
    carried = deepcopy(document.json)
    others = other_motion(document, scene, [place.node for place in places])
    others.warn_of_times(document.path, header, sources)
    _drop_animations(carried, document, scene, places)
    meshes = [_new_mesh(carried, document, place) for place in places]
    roots = {scene.lineage(place.node)[-1] for place in places}
    shown_in = [each for each in carried.get("scenes", ()) if roots.intersection(each.get("nodes", ()))]
    above = {scene.parents[place.node] for place in places}
    animated = {channel.node for channel in others.channels}
    inverses = [
        None if axis_conversion(header) else _inverse(scene, place.node, animated) for place in places
    ]
    stay = None not in inverses
    others = others.instead({place.node: detach(carried, place.node, stay) for place in places})
    for place, inverse in zip(places, inverses, strict=True):
        _stand_in_world(carried["nodes"][place.node], inverse if stay else None)
    if not stay:
        root = group(carried, [place.node for place in places], header, vacant(carried, scene, above))
        for each in shown_in:
            each["nodes"] = [root, *(node for node in each.get("nodes", ()) if node != root)]
    carried["asset"]["generator"] = GENERATOR_NAME
    json.dumps(carried, allow_nan=False)  # NaN is read, but must not be written; fail early
    prune(document.path, carried)
    layout = _with_data(carried, document)
    for place, mesh in zip(places, meshes, strict=True):
        for primitive, moving in zip(place.weld.primitives, mesh.primitives, strict=True):
            add_vertex_numbers(layout, moving, place.weld.count)
            if place.mirrored:
                turned = place.triangles(primitive).astype(np.uint32).reshape(-1)
                moving.entry.update(
                    indices=layout.add_array(turned, target=ELEMENT_ARRAY_BUFFER), mode=_TRIANGLES
                )
    return layout, meshes, others


def _inverse(scene: Scene, node: int, moved: Set[int]) -> Json | None:
    """Return the transform of a node that inverts its parents'; None if there is none, or the node is hidden."""
    parent = scene.parents[node]
    if node in scene.hidden or not moved.isdisjoint(scene.lineage(parent)):
        return None
    if not isinstance(scene.nodes[node].values.get("extras", {}), dict):
        return None  # there is no room for the mark
    return invert_transform(scene.world_matrices([parent], {})[parent][0])


def _stand_in_world(entry: Json, inverse: Json | None) -> None:
    """Set a node's transform to an inverse, marked in its extras; leave it without for None or {}."""
    extras = entry.pop("extras", {})
    if isinstance(extras, dict):
        extras = {key: value for key, value in extras.items() if key != WORLD_SPACE_MARK} | (
            {WORLD_SPACE_MARK: True} if inverse else {}
        )
    entry.update(inverse or {})
    if extras != {}:
        entry["extras"] = extras


def _drop_animations(carried: Json, document: Document, scene: Scene, places: Sequence[Place]) -> None:
    animations = carried.pop("animations", [])
    if len(animations) < 2:
        return
    others = moved_by_animations(carried, animations, scene) - {place.node for place in places}
    names = [each.get("name") or f"animation {number}" for number, each in enumerate(animations)]
    still = [scene.paths[node] for node in sorted(others)]
    rest = f"; what else they moved will stand still: {format_names(still)}" if still else ""
    warn(f"{document.path}: the sequence takes the place of all its animations, {format_names(names)}{rest}")


def _new_mesh(carried: Json, document: Document, place: Place) -> MovingMesh:
    """Give a node a mesh of its own without data that depend on the old positions."""
    if place.weld.skipped:
        warn(f"{document.path}: points or lines in the mesh {place.scene_mesh.path!r} are left out")
    node = carried["nodes"][place.node]
    old = carried["meshes"][node["mesh"]]
    moving, corner = [], 0
    for primitive, vertices in zip(place.weld.primitives, place.weld.of_primitive, strict=True):
        entry = deepcopy(old["primitives"][primitive.number])
        corners = slice(corner, corner + primitive.triangles.size)
        normals = _groups(place, primitive, corners) if "NORMAL" in entry["attributes"] else None
        if place.mirrored:
            entry.pop("indices", None)
        moving.append(MovingPrimitive(_without_positions(entry), vertices, normals))
        corner = corners.stop
    mesh = {key: value for key, value in old.items() if key != "weights"}
    mesh["primitives"] = [each.entry for each in moving]
    if isinstance(mesh.get("extras"), dict):
        mesh["extras"] = {key: value for key, value in mesh["extras"].items() if key != "targetNames"}
    node["mesh"] = append(carried, "meshes", mesh)
    return MovingMesh(place.node, place.scene_mesh, moving)


def _groups(place: Place, primitive: Primitive, corners: slice) -> NDArray[np.int32]:
    """Return the index of the shared normal of every vertex ``(n,)`` of a primitive."""
    groups = np.zeros(len(primitive.positions), dtype=np.int32)
    groups[place.triangles(primitive).reshape(-1)] = place.scene_mesh.normal_groups[place.corners[corners]]
    return groups


def _without_positions(entry: Json) -> Json:
    attributes = {
        name: accessor for name, accessor in entry["attributes"].items() if not name.startswith(_REPLACED)
    }
    kept = {key: value for key, value in entry.items() if key != "targets"}
    return {**kept, "attributes": attributes}


def _with_data(carried: Json, document: Document) -> Layout:
    """Return the document with its buffer views in one buffer."""
    views = carried.pop("bufferViews", [])
    layout = Layout(carried)
    for number, view in enumerate(views):
        fields = Fields(document.path, f"bufferViews[{number}]", view)
        start, length = fields.integer("byteOffset", 0), fields.integer("byteLength")
        data = document.buffer(fields.integer("buffer")).read(start, length)
        if len(data) != length:
            raise fields.error("goes beyond its buffer; the file is damaged")
        rest = {
            key: value for key, value in view.items() if key not in ("buffer", "byteOffset", "byteLength")
        }
        layout.add([data], length, **rest)
    embed_images(layout, document)
    return layout


def write_gltf(
    path: Path,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None = None,
    flatten: bool = False,
    onto: str | os.PathLike[str] | None = None,
    keep_start: bool = False,
    sources: ArrayLike | None = None,
) -> None:
    """Write a glTF file, ``.glb`` binary, ``.gltf`` text with everything in it; options as in `FORMATS`.

    By default everything else of the sequence's original file is kept; `sources` are ``(T,)`` in seconds. Velocities
    are lost.
    """

    def opened(file: Path) -> tuple[Layout, list[MovingMesh], OtherMotion]:
        with translate_read_errors(file, "glTF", *MALFORMED_JSON_ERRORS):
            return lay_over(decompress_document(load_document(file)), header, sources)

    overlay = open_original_file(path, header, flatten, onto, "glTF", opened)
    layout, meshes, others = overlay or (*create_scene(header), NOTHING)
    lost = [] if overlay else standalone_losses(header)
    warn_of_changes(path, header, [*(["velocities"] if velocities is not None else []), *lost], keep_start)
    warn_of_many_frames(path, header)
    morphs = MorphFrameWriter(layout, meshes, header, keep_start, others)
    _, numbered = validate_blocks(header, blocks, velocities)
    with atomic_file(path) as temporary, open_buffer_writer(path, temporary, layout) as writer:
        for first, block, _ in numbered:
            # One by one, because a block may be the whole sequence.
            for frame, points in enumerate(block, start=first):
                morphs.write(frame, as_float32(points[None], frame, "glTF", header=header)[0], writer)


# Of browsers: WebGL holds weights in uniforms, usually 1024 or 4096, and targets in layers of a texture, usually 2048.
_USUAL_LIMIT_OF_FRAMES = 1000


def standalone_losses(header: SequenceHeader) -> list[str]:
    """Return the losses of a mesh in a document of its own, in words."""
    lost = []
    if not header.polygons.only_triangles:
        lost.append("polygons other than triangles (they are cut)")
    lost += lost_colours(header)
    subdivision = lost_subdivision(header.surface)
    if subdivision:
        lost.append(subdivision)
    meshes = split_meshes(header)
    if any(_overlap(mesh) for mesh in meshes):
        lost.append("face sets that overlap")
    if any(each.name != material_name(each) for mesh in meshes for each in mesh.face_sets):
        lost.append("names of face sets other than their materials'")
    empty = [mesh.name for mesh in meshes if not mesh.polygons.counts.size]
    if empty:
        lost.append(f"objects without polygons ({', '.join(map(repr, empty[:20]))})")
    return lost


def warn_of_changes(
    path: Path, header: SequenceHeader, lost: Sequence[str], keep_start: bool = False
) -> None:
    """Warn of losses, and of differences when the file is read again."""
    warn_of_losses(path, "glTF files", lost)
    if axis_conversion(header):
        warn(
            f"{path}: glTF is in metres with Y up; the points stay as they are, in {header.metres_per_unit:g} metres "
            f"per unit with {header.up_axis} up, under a node that turns and scales them; convert_units "
            "(--convert-axes Y, --convert-units m) turns and scales the points"
        )
    shift = time_shift(header, keep_start)
    if shift and (keep_start or header.frame_count == 1):  # else the file stores its start
        warn(f"{path}: glTF's times begin at 0; all times are moved by {-shift:g} s")


def warn_of_many_frames(path: Path, header: SequenceHeader) -> None:
    """Warn of more frames than browsers show, since each is a morph target."""
    if header.frame_count > _USUAL_LIMIT_OF_FRAMES:
        warn(
            f"{path}: {header.frame_count} frames are as many morph targets; browsers usually show no more than "
            f"about {_USUAL_LIMIT_OF_FRAMES}, so resample it for them"
        )


def _overlap(mesh: SceneMesh) -> bool:
    owner = owners(mesh)
    return any(
        (owner[each.polygons] != number).any()
        for number, each in enumerate(mesh.face_sets)
        if distinguishes(each, mesh)
    )
