"""Write skins and morphs to glTF and USD, read skeletons and bind poses, and measure the errors of written files."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mixseq.errors import FormatError, OutputError
from mixseq.runtime.public import public
from mixseq.types import Float, FloatArray, IntArray, PathLike
from mixseq_io.reader import check_regular_file, prefix_errors

if TYPE_CHECKING:
    from mixseq.rigging.rigs import Morph, Skeleton, Skin
    from mixseq.sequence.header import SequenceHeader
    from mixseq.sequence.sequence import MeshSequence


GLTF_EXTENSIONS = (".glb", ".gltf")
USD_EXTENSIONS = (".usd", ".usda", ".usdc", ".usdz")
RIG_EXTENSIONS = (*GLTF_EXTENSIONS, *USD_EXTENSIONS)
"""File extensions of skins, morphs and skeletons."""

_EXTENSION_LIST = f"{', '.join(RIG_EXTENSIONS[:-1])} or {RIG_EXTENSIONS[-1]}"


@public
def write_rig(path: PathLike, rig: Skin | Morph) -> None:
    """Write a skin or a morph to a glTF or USD file.

    In glTF, ``.glb`` is binary, and ``.gltf`` is text with embedded data. In USD, ``.usd`` and ``.usdc`` are binary,
    ``.usda`` is text, and ``.usdz`` is a package; skins have a skeleton and blend shapes (UsdSkel).

    Texture coordinates, hard edges and names of materials are written. USD files also get the materials of the original
    USD file. Numbers are float32. The file appears when it is complete; `mixseq_io.read` can read it.

    Parameters
    ----------
    path : path-like
        Path of the file to write.
    rig : Skin or Morph
        Result of `mixseq.fit_skin` or `mixseq.fit_morph`. Keys are at its frames; ``rig.resampled`` changes the frames.

    Raises
    ------
    OutputError
        If the file extension is not supported, the file cannot be written or would be too large, a skin for glTF has
        more than 65535 bones, or USD does not support the up axis.
    TypeError
        If `rig` is neither a skin nor a morph.
    InvalidSequenceError
        If points or times do not fit into float32.

    Warns
    -----
    MixseqWarning
        If the format does not support an attribute of the mesh, a node rotates and scales the mesh (glTF), times are
        changed, or only names of materials are written (USD).

    Examples
    --------
    >>> import mixseq
    >>> mixseq.write_rig("arm.glb", mixseq.fit_skin("arm.usdc", bones=2))
    """
    _write(Path(path), rig)


def write_measured_rig(path: Path, rig: Skin | Morph, sequence: MeshSequence, bound: float | None) -> RigErrors:
    """Write a rig and return its errors; write no file if rounding breaks a bound in diagonals that the rig keeps."""
    from mixseq.signals.decoding import largest_distance

    errors: list[RigErrors] = []

    def check(file: Path) -> None:
        errors.append(measured := measure_rig_file(file, sequence))
        if bound is None or measured.max_error <= bound:
            return
        if largest_distance(sequence.blocks(), rig.blocks()) <= bound * (sequence.diagonal or 1.0):
            raise OutputError(
                f"{path}: rounding to single precision moves vertices by up to {measured.max_error:.3g} of the "
                f"diagonal, more than {bound:g}, so nothing is written; give a larger bound"
            )

    _write(path, rig, check)
    return errors[-1]


def _write(file: Path, rig: Skin | Morph, check: Callable[[Path], object] | None = None) -> None:
    from mixseq.rigging.rigs import Skin

    check_rig_target(file)
    if file.suffix.lower() in USD_EXTENSIONS:
        from mixseq_io.usd.rigs import write_usd_rig

        write_usd_rig(file, rig, check)
        return
    from mixseq_io.gltf.buffers import open_buffer_writer
    from mixseq_io.gltf.rigs import create_morphed_scene, create_skinned_scene
    from mixseq_io.gltf.writer import standalone_losses, warn_of_changes

    layout = create_skinned_scene(rig) if isinstance(rig, Skin) else create_morphed_scene(rig)
    warn_of_changes(file, rig.header, standalone_losses(rig.header))
    with open_buffer_writer(file, layout, check):
        pass  # the layout already has all data


def check_rig_target(path: Path) -> None:
    """Raise if the extension of a path is not an extension of rig files."""
    if path.suffix.lower() not in RIG_EXTENSIONS:
        raise OutputError(f"{path}: skins and morphs are written as glTF or USD; end the name in {_EXTENSION_LIST}")


@public
def read_skeleton(path: PathLike, name: str | None = None) -> Skeleton:
    """Read the joints of a glTF skin or a UsdSkel skeleton.

    Joints are in their bind pose, in world space like the points of `mixseq_io.read`. Joints without a name are named
    ``joint_000`` and so on; repeated names get a number.

    Parameters
    ----------
    path : path-like
        A ``.glb``, ``.gltf``, ``.usd``, ``.usda``, ``.usdc`` or ``.usdz`` file. Its meshes are not read.
    name : str, optional
        Name of the skeleton, if there are several. In glTF: the skin's name, or ``skin 0`` and so on for unnamed skins;
        skins with the same joints are one skeleton. In USD: the path or name of the prim.

    Returns
    -------
    Skeleton
        Joints of the bind pose, parents before children; scales of joints are ignored.

    Raises
    ------
    FormatError
        If the file is missing, damaged, of another type, or has no skeleton of that name.
    AmbiguousError
        If there are several skeletons; the message names them.

    Examples
    --------
    >>> import mixseq
    >>> mixseq.write_rig("arm.glb", mixseq.fit_skin("arm.usdc", bones=2))
    >>> mixseq.read_skeleton("arm.glb").names
    ('bone_000', 'bone_001')
    """
    file = Path(path)
    _check_skeleton_file(file)
    with prefix_errors(file):
        if file.suffix.lower() in GLTF_EXTENSIONS:
            from mixseq_io.gltf.reader import read_joints

            return read_joints(file, name)
        from mixseq_io.usd.rigs import read_skel_joints

        return read_skel_joints(file, name)


@public
def read_bind_pose(path: PathLike, name: str | None = None) -> MeshSequence:
    """Read the meshes of a skeleton in their bind pose, as a sequence of one frame.

    Vertices have the order of `mixseq_io.read`, and are in the space of `read_skeleton`. Meshes below glTF joints are
    included. Morph targets of glTF have their static weights; blend shapes of USD have zero weight.

    Parameters
    ----------
    path, name
        See `read_skeleton`.

    Raises
    ------
    FormatError
        If the file is missing, damaged, of another type, or has no skeleton of that name.
    NoMeshError
        If the skeleton has no mesh.
    AmbiguousError
        If there are several skeletons; the message names them.

    Examples
    --------
    >>> import mixseq
    >>> mixseq.write_rig("arm.glb", mixseq.fit_skin("arm.usdc", bones=2))
    >>> len(mixseq.read_bind_pose("arm.glb"))
    1
    """
    from mixseq.sequence.sequence import join_blocks

    file = Path(path)
    _check_skeleton_file(file)
    if file.suffix.lower() in GLTF_EXTENSIONS:
        from mixseq_io.gltf.reader import open_gltf_bind_pose as open_bind_pose
    else:
        from mixseq_io.usd.reader import open_usd_bind_pose as open_bind_pose
    with open_bind_pose(file, name) as reader:
        return join_blocks(reader.header, reader.blocks())


def _check_skeleton_file(file: Path) -> None:
    """Raise if files with the extension of the given file have no skeletons."""
    check_regular_file(file, "a file")
    if file.suffix.lower() not in RIG_EXTENSIONS:
        raise FormatError(f"{file}: skeletons are read from glTF and USD; give a file that ends in {_EXTENSION_LIST}")


@dataclass(frozen=True)
class RigErrors:
    """Errors of a rig file, compared with its original sequence; formulas are in `mixseq.metrics`."""

    max_error: float  # in diagonals
    rms_error: float  # in diagonals
    kg_percent: float


def measure_rig_file(path: Path, sequence: MeshSequence) -> RigErrors:
    """Compare a written rig with its sequence, at the times of its frames."""
    from mixseq.metrics import error_ratio
    from mixseq_io.registry import open_sequence

    vertex_ids, rotation, scale = _placement(path, sequence.header)
    largest = squares = spread = 0.0
    with open_sequence(path, prim="/") as reader:
        times = reader.header.times
        # Frames are matched by nearest times: glTF has float32 times, and static files have a single frame.
        nearest = np.searchsorted((times[1:] + times[:-1]) / 2, sequence.times)
        for file_frame, written in enumerate(chain.from_iterable(reader.blocks())):
            for points in sequence.points[nearest == file_frame]:
                expected = points[vertex_ids].astype(np.float64) @ rotation
                squared_distances = np.square(written.astype(np.float64) / scale - expected).sum(axis=1)
                largest = max(largest, float(squared_distances.max()))
                squares += float(squared_distances.sum())
                spread += float(np.square(expected - expected.mean(axis=0)).sum())
    return RigErrors(
        max_error=error_ratio(np.sqrt(largest), sequence.diagonal),
        rms_error=error_ratio(np.sqrt(squares / (sequence.frame_count * len(vertex_ids))), sequence.diagonal),
        kg_percent=100 * error_ratio(np.sqrt(squares), np.sqrt(spread)),
    )


def measure_file_between(
    path: Path, header: SequenceHeader, points_at: Callable[[Float], Iterable[FloatArray]]
) -> float | None:
    """Return the largest distance of a file from a motion between frames, in its units; None if it has other meshes."""
    from mixseq.signals.decoding import largest_distance, played_blocks, quarter_times
    from mixseq_io.registry import open_sequence

    vertex_ids, rotation, scale = _placement(path, header)
    times = quarter_times(header.times)
    expected = (block[:, vertex_ids] @ rotation for block in points_at(times))
    with open_sequence(path, prim="/") as reader:
        if reader.header.vertex_count != len(vertex_ids):
            return None
        return largest_distance(expected, (block / scale for block in played_blocks(reader, times)))


def _placement(path: Path, header: SequenceHeader) -> tuple[IntArray, Float, float]:
    """Return the vertices ``(n,)`` that a file has, and how it rotates ``(3, 3)`` and scales them."""
    from mixseq_io.gltf.new_document import node_transform
    from mixseq_io.scene_meshes import split_meshes

    vertices = np.arange(header.vertex_count)
    if path.suffix.lower() not in GLTF_EXTENSIONS:
        return vertices, np.eye(3), 1.0
    # glTF omits objects without polygons.
    vertex_ids = [vertices[mesh.vertices] for mesh in split_meshes(header) if mesh.polygons.counts.size]
    matrix = node_transform(header).get("matrix", np.eye(4))
    scale = header.metres_per_unit
    # The file stores columns, so rows are transposed.
    return np.concatenate(vertex_ids), np.reshape(matrix, (4, 4))[:3, :3] / scale, scale
