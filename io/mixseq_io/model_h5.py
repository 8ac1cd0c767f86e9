"""HDF5 models: a shape space and the signals of a sequence in it. Layout in ``docs/file-format.md``.

::

    /                          format = "mixseq-model", version = 1, created_by, settings (JSON),
                               name, fps, up_axis, metres_per_unit, vertex_count
    /polygons/                 counts, indices
    /segmentation/             part_of_face, widths
    /segmentation/parts/       vertices, sizes
    /segmentation/joints/      faces, sizes
    /space/                    shapes, reference_lengths, reference; placement, scale
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

from mixseq.errors import FormatError, InvalidSequenceError, OutputError
from mixseq.reconstruction.shells import ShellSettings
from mixseq.segmentation.joints import Decomposition, make_joint
from mixseq.sequence import SequenceHeader
from mixseq.signals.model import Model
from mixseq.spaces.mixed import PLACEMENTS, MixedBlocks, MixedSpace
from mixseq.topology import Topology
from mixseq.version import __version__
from mixseq_io.h5 import (
    CHECKED,
    MODEL_FORMAT,
    check_version,
    creating_h5,
    read_header,
    reading_h5,
    whole,
    write_header,
)
from mixseq_io.registry import PathLike

VERSION = 1

SUFFIXES = (".h5", ".hdf5")

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
        If the file cannot be written, or its name does not end in .h5 or .hdf5.
    """
    target = Path(path)
    if target.suffix.lower() not in SUFFIXES:
        raise OutputError(f"{target}: models are HDF5 files; end the name in {' or '.join(SUFFIXES)}")
    with creating_h5(target) as (file, store):
        file.attrs["format"] = MODEL_FORMAT
        file.attrs["version"] = VERSION
        file.attrs["created_by"] = f"mixseq {__version__}"
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
    if source.is_file() and source.stat().st_size and not h5py.is_hdf5(source):
        raise FormatError(f"{source} is not a model, which is an HDF5 file; make one with mixseq encode")
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
    for name in ("shapes", "reference_lengths", "reference"):
        _put(file, f"space/{name}", getattr(space, name))


def _write_signals(file: h5py.File, model: Model) -> None:
    blocks = model.space.split(model.vectors)
    _put(file, "signals/time/times", model.times)
    for name in ("lengths", "angles", "parts"):
        _put(file, f"signals/shape/{name}", getattr(blocks, name))
    for name in ("rotations", "translations"):
        _put(file, f"signals/placement/{name}", getattr(blocks, name))


