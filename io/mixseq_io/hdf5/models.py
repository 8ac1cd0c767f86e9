"""Read and write HDF5 models: a shape space and the signals of a sequence, in datasets that users may edit.

``docs/file-format.md`` describes all datasets and attributes, also those of compressed models (`mixseq_io.coded`).
"""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import h5py
import numpy as np
from scipy import sparse

from mixseq.choices import PLACEMENTS, SPACES
from mixseq.errors import FormatError, InvalidSequenceError, OutputError, ReconstructionError, SettingsError
from mixseq.mesh.topology import Topology
from mixseq.segmentation.joints import Decomposition, make_joint
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.provenance import Provenance
from mixseq.shells.fitting import ShellSettings
from mixseq.signals.bodies import Body
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.signals.pose import PoseMap
from mixseq.spaces.base import ShapeSpace, VertexSpace
from mixseq.spaces.edge import EdgeSettings, EdgeSpace
from mixseq.spaces.gradient import GradientSpace
from mixseq.spaces.lri import LRISpace
from mixseq.spaces.mixed.articulation import STEADINESS_RANGE, Steadiness
from mixseq.spaces.mixed.mixed_space import MixedSpace, Projection
from mixseq.types import Float, index_mask
from mixseq.version import __version__
from mixseq_io.hdf5.contents import MODEL_FORMAT, Contents, bodies_of, check_version, read_header
from mixseq_io.hdf5.datasets import (
    MAX_LENGTH_DIAGONALS,
    body_groups,
    read_floats,
    read_increasing_times,
    read_index_lists,
    read_integers,
    read_ragged,
    read_scale,
    read_settings,
    write_array,
    write_compact,
    write_header,
    write_index_lists,
    write_ragged,
    write_text,
)

MODEL_VERSION = 1
_WEIGHT_SUM_TOLERANCE = 1e-9
_MIN_QUATERNION_NORM = 0.5
_MAX_TURN = 2.0


def write_mixed_space(file: h5py.Group, space: MixedSpace) -> None:
    """Store a mixed space except for its scale and settings."""
    weights = space.skinning_weights
    write_compact(file, "space/shapes", space.shapes)
    write_compact(file, "space/reference", space.reference)
    write_ragged(file, "space/skinning", "parts", np.diff(weights.indptr), weights.indices)
    write_compact(file, "space/skinning/weights", weights.data)
    for name, values in space.articulation.steadiness._asdict().items():
        write_compact(file, f"space/steadiness/{name}", values)
    write_compact(file, "space/joint_faces", np.flatnonzero(space.joint_faces).astype(np.int32))
    decomposition = space.decomposition
    write_compact(file, "segmentation/part_of_face", decomposition.part_of_face.astype(np.int32))
    write_compact(file, "segmentation/widths", decomposition.widths.astype(np.int32))
    write_index_lists(file, "segmentation/parts", "vertices", decomposition.parts)
    joint_faces = [joint.face_ids for joint in decomposition.joints]
    write_index_lists(file, "segmentation/joints", "faces", joint_faces)


def read_mixed_space(file: Contents, header: SequenceHeader) -> MixedSpace:
    """Read a mixed space."""
    topology = Topology(header.faces, header.vertex_count)
    face_count = len(topology.faces)
    decomposition = _read_segmentation(file, topology)
    shape_rows = sum(map(len, decomposition.parts))
    projection = read_settings(file, "projection", Projection.__dataclass_fields__)
    if projection["placement"] not in PLACEMENTS:
        raise FormatError(f"{file.path}: the placement {projection['placement']!r} is not known")
    steadiness = Steadiness(*(_read_steadiness(file, name) for name in Steadiness._fields))
    space = MixedSpace(
        topology=topology,
        decomposition=decomposition,
        scale=read_scale(file),
        shapes=read_floats(file, "space/shapes", (shape_rows, 3), MAX_LENGTH_DIAGONALS),
        reference=read_floats(file, "space/reference", (header.vertex_count, 3), MAX_LENGTH_DIAGONALS),
        skinning_weights=_read_skinning(file, header.vertex_count, len(decomposition.parts)),
        steadiness=steadiness,
        joint_faces=index_mask(read_integers(file, "space/joint_faces", (None,), 0, face_count), face_count),
        projection=Projection(**projection),
    )
    counts = len(decomposition.parts), len(space.articulation.pairs)
    for name, values in steadiness._asdict().items():
        if len(values) != counts[name.startswith("relation")]:
            raise FormatError(f"{file.path}: space/steadiness/{name} does not fit the segmentation")
    return space


