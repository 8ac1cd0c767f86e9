"""The signals of a model in HDF5, made to be read and changed by hand: see ``docs/file-format.md``."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from mixseq.errors import FormatError, SettingsError
from mixseq.sequence import SequenceHeader
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.signals.placement import StatedPlacement
from mixseq.signals.pose import PoseMap
from mixseq_io.hdf5.arrays import Float, floats, increasing, put
from mixseq_io.hdf5.space import StoredSpace, shape_blocks

POSES = ("rotations", "translations")
LINKS = ("turns", "gaps")


def write_signals(file: h5py.File, model: Model, space: StoredSpace) -> None:
    """Store the signals of a model in a space."""
    put(file, "signals/time/frames", model.times)
    put(file, "signals/time/times", model.time.times)
    put(file, "signals/time/values", model.time.values)
    put(file, "signals/pose/offset", model.pose.offset)
    put(file, "signals/pose/matrix", model.pose.matrix)
    blocks = shape_blocks(space)
    ends = np.cumsum([int(np.prod(shape)) for shape in blocks.values()])
    columns = np.split(model.shapes, ends[:-1], axis=1)
    for (name, shape), block in zip(blocks.items(), columns, strict=True):
        put(file, f"signals/shape/{name}", block.reshape(len(block), *shape))
    put(file, "signals/placement/times", model.placement.times)
    _put_pairs(file, POSES, model.placement.values)
    if isinstance(model.placement, StatedPlacement):
        _put_pairs(file, LINKS, model.placement.dependent.values)


def read_signals(path: Path, file: h5py.File, header: SequenceHeader, space: StoredSpace) -> Model:
    """Read the signals of a model in a space.

    Raises
    ------
    FormatError
        If a dataset is missing or damaged, or signals contradict each other.
    """
    pose = _read_pose(path, file)
    knots = increasing(path, file, "signals/time/times")
    time = Curve(knots, floats(path, file, "signals/time/values", (len(knots), pose.dim)))
    shapes = read_shapes(path, file, shape_blocks(space), len(pose.offset))
    placement = _read_placement(path, file, space)
    for name, curve in (("time", time), ("placement", placement)):
        if curve.start > header.times[0] or curve.end < header.times[-1]:
            raise FormatError(
                f"{path}: signals/time/frames has times from {header.times[0]:g} to {header.times[-1]:g} s, but "
                f"signals/{name}/times are only from {curve.start:g} to {curve.end:g} s"
            )
    return Model(header, space, time, pose, shapes, placement)


def read_shapes(path: Path, file: h5py.File, blocks: dict[str, tuple[int, ...]], count: int) -> Float:
    """Read key shapes ``(count, S)`` that consist of some of `shape_blocks`."""
    columns = [
        floats(path, file, f"signals/shape/{name}", (count, *shape)).reshape(count, -1)
        for name, shape in blocks.items()
    ]
    return np.concatenate(columns, axis=1)


def read_poses(path: Path, file: h5py.File, space: StoredSpace, count: int) -> Float:
    """Read the poses ``(count, P)`` of the parts: rotations, then translations."""
    return _get_pairs(path, file, POSES, (count, space.stored_placement_dim // 6, 3))


def _read_placement(path: Path, file: h5py.File, space: StoredSpace) -> Curve:
    knots = increasing(path, file, "signals/placement/times")
    poses = read_poses(path, file, space, len(knots))
    if not any(f"signals/placement/{name}" in file for name in LINKS):
        return Curve(knots, poses)
    links = (space.placement_dim - space.stored_placement_dim) // 6
    return StatedPlacement(knots, poses, Curve(knots, _get_pairs(path, file, LINKS, (len(knots), links, 3))))


def _put_pairs(file: h5py.File, names: tuple[str, str], values: Float) -> None:
    """Store numbers ``(m, 6 g)`` of the placement as two arrays ``(m, g, 3)``."""
    pairs = values.reshape(len(values), 2, values.shape[1] // 6, 3)
    for name, block in zip(names, np.moveaxis(pairs, 1, 0), strict=True):
        put(file, f"signals/placement/{name}", block)


def _get_pairs(path: Path, file: h5py.File, names: tuple[str, str], shape: tuple[int, ...]) -> Float:
    """Read what `_put_pairs` stored."""
    blocks = [floats(path, file, f"signals/placement/{name}", shape) for name in names]
    return np.stack(blocks, axis=1).reshape(shape[0], -1)


def _read_pose(path: Path, file: h5py.File) -> PoseMap:
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
