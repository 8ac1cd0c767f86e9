"""The mixed space of a model in HDF5: its parts and joints, links and trust."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np

from mixseq.errors import FormatError
from mixseq.reconstruction.anchored import AnchoredPlacement
from mixseq.reconstruction.links import Links
from mixseq.segmentation.joints import Decomposition, make_joint
from mixseq.sequence import SequenceHeader
from mixseq.spaces import MixedSpace
from mixseq.spaces.mixed import PLACEMENTS
from mixseq.topology import Topology
from mixseq_io.hdf5.arrays import Float, floats, get_lists, integers, put, put_lists
from mixseq_io.hdf5.settings import read_scale, read_shell

_ROTATION = 1e-9  # how far a stored rotation may be from one


def mixed_blocks(space: MixedSpace) -> dict[str, tuple[int, ...]]:
    """Return what a vector consists of before its poses, as `shape_blocks` does."""
    lengths, angles, parts = space.sizes[:3]
    return {"lengths": (lengths,), "angles": (angles,), "parts": (parts // 3, 3)}


def write_mixed_space(file: h5py.File, space: MixedSpace) -> None:
    """Store what a mixed space has beside its scale and settings."""
    file["space"].attrs["placement"] = space.placement
    for name in ("shapes", "reference_lengths", "reference", "trust"):
        put(file, f"space/{name}", getattr(space, name))
    put(file, "space/links/parts", space.links.parts.astype(np.int32))
    for name in ("pivots", "rests", "own_weights", "weights"):
        put(file, f"space/links/{name}", getattr(space.links, name))
    _write_segmentation(file, space.decomposition)


def read_mixed_space(path: Path, file: h5py.File, header: SequenceHeader) -> MixedSpace:
    """Read a mixed space.

    Raises
    ------
    FormatError
        If something in it is missing, damaged or contradicts the rest.
    """
    links, trust = _read_links(path, file), _weights(path, file, "space/trust", (None,))
    space = replace(read_untaught(path, file, header), links=links, trust=trust)
    _check_learnt(path, space)
    return space


def read_untaught(path: Path, file: h5py.File, header: SequenceHeader) -> MixedSpace:
    """Read a mixed space without what a sequence teaches about the time between its frames: links and trust."""
    topology = Topology(header.faces, header.vertex_count)
    placement, scale = str(file["space"].attrs["placement"]), read_scale(path, file)
    if placement not in PLACEMENTS:
        raise FormatError(f"{path}: the placement {placement!r} is not known")
    decomposition = _read_segmentation(path, file, topology)
    space = MixedSpace(
        topology=topology,
        decomposition=decomposition,
        placement=placement,
        scale=scale,
        shapes=floats(path, file, "space/shapes", (sum(map(len, decomposition.parts)), 3)),
        reference_lengths=floats(path, file, "space/reference_lengths", (None,)),
        reference=floats(path, file, "space/reference", (header.vertex_count, 3)),
        links=Links.none(len(decomposition.parts)),
        trust=np.zeros(0),
        settings=read_shell(path, file),
    )
    if len(space.reference_lengths) != space.sizes[0]:
        raise FormatError(f"{path}: space/reference_lengths does not fit the segmentation; it is damaged")
    return space


def _write_segmentation(file: h5py.File, decomposition: Decomposition) -> None:
    put(file, "segmentation/part_of_face", decomposition.part_of_face.astype(np.int32))
    put(file, "segmentation/widths", decomposition.widths.astype(np.int32))
    put_lists(file, "segmentation/parts", "vertices", decomposition.parts)
    put_lists(file, "segmentation/joints", "faces", [joint.face_ids for joint in decomposition.joints])


def _read_segmentation(path: Path, file: h5py.File, topology: Topology) -> Decomposition:
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


def _read_links(path: Path, file: h5py.File) -> Links:
    parts = integers(path, file, "space/links/parts", (None, 2), 0)
    return Links(
        parts=parts,
        pivots=floats(path, file, "space/links/pivots", (len(parts), 2, 3)),
        rests=floats(path, file, "space/links/rests", (len(parts), 3, 3)),
        own_weights=_weights(path, file, "space/links/own_weights", (None, 2)),
        weights=_weights(path, file, "space/links/weights", (len(parts), 2)),
    )


def _weights(path: Path, file: h5py.File, name: str, shape: tuple[int | None, ...]) -> Float:
    weights = floats(path, file, name, shape)
    if (weights <= 0).any():
        raise FormatError(f"{path}: {name} has weights that are not positive")
    return weights


def _check_learnt(path: Path, space: MixedSpace) -> None:
    """Refuse links that are none between the parts, and trust in other joints than those that are solved."""
    links, projection = space.links, space.projection
    posed = len(projection.posed)
    solved = len(projection.rows.joints) if isinstance(projection, AnchoredPlacement) else 0
    if len(links) and space.placement == "free":
        raise FormatError(f"{path}: space/links/parts has links, but the free placement has none")
    if len(links) and (links.parts.max() >= posed or (links.parts[:, 0] >= links.parts[:, 1]).any()):
        raise FormatError(f"{path}: space/links/parts must be pairs i < j of the parts 0 to {posed - 1}")
    if len(links.own_weights) != posed:
        raise FormatError(
            f"{path}: space/links/own_weights has {len(links.own_weights)} rows for {posed} poses"
        )
    if len(space.trust) != solved:
        raise FormatError(f"{path}: space/trust has {len(space.trust)} rows for {solved} solved joints")
    unturned = links.rests @ np.swapaxes(links.rests, 1, 2) - np.eye(3)
    if np.abs(unturned).max(initial=0.0) > _ROTATION or (np.linalg.det(links.rests) < 0).any():
        raise FormatError(f"{path}: space/links/rests has matrices that are no rotations")