def _read_steadiness(file: Contents, name: str) -> Float:
    values = read_floats(file, f"space/steadiness/{name}", (None,))
    low, high = STEADINESS_RANGE
    if ((values < low) | (values > high)).any():
        raise FormatError(
            f"{file.path}: space/steadiness/{name} has numbers outside {low:g} to {high:g}; it is damaged"
        )
    return values


def _read_skinning(file: Contents, vertex_count: int, part_count: int) -> sparse.csr_array:
    sizes, parts = read_ragged(file, "space/skinning", "parts", part_count)
    row_starts = np.append(0, np.cumsum(sizes))
    weights = read_floats(file, "space/skinning/weights", (int(row_starts[-1]),))
    if len(sizes) != vertex_count:
        raise FormatError(
            f"{file.path}: space/skinning has {len(sizes)} rows for {vertex_count} vertices; it is damaged"
        )
    sum_errors = np.abs(np.add.reduceat(weights, row_starts[:-1]) - 1.0)
    if (weights <= 0).any() or sum_errors.max() > _WEIGHT_SUM_TOLERANCE:
        raise FormatError(f"{file.path}: space/skinning/weights must be positive and add up to one for every vertex")
    return sparse.csr_array((weights, parts, row_starts), shape=(vertex_count, part_count))


def _read_segmentation(file: Contents, topology: Topology) -> Decomposition:
    face_count, vertex_count = len(topology.faces), topology.vertex_count
    parts = read_index_lists(file, "segmentation/parts", "vertices", vertex_count)
    if not parts:
        raise FormatError(f"{file.path}: the segmentation has no parts; it is damaged")
    in_parts = index_mask(np.concatenate(parts), vertex_count)
    joint_faces = read_index_lists(file, "segmentation/joints", "faces", face_count)
    return Decomposition(
        part_of_face=read_integers(file, "segmentation/part_of_face", (face_count,), 0, len(parts)),
        parts=tuple(parts),
        joints=tuple(make_joint(topology, index_mask(ids, face_count), in_parts) for ids in joint_faces),
        widths=read_integers(file, "segmentation/widths", (len(parts),), 1),
    )


StoredSpace = MixedSpace | VertexSpace | GradientSpace | LRISpace | EdgeSpace
Blocks = dict[str, tuple[int, ...]]
"""Shape of each dataset by name, in the order of the corresponding blocks in a vector."""

EDGE_SETTINGS = ("projection", "volume")
"""Settings of the edge space that are stored in the group "edge"; the group "shell" has those of its shell fits."""


