"""HDF5 models: a shape space and the signals of a sequence in it. Layout in ``docs/file-format.md``.

::

    /                          format = "mixseq-model", version = 1, created_by, settings (JSON),
                               name, fps, up_axis, metres_per_unit, vertex_count
    /polygons/                 counts, indices
    /segmentation/             part_of_face, widths
    /segmentation/parts/       vertices, sizes
    /segmentation/joints/      faces, sizes
    /space/                    shapes, reference_lengths, reference_angles; placement, scale
    /signals/time/             times
    /signals/shape/            lengths, angles, parts
    /signals/placement/        rotations, translations
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

import mixseq
from mixseq.errors import FormatError, InvalidSequenceError
from mixseq.reconstruction.shells import ShellSettings
from mixseq.segmentation.joints import Decomposition, make_joint
from mixseq.sequence import IntArray, SequenceHeader
from mixseq.signals.model import Model
from mixseq.spaces.mixed import PLACEMENTS, MixedBlocks, MixedSpace
from mixseq.topology import Topology
from mixseq_io.h5 import CHECKED, check_version, creating_h5, read_header, reading_h5, whole, write_header
from mixseq_io.registry import PathLike
from mixseq_io.sequence_h5 import MODEL_FORMAT

VERSION = 1

_CHUNK_ELEMENTS = 1 << 17


def save(path: PathLike, model: Model) -> None:
    """Store a model in an HDF5 file.

    Parameters
    ----------
    path : path-like
        The file; an existing one is replaced when the new one is complete.
    model : Model
        What to store; nothing is lost.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    with creating_h5(Path(path)) as (file, store):
        file.attrs["format"] = MODEL_FORMAT
        file.attrs["version"] = VERSION
        file.attrs["created_by"] = f"mixseq {mixseq.__version__}"
        file.attrs["settings"] = json.dumps({"shell": asdict(model.space.settings)}, sort_keys=True)
        file.attrs["vertex_count"] = model.header.vertex_count
        write_header(file, model.header)
        _write_segmentation(file, model.space.decomposition)
        _write_space(file, model.space)
        _write_signals(file, model)
        store.check()


def load(path: PathLike) -> Model:
    """Load a model from an HDF5 file.

    Parameters
    ----------
    path : path-like
        A file that `save` wrote.

    Returns
    -------
    Model

    Raises
    ------
    FormatError
        If the file is missing, damaged, not a model, or written by a newer mixseq.
    """
    source = Path(path)
    with reading_h5(source), h5py.File(source, "r") as file:
        kind = file.attrs.get("format")
        if kind != MODEL_FORMAT:
            raise FormatError(
                f"{source} is an HDF5 file, but not a mixseq model (format = {kind!r}); make one with mixseq encode"
            )
        check_version(source, file, VERSION)
        try:
            return _read(source, file)
        except (InvalidSequenceError, IndexError) as error:
            raise FormatError(f"{source}: {error}; it is damaged") from error


