"""HDF5 models: a shape space and the signals of a sequence in it, readable and editable by hand.

::

    /                          format = "mixseq-model", version = 1, created_by, settings (JSON), space,
                               name, fps, up_axis, metres_per_unit, vertex_count
    /polygons/                 counts, indices
    /segmentation/             part_of_face, widths                         (mixed space)
    /segmentation/parts/       vertices, sizes                              (mixed space)
    /segmentation/joints/      faces, sizes                                 (mixed space)
    /space/                    scale; reference (all but vertex, basis); shapes, joint_faces (mixed space);
                               reference_lengths (edge space); fields (basis space)
    /space/skinning/           sizes, parts, weights                        (mixed space)
    /space/steadiness/         turns, centres, relation_turns, relation_points  (mixed space)
    /signals/time/             frames, times, values
    /signals/pose/             offset, matrix
    /signals/shape/            what vectors consist of, see `shape_blocks`
    /signals/placement/        times, rotations, translations
    /signals/correction/       times, rotations, translations               (mixed space)

See ``docs/file-format.md``. Compressed models have a layout of their own: `mixseq_io.coded.streams`.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mixseq.choices import PLACEMENTS, SPACES
from mixseq.errors import FormatError, InvalidSequenceError, OutputError, ReconstructionError, SettingsError
from mixseq.mesh.topology import Topology
from mixseq.segmentation.joints import Decomposition, make_joint
from mixseq.sequence.header import SequenceHeader
from mixseq.shells.gauss_newton import ShellSettings
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.signals.pose import PoseMap
from mixseq.spaces.base import ShapeSpace
from mixseq.spaces.edge import EdgeSettings, EdgeSpace
from mixseq.spaces.gradient import GradientSpace
from mixseq.spaces.lri import LRISpace
from mixseq.spaces.mixed.articulation import STEADINESS_RANGE, Steadiness
from mixseq.spaces.mixed.mixed_space import MixedSpace, Projection
from mixseq.spaces.vertex import BasisSpace, VertexSpace
from mixseq.types import Float, Index
from mixseq.version import __version__
from mixseq_io.hdf5.contents import MODEL_FORMAT, Contents, check_version, read_header
from mixseq_io.hdf5.datasets import (
    diagonals,
    floats,
    get_joined,
    get_lists,
    increasing,
    integers,
    put,
    put_joined,
    put_lists,
    put_text,
    read_scale,
    read_settings,
    write_header,
)

_SUM = 1e-9  # how far the weights of a vertex may be from one


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
        joint_faces=_mask(
            integers(path, file, "space/joint_faces", (None,), 0, len(topology.faces)), len(topology.faces)
        ),
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


def _mask(indices: Index, count: int) -> NDArray[np.bool_]:
    """Return a mask ``(count,)`` that is true at some indices."""
    mask = np.zeros(count, dtype=bool)
    mask[indices] = True
    return mask


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
    held = _mask(np.concatenate(parts), vertices)
    joint_faces = get_lists(path, file, "segmentation/joints", "faces", faces)
    return Decomposition(
        part_of_face=integers(path, file, "segmentation/part_of_face", (faces,), 0, len(parts)),
        parts=tuple(parts),
        joints=tuple(make_joint(topology, _mask(each, faces), held) for each in joint_faces),
        widths=integers(path, file, "segmentation/widths", (len(parts),), 1),
    )


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
            return {"connections": (len(space.edge_rows), 3, 3), "ends": (len(space.edge_rows), 2, 3)}
        case EdgeSpace():
            return {
                name: (size,)
                for name, size in zip(("lengths", "angles", "volumes"), space.block_sizes, strict=True)
            }
        case MixedSpace():
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
    put_text(file, "settings", json.dumps(settings, sort_keys=True))
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
    shell = ShellSettings(**read_settings(path, file, "shell", ShellSettings.__dataclass_fields__))
    settings = EdgeSettings(**read_settings(path, file, "edge", EDGE), shell=shell)
    return EdgeSpace(topology, scale, reference, lengths, settings)


_UNIT = 0.5  # quaternions are far from zero, which is no rotation


def write_signals(file: h5py.File, model: Model, space: StoredSpace) -> None:
    """Store the signals of a model in a space."""
    put(file, "signals/time/frames", model.times)
    put(file, "signals/time/times", model.time.times)
    put(file, "signals/time/values", model.time.values)
    put(file, "signals/pose/offset", model.pose.offset)
    put(file, "signals/pose/matrix", model.pose.matrix)
    _put_blocks(file, "signals/shape", shape_blocks(space), model.shapes)
    put(file, "signals/placement/times", model.placement.times)
    _put_blocks(file, "signals/placement", placement_blocks(space), model.placement.values)
    if space.correction_dim:
        put(file, "signals/correction/times", model.correction.times)
        _put_blocks(file, "signals/correction", correction_blocks(space), model.correction.values)


def read_signals(path: Path, file: Contents, header: SequenceHeader, space: StoredSpace) -> Model:
    """Read the signals of a model in a space."""
    pose = _read_pose(path, file)
    knots = increasing(path, file, "signals/time/times")
    time = Curve(knots, floats(path, file, "signals/time/values", (len(knots), pose.dim)))
    shapes = _get_blocks(path, file, "signals/shape", shape_blocks(space), len(pose.offset))
    placement = _read_placement(path, file, space)
    _check_frames(path, header, time=time, placement=placement)
    if not space.correction_dim:
        return Model(header, space, time, pose, shapes, placement)
    knots = increasing(path, file, "signals/correction/times")
    blocks = _get_blocks(path, file, "signals/correction", correction_blocks(space), len(knots))
    correction = Curve(knots, blocks)
    _check_frames(path, header, correction=correction)
    return Model(header, space, time, pose, shapes, placement, correction)


def _check_frames(path: Path, header: SequenceHeader, **curves: Curve) -> None:
    """Raise an error for frames outside the knots of a curve, named by signal."""
    first, last = header.times[0], header.times[-1]
    for name, curve in curves.items():
        if curve.start > first or curve.end < last:
            raise FormatError(
                f"{path}: signals/time/frames has times from {first:g} to {last:g} s, but "
                f"signals/{name}/times are only from {curve.start:g} to {curve.end:g} s"
            )


def _read_placement(path: Path, file: Contents, space: StoredSpace) -> Curve:
    knots = increasing(path, file, "signals/placement/times")
    placements = _get_blocks(path, file, "signals/placement", placement_blocks(space), len(knots))
    norms = np.linalg.norm(space.unpack_placements(placements).rotations, axis=2)
    if (norms < _UNIT).any():
        raise FormatError(
            f"{path}: signals/placement/rotations has quaternions that are nearly zero, no rotations"
        )
    return Curve(knots, placements)


def _put_blocks(file: h5py.File, group: str, blocks: Blocks, values: Float) -> None:
    """Store rows ``(m, D)`` as one dataset ``(m, ...)`` per block."""
    ends = np.cumsum([int(np.prod(shape)) for shape in blocks.values()])
    columns = np.split(values, ends[:-1], axis=1)
    for (name, shape), block in zip(blocks.items(), columns, strict=True):
        put(file, f"{group}/{name}", block.reshape(len(block), *shape))


def _get_blocks(path: Path, file: Contents, group: str, blocks: Blocks, count: int) -> Float:
    """Read the rows ``(m, D)`` stored by `_put_blocks`."""
    columns = []
    for name, shape in blocks.items():
        values = floats(path, file, f"{group}/{name}", (count, *shape))
        if shape[1:] == (4,) and not values.any(axis=(0, 2)).all():
            raise FormatError(f"{path}: {group}/{name} has quaternions that are always zero, no rotations")
        columns.append(values.reshape(count, int(np.prod(shape))))
    return np.concatenate(columns, axis=1)


def _read_pose(path: Path, file: Contents) -> PoseMap:
    """Read the pose signal."""
    offset = floats(path, file, "signals/pose/offset", (None,))
    matrix = floats(path, file, "signals/pose/matrix", (None, len(offset)))
    try:
        return PoseMap(offset, matrix)
    except SettingsError as error:
        sums = np.abs(matrix.sum(axis=1)).max(initial=0.0)
        raise FormatError(
            f"{path}: signals/pose: {error}; offset adds up to {offset.sum():.12g} and must to 1, "
            f"rows of matrix to {sums:.3g} at most and must to 0"
        ) from error


VERSION = 1


def write_model(file: h5py.File, model: Model) -> None:
    """Store a model in a new file; raises `OutputError` if its shape space is not one of mixseq's."""
    space = storable(model.space)
    put_text(file, "format", MODEL_FORMAT)
    file.attrs["version"] = VERSION
    put_text(file, "created_by", f"mixseq {__version__}")
    file.attrs["vertex_count"] = model.header.vertex_count
    write_header(file, model.header)
    write_space(file, space)
    write_signals(file, model, space)


def read_model(path: Path, file: Contents) -> Model:
    """Make a model from a file's contents."""
    check_version(path, file, VERSION)
    try:
        frames = increasing(path, file, "signals/time/frames")
        header = read_header(path, file, int(file.attrs["vertex_count"]), frames)
        return read_signals(path, file, header, read_space(path, file, header))
    except (InvalidSequenceError, SettingsError, ReconstructionError, IndexError) as error:
        raise FormatError(f"{path}: {error}; it is damaged") from error