def shape_blocks(space: StoredSpace) -> Blocks:
    """Return the blocks of shape vectors, which are datasets in `signals/shape`."""
    match space:
        case VertexSpace():
            return {"positions": (space.vertex_count, 3)}
        case GradientSpace():
            return {"turns": (len(space.topology.faces), 3), "stretches": (len(space.topology.faces), 6)}
        case LRISpace():
            return {"connections": (len(space.edge_rows), 3, 3), "ends": (len(space.edge_rows), 2, 3)}
        case EdgeSpace():
            return {
                name: (size,) for name, size in zip(("lengths", "angles", "volumes"), space.block_sizes, strict=True)
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
    """Return the blocks of placement vectors, which are datasets in `signals/placement`."""
    return {"rotations": (space.rotation_count, 4), "translations": (space.centre_count, 3)}


def correction_blocks(space: StoredSpace) -> Blocks:
    """Return the blocks of correction vectors, datasets in `signals/correction`; a space without parts has none."""
    parts = space.correction_dim // 6
    return {"rotations": (parts, 3), "translations": (parts, 3)} if parts else {}


def write_space(file: h5py.Group, space: StoredSpace) -> None:
    """Store a shape space."""
    settings = {}
    if isinstance(space, MixedSpace):
        settings = {"projection": asdict(space.projection)}
    if isinstance(space, EdgeSpace):
        edge = {name: getattr(space.settings, name) for name in EDGE_SETTINGS}
        settings = {"shell": asdict(space.shell), "edge": edge}
    write_text(file, "settings", json.dumps(settings, sort_keys=True))
    write_text(file, "space", space.name)
    file.require_group("space").attrs["scale"] = space.scale
    file.file.flush()
    match space:
        case MixedSpace():
            write_mixed_space(file, space)
        case GradientSpace() | LRISpace():
            write_compact(file, "space/reference", space.reference)
        case EdgeSpace():
            write_compact(file, "space/reference", space.reference)
            write_compact(file, "space/reference_lengths", space.reference_lengths)


def read_space(file: Contents, header: SequenceHeader) -> StoredSpace:
    """Read a shape space."""
    kind = file.text("space")
    if kind not in SPACES:
        raise FormatError(f"{file.path}: the space {kind!r} is not known; {', '.join(SPACES)} are")
    if kind == MixedSpace.name:
        return read_mixed_space(file, header)
    scale = read_scale(file)
    if kind == VertexSpace.name:
        return VertexSpace(header.vertex_count, scale)
    topology = Topology(header.faces, header.vertex_count)
    reference = read_floats(file, "space/reference", (header.vertex_count, 3), MAX_LENGTH_DIAGONALS)
    if kind == GradientSpace.name:
        return GradientSpace(topology, scale, reference)
    if kind == LRISpace.name:
        return LRISpace(topology, scale, reference)
    return _read_edge_space(file, topology, scale, reference)


def _read_edge_space(file: Contents, topology: Topology, scale: float, reference: Float) -> EdgeSpace:
    lengths = read_floats(file, "space/reference_lengths", (len(topology.edges),), MAX_LENGTH_DIAGONALS)
    if (lengths < 0).any():
        raise FormatError(f"{file.path}: space/reference_lengths has negative lengths")
    shell = ShellSettings(**read_settings(file, "shell", ShellSettings.__dataclass_fields__))
    settings = EdgeSettings(**read_settings(file, "edge", EDGE_SETTINGS), shell=shell)
    return EdgeSpace(topology, scale, reference, lengths, settings)


def write_signals(file: h5py.Group, model: Model, space: StoredSpace) -> None:
    """Store the signals of a model, whose shape vectors belong to the given space."""
    write_compact(file, "signals/time/frames", model.times)
    write_compact(file, "signals/time/times", model.time.times)
    write_compact(file, "signals/time/values", model.time.values)
    write_compact(file, "signals/pose/offset", model.pose.offset)
    write_compact(file, "signals/pose/matrix", model.pose.matrix)
    _write_blocks(file, "signals/shape", shape_blocks(space), model.shapes)
    write_compact(file, "signals/placement/times", model.placement.times)
    _write_blocks(file, "signals/placement", placement_blocks(space), model.placement.values)
    if space.correction_dim:
        write_compact(file, "signals/correction/times", model.correction.times)
        _write_blocks(file, "signals/correction", correction_blocks(space), model.correction.values)


def read_signals(file: Contents, header: SequenceHeader, space: StoredSpace) -> Model:
    """Read signals whose shape vectors belong to the given space, and return the model."""
    pose = _read_pose(file)
    knots = read_increasing_times(file, "signals/time/times", of_curve=True)
    time = Curve(knots, read_floats(file, "signals/time/values", (len(knots), pose.dim)))
    shapes = _read_blocks(file, "signals/shape", shape_blocks(space), len(pose.offset))
    placement_knots = read_increasing_times(file, "signals/placement/times", of_curve=True)
    placements = _read_blocks(file, "signals/placement", placement_blocks(space), len(placement_knots))
    if (np.linalg.norm(space.unpack_placements(placements).rotations, axis=2) < _MIN_QUATERNION_NORM).any():
        raise FormatError(f"{file.path}: signals/placement/rotations has quaternions that are nearly zero")
    placement = Curve(placement_knots, placements)
    _check_time_range(file, header, time=time, placement=placement)
    if not space.correction_dim:
        return Model(header, space, time, pose, shapes, placement)
    knots = read_increasing_times(file, "signals/correction/times", of_curve=True)
    blocks = _read_blocks(file, "signals/correction", correction_blocks(space), len(knots))
    correction = Curve(knots, blocks)
    _check_time_range(file, header, correction=correction)
    return Model(header, space, time, pose, shapes, placement, correction)


def _check_time_range(file: Contents, header: SequenceHeader, **curves: Curve) -> None:
    """Raise an error if a curve does not cover all frames; keyword names are names of signals."""
    first, last = header.times[0], header.times[-1]
    for name, curve in curves.items():
        if curve.start > first or curve.end < last:
            raise FormatError(
                f"{file.path}: signals/time/frames has times from {first:g} to {last:g} s, but "
                f"signals/{name}/times are only from {curve.start:g} to {curve.end:g} s"
            )


def _write_blocks(file: h5py.Group, group: str, blocks: Blocks, values: Float) -> None:
    """Store vectors ``(m, D)`` in one dataset ``(m, ...)`` per block."""
    ends = np.cumsum([int(np.prod(shape)) for shape in blocks.values()])
    columns = np.split(values, ends[:-1], axis=1)
    for (name, shape), block in zip(blocks.items(), columns, strict=True):
        write_compact(file, f"{group}/{name}", block.reshape(len(block), *shape))


def _read_blocks(file: Contents, group: str, blocks: Blocks, count: int) -> Float:
    """Read vectors ``(m, D)`` stored by `_write_blocks`."""
    columns = []
    for name, shape in blocks.items():
        values = read_floats(file, f"{group}/{name}", (count, *shape))
        if shape[1:] == (4,) and not values.any(axis=(0, 2)).all():
            raise FormatError(f"{file.path}: {group}/{name} has quaternions that are always zero")
        columns.append(values.reshape(count, int(np.prod(shape))))
    return np.concatenate(columns, axis=1)


def _read_pose(file: Contents) -> PoseMap:
    offset = read_floats(file, "signals/pose/offset", (None,))
    matrix = read_floats(file, "signals/pose/matrix", (None, len(offset)))
    try:
        return PoseMap(offset, matrix)
    except SettingsError as error:
        sums = np.abs(matrix.sum(axis=1)).max(initial=0.0)
        raise FormatError(
            f"{file.path}: signals/pose: {error}; offset adds up to {offset.sum():.12g} instead of 1, "
            f"rows of matrix to {sums:.3g} at most instead of 0"
        ) from error


def _check_stored(space: ShapeSpace) -> StoredSpace:
    if not isinstance(space, StoredSpace):
        raise OutputError(f"files hold models in the spaces {', '.join(SPACES)}, not in {type(space).__name__}")
    return space


def _write_mesh(file: h5py.Group, header: SequenceHeader) -> None:
    file.attrs["vertex_count"] = header.vertex_count
    write_header(file, header)
    provenance = replace(header.provenance or Provenance(""), name="")
    write_text(file, "provenance", json.dumps(provenance.to_plain()))


def _read_mesh(file: Contents, frames: Float) -> SequenceHeader:
    header = read_header(file, int(file.attrs["vertex_count"]), frames)
    provenance = Provenance.from_plain(json.loads(file.text("provenance") if "provenance" in file.attrs else "{}"))
    return replace(header, provenance=replace(provenance, name=file.path.name))


def write_body(file: h5py.Group, body: Body) -> None:
    """Store a further body of a model."""
    space = _check_stored(body.space)
    _write_mesh(file, body.header)
    write_space(file, space)
    _write_blocks(file, "signals/shape", shape_blocks(space), body.shapes)
    write_array(file, "turn", body.turn)
    write_array(file, "rotations", body.rotations)
    write_array(file, "shifts", body.shifts)
    if body.part_turns is not None:
        write_array(file, "part_turns", body.part_turns)


def read_body(file: Contents, model: Model) -> Body:
    """Read a further body of a model."""
    header = _read_mesh(file, model.times)
    space = read_space(file, header)
    turn, rotations = (read_floats(file, "turn", (4,)), read_floats(file, "rotations", (space.rotation_count, 4)))
    if (np.linalg.norm([turn, *rotations], axis=1) < _MIN_QUATERNION_NORM).any():
        raise FormatError(
            f"{file.path}: the rotations of the body {header.name!r} have quaternions that are nearly zero"
        )
    turns = None
    if "part_turns" in file.arrays:
        turns = read_floats(file, "part_turns", (model.space.correction_dim // 6, 3, 3), _MAX_TURN)
    shapes = _read_blocks(file, "signals/shape", shape_blocks(space), len(model.shapes))
    shifts = read_floats(file, "shifts", (space.centre_count, 3), MAX_LENGTH_DIAGONALS)
    return Body(header, space, shapes, turn, rotations, shifts, turns)


def write_model(file: h5py.File, model: Model) -> None:
    """Store a model in a new file; raise `OutputError` if its shape space cannot be stored."""
    space = _check_stored(model.space)
    groups = body_groups(file, len(model.bodies))
    write_text(file, "format", MODEL_FORMAT)
    file.attrs["version"] = MODEL_VERSION
    write_text(file, "created_by", f"mixseq {__version__}")
    _write_mesh(file, model.header)
    write_space(file, space)
    write_signals(file, model, space)
    for body, group in zip(model.bodies, groups, strict=True):
        write_body(group, body)


def read_model(file: Contents) -> Model:
    """Construct a model from the contents of a file."""
    check_version(file, MODEL_VERSION)
    try:
        header = _read_mesh(file, read_increasing_times(file, "signals/time/frames"))
        model = read_signals(file, header, read_space(file, header))
        bodies = tuple(read_body(each, model) for each in bodies_of(file))
        return replace(model, bodies=bodies) if bodies else model
    except (InvalidSequenceError, SettingsError, ReconstructionError, IndexError) as error:
        raise FormatError(f"{file.path}: {error}; it is damaged") from error