def _read(path: Path, file: h5py.File) -> Model:
    times = _floats(path, file, "signals/time/times", (None,))
    header = read_header(path, file, int(file.attrs["vertex_count"]), times)
    space = _read_space(path, file, header)
    frames, (edges, hinges, parts, rotations, translations) = len(times), space.sizes
    blocks = MixedBlocks(
        lengths=_floats(path, file, "signals/shape/lengths", (frames, edges)),
        angles=_floats(path, file, "signals/shape/angles", (frames, hinges)),
        parts=_floats(path, file, "signals/shape/parts", (frames, parts // 3, 3)),
        rotations=_floats(path, file, "signals/placement/rotations", (frames, rotations // 3, 3)),
        translations=_floats(path, file, "signals/placement/translations", (frames, translations // 3, 3)),
    )
    return Model(header=header, space=space, vectors=space.join(blocks))


def _read_space(path: Path, file: h5py.File, header: SequenceHeader) -> MixedSpace:
    topology = Topology(header.faces, header.vertex_count)
    attributes = file["space"].attrs
    placement, scale = str(attributes["placement"]), float(attributes["scale"])
    if placement not in PLACEMENTS:
        raise FormatError(f"{path}: the placement {placement!r} is not known")
    if not (np.isfinite(scale) and scale > 0):
        raise FormatError(f"{path}: the scale of the space is {scale}; a positive number is expected")
    decomposition = _read_segmentation(path, file, topology)
    shell = json.loads(str(file.attrs["settings"]))["shell"]
    unknown = sorted(set(shell) - set(ShellSettings.__dataclass_fields__))
    if unknown:
        raise FormatError(f"{path}: this mixseq does not know the setting {unknown[0]!r}; upgrade it")
    space = MixedSpace(
        topology=topology,
        decomposition=decomposition,
        placement=placement,
        scale=scale,
        shapes=_floats(path, file, "space/shapes", (sum(map(len, decomposition.parts)), 3)),
        reference_lengths=_floats(path, file, "space/reference_lengths", (None,)),
        reference=_floats(path, file, "space/reference", (header.vertex_count, 3)),
        settings=ShellSettings(**shell),
    )
    if len(space.reference_lengths) != space.sizes[0]:
        raise FormatError(f"{path}: the space does not fit the segmentation; it is damaged")
    return space


def _read_segmentation(path: Path, file: h5py.File, topology: Topology) -> Decomposition:
    faces, vertices = len(topology.faces), topology.vertex_count
    parts = _lists(path, file, "segmentation/parts", "vertices", vertices)
    if not parts:
        raise FormatError(f"{path}: the segmentation has no parts; it is damaged")
    held = np.zeros(vertices, dtype=bool)
    held[np.concatenate(parts)] = True
    joints = []
    for joint_faces in _lists(path, file, "segmentation/joints", "faces", faces):
        inside = np.zeros(faces, dtype=bool)
        inside[joint_faces] = True
        joints.append(make_joint(topology, inside, held))
    return Decomposition(
        part_of_face=_integers(path, file, "segmentation/part_of_face", faces, 0, len(parts)),
        parts=tuple(parts),
        joints=tuple(joints),
        widths=_integers(path, file, "segmentation/widths", len(parts), 1, None),
    )


def _lists(path: Path, file: h5py.File, group: str, name: str, limit: int) -> list[NDArray[np.int64]]:
    """Read lists of indices below `limit` that `_write_lists` stored."""
    sizes = _integers(path, file, f"{group}/sizes", None, 1, None)
    items = _integers(path, file, f"{group}/{name}", int(sizes.sum()), 0, limit)
    return np.split(items, np.cumsum(sizes))[: len(sizes)]


def _integers(
    path: Path, file: h5py.File, name: str, count: int | None, low: int, limit: int | None
) -> NDArray[np.int64]:
    """Read whole numbers from `low` to below `limit`."""
    array = whole(path, file, name)
    if array.ndim != 1 or not np.issubdtype(array.dtype, np.integer) or count not in (None, len(array)):
        raise FormatError(
            f"{path}: {name} is {array.dtype} of shape {array.shape}, not {count or 'some'} integers"
        )
    if array.size and (array.min() < low or (limit is not None and array.max() >= limit)):
        raise FormatError(f"{path}: {name} has values out of range; it is damaged")
    return array.astype(np.int64)


def _floats(path: Path, file: h5py.File, name: str, shape: tuple[int | None, ...]) -> NDArray[np.float64]:
    """Read finite numbers of a shape; None stands for any length."""
    array = whole(path, file, name)
    fits = len(shape) == array.ndim and all(n in (None, m) for n, m in zip(shape, array.shape, strict=True))
    if not fits or not np.issubdtype(array.dtype, np.floating):
        expected = tuple("any" if n is None else n for n in shape)
        raise FormatError(
            f"{path}: {name} is {array.dtype} of shape {array.shape}, not floats of shape {expected}"
        )
    if not np.isfinite(array).all():
        first = int(np.argwhere(~np.isfinite(array))[0, 0])
        where = f"frame {first}" if name.startswith("signals") else f"row {first}"
        raise FormatError(f"{path}: {name} is not finite in {where}")
    return array.astype(np.float64)
