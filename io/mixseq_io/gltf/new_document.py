"""A stand-alone glTF document of a sequence: a node per object, plain materials by name, frames as morph targets.

Meshes become triangles by material. Vertices are split at seams of texture coordinates, hard edges and borders of
materials, since glTF primitives have one material and one index for all attributes. The attribute ``_VERTEX`` stores
the sequence's vertex of each copy, so that readers can weld them again.

The first frame is the mesh, every further frame a target: frame ``k`` is ``x_k = x_0 + sum_j w_j(t_k) d_j`` with
``d_j = x_j - x_0`` and weights ``w_j(t_k)`` one where ``j = k``, else zero. Viewers interpolate weights linearly
between keys, hence points and normals too. ``x_0`` and ``d_j`` are rounded to float32: a point is off by at most 2**-24
of its displacement since the first frame, plus its own rounding.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html#morph-targets
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import InvalidSequenceError
from mixseq.mesh.measures import shared_normals
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import FaceSet
from mixseq.sequence.header import SequenceHeader
from mixseq.types import FloatArray, IntArray, Single
from mixseq_io.gltf.codecs import (
    ARRAY_BUFFER,
    ELEMENT_ARRAY_BUFFER,
    GENERATOR_NAME,
    BufferWriter,
    Json,
    Layout,
    append,
    compute_bounds,
)
from mixseq_io.gltf.edits import NOTHING, OtherMotion
from mixseq_io.reader import as_float32
from mixseq_io.scene_meshes import SceneMesh, split_meshes
from mixseq_io.surfaces import clip_to_unit, colours_to_exact_bytes

_BYTES_PER_VECTOR = 12


@dataclass(frozen=True, eq=False)
class MovingPrimitive:
    """Primitive of the document with moving vertices."""

    entry: Json
    vertices: IntArray
    normals: IntArray | None


@dataclass(frozen=True, eq=False)
class MovingMesh:
    """Mesh of the document with moving vertices: its node, its mesh of the sequence, its primitives."""

    node: int
    scene_mesh: SceneMesh
    primitives: Sequence[MovingPrimitive]

    def normals_of(self, points: FloatArray) -> Single:
        """Return the shared normals ``(B, G, 3)`` for points ``(B, V, 3)`` of the sequence."""
        mesh = self.scene_mesh
        return shared_normals(points[:, mesh.vertices], mesh.polygons, mesh.hard_edges)


class MorphFrameWriter:
    """Frames in the buffer: laid out on construction, then written one after the other."""

    def __init__(
        self,
        layout: Layout,
        meshes: Sequence[MovingMesh],
        header: SequenceHeader,
        keep_start: bool = False,
        others: OtherMotion = NOTHING,
    ) -> None:
        self._meshes = meshes
        self._animate(layout, header, keep_start, others)
        self._frames = [self._lay_out(layout, frame) for frame in range(header.frame_count)]
        self._first: tuple[FloatArray, list[NDArray[np.float32]]] | None = None

    def _animate(self, layout: Layout, header: SequenceHeader, keep_start: bool, others: OtherMotion) -> None:
        """Add the animation that steps through the targets."""
        if header.frame_count == 1:
            return
        times, animation = new_animation(layout, header, keep_start)
        count = header.frame_count * (header.frame_count - 1)
        targets = np.arange(1, header.frame_count)
        rows = ((targets == key).astype(np.float32) for key in range(header.frame_count))
        weights = layout.accessor(layout.add(rows, 4 * count), count, "SCALAR")
        animation["samplers"].append({"input": times, "output": weights, "interpolation": "LINEAR"})
        animation["channels"] += [
            {"sampler": 0, "target": {"node": mesh.node, "path": "weights"}} for mesh in self._meshes
        ]
        others.animate(layout, animation, header)
        append(layout.document, "animations", animation)

    def _lay_out(self, layout: Layout, frame: int) -> tuple[int, list[Json]]:
        """Return the offset of a frame's view, and the accessors of points without bounds."""
        vectors = sum(
            len(each.vertices) * (1 if each.normals is None else 2)
            for mesh in self._meshes
            for each in mesh.primitives
        )
        view = layout.reserve(vectors * _BYTES_PER_VECTOR, byteStride=_BYTES_PER_VECTOR, target=ARRAY_BUFFER)
        offset, unbounded = 0, []
        for mesh in self._meshes:
            for each in mesh.primitives:
                count = len(each.vertices)
                attributes = each.entry["attributes"] if frame == 0 else {}
                points = layout.accessor(view, count, "VEC3", offset)
                attributes["POSITION"] = points
                unbounded.append(layout.set_bounds(points))
                offset += count * _BYTES_PER_VECTOR
                if each.normals is not None:
                    attributes["NORMAL"] = layout.accessor(view, count, "VEC3", offset)
                    offset += count * _BYTES_PER_VECTOR
                if frame > 0:
                    append(each.entry, "targets", attributes)
        return layout.document["bufferViews"][view]["byteOffset"], unbounded

    def write(self, frame: int, points: NDArray[np.float32], writer: BufferWriter) -> None:
        """Write a frame's points ``(V, 3)``; `InvalidSequenceError` if too far from the first frame for float32."""
        normals = [mesh.normals_of(points[None])[0] for mesh in self._meshes]
        if self._first is None:
            self._first = points.astype(np.float64), normals
        else:
            base, base_normals = self._first
            points = as_float32((points - base)[None], frame, "glTF")[0]
            normals = [here - there for here, there in zip(normals, base_normals, strict=True)]
        start, unbounded = self._frames[frame]
        chunks: list[NDArray[np.float32]] = []
        awaiting = iter(unbounded)
        for mesh, of_mesh in zip(self._meshes, normals, strict=True):
            for each in mesh.primitives:
                here = points[mesh.scene_mesh.vertices][each.vertices]
                accessor = next(awaiting)
                accessor["min"], accessor["max"] = compute_bounds(here)
                chunks.append(here)
                if each.normals is not None:
                    chunks.append(of_mesh[each.normals])
        writer.put(start, chunks)


