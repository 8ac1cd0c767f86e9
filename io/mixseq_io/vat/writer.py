"""Write vertex animation textures: images, a mesh with coordinates in these images, ``vat.json``, and shaders.

`mixseq_io.vat.textures` describes the encoding. Reported errors are measured on images decoded in single precision, as
in shaders. Points far from zero are relative to an origin, at which the node of the mesh is.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np

from mixseq.errors import OutputError, SettingsError
from mixseq.mesh.measures import choose_origin
from mixseq.rigging.low_rank import fit_low_rank
from mixseq.runtime.progress import Progress, log_progress
from mixseq.runtime.public import FileOr, HasFrames, public
from mixseq.sequence.sequence import Frames, MeshSequence
from mixseq.signals.decoding import Decodable, hold_between, largest_distance, quarter_times, straight_blocks
from mixseq.signals.fitting import as_motion
from mixseq.signals.model import Model
from mixseq_io.files import atomic_folder
from mixseq_io.gltf.buffers import open_buffer_writer
from mixseq_io.reader import warn
from mixseq_io.vat.textures import (
    MAX_TEXTURE_SIDE_PIXELS,
    PixelType,
    Texels,
    Textures,
    VertexFrames,
    encode_low_rank,
    encode_plain,
    encode_png,
    import_openexr,
    write_exr,
)

SHADER_NAMES = ("webgl2.js", "godot.gdshader", "unity.shader", "unreal.hlsl")


def format_shader(name: str, metadata: dict[str, Any]) -> str:
    """Return the text of a shader, completed with values from the contents of ``vat.json``."""
    text = files("mixseq_io.vat").joinpath("shaders", name).read_text(encoding="utf-8")
    keys = ("frames", "width", "height", "rows", "layers", "fps")
    values = {key.upper(): str(metadata[key]) for key in keys}
    fps = f"{float(metadata['fps']):.9g}"
    values["FPS"] = fps if "." in fps else f"{metadata['fps']:.1f}"
    values["LOW_RANK"] = str(int(metadata["kind"] != "plain"))
    values["PART_SCALE"] = f"{metadata['part_scale']:.1f}"
    values["COLUMNS"] = str(metadata["textures"].get("coefficients", {"width": 1})["width"])
    values["NORMALS_HEIGHT"] = str(metadata["textures"]["normals"]["height"])
    for key in ("points", "normals", "coefficients"):
        texture = metadata["textures"].get(key, {"offset": 0.0, "scale": 1.0})
        for field in ("offset", "scale"):
            numbers = texture[field] if isinstance(texture[field], list) else [texture[field]]
            values[f"{key}_{field}".upper()] = ", ".join(repr(float(number)) for number in numbers)
    for key, value in values.items():
        text = text.replace(f"@{key}@", value)
    return text


VAT_EXTENSION = ".vat"
TextureName = Literal["png16", "exr"]
_IMAGE_SUFFIXES: dict[TextureName, str] = {"png16": ".png", "exr": ".exr"}

VAT_FILE_NAMES = {
    *("vat.json", "mesh.glb", *SHADER_NAMES),
    *(name + suffix for name in ("points", "normals", "coefficients") for suffix in _IMAGE_SUFFIXES.values()),
}
"""Names of all files that the writer may write; such files from an earlier run are removed."""

_MAX_ATTEMPTS = 6
_INITIAL_BOUND_RATIO = 0.98
"""Initial fraction of the error bound that is used for the fit; the remainder is for rounding."""

_MAX_STEP_VARIATION = 1e-3
"""Largest difference of frame durations that causes no warning, relative to the mean duration."""


@dataclass(frozen=True)
class VatReport:
    """Kind, errors and sizes of written textures."""

    kind: str  # kind of textures, see mixseq_io.vat.textures
    rank: int  # number of basis vectors, 0 for plain textures
    max_error: float  # largest error of a vertex, in diagonals
    rms_error: float  # root mean square error of the vertices, in diagonals
    normal_degrees: float  # root mean square angle of the normals to the original normals
    # Largest distance of a vertex from `motion` between frames, in diagonals; None without a motion.
    between_error: float | None
    file_bytes: int  # size of the texture files
    memory_bytes: int  # size of the textures in the memory of a graphics card


@public
def write_vat(
    path: str | os.PathLike[str],
    sequence: FileOr[MeshSequence | HasFrames],
    max_error: float | None = None,
    texture: TextureName = "png16",
    progress: Progress = log_progress,
    *,
    motion: FileOr[Model | Decodable | Frames] | None = None,
    between_frames: bool = False,
) -> VatReport:
    """Write a sequence as vertex animation textures: a folder with images, a mesh, ``vat.json`` and shaders.

    Parameters
    ----------
    path : path-like
        Output folder with a name that ends in ``.vat``. Textures in an existing folder are replaced after all files
        are written; other files in the folder are unchanged.
    sequence : MeshSequence
        The sequence to be written.
    max_error : float, optional
        Error bound of low-rank textures in diagonals, for all frames; by default textures are plain.
    texture : {"png16", "exr"}
        File format: PNG with 16 bits, or EXR with 32-bit floats.
    progress : callable
        Function that receives the progress.
    motion : Model, MeshSequence or SequenceReader, optional
        The motion whose frames are written, to measure the error between them at quarters of a frame, where shaders
        join frames by straight lines. Of sequences that are no rigs, the exact model is fitted.
    between_frames : bool
        Whether `max_error` also holds between frames, at quarters of a frame of the textures. They get up to eight
        times the frames of `sequence`, which are those of `motion`, by default its exact model.

    Raises
    ------
    OutputError
        If the name does not end in .vat, or the folder cannot be written.
    SettingsError
        If `max_error` is not positive or smaller than the rounding error of textures, textures would be too large, or
        the bound cannot be kept between frames.
    MissingExtraError
        If `texture` is "exr" and OpenEXR is not installed.

    Warns
    -----
    MixseqWarning
        If frames are not evenly spaced.

    Examples
    --------
    >>> import mixseq
    >>> report = mixseq.write_vat("arm.vat", mixseq.read("arm.usdc"))
    """
    sequence = cast("MeshSequence", sequence)
    motion = cast("Model | Decodable | Frames | None", motion)
    folder = Path(path)
    check_vat_target(folder)
    if texture not in _IMAGE_SUFFIXES:
        raise SettingsError(f"texture is {texture!r}; one of {', '.join(_IMAGE_SUFFIXES)} is expected")
    if texture == "exr":
        import_openexr(folder)
    pixel_type: PixelType = np.uint16 if texture == "png16" else np.float32
    steps = np.diff(sequence.times)
    if steps.size and np.ptp(steps) > _MAX_STEP_VARIATION * steps.mean():
        warn(f"{folder}: textures need evenly spaced frames; resample the sequence (--fps)")
    if motion is None and between_frames:
        motion = sequence
    source = None if motion is None else as_motion(motion, progress)

    def encode(sequence: MeshSequence, bound: float | None) -> tuple[_Encoding, float]:
        encoding = _encode(sequence, bound, pixel_type, source, progress)
        return encoding, encoding[-1].between_error or 0.0

    if between_frames and source is not None:
        if max_error is None:
            raise SettingsError("between_frames is about max_error, which is missing; give both")
        sequence, texels, textures, report = hold_between(source, sequence, max_error, encode)
    else:
        (sequence, texels, textures, report), _ = encode(sequence, max_error)
    texels.add_vertices(np.asarray(sequence.points[0]), len(textures.images["points"].pixels) // texels.rows)
    with atomic_folder(folder, VAT_FILE_NAMES) as temporary:
        for name, image in textures.images.items():
            file = temporary / f"{name}{_IMAGE_SUFFIXES[texture]}"
            if texture == "exr":
                write_exr(file, np.asarray(image.pixels, dtype=np.float32))
            else:
                file.write_bytes(encode_png(image.pixels))
        report = replace(report, file_bytes=sum(image.stat().st_size for image in temporary.iterdir()))
        with open_buffer_writer(temporary / "mesh.glb", texels.layout):
            pass
        metadata = _make_metadata(sequence, texels, textures, texture, report)
        (temporary / "vat.json").write_text(json.dumps(metadata, indent=1), encoding="utf-8")
        for name in SHADER_NAMES:
            (temporary / name).write_text(format_shader(name, metadata), encoding="utf-8")
    return report


_Encoding = tuple[MeshSequence, Texels, Textures, VatReport]


def _encode(
    sequence: MeshSequence, max_error: float | None, pixel_type: PixelType, motion: Decodable | None, progress: Progress
) -> _Encoding:
    """Encode a sequence, relative to the origin of its texels, as textures, plain without `max_error`; measure them."""
    origin = choose_origin(sequence.points[0])
    if origin.any():
        sequence = sequence.with_points(sequence.points - origin)
    texels = Texels.from_header(sequence.header, origin)
    if max_error is None:
        texels.check_height(sequence.frame_count, "frames")
    elif 2 * sequence.frame_count > MAX_TEXTURE_SIDE_PIXELS:
        raise SettingsError(f"{sequence.frame_count} frames are too high for a texture of coefficients; write fewer")
    frames = VertexFrames.from_points(sequence.points, texels)
    if max_error is None:
        textures = encode_plain(frames, texels, pixel_type)
        report = _measure_errors(sequence, frames, textures)
    else:
        textures, report = _fit_within_bound(sequence, frames, texels, pixel_type, max_error, progress)
    if motion is not None:
        times = quarter_times(sequence.times)
        expected = (block[:, texels.vertices] - origin for block in motion.blocks(times))
        largest = largest_distance(expected, straight_blocks([textures.decoded.points], times))
        report = replace(report, between_error=largest / (sequence.diagonal or 1.0))
    return sequence, texels, textures, report


def check_vat_target(path: Path) -> None:
    """Raise an error if a path is not a valid name for a folder of textures."""
    if path.suffix.lower() != VAT_EXTENSION:
        raise OutputError(f"{path}: vertex animation textures are a folder; end its name in {VAT_EXTENSION}")
    if path.exists() and not path.is_dir():
        raise OutputError(f"{path} is a file, and vertex animation textures are a folder; give another name")


def _fit_within_bound(
    sequence: MeshSequence,
    frames: VertexFrames,
    texels: Texels,
    pixel_type: PixelType,
    max_error: float,
    progress: Progress,
) -> tuple[Textures, VatReport]:
    """Fit low-rank textures whose error, including rounding, is at most `max_error` diagonals."""
    if not max_error > 0:
        raise SettingsError(f"max_error is {max_error:g}; a positive number of diagonals is expected")
    bound = _INITIAL_BOUND_RATIO * max_error
    for _ in range(_MAX_ATTEMPTS):
        fitted = fit_low_rank(sequence, bound, progress=progress)
        textures = encode_low_rank(fitted, frames, texels, pixel_type)
        report = _measure_errors(sequence, frames, textures)
        excess = report.max_error - max_error
        if excess <= 0:
            return textures, report
        bound -= 1.5 * excess
        if bound <= 0:
            break
    raise SettingsError(
        f"max_error is {max_error:g}, and rounding to 16 bits alone takes about {max_error + excess - bound:.1g}; "
        "allow more, or write EXR (--texture exr)"
    )


def _measure_errors(sequence: MeshSequence, frames: VertexFrames, textures: Textures) -> VatReport:
    decoded = textures.decoded
    diagonal = sequence.diagonal or 1.0
    squares = np.square(decoded.points - frames.points).sum(axis=2)
    lengths = np.linalg.norm(decoded.normals, axis=2)
    cosines = np.sum(decoded.normals * frames.normals, axis=2) / np.where(lengths > 0, lengths, 1)
    angles = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
    return VatReport(
        kind=textures.metadata["kind"],
        rank=textures.rank,
        max_error=float(np.sqrt(squares.max(initial=0))) / diagonal,
        rms_error=float(np.sqrt(squares.mean())) / diagonal,
        normal_degrees=float(np.sqrt(np.square(angles).mean())),
        between_error=None,
        file_bytes=0,
        # Pixels have four channels in the memory of a graphics card.
        memory_bytes=sum(4 * image.pixels[..., 0].nbytes for image in textures.images.values()),
    )


def _make_metadata(
    sequence: MeshSequence, texels: Texels, textures: Textures, texture: TextureName, report: VatReport
) -> dict[str, Any]:
    """Return the contents of ``vat.json``."""
    header = sequence.header
    points = np.asarray(sequence.points)
    images = {}
    for name, image in textures.images.items():
        height, width = image.pixels.shape[:2]
        is_uniform = name == "coefficients" or textures.rank > 0  # equal in all channels
        images[name] = {
            "file": f"{name}{_IMAGE_SUFFIXES[texture]}",
            "width": width,
            "height": height,
            "offset": float(image.offset[0]) if is_uniform else image.offset.tolist(),
            "scale": float(image.scale[0]) if is_uniform else image.scale.tolist(),
        }
    return {
        "format": "mixseq vertex animation texture",
        "version": 1,
        **textures.metadata,
        "rank": textures.rank,
        "texture": texture,
        "mesh": "mesh.glb",
        "frames": header.frame_count,
        "fps": header.fps,
        "start": float(header.times[0]),
        "vertices": header.vertex_count,
        "texels": texels.count,
        "width": images["points"]["width"],
        "height": images["points"]["height"],
        "rows": texels.rows,
        "textures": images,
        "origin": texels.origin.tolist(),
        "bounds": {"min": points.min(axis=(0, 1)).tolist(), "max": points.max(axis=(0, 1)).tolist()},
        "up_axis": header.up_axis,
        "metres_per_unit": header.metres_per_unit,
        "error": {
            "max": report.max_error,
            "rms": report.rms_error,
            "normal_degrees": report.normal_degrees,
            "between": report.between_error,
        },
    }
