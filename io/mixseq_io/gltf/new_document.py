"""New glTF documents of a sequence, with a node per object, plain named materials, and frames as morph targets.

Meshes become primitives of triangles, one per material. Vertices are split at seams of texture coordinates, hard edges
and borders of materials, since glTF primitives have one material and one index for all attributes. The attribute
``_VERTEX`` stores the sequence's vertex index of each split vertex, so that readers can weld the split vertices.

The first frame is the base mesh, and every other frame a morph target: ``x_k = x_0 + sum_j w_j(t_k) d_j`` with
``d_j = x_j - x_0`` and weights ``w_j(t_k)`` one where ``j = k``, else zero. Viewers interpolate weights linearly
between keys, and therefore points and normals. ``x_0`` and ``d_j`` are rounded to float32. The error of a point is at
most 2**-24 of its displacement from the first frame.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html#morph-targets
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import InvalidSequenceError
from mixseq.mesh.measures import NO_ORIGIN, corner_normals
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import FaceSet
from mixseq.sequence.header import SequenceHeader
from mixseq.types import Float, FloatArray, IntArray, Single
from mixseq_io.gltf.buffers import (
    ARRAY_BUFFER,
    ELEMENT_ARRAY_BUFFER,
    GENERATOR_NAME,
    BufferWriter,
    Json,
    Layout,
    add_channels,
    append,
    compute_bounds,
    compute_glb_size,
)
from mixseq_io.reader import as_float32
from mixseq_io.scene_meshes import SceneMesh, split_meshes
from mixseq_io.surfaces import clip_to_unit, colours_to_exact_bytes

_BYTES_PER_VECTOR = 12


@dataclass(frozen=True, eq=False)
class MovingPrimitive:
    """Primitive of a document, with the indices of the mesh vertex and shared normal ``(n,)`` of each split vertex."""

    entry: Json
    vertex_ids: IntArray
    normal_ids: IntArray | None


@dataclass(frozen=True, eq=False)
class MovingMesh:
    """Mesh of a document, and the mesh of the sequence whose points are written to it."""

    node: int
    scene_mesh: SceneMesh
    primitives: Sequence[MovingPrimitive]

    def compute_normals(self, points: FloatArray) -> Single:
        """Return the shared normals ``(B, G, 3)`` for points ``(B, V, 3)`` of the sequence."""
        mesh = self.scene_mesh
        return corner_normals(points[:, mesh.vertices], mesh.polygons, mesh.hard_edges)


class MorphFrameWriter:
    """Writer of frames as morph targets; the constructor lays out the buffer, then frames are written in order."""

    def __init__(self, layout: Layout, meshes: Sequence[MovingMesh], header: SequenceHeader) -> None:
        self._meshes, self._header = meshes, header
        self._frames = [self._reserve(layout, frame) for frame in range(header.frame_count)]
        self._first: tuple[FloatArray, list[Single]] | None = None

    def _reserve(self, layout: Layout, frame: int) -> tuple[int, list[Json]]:
        """Reserve a view for a frame; return its offset, and the accessors of points without bounds."""
        vector_count = sum(
            len(each.vertex_ids) * (1 if each.normal_ids is None else 2)
            for mesh in self._meshes
            for each in mesh.primitives
        )
        length = vector_count * _BYTES_PER_VECTOR
        view = layout.reserve(length, byteStride=_BYTES_PER_VECTOR, target=ARRAY_BUFFER)
        offset, unbounded = 0, []
        for mesh in self._meshes:
            for each in mesh.primitives:
                count = len(each.vertex_ids)
                attributes = each.entry["attributes"] if frame == 0 else {}
                attributes["POSITION"] = layout.accessor(view, count, "VEC3", offset)
                unbounded.append(layout.set_bounds(attributes["POSITION"]))
                offset += count * _BYTES_PER_VECTOR
                if each.normal_ids is not None:
                    attributes["NORMAL"] = layout.accessor(view, count, "VEC3", offset)
                    offset += count * _BYTES_PER_VECTOR
                if frame > 0:
                    append(each.entry, "targets", attributes)
        return layout.document["bufferViews"][view]["byteOffset"], unbounded

    def write(self, frame: int, points: FloatArray, writer: BufferWriter) -> FloatArray:
        """Write a frame's points ``(V, 3)``, and return what readers get for them; displacements may exceed float32."""
        single = as_float32(points[None], frame, "glTF", header=self._header)[0]
        normals = [mesh.compute_normals(single[None])[0] for mesh in self._meshes]
        written: Float = single.astype(np.float64)
        if self._first is None:
            self._first = written, normals
        else:
            base_points, base_normals = self._first
            single = as_float32((points - base_points)[None], frame, "glTF")[0]
            written = np.asarray(base_points + single, dtype=np.float64)
            normals = [own - base for own, base in zip(normals, base_normals, strict=True)]
        start, unbounded = self._frames[frame]
        accessors = iter(unbounded)
        chunks: list[Single] = []
        for mesh, own_normals in zip(self._meshes, normals, strict=True):
            for each in mesh.primitives:
                positions = single[mesh.scene_mesh.vertices][each.vertex_ids]
                accessor = next(accessors)
                accessor["min"], accessor["max"] = compute_bounds(positions)
                chunks.append(positions)
                if each.normal_ids is not None:
                    chunks.append(own_normals[each.normal_ids])
        writer.put(start, chunks)
        return written