def new_animation(layout: Layout, header: SequenceHeader, keep_start: bool = False) -> tuple[int, Json]:
    """Add float32 key times ``(T,)`` of the frames; return their accessor, and an animation without channels.

    Its extras are ``fps``, and ``start``, the time in s at key 0, unless it is 0.
    """
    start = time_shift(header, keep_start)
    keys = (header.times - start).astype(np.float32)
    close = np.diff(keys) <= 0
    if close.any() or not np.isfinite(keys).all():
        frame = int(np.argmax(close))
        raise InvalidSequenceError(
            f"frames {frame} and {frame + 1} are at {header.times[frame]:.9g} s and {header.times[frame + 1]:.9g} s, "
            "too close, or too late, for glTF's float32; let the times begin at 0, or write USD, .npz or .h5"
        )
    times = layout.add_array(keys)
    layout.set_bounds(times, ([float(keys[0])], [float(keys[-1])]))
    extras = {"fps": header.fps, **({"start": start} if start else {})}
    return times, {"name": header.name or "animation", "samplers": [], "channels": [], "extras": extras}


def time_shift(header: SequenceHeader, keep_start: bool = False) -> float:
    """Return the time in seconds that becomes 0: the first one.

    Players would otherwise show the first frame until then: 40 s for a shot that begins at frame 1001. `keep_start`
    moves only times that glTF cannot hold: those before 0, and that of a single frame.
    """
    first = float(header.times[0])
    return 0.0 if keep_start and first >= 0 and header.frame_count > 1 else first


@dataclass(frozen=True, eq=False)
class SplitPrimitive:
    """Triangles ``(m, 3)`` of one material by n split vertices, with uvs ``(n, 2)``, v up, and colours ``(n, 4)``.

    `vertices` ``(n,)`` are the mesh's vertices that they copy, `normals` ``(n,)`` the indices of shared normals, see
    `mixseq.mesh.measures.shared_normals`.
    """

    vertices: IntArray
    normals: IntArray
    uvs: NDArray[np.float32] | None
    colours: NDArray[np.float32] | None
    triangles: NDArray[np.uint32]
    face_set: FaceSet | None


