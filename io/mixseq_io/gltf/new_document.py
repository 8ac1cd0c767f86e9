"""A glTF document of a sequence alone: a node per object, plain materials by name.

A mesh becomes triangles by material, with one vertex per combination of everything at a corner: glTF's primitives have
one material and one index for all attributes of a vertex, so that a vertex at a seam of the texture, at a hard edge, or
between materials becomes several. Every one of them tells which it was in the attribute ``_VERTEX``, so that they can
be welded again without guessing.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html#meshes
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import IntArray
from mixseq.polygons import Polygons
from mixseq.sequence import SequenceHeader
from mixseq.surface import FaceSet
from mixseq_io.colours import as_bytes, within_one
from mixseq_io.gltf.buffers import GENERATOR, INDICES, VERTICES, Json, Layout, append
from mixseq_io.gltf.morphs import MovingMesh, MovingPrimitive
from mixseq_io.scene_meshes import SceneMesh, split


@dataclass(frozen=True, eq=False)
class SplitPrimitive:
    """Triangles of one material, and their vertices.

    Parameters
    ----------
    vertices : (n,) int
        Vertex of the mesh that each glTF vertex is a copy of.
    normals : (n,) int
        Its group of corners that share a normal, see `mixseq.geometry.normals.shared_normals`.
    uvs : (n, 2) float32 or None
        Its texture coordinates, v upwards.
    colours : (n, 4) float32 or None
        Its colours.
    triangles : (m, 3) uint32
        Indices of glTF vertices.
    face_set : FaceSet or None
        The face set that the triangles are of.
    """

    vertices: IntArray
    normals: IntArray
    uvs: NDArray[np.float32] | None
    colours: NDArray[np.float32] | None
    triangles: NDArray[np.uint32]
    face_set: FaceSet | None


def split_corners(mesh: SceneMesh) -> list[SplitPrimitive]:
    """Split a mesh into primitives: one per face set that has polygons of its own, one for the rest.

    Vertices keep their order within a primitive. Those that no polygon uses are in the first one, without
    triangles, so that their number stays the same.
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
        chosen, copies = _distinct(list(some.values()))
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
    """Yield every owner, in ascending order, and the places where it is, in theirs."""
    order = np.argsort(owner, kind="stable")
    found, starts = np.unique(owner[order], return_index=True)
    yield from zip(found.tolist(), np.split(order, starts[1:])[: len(found)], strict=True)


def _distinct(columns: Sequence[IntArray]) -> tuple[IntArray, IntArray]:
    """Find rows of n columns ``(n,)`` of indices that are not the same."""
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
    """Return which of the face sets has each polygon ``(P,)``, -1 for none.

    Where they overlap, the first with a material wins, then the first.
    """
    owner = np.full(len(mesh.polygons.counts), -1, dtype=np.int32)
    numbers = [number for number, each in enumerate(mesh.face_sets) if distinguishes(each, mesh)]
    for number in sorted(numbers, key=lambda number: not mesh.face_sets[number].material)[::-1]:
        owner[mesh.face_sets[number].polygons] = number
    return owner


def distinguishes(face_set: FaceSet, mesh: SceneMesh) -> bool:
    """Whether a face set tells more than that these are all polygons of the mesh."""
    return bool(face_set.material) or face_set.polygons.size < len(mesh.polygons.counts)


_LARGEST_EXACT = 2**24
_SPARSE = 4
_LARGEST_SHORT = 2**16 - 1


def new_scene(header: SequenceHeader) -> tuple[Layout, list[MovingMesh]]:
    """Return a document with all of a sequence but its frames, and what of it will move.

    Objects without polygons are left out: glTF has no place for them.
    """
    layout, meshes = new_meshes(header)
    root = group(layout.document, [mesh.node for mesh in meshes], header)
    layout.document["scene"], layout.document["scenes"] = 0, [{"nodes": [root]}]
    return layout, meshes


def new_meshes(header: SequenceHeader) -> tuple[Layout, list[MovingMesh]]:
    """Return a document with the meshes of a sequence and a node for each, but without a scene."""
    layout = Layout({"asset": {"version": "2.0", "generator": GENERATOR}})
    scene_meshes = [scene_mesh for scene_mesh in split(header) if scene_mesh.polygons.counts.size]
    names = [header.name if len(scene_meshes) == 1 else scene_mesh.name for scene_mesh in scene_meshes]
    materials: dict[str, int] = {}
    return layout, [
        _new_mesh(layout, scene_mesh, name, materials)
        for scene_mesh, name in zip(scene_meshes, names, strict=True)
    ]