def size_with_frame_targets(header: SequenceHeader) -> int:
    """Return the size in bytes of a .glb with a morph target per frame; the text of bounds may differ in length."""
    layout, meshes = create_scene(header)
    add_frame_animation(layout, meshes, header)
    MorphFrameWriter(layout, meshes, header)
    return compute_glb_size(layout)


def add_frame_animation(
    layout: Layout, meshes: Sequence[MovingMesh], header: SequenceHeader, keep_start: bool = False
) -> Json | None:
    """Add the animation of the weights, 1 for the target of each frame; return it, None for a single frame."""
    if header.frame_count == 1:
        return None
    times, animation = create_animation(layout, header, keep_start)
    count = header.frame_count * (header.frame_count - 1)
    targets = np.arange(1, header.frame_count)
    rows = ((targets == key).astype(np.float32) for key in range(header.frame_count))
    weights = layout.accessor(layout.add(rows, 4 * count), count, "SCALAR")
    add_channels(animation, times, weights, [mesh.node for mesh in meshes], "weights")
    append(layout.document, "animations", animation)
    return animation


def create_animation(layout: Layout, header: SequenceHeader, keep_start: bool = False) -> tuple[int, Json]:
    """Add key times ``(T,)`` of the frames; return their accessor, and an animation with rate and start as extras."""
    start = choose_start(header, keep_start)
    keys = (header.times - start).astype(np.float32)
    is_equal = np.diff(keys) <= 0
    if is_equal.any() or not np.isfinite(keys).all():
        frame = int(np.argmax(is_equal))
        raise InvalidSequenceError(
            f"frames {frame} and {frame + 1} are at {header.times[frame]:.9g} s and {header.times[frame + 1]:.9g} s, "
            "too close, or too late, for glTF's float32; let the times begin at 0, or write USD, .npz or .h5"
        )
    times = layout.add_array(keys)
    layout.set_bounds(times, ([float(keys[0])], [float(keys[-1])]))
    extras = {"fps": header.fps, **({"start": start} if start else {})}
    return times, {"name": header.name or "animation", "samplers": [], "channels": [], "extras": extras}


def choose_start(header: SequenceHeader, keep_start: bool = False) -> float:
    """Return the time in s at key time 0: the first frame's time, since players show a static mesh before it.

    With `keep_start` it is 0, except for times below 0 and for a single frame, whose time glTF cannot store.
    """
    first = float(header.times[0])
    return 0.0 if keep_start and first >= 0 and header.frame_count > 1 else first


@dataclass(frozen=True, eq=False)
class SplitPrimitive:
    """Triangles ``(F, 3)`` of one material on n split vertices, with attributes ``(n, k)`` by glTF name."""

    vertex_ids: IntArray  # (n,) of the mesh
    normal_ids: IntArray  # (n,) of the shared normals, see `mixseq.mesh.measures.corner_normals`
    attributes: Mapping[str, Single]
    triangles: NDArray[np.uint32]
    face_set: FaceSet | None