def split_corners(mesh: SceneMesh) -> list[SplitPrimitive]:
    """Split a mesh into primitives: one per face set with polygons of its own, one for the rest.

    Vertices keep their order within a primitive. Unused vertices go into the first one, without triangles.
    """
    owner = owners(mesh)
    of_corner = np.repeat(owner, mesh.polygons.counts)
    on = {name: each for name, each in (("uvs", mesh.uvs), ("colours", mesh.colours)) if each is not None}
    keys = {"vertices": mesh.polygons.indices, **{name: each.indices for name, each in on.items()}}
    if mesh.hard_edges is not None:
        keys["normals"] = mesh.hard_edges
    triangles = Polygons(mesh.polygons.counts, np.arange(of_corner.size)).triangles  # of corners
    unused = np.flatnonzero(np.bincount(mesh.polygons.indices, minlength=mesh.vertex_count) == 0)
    primitives: list[SplitPrimitive] = []
    place = np.zeros(of_corner.size, dtype=np.uint32)  # each owner's are set before they are used
    of_triangle = of_corner[triangles[:, 0]]
    for (number, corners), (_, own) in zip(_by_owner(of_corner), _by_owner(of_triangle), strict=True):
        alone = unused if not primitives else unused[:0]
        some = {
            name: np.append(key[corners], alone if name == "vertices" else np.zeros_like(alone))
            for name, key in keys.items()
        }
        chosen, copies = _unique_tuples(list(some.values()))
        place[corners] = copies[: corners.size]
        rows = {name: key[chosen] for name, key in some.items()}
        values = {name: each.values[rows[name]] for name, each in on.items()}
        # A vertex that no polygon uses has the first normal, where normals are not those of vertices.
        used = chosen < corners.size
        primitives.append(
            SplitPrimitive(
                vertices=rows["vertices"],
                normals=np.where(used, rows.get("normals", rows["vertices"]), 0),
                uvs=values.get("uvs"),
                colours=values.get("colours"),
                triangles=place[triangles[own]],
                face_set=None if number < 0 else mesh.face_sets[number],
            )
        )
    return primitives


def _by_owner(owner: IntArray) -> Iterator[tuple[int, IntArray]]:
    """Yield each owner in ascending order, with the indices of its elements in ascending order."""
    order = np.argsort(owner, kind="stable")
    found, starts = np.unique(owner[order], return_index=True)
    yield from zip(found.tolist(), np.split(order, starts[1:])[: len(found)], strict=True)


def _unique_tuples(columns: Sequence[IntArray]) -> tuple[IntArray, IntArray]:
    """Return the rows of the distinct tuples of n columns ``(n,)``, and the index of each row's tuple."""
    numbers = columns[0].astype(np.int64)
    for column in columns[1:]:
        several = numbers * (int(column.max(initial=0)) + 1) + column
        numbers = np.unique(several, return_inverse=True)[1].reshape(-1)
    if numbers.max(initial=0) > _SPARSE * len(numbers):  # few corners of a large mesh
        numbers = np.unique(numbers, return_inverse=True)[1].reshape(-1)
    rows = np.full(int(numbers.max(initial=-1)) + 1, -1)
    rows[numbers] = np.arange(len(numbers))
    there = rows >= 0
    return rows[there], (np.cumsum(there) - 1)[numbers]


def owners(mesh: SceneMesh) -> IntArray:
    """Return the face set of each polygon ``(P,)``, -1 for none; the first with a material wins, then the first."""
    owner = np.full(len(mesh.polygons.counts), -1, dtype=np.int32)
    numbers = [number for number, each in enumerate(mesh.face_sets) if distinguishes(each, mesh)]
    for number in sorted(numbers, key=lambda number: not mesh.face_sets[number].material)[::-1]:
        owner[mesh.face_sets[number].polygons] = number
    return owner


def distinguishes(face_set: FaceSet, mesh: SceneMesh) -> bool:
    """Whether a face set has a material or fewer polygons than the mesh."""
    return bool(face_set.material) or face_set.polygons.size < len(mesh.polygons.counts)


_LARGEST_EXACT = 2**24
_SPARSE = 4
_LARGEST_SHORT = 2**16 - 1


def create_scene(header: SequenceHeader) -> tuple[Layout, list[MovingMesh]]:
    """Return a document of a sequence without frames, and its moving meshes; objects without polygons are left out."""
    layout, meshes = new_meshes(header)
    root = group(layout.document, [mesh.node for mesh in meshes], header)
    layout.document["scene"], layout.document["scenes"] = 0, [{"nodes": [root]}]
    return layout, meshes


def new_meshes(header: SequenceHeader) -> tuple[Layout, list[MovingMesh]]:
    """Return a document of a sequence's meshes with a node each, without a scene, and its moving meshes."""
    layout = Layout({"asset": {"version": "2.0", "generator": GENERATOR_NAME}})
    scene_meshes = [scene_mesh for scene_mesh in split_meshes(header) if scene_mesh.polygons.counts.size]
    names = [header.name if len(scene_meshes) == 1 else scene_mesh.name for scene_mesh in scene_meshes]
    materials: dict[str, int] = {}
    return layout, [
        _new_mesh(layout, scene_mesh, name, materials)
        for scene_mesh, name in zip(scene_meshes, names, strict=True)
    ]


