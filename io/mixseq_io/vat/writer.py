"""Vertex animation textures, writing: pictures, the mesh that refers to them, ``vat.json``, and shaders.

`mixseq_io.vat.textures` describes the encoding. Errors are those of the pictures' numbers, without float32 rounding in
shaders.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from mixseq.errors import OutputError, SettingsError
from mixseq.rigging.low_rank import fit_low_rank
from mixseq.runtime.progress import Progress, no_progress
from mixseq.runtime.public import public
from mixseq.sequence.sequence import MeshSequence, bounding_diagonal
from mixseq_io.files import atomic_folder
from mixseq_io.gltf.codecs import open_buffer_writer
from mixseq_io.reader import warn
from mixseq_io.vat.textures import (
    Frames,
    Kind,
    Texels,
    Textures,
    exr_library,
    low_rank,
    plain,
    png_of,
    write_exr,
)

SHADERS = ("webgl2.js", "godot.gdshader", "unity.shader", "unreal.hlsl")
"""Names of the shaders."""


def shader(name: str, told: dict[str, Any]) -> str:
    """Return the text of a shader, given the contents of ``vat.json``."""
    text = files("mixseq_io.vat").joinpath("shaders", name).read_text(encoding="utf-8")
    values = {key.upper(): str(told[key]) for key in ("frames", "width", "height", "rows", "layers", "fps")}
    values["FPS"] = (
        f"{float(told['fps']):.9g}" if "." in f"{float(told['fps']):.9g}" else f"{told['fps']:.1f}"
    )
    values["LOW_RANK"] = str(int(told["kind"] != "plain"))
    values["PART_SCALE"] = f"{told['part_scale']:.1f}"
    values["COLUMNS"] = str(told["textures"].get("coefficients", {"width": 1})["width"])
    values["NORMALS_HEIGHT"] = str(told["textures"]["normals"]["height"])
    for key in ("points", "normals", "coefficients"):
        texture = told["textures"].get(key, {"offset": 0.0, "scale": 1.0})
        for part in ("offset", "scale"):
            numbers = texture[part] if isinstance(texture[part], list) else [texture[part]]
            values[f"{key}_{part}".upper()] = ", ".join(repr(float(each)) for each in numbers)
    for key, value in values.items():
        text = text.replace(f"@{key}@", value)
    return text


VAT_EXTENSION = ".vat"
TextureName = Literal["png16", "exr"]
TEXTURES: tuple[TextureName, ...] = get_args(TextureName)

VAT_FILE_NAMES = {
    *("vat.json", "mesh.glb", *SHADERS),
    *(f"{name}.{suffix}" for name in ("points", "normals", "coefficients") for suffix in ("png", "exr")),
}
"""Names of the written files; those of an older run are removed."""

_TRIES = 6
_CAUTION = 0.98
"""Initial share of the error bound for the fit; the rest is for rounding."""

_UNEVEN = 1e-3


@dataclass(frozen=True)
class VatReport:
    """Written files and their error."""

    kind: str  # see mixseq_io.vat.textures
    rank: int  # number of basis vectors, 0 of plain textures
    max_error: float  # largest error of a vertex, in diagonals
    rms_error: float  # root mean square error of the vertices, in diagonals
    normal_degrees: float  # root mean square angle of the normals
    file_bytes: int  # size of the texture files
    memory_bytes: int  # size of the textures in the memory of a graphics card


@public
def write_vat(
    path: str | os.PathLike[str],
    sequence: MeshSequence,
    max_error: float | None = None,
    texture: TextureName = "png16",
    progress: Progress = no_progress,
) -> VatReport:
    """Write a sequence as vertex animation textures: a folder with pictures, a mesh, ``vat.json`` and shaders.

    Parameters
    ----------
    path : path-like
        The folder, whose name ends in ``.vat``. If it exists, its textures are replaced when all is written; other
        files in it stay.
    sequence : MeshSequence
        What to write.
    max_error : float, optional
        Error bound of low-rank textures in diagonals, for all frames; by default a texel for every vertex and frame.
    texture : {"png16", "exr"}
        PNG with 16 bits, or EXR with 32-bit floats.
    progress : callable
        Receives the progress.

    Raises
    ------
    OutputError
        If the name does not end in .vat, or the folder cannot be written.
    SettingsError
        If `max_error` is not positive, or below what textures can hold, or textures would be too large.
    MissingExtraError
        If OpenEXR, which EXR needs, is not installed.

    Warns
    -----
    MixseqWarning
        If frames are not evenly spaced.
    """
    folder = Path(path)
    check_vat_target(folder)
    if texture not in TEXTURES:
        raise SettingsError(f"texture is {texture!r}; one of {', '.join(TEXTURES)} is expected")
    if texture == "exr":
        exr_library(folder)
    kind: Kind = np.uint16 if texture == "png16" else np.float32
    steps = np.diff(sequence.times)
    if steps.size and np.ptp(steps) > _UNEVEN * steps.mean():
        warn(
            f"{folder}: frames of textures are evenly spaced, those of the sequence are not; resample it (--fps)"
        )
    texels = Texels.of(sequence.header)
    frames = Frames.of(sequence.points, texels)
    if max_error is None:
        textures = plain(frames, texels, kind)
        report = _measured(frames, _diagonal(sequence), textures)
    else:
        textures, report = _bounded(sequence, frames, texels, kind, max_error, progress)
    texels.add_vertices(np.asarray(sequence.points[0]), len(textures.images["points"].pixels) // texels.rows)
    with atomic_folder(folder, VAT_FILE_NAMES) as temporary:
        report = replace(report, file_bytes=sum(_write_images(temporary, textures, texture)))
        mesh = temporary / "mesh.glb"
        with open_buffer_writer(mesh, mesh, texels.layout):
            pass
        told = _told(sequence, texels, textures, texture, report)
        (temporary / "vat.json").write_text(json.dumps(told, indent=1), encoding="utf-8")
        for name in SHADERS:
            (temporary / name).write_text(shader(name, told), encoding="utf-8")
    return report


def check_vat_target(path: Path) -> None:
    """Raise an error for a path that is not a folder name of textures."""
    if path.suffix.lower() != VAT_EXTENSION:
        raise OutputError(f"{path}: vertex animation textures are a folder; end its name in {VAT_EXTENSION}")
    if path.exists() and not path.is_dir():
        raise OutputError(f"{path} is a file, and vertex animation textures are a folder; give another name")


def _bounded(
    sequence: MeshSequence, frames: Frames, texels: Texels, kind: Kind, max_error: float, progress: Progress
) -> tuple[Textures, VatReport]:
    """Return low-rank textures within an error in diagonals, including rounding."""
    if not max_error > 0:
        raise SettingsError(f"max_error is {max_error:g}; a positive number of diagonals is expected")
    bound, diagonal = _CAUTION * max_error, _diagonal(sequence)
    for _ in range(_TRIES):
        textures = low_rank(fit_low_rank(sequence, bound, progress=progress), frames, texels, kind)
        report = _measured(frames, diagonal, textures)
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


def _diagonal(sequence: MeshSequence) -> float:
    return bounding_diagonal(np.asarray(sequence.points[0], dtype=np.float64)) or 1.0


def _measured(frames: Frames, diagonal: float, textures: Textures) -> VatReport:
    shown = textures.shown
    squares = np.square(shown.points - frames.points).sum(axis=2)
    lengths = np.linalg.norm(shown.normals, axis=2)
    cosines = np.sum(shown.normals * frames.normals, axis=2) / np.where(lengths > 0, lengths, 1)
    angles = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
    return VatReport(
        kind=textures.told["kind"],
        rank=textures.rank,
        max_error=float(np.sqrt(squares.max(initial=0))) / diagonal,
        rms_error=float(np.sqrt(squares.mean())) / diagonal,
        normal_degrees=float(np.sqrt(np.square(angles).mean())),
        file_bytes=0,
        # On a graphics card pixels have four channels.
        memory_bytes=sum(4 * each.pixels[..., 0].nbytes for each in textures.images.values()),
    )


def _write_images(folder: Path, textures: Textures, texture: TextureName) -> list[int]:
    sizes = []
    for name, each in textures.images.items():
        file = folder / _file(name, texture)
        if texture == "exr":
            write_exr(file, np.asarray(each.pixels, dtype=np.float32))
        else:
            file.write_bytes(png_of(each.pixels))
        sizes.append(file.stat().st_size)
    return sizes


def _file(name: str, texture: TextureName) -> str:
    return f"{name}.{'exr' if texture == 'exr' else 'png'}"


def _told(
    sequence: MeshSequence, texels: Texels, textures: Textures, texture: TextureName, report: VatReport
) -> dict[str, Any]:
    """Return the contents of ``vat.json``."""
    header = sequence.header
    points = np.asarray(sequence.points)
    images = {}
    for name, each in textures.images.items():
        height, width = each.pixels.shape[:2]
        # One number is enough where all channels have the same.
        same = name == "coefficients" or textures.rank > 0
        offset = float(each.offset[0]) if same else each.offset.tolist()
        scale = float(each.scale[0]) if same else each.scale.tolist()
        images[name] = {
            "file": _file(name, texture),
            "width": width,
            "height": height,
            "offset": offset,
            "scale": scale,
        }
    return {
        "format": "mixseq vertex animation texture",
        "version": 1,
        **textures.told,
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
        "bounds": {"min": points.min(axis=(0, 1)).tolist(), "max": points.max(axis=(0, 1)).tolist()},
        "up_axis": header.up_axis,
        "metres_per_unit": header.metres_per_unit,
        "error": {
            "max": report.max_error,
            "rms": report.rms_error,
            "normal_degrees": report.normal_degrees,
        },
    }