def split_primitives(mesh: SceneMesh) -> list[SplitPrimitive]:
    """Split a mesh into a primitive per face set of `assign_face_sets`, and one of others; loose vertices go first."""
    corner_count, vertex_count = mesh.polygons.indices.size, mesh.vertex_count
    owner_of_corner = np.repeat(assign_face_sets(mesh).astype(np.int64) + 1, mesh.polygons.counts)
    layers = {name: layer for name, layer in (("TEXCOORD_0", mesh.uvs), ("COLOR_0", mesh.colours)) if layer is not None}
    keys = {name: layer.indices for name, layer in layers.items()}
    if mesh.hard_edges is not None:
        keys["normals"] = mesh.hard_edges
    # Unused vertices follow the corners.
    unused = np.flatnonzero(np.bincount(mesh.polygons.indices, minlength=vertex_count) == 0)
    owners = np.append(owner_of_corner, np.full_like(unused, owner_of_corner.min()))
    vertices = np.append(mesh.polygons.indices, unused)
    keys = {name: np.append(key, np.zeros_like(unused)) for name, key in keys.items()}
    rows, split_vertex = _unique_tuples([owners * vertex_count + vertices, *keys.values()])
    used_owners, starts = np.unique(owners[rows], return_index=True)
    triangles = Polygons(mesh.polygons.counts, np.arange(corner_count)).triangles  # corner indices
    triangles = triangles[np.argsort(owner_of_corner[triangles[:, 0]], kind="stable")]
    triangle_starts = np.searchsorted(owner_of_corner[triangles[:, 0]], used_owners[1:])
    groups = zip(used_owners, starts, np.split(rows, starts[1:]), np.split(triangles, triangle_starts), strict=True)
    primitives = []
    for owner, start, own_rows, own_triangles in groups:
        attributes = {name: layer.values[keys[name][own_rows]] for name, layer in layers.items()}
        if "TEXCOORD_0" in attributes:
            attributes["TEXCOORD_0"] = (attributes["TEXCOORD_0"] * (1, -1) + (0, 1)).astype(np.float32)  # v downwards
        # Unused vertices get normal 0: with hard edges, the vertex index is not a valid normal index.
        normal_ids = np.where(own_rows < corner_count, keys.get("normals", vertices)[own_rows], 0)
        primitives.append(
            SplitPrimitive(
                vertex_ids=vertices[own_rows],
                normal_ids=normal_ids,
                attributes=attributes,
                triangles=(split_vertex[own_triangles] - start).astype(np.uint32),
                face_set=mesh.face_sets[owner - 1] if owner else None,
            )
        )
    return primitives


def _unique_tuples(columns: Sequence[IntArray]) -> tuple[IntArray, IntArray]:
    """Return a row index of each distinct tuple of columns ``(n,)``, and the tuple index ``(n,)`` of each row."""
    labels = columns[0].astype(np.int64)
    for column in columns[1:]:
        combined = labels * (int(column.max(initial=0)) + 1) + column
        labels = np.unique(combined, return_inverse=True)[1].reshape(-1)
    if labels.max(initial=0) > _MAX_LABELS_PER_ROW * len(labels):  # sparse labels, for few corners of a large mesh
        labels = np.unique(labels, return_inverse=True)[1].reshape(-1)
    rows = np.full(int(labels.max(initial=-1)) + 1, -1)
    rows[labels] = np.arange(len(labels))
    is_used = rows >= 0
    return rows[is_used], (np.cumsum(is_used) - 1)[labels]


def assign_face_sets(mesh: SceneMesh) -> IntArray:
    """Return the first face set of each polygon ``(P,)``, preferably with a material, or -1 without a face set."""
    owner = np.full(len(mesh.polygons.counts), -1, dtype=np.int32)
    indices = [index for index, each in enumerate(mesh.face_sets) if has_own_primitive(each, mesh)]
    for index in sorted(indices, key=lambda index: not mesh.face_sets[index].material)[::-1]:
        owner[mesh.face_sets[index].polygons] = index
    return owner


def has_own_primitive(face_set: FaceSet, mesh: SceneMesh) -> bool:
    """Whether a face set has a material or fewer polygons than the mesh."""
    return bool(face_set.material) or face_set.polygons.size < len(mesh.polygons.counts)


_MAX_EXACT_FLOAT32 = 2**24
_MAX_LABELS_PER_ROW = 4
_MAX_UINT16_INDEX = 2**16 - 1


def create_scene(header: SequenceHeader, origin: Float = NO_ORIGIN) -> tuple[Layout, list[MovingMesh]]:
    """Create a document of a sequence without frames, and its meshes; omit objects without polygons."""
    layout, meshes = create_meshes(header)
    root = group_nodes(layout.document, [mesh.node for mesh in meshes], header, origin)
    layout.document["scene"], layout.document["scenes"] = 0, [{"nodes": [root]}]
    return layout, meshes


def create_meshes(header: SequenceHeader) -> tuple[Layout, list[MovingMesh]]:
    """Create a document of a sequence with a node for each mesh, without a scene."""
    layout = Layout({"asset": {"version": "2.0", "generator": GENERATOR_NAME}})
    scene_meshes = [scene_mesh for scene_mesh in split_meshes(header) if scene_mesh.polygons.counts.size]
    names = [header.name if len(scene_meshes) == 1 else scene_mesh.name for scene_mesh in scene_meshes]
    materials: dict[str, int] = {}
    return layout, [
        _add_mesh(layout, scene_mesh, name, materials) for scene_mesh, name in zip(scene_meshes, names, strict=True)
    ]