def group(document: Json, nodes: list[int], header: SequenceHeader, vacant: int | None = None) -> int:
    """Return the root of a sequence's nodes: the only one, or one above them; it shows the points upright.

    The one above them takes the place of the node `vacant`, if there is such a node.
    """
    entry = {**named(header.name), "children": nodes}
    if len(nodes) == 1:
        root = nodes[0]
    elif vacant is None:
        root = append(document, "nodes", entry)
    else:
        root = vacant
        document["nodes"][root] = entry
    document["nodes"][root].update(upright(header))
    return root


def upright(header: SequenceHeader) -> Json:
    """Return the transform of a node that shows points with Y up and in metres, as all of glTF is.

    Examples
    --------
    >>> times = np.zeros(1)
    >>> from mixseq.polygons import Polygons
    >>> one = Polygons.from_triangles([[0, 1, 2]])
    >>> upright(SequenceHeader(polygons=one, vertex_count=3, times=times))
    {}
    >>> upright(SequenceHeader(polygons=one, vertex_count=3, times=times, up_axis="Z"))["matrix"][4:7]
    [0.0, 0.0, -1.0]
    """
    columns = {"X": [(0, 1, 0), (-1, 0, 0), (0, 0, 1)], "Z": [(1, 0, 0), (0, 0, -1), (0, 1, 0)]}
    matrix = np.eye(4)
    matrix[:3, :3] = header.metres_per_unit * np.array(columns.get(header.up_axis, np.eye(3)))
    return {} if np.array_equal(matrix, np.eye(4)) else {"matrix": matrix.ravel().tolist()}


def named(name: str) -> Json:
    """Return the member ``name``, which glTF omits where there is none."""
    return {"name": name} if name else {}


def material_name(face_set: FaceSet) -> str:
    """Return what a material is called in glTF: the last name of a path, or the face set's name."""
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
        attributes["TEXCOORD_0"] = layout.add_array(upside_down(primitive.uvs), target=VERTICES)
    if primitive.colours is not None:
        attributes["COLOR_0"] = add_colours(layout, primitive.colours)
    entry: Json = {
        "attributes": attributes,
        "indices": layout.add_array(narrow(primitive.triangles.reshape(-1)), target=INDICES),
    }
    if primitive.face_set is not None:
        entry["material"] = material(layout.document, material_name(primitive.face_set), materials)
    moving = MovingPrimitive(entry, primitive.vertices, primitive.normals)
    add_vertex_numbers(layout, moving, scene_mesh.vertex_count)
    return moving


def upside_down(uvs: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return texture coordinates ``(n, 2)`` with v downwards, as glTF has them."""
    return (uvs * (1, -1) + (0, 1)).astype(np.float32)


def add_colours(layout: Layout, colours: NDArray[np.float32]) -> int:
    """Add colours ``(n, 4)``, as bytes if these are the same; return their accessor."""
    exact = as_bytes(colours)
    number = layout.add_array(within_one(colours) if exact is None else exact, target=VERTICES)
    if exact is not None:
        layout.document["accessors"][number]["normalized"] = True
    return number


def narrow(indices: NDArray[np.uint32]) -> NDArray[np.uint32] | NDArray[np.uint16]:
    """Return indices with two bytes each where that is enough; glTF keeps the largest number for itself."""
    return indices.astype(np.uint16) if indices.max(initial=0) < _LARGEST_SHORT else indices


def add_vertex_numbers(layout: Layout, primitive: MovingPrimitive, vertex_count: int) -> None:
    """Tell which vertex of the sequence's mesh each glTF vertex is; other programs ignore it.

    It is written as float32, since glTF allows no 32-bit integers in attributes, unless there are too many.
    """
    if vertex_count <= _LARGEST_EXACT:
        numbers = primitive.vertices.astype(np.float32)
        primitive.entry["attributes"]["_VERTEX"] = layout.add_array(numbers, target=VERTICES)


def material(document: Json, name: str, materials: dict[str, int]) -> int:
    """Return the number of the material of that name, a new one if need be; `materials` are those that are there."""
    if name in materials:
        return materials[name]
    plain = {
        **named(name),
        "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.8},
        "doubleSided": True,
    }
    materials[name] = append(document, "materials", plain)
    return materials[name]
