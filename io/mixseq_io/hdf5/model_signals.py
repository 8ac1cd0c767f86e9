"""Signals of a model in HDF5, readable and editable by hand: see ``docs/file-format.md``."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from mixseq.arrays import Float
from mixseq.errors import FormatError, SettingsError
from mixseq.sequence import SequenceHeader
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.signals.pose import PoseMap
from mixseq_io.hdf5.contents import Contents
from mixseq_io.hdf5.datasets import floats, increasing, put
from mixseq_io.hdf5.stored_space import Blocks, StoredSpace, correction_blocks, placement_blocks, shape_blocks

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
    correction = _read_correction(path, file, space)
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
    norms = np.linalg.norm(space.poses(placements).rotations, axis=2)
    if (norms < _UNIT).any():
        raise FormatError(
            f"{path}: signals/placement/rotations has quaternions that are nearly zero, no rotations"
        )
    return Curve(knots, placements)


def _read_correction(path: Path, file: Contents, space: StoredSpace) -> Curve:
    knots = increasing(path, file, "signals/correction/times")
    return Curve(knots, _get_blocks(path, file, "signals/correction", correction_blocks(space), len(knots)))


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