def group_nodes(
    document: Json, nodes: list[int], header: SequenceHeader, origin: Float, unused: int | None = None
) -> int:
    """Return the only node of a sequence, or a parent (`unused` or new) of several; it gets the `node_transform`."""
    entry = {**name_member(header.name), "children": nodes}
    if len(nodes) == 1:
        root = nodes[0]
    elif unused is None:
        root = append(document, "nodes", entry)
    else:
        root = unused
        document["nodes"][root] = entry
    document["nodes"][root].update(node_transform(header, origin))
    return root


def node_transform(header: SequenceHeader, origin: Float = NO_ORIGIN) -> Json:
    """Return the transform to Y up and metres of points relative to an origin ``(3,)``, or {} for the identity."""
    columns = {"X": [(0, 1, 0), (-1, 0, 0), (0, 0, 1)], "Z": [(1, 0, 0), (0, 0, -1), (0, 1, 0)]}
    matrix = np.eye(4)
    matrix[:3, :3] = header.metres_per_unit * np.array(columns.get(header.up_axis, np.eye(3)))
    matrix[3, :3] = origin @ matrix[:3, :3]
    return {} if np.array_equal(matrix, np.eye(4)) else {"matrix": matrix.ravel().tolist()}


def name_member(name: str) -> Json:
    """Return a JSON member ``name``, or {} for an empty name."""
    return {"name": name} if name else {}


def material_name(face_set: FaceSet) -> str:
    """Return the glTF name of a face set's material: the last name in its path, or the face set's name."""
    name = face_set.material
    return (name.rstrip("/").rpartition("/")[2] if name.startswith("/") else name) or face_set.name


def _add_mesh(layout: Layout, scene_mesh: SceneMesh, name: str, materials: dict[str, int]) -> MovingMesh:
    primitives = []
    for each in split_primitives(scene_mesh):
        entry = add_triangles(layout, each.triangles, each.attributes)
        if each.face_set is not None:
            entry["material"] = add_material(layout.document, material_name(each.face_set), materials)
        primitives.append(MovingPrimitive(entry, each.vertex_ids, each.normal_ids))
        add_vertex_numbers(layout, primitives[-1], scene_mesh.vertex_count)
    mesh = append(
        layout.document, "meshes", {**name_member(name), "primitives": [moving.entry for moving in primitives]}
    )
    node = append(layout.document, "nodes", {**name_member(name), "mesh": mesh})
    return MovingMesh(node, scene_mesh, primitives)


def add_triangles(layout: Layout, triangles: NDArray[np.uint32], attributes: Mapping[str, Single]) -> Json:
    """Add triangles ``(F, 3)`` and attributes ``(n, k)`` by glTF name; return the primitive's JSON entry."""
    add: dict[str, Callable[[Single], int]] = {"POSITION": layout.add_points, "COLOR_0": partial(_add_colours, layout)}
    add_values = partial(layout.add_array, target=ARRAY_BUFFER)
    accessors = {name: add.get(name, add_values)(values) for name, values in attributes.items()}
    corners = triangles.reshape(-1)
    # glTF reserves the largest uint16.
    narrow = corners.astype(np.uint16) if corners.max(initial=0) < _MAX_UINT16_INDEX else corners
    return {"attributes": accessors, "indices": layout.add_array(narrow, target=ELEMENT_ARRAY_BUFFER)}


def _add_colours(layout: Layout, colours: Single) -> int:
    """Add colours ``(n, 4)``, as bytes if bytes are exact; return their accessor's index."""
    exact = colours_to_exact_bytes(colours)
    accessor = layout.add_array(clip_to_unit(colours) if exact is None else exact, target=ARRAY_BUFFER)
    if exact is not None:
        layout.document["accessors"][accessor]["normalized"] = True
    return accessor


def add_vertex_numbers(layout: Layout, primitive: MovingPrimitive, vertex_count: int) -> None:
    """Store the mesh vertex index of each split vertex in ``_VERTEX`` if float32 can represent all indices."""
    if vertex_count <= _MAX_EXACT_FLOAT32:
        numbers = primitive.vertex_ids.astype(np.float32)
        primitive.entry["attributes"]["_VERTEX"] = layout.add_array(numbers, target=ARRAY_BUFFER)


def add_material(document: Json, name: str, materials: dict[str, int]) -> int:
    """Return the index of the material with a name; add the material if `materials` does not list it."""
    if name not in materials:
        entry = {
            **name_member(name),
            "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.8},
            "doubleSided": True,
        }
        materials[name] = append(document, "materials", entry)
    return materials[name]
