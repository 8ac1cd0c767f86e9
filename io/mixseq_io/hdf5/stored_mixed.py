"""The mixed space of a model in HDF5: its parts and joints, and how vertices follow parts."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mixseq.choices import PLACEMENTS
from mixseq.errors import FormatError
from mixseq.segmentation.joints import Decomposition, make_joint
from mixseq.sequence import SequenceHeader
from mixseq.spaces import AnchoredSpace, FreeSpace, MixedSpace
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
    read_relaxation,
    read_scale,
)
from mixseq_io.hdf5.h5_writing import put_text

_SUM = 1e-9  # how far the shares of a vertex may be from one


def mixed_blocks(space: MixedSpace) -> dict[str, tuple[int, ...]]:
    """Return what a vector consists of before its poses, as `shape_blocks` does."""
    joints = {"lengths": (len(space.edge_ids),), "angles": (len(space.hinge_ids),)}
    if isinstance(space, AnchoredSpace):
        sides = len(space.seams.faces)
        return {**joints, "unposed": (space.topology.vertex_count, 3), "sides": (sides, 2, 3)}
    return {**joints, "parts": (len(space.shapes), 3)}


def write_mixed_space(file: h5py.File, space: MixedSpace) -> None:
    """Store what a mixed space has beside its scale and settings."""
    put_text(file["space"], "placement", space.placement)
    put(file, "space/shapes", space.shapes)
    put(file, "space/reference", space.reference)
    if isinstance(space, FreeSpace):
        put(file, "space/reference_lengths", space.reference_lengths)
    if isinstance(space, AnchoredSpace):
        shares = space.shares
        put_joined(file, "space/shares", "parts", np.diff(shares.indptr), shares.indices)
        put(file, "space/shares/weights", shares.data)
        put(file, "space/free", np.flatnonzero(space.free).astype(np.int32))
        put(file, "space/known", np.flatnonzero(space.known).astype(np.int32))
    _write_segmentation(file, space.decomposition)


def read_mixed_space(path: Path, file: Contents, header: SequenceHeader) -> MixedSpace:
    """Read a mixed space.

    Raises
    ------
    FormatError
        If something in it is missing, damaged or contradicts the rest.
    """
    if _read_placement(path, file) == "free":
        return _read_free(path, file, header)
    topology, scale = Topology(header.faces, header.vertex_count), read_scale(path, file)
    decomposition = _read_segmentation(path, file, topology)
    shapes = diagonals(path, file, "space/shapes", (sum(map(len, decomposition.parts)), 3))
    reference = diagonals(path, file, "space/reference", (header.vertex_count, 3))
    shares = _read_shares(path, file, header.vertex_count, len(decomposition.parts))
    return AnchoredSpace(
        topology=topology,
        decomposition=decomposition,
        scale=scale,
        shapes=shapes,
        reference=reference,
        shares=shares,
        free=_read_marks(path, file, "space/free", header.vertex_count),
        known=_read_marks(path, file, "space/known", len(topology.faces)),
        relaxation=read_relaxation(path, file),
    )


def _read_marks(path: Path, file: Contents, name: str, count: int) -> NDArray[np.bool_]:
    """Read which of so many are marked: their numbers."""
    marks = np.zeros(count, dtype=bool)
    marks[integers(path, file, name, (None,), 0, count)] = True
    return marks


def _read_placement(path: Path, file: Contents) -> str:
    """Read how parts are placed."""
    placement = file.text("placement", "space")
    if placement not in PLACEMENTS:
        raise FormatError(f"{path}: the placement {placement!r} is not known")
    return placement


def _read_free(path: Path, file: Contents, header: SequenceHeader) -> FreeSpace:
    """Read a mixed space in the free placement."""
    topology = Topology(header.faces, header.vertex_count)
    decomposition = _read_segmentation(path, file, topology)
    space = FreeSpace(
        topology=topology,
        decomposition=decomposition,
        scale=read_scale(path, file),
        shapes=diagonals(path, file, "space/shapes", (sum(map(len, decomposition.parts)), 3)),
        reference=diagonals(path, file, "space/reference", (header.vertex_count, 3)),
        reference_lengths=diagonals(path, file, "space/reference_lengths", (None,)),
        relaxation=read_relaxation(path, file),
    )
    if len(space.reference_lengths) != len(space.edge_ids):
        raise FormatError(f"{path}: space/reference_lengths does not fit the segmentation; it is damaged")
    return space


def _read_shares(path: Path, file: Contents, vertices: int, parts: int) -> sparse.csr_array:
    sizes, items = get_joined(path, file, "space/shares", "parts", parts)
    ends = np.append(0, np.cumsum(sizes))
    weights = floats(path, file, "space/shares/weights", (int(ends[-1]),))
    if len(sizes) != vertices:
        raise FormatError(
            f"{path}: space/shares has {len(sizes)} rows for {vertices} vertices; it is damaged"
        )
    if (weights <= 0).any() or np.abs(np.add.reduceat(weights, ends[:-1]) - 1.0).max() > _SUM:
        raise FormatError(f"{path}: space/shares/weights must be positive and add up to one for every vertex")
    return sparse.csr_array((weights, items, ends), shape=(vertices, parts))


def _write_segmentation(file: h5py.File, decomposition: Decomposition) -> None:
    put(file, "segmentation/part_of_face", decomposition.part_of_face.astype(np.int32))
    put(file, "segmentation/widths", decomposition.widths.astype(np.int32))
    put_lists(file, "segmentation/parts", "vertices", decomposition.parts)
    put_lists(file, "segmentation/joints", "faces", [joint.face_ids for joint in decomposition.joints])


def _read_segmentation(path: Path, file: Contents, topology: Topology) -> Decomposition:
    """Read the parts and joints of a mesh."""
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
