"""Mixed space of a model in HDF5: its parts, joints, and skinning weights."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mixseq.arrays import Float
from mixseq.choices import PLACEMENTS
from mixseq.errors import FormatError
from mixseq.segmentation.joints import Decomposition, make_joint
from mixseq.sequence import SequenceHeader
from mixseq.spaces import MixedSpace, Projection
from mixseq.spaces.mixed.articulation import STEADINESS_RANGE, Steadiness
from mixseq.topology import Topology
from mixseq_io.hdf5.contents import Contents
from mixseq_io.hdf5.datasets import (
    diagonals,
    floats,
    get_joined,
    get_lists,
    integers,
    put,
    put_joined,
    put_lists,
    read_scale,
    read_settings,
)

_SUM = 1e-9  # how far the weights of a vertex may be from one


def mixed_blocks(space: MixedSpace) -> dict[str, tuple[int, ...]]:
    """Return the blocks of a shape, as `shape_blocks`."""
    parts, relations = len(space.decomposition.parts), len(space.articulation.pairs)
    return {
        "lengths": (len(space.edge_ids),),
        "angles": (len(space.hinge_ids),),
        "unposed": (space.vertex_count, 3),
        "part_rotations": (parts, 4),
        "part_centres": (parts, 3),
        "relation_rotations": (relations, 4),
        "relation_points": (relations, 3),
    }


def write_mixed_space(file: h5py.File, space: MixedSpace) -> None:
    """Store a mixed space except for its scale and settings."""
    weights = space.skinning_weights
    put(file, "space/shapes", space.shapes)
    put(file, "space/reference", space.reference)
    put_joined(file, "space/skinning", "parts", np.diff(weights.indptr), weights.indices)
    put(file, "space/skinning/weights", weights.data)
    for name, values in space.articulation.steadiness._asdict().items():
        put(file, f"space/steadiness/{name}", values)
    put(file, "space/joint_faces", np.flatnonzero(space.joint_faces).astype(np.int32))
    _write_segmentation(file, space.decomposition)


def read_mixed_space(path: Path, file: Contents, header: SequenceHeader) -> MixedSpace:
    """Read a mixed space."""
    topology = Topology(header.faces, header.vertex_count)
    decomposition = _read_segmentation(path, file, topology)
    steadiness = Steadiness(*(_read_steadiness(path, file, name) for name in Steadiness._fields))
    space = MixedSpace(
        topology=topology,
        decomposition=decomposition,
        scale=read_scale(path, file),
        shapes=diagonals(path, file, "space/shapes", (sum(map(len, decomposition.parts)), 3)),
        reference=diagonals(path, file, "space/reference", (header.vertex_count, 3)),
        skinning_weights=_read_skinning(path, file, header.vertex_count, len(decomposition.parts)),
        steadiness=steadiness,
        joint_faces=_read_marks(path, file, "space/joint_faces", len(topology.faces)),
        projection=_read_projection(path, file),
    )
    counts = len(decomposition.parts), len(space.articulation.pairs)
    for name, values in steadiness._asdict().items():
        if len(values) != counts[name.startswith("relation")]:
            raise FormatError(f"{path}: space/steadiness/{name} does not fit the segmentation; it is damaged")
    return space


def _read_steadiness(path: Path, file: Contents, name: str) -> Float:
    values = floats(path, file, f"space/steadiness/{name}", (None,))
    low, high = STEADINESS_RANGE
    if ((values < low) | (values > high)).any():
        raise FormatError(
            f"{path}: space/steadiness/{name} has numbers outside {low:g} to {high:g}; it is damaged"
        )
    return values


def _read_projection(path: Path, file: Contents) -> Projection:
    found = read_settings(path, file, "projection", Projection.__dataclass_fields__)
    if found["placement"] not in PLACEMENTS:
        raise FormatError(f"{path}: the placement {found['placement']!r} is not known")
    return Projection(**found)


def _read_marks(path: Path, file: Contents, name: str, count: int) -> NDArray[np.bool_]:
    """Return a mask ``(count,)`` from stored indices."""
    marks = np.zeros(count, dtype=bool)
    marks[integers(path, file, name, (None,), 0, count)] = True
    return marks


def _read_skinning(path: Path, file: Contents, vertices: int, parts: int) -> sparse.csr_array:
    sizes, items = get_joined(path, file, "space/skinning", "parts", parts)
    ends = np.append(0, np.cumsum(sizes))
    weights = floats(path, file, "space/skinning/weights", (int(ends[-1]),))
    if len(sizes) != vertices:
        raise FormatError(
            f"{path}: space/skinning has {len(sizes)} rows for {vertices} vertices; it is damaged"
        )
    if (weights <= 0).any() or np.abs(np.add.reduceat(weights, ends[:-1]) - 1.0).max() > _SUM:
        raise FormatError(
            f"{path}: space/skinning/weights must be positive and add up to one for every vertex"
        )
    return sparse.csr_array((weights, items, ends), shape=(vertices, parts))


def _write_segmentation(file: h5py.File, decomposition: Decomposition) -> None:
    put(file, "segmentation/part_of_face", decomposition.part_of_face.astype(np.int32))
    put(file, "segmentation/widths", decomposition.widths.astype(np.int32))
    put_lists(file, "segmentation/parts", "vertices", decomposition.parts)
    put_lists(file, "segmentation/joints", "faces", [joint.face_ids for joint in decomposition.joints])


def _read_segmentation(path: Path, file: Contents, topology: Topology) -> Decomposition:
    """Read a mesh's parts and joints."""
    faces, vertices = len(topology.faces), topology.vertex_count
    parts = get_lists(path, file, "segmentation/parts", "vertices", vertices)
    if not parts:
        raise FormatError(f"{path}: the segmentation has no parts; it is damaged")
    held = np.zeros(vertices, dtype=bool)
    held[np.concatenate(parts)] = True
    joints = []
    for joint_faces in get_lists(path, file, "segmentation/joints", "faces", faces):
        inside = np.zeros(faces, dtype=bool)
        inside[joint_faces] = True
        joints.append(make_joint(topology, inside, held))
    return Decomposition(
        part_of_face=integers(path, file, "segmentation/part_of_face", (faces,), 0, len(parts)),
        parts=tuple(parts),
        joints=tuple(joints),
        widths=integers(path, file, "segmentation/widths", (len(parts),), 1),
    )
