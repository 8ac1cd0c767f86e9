"""Shape space of a model in HDF5, and the blocks of its vectors."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import h5py

from mixseq.arrays import Float
from mixseq.choices import SPACES
from mixseq.errors import FormatError, OutputError
from mixseq.sequence import SequenceHeader
from mixseq.spaces import (
    EdgeSettings,
    EdgeSpace,
    GradientSpace,
    LRISpace,
    MixedSpace,
    ShapeSpace,
    VertexSpace,
)
from mixseq.spaces.basis import BasisSpace
from mixseq.topology import Topology
from mixseq_io.hdf5.contents import Contents
from mixseq_io.hdf5.datasets import (
    diagonals,
    floats,
    put,
    read_scale,
    read_settings,
    read_shell,
    write_settings,
)
from mixseq_io.hdf5.h5_writing import put_text
from mixseq_io.hdf5.stored_mixed import mixed_blocks, read_mixed_space, write_mixed_space

StoredSpace = MixedSpace | VertexSpace | GradientSpace | LRISpace | EdgeSpace | BasisSpace
Blocks = dict[str, tuple[int, ...]]
"""Names of datasets in the order of the vector, with their shapes."""

EDGE = ("projection", "volume")
"""Group of the edge space's settings; those of its fits have their own."""

KNOWN = (*SPACES, BasisSpace.name)
"""Names of the spaces that files can hold."""


def storable(space: ShapeSpace) -> StoredSpace:
    """Return the space if files can hold it; else raise an error."""
    if isinstance(space, StoredSpace):
        return space
    raise OutputError(f"files hold models in the spaces {', '.join(KNOWN)}, not in {type(space).__name__}")


def shape_blocks(space: StoredSpace) -> Blocks:
    """Return the blocks of a key shape: datasets of `signals/shape`."""
    match space:
        case VertexSpace():
            return {"positions": (space.vertex_count, 3)}
        case BasisSpace():
            return {"coefficients": (len(space.basis), 3)}
        case GradientSpace():
            return {"turns": (len(space.topology.faces), 3), "stretches": (len(space.topology.faces), 6)}
        case LRISpace():
            return {"connections": (len(space.edges), 3, 3), "ends": (len(space.edges), 2, 3)}
        case EdgeSpace():
            return {
                name: (size,)
                for name, size in zip(("lengths", "angles", "volumes"), space.sizes, strict=True)
            }
        case MixedSpace():
            return mixed_blocks(space)


def placement_blocks(space: StoredSpace) -> Blocks:
    """Return the blocks of a placement: datasets of `signals/placement`."""
    return {"rotations": (space.rotation_count, 4), "translations": (space.centre_count, 3)}


def correction_blocks(space: StoredSpace) -> Blocks:
    """Return the blocks of a correction: datasets of `signals/correction`; none without parts."""
    parts = space.correction_dim // 6
    return {"rotations": (parts, 3), "translations": (parts, 3)} if parts else {}


def write_space(file: h5py.File, space: StoredSpace) -> None:
    """Store a shape space."""
    settings = {}
    if isinstance(space, MixedSpace):
        settings = {"projection": asdict(space.projection)}
    if isinstance(space, EdgeSpace):
        edge = {name: getattr(space.settings, name) for name in EDGE}
        settings = {"shell": asdict(space.shell), "edge": edge}
    write_settings(file, settings)
    put_text(file, "space", space.name)
    file.require_group("space").attrs["scale"] = space.scale
    file.flush()
    match space:
        case MixedSpace():
            write_mixed_space(file, space)
        case BasisSpace():
            put(file, "space/fields", space.basis)
        case GradientSpace() | LRISpace():
            put(file, "space/reference", space.reference)
        case EdgeSpace():
            put(file, "space/reference", space.reference)
            put(file, "space/reference_lengths", space.reference_lengths)


def read_space(path: Path, file: Contents, header: SequenceHeader) -> StoredSpace:
    """Read a shape space."""
    kind = file.text("space")
    if kind not in KNOWN:
        raise FormatError(f"{path}: the space {kind!r} is not known; {', '.join(KNOWN)} are")
    if kind == MixedSpace.name:
        return read_mixed_space(path, file, header)
    scale = read_scale(path, file)
    if kind == VertexSpace.name:
        return VertexSpace(header.vertex_count, scale)
    if kind == BasisSpace.name:
        return _read_basis_space(path, file, header.vertex_count, scale)
    topology = Topology(header.faces, header.vertex_count)
    reference = diagonals(path, file, "space/reference", (header.vertex_count, 3))
    if kind == GradientSpace.name:
        return GradientSpace(topology, scale, reference)
    if kind == LRISpace.name:
        return LRISpace(topology, scale, reference)
    return _read_edge_space(path, file, topology, scale, reference)


def _read_basis_space(path: Path, file: Contents, vertices: int, scale: float) -> BasisSpace:
    fields = floats(path, file, "space/fields", (None, vertices))
    zero = ~fields.any(axis=1)
    if zero.any():
        raise FormatError(f"{path}: space/fields is zero everywhere in row {int(zero.argmax())}")
    return BasisSpace(fields, scale)


def _read_edge_space(
    path: Path, file: Contents, topology: Topology, scale: float, reference: Float
) -> EdgeSpace:
    lengths = diagonals(path, file, "space/reference_lengths", (len(topology.edges),))
    if (lengths < 0).any():
        raise FormatError(f"{path}: space/reference_lengths has lengths below zero")
    settings = EdgeSettings(**read_settings(path, file, "edge", EDGE), shell=read_shell(path, file))
    return EdgeSpace(topology, scale, reference, lengths, settings)