def group(document: Json, nodes: list[int], header: SequenceHeader, vacant: int | None = None) -> int:
    """Return the root of a sequence's nodes, upright: the only node, or a parent of all (`vacant` if given)."""
    entry = {**named(header.name), "children": nodes}
    if len(nodes) == 1:
        root = nodes[0]
    elif vacant is None:
        root = append(document, "nodes", entry)
    else:
        root = vacant
        document["nodes"][root] = entry
    document["nodes"][root].update(axis_conversion(header))
    return root


def axis_conversion(header: SequenceHeader) -> Json:
    """Return the transform of a node from the sequence's axes and units to glTF's, Y up and metres; {} for identity."""
    columns = {"X": [(0, 1, 0), (-1, 0, 0), (0, 0, 1)], "Z": [(1, 0, 0), (0, 0, -1), (0, 1, 0)]}
    matrix = np.eye(4)
    matrix[:3, :3] = header.metres_per_unit * np.array(columns.get(header.up_axis, np.eye(3)))
    return {} if np.array_equal(matrix, np.eye(4)) else {"matrix": matrix.ravel().tolist()}


def named(name: str) -> Json:
    """Return the member ``name``, or no member for an empty name."""
    return {"name": name} if name else {}


def material_name(face_set: FaceSet) -> str:
    """Return a material's glTF name: the last name of its path, or the face set's name."""
    name = face_set.material
    return (name.rstrip("/").rpartition("/")[2] if name.startswith("/") else name) or face_set.name


def _new_mesh(layout: Layout, scene_mesh: SceneMesh, name: str, materials: dict[str, int]) -> MovingMesh:
    primitives = [_new_primitive(layout, each, scene_mesh, materials) for each in split_corners(scene_mesh)]
    entries = [primitive.entry for primitive in primitives]
    mesh = append(layout.document, "meshes", {**named(name), "primitives": entries})
    node = append(layout.document, "nodes", {**named(name), "mesh": mesh})
    return MovingMesh(node, scene_mesh, primitives)


def _new_primitive(
    layout: Layout, primitive: SplitPrimitive, scene_mesh: SceneMesh, materials: dict[str, int]
) -> MovingPrimitive:
    attributes: dict[str, int] = {}
    if primitive.uvs is not None:
        attributes["TEXCOORD_0"] = layout.add_array(upside_down(primitive.uvs), target=ARRAY_BUFFER)
    if primitive.colours is not None:
        attributes["COLOR_0"] = add_colours(layout, primitive.colours)
    entry: Json = {
        "attributes": attributes,
        "indices": layout.add_array(narrow(primitive.triangles.reshape(-1)), target=ELEMENT_ARRAY_BUFFER),
    }
    if primitive.face_set is not None:
        entry["material"] = material(layout.document, material_name(primitive.face_set), materials)
    moving = MovingPrimitive(entry, primitive.vertices, primitive.normals)
    add_vertex_numbers(layout, moving, scene_mesh.vertex_count)
    return moving


def upside_down(uvs: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return texture coordinates ``(n, 2)`` with v pointing down, as in glTF."""
    return (uvs * (1, -1) + (0, 1)).astype(np.float32)


def add_colours(layout: Layout, colours: NDArray[np.float32]) -> int:
    """Add colours ``(n, 4)``, as bytes where that is exact; return their accessor."""
    exact = colours_to_exact_bytes(colours)
    number = layout.add_array(clip_to_unit(colours) if exact is None else exact, target=ARRAY_BUFFER)
    if exact is not None:
        layout.document["accessors"][number]["normalized"] = True
    return number


def narrow(indices: NDArray[np.uint32]) -> NDArray[np.uint32] | NDArray[np.uint16]:
    """Return indices ``(n,)`` as uint16 if they fit; glTF reserves the largest number."""
    return indices.astype(np.uint16) if indices.max(initial=0) < _LARGEST_SHORT else indices


def add_vertex_numbers(layout: Layout, primitive: MovingPrimitive, vertex_count: int) -> None:
    """Store the sequence's vertex of each glTF vertex in ``_VERTEX``, as float32, unless the numbers are too large."""
    if vertex_count <= _LARGEST_EXACT:
        numbers = primitive.vertices.astype(np.float32)
        primitive.entry["attributes"]["_VERTEX"] = layout.add_array(numbers, target=ARRAY_BUFFER)


def material(document: Json, name: str, materials: dict[str, int]) -> int:
    """Return the index of the material of a name, added if missing; `materials` are indices by name."""
    if name in materials:
        return materials[name]
    entry = {
        **named(name),
        "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.8},
        "doubleSided": True,
    }
    materials[name] = append(document, "materials", entry)
    return materials[name]