def _put(file: h5py.File, name: str, array: NDArray[Any]) -> None:
    """Store an array, its first axis cut into chunks of about a mebibyte."""
    row = max(1, array[:1].size)
    chunks = (max(1, min(len(array), _CHUNK_ELEMENTS // row)), *array.shape[1:]) if array.size else None
    file.create_dataset(name, data=array, chunks=chunks, **(CHECKED if array.size else {}))


def _write_segmentation(file: h5py.File, decomposition: Decomposition) -> None:
    _put(file, "segmentation/part_of_face", decomposition.part_of_face.astype(np.int32))
    _put(file, "segmentation/widths", decomposition.widths.astype(np.int32))
    _write_lists(file, "segmentation/parts", "vertices", decomposition.parts)
    _write_lists(file, "segmentation/joints", "faces", [joint.face_ids for joint in decomposition.joints])


def _write_lists(file: h5py.File, group: str, name: str, lists: Any) -> None:
    sizes = np.array([len(items) for items in lists], dtype=np.int32)
    _put(file, f"{group}/sizes", sizes)
    _put(file, f"{group}/{name}", np.concatenate([*lists, np.zeros(0, dtype=np.int32)]).astype(np.int32))


def _write_space(file: h5py.File, space: MixedSpace) -> None:
    group = file.require_group("space")
    group.attrs["placement"] = space.placement
    group.attrs["scale"] = space.scale
    for name in ("shapes", "reference_lengths", "reference_angles"):
        _put(file, f"space/{name}", getattr(space, name))


def _write_signals(file: h5py.File, model: Model) -> None:
    blocks = model.space.split(model.vectors)
    _put(file, "signals/time/times", model.times)
    for name in ("lengths", "angles", "parts"):
        _put(file, f"signals/shape/{name}", getattr(blocks, name))
    for name in ("rotations", "translations"):
        _put(file, f"signals/placement/{name}", getattr(blocks, name))


def _read(path: Path, file: h5py.File) -> Model:
    header = read_header(path, file, int(file.attrs["vertex_count"]), whole(path, file, "signals/time/times"))
    space = _read_space(path, file, header)
    blocks = MixedBlocks(
        **{name: whole(path, file, f"signals/shape/{name}") for name in ("lengths", "angles", "parts")},
        **{name: whole(path, file, f"signals/placement/{name}") for name in ("rotations", "translations")},
    )
    sizes = tuple(int(np.prod(block.shape[1:])) for block in blocks)
    frames = {len(block) for block in blocks}
    if sizes != space.sizes or frames != {header.frame_count}:
        raise FormatError(
            f"{path}: signals have {sorted(frames)} frames of {sizes} numbers, "
            f"{header.frame_count} frames of {space.sizes} are expected"
        )
    for name, block in zip(blocks._fields, blocks, strict=True):
        if not np.isfinite(block).all():
            frame = int(np.argwhere(~np.isfinite(block))[0, 0])
            raise FormatError(f"{path}: frame {frame} of the signal {name} has values that are not finite")
    return Model(header=header, space=space, vectors=space.join(blocks))


def _read_space(path: Path, file: h5py.File, header: SequenceHeader) -> MixedSpace:
    topology = Topology(header.faces, header.vertex_count)
    placement = str(file["space"].attrs["placement"])
    if placement not in PLACEMENTS:
        raise FormatError(f"{path}: the placement {placement!r} is not known")
    settings = json.loads(str(file.attrs["settings"]))
    space = MixedSpace(
        topology=topology,
        decomposition=_read_segmentation(path, file, topology),
        placement=placement,
        scale=float(file["space"].attrs["scale"]),
        shapes=whole(path, file, "space/shapes"),
        reference_lengths=whole(path, file, "space/reference_lengths"),
        reference_angles=whole(path, file, "space/reference_angles"),
        settings=ShellSettings(**settings["shell"]),
    )
    expected = (sum(map(len, space.decomposition.parts)), 3)
    found = space.shapes.shape, len(space.reference_lengths), len(space.reference_angles)
    if found != (expected, space.sizes[0], space.sizes[1]):
        raise FormatError(f"{path}: the space does not fit the segmentation; it is damaged")
    return space


def _read_segmentation(path: Path, file: h5py.File, topology: Topology) -> Decomposition:
    part_of_face = whole(path, file, "segmentation/part_of_face").astype(np.int64)
    if part_of_face.shape != (len(topology.faces),):
        raise FormatError(
            f"{path}: {len(part_of_face)} part labels for {len(topology.faces)} faces; it is damaged"
        )
    parts = _read_lists(path, file, "segmentation/parts", "vertices", topology.vertex_count)
    held = np.zeros(topology.vertex_count, dtype=bool)
    held[np.concatenate(parts)] = True
    joints = []
    for faces in _read_lists(path, file, "segmentation/joints", "faces", len(topology.faces)):
        inside = np.zeros(len(topology.faces), dtype=bool)
        inside[faces] = True
        joints.append(make_joint(topology, inside, held))
    return Decomposition(
        part_of_face=part_of_face,
        parts=tuple(parts),
        joints=tuple(joints),
        widths=whole(path, file, "segmentation/widths").astype(np.int64),
    )


def _read_lists(path: Path, file: h5py.File, group: str, name: str, limit: int) -> list[NDArray[np.int64]]:
    sizes: IntArray = whole(path, file, f"{group}/sizes")
    items: IntArray = whole(path, file, f"{group}/{name}")
    if int(sizes.sum()) != len(items) or (sizes < 1).any():
        raise FormatError(f"{path}: {group}/sizes do not add up; it is damaged")
    if ((items < 0) | (items >= limit)).any():
        raise FormatError(f"{path}: {group}/{name} are not all from 0 to {limit - 1}; it is damaged")
    return [piece.astype(np.int64) for piece in np.split(items, np.cumsum(sizes))[: len(sizes)]]
