r"""Vertex animation textures, writing: pictures, the mesh that looks them up, ``vat.json``, shaders.

Plain
    A texel for every vertex and frame: its point between the bounds of all frames, and its normal.
Low rank
    :math:`x_t(v) = \sum_k b_k(v) u_{tk p_v}` (`mixseq.rigging.low_rank`): four basis vectors are a texel of every
    vertex, behind one that tells its part; coefficients are a texture of their own, with two rows for a frame. Normals
    are sums with the same coefficients, whose basis vectors are those that come closest to them (least squares).

What is told of errors is that of the numbers in the pictures, as a shader sees them but for its float32.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import OutputError, SettingsError
from mixseq.progress import Progress, silent
from mixseq.public import public
from mixseq.rigging.low_rank import LowRank, fit_low_rank
from mixseq.sequence import MeshSequence, bounding_diagonal
from mixseq_io.atomic import replacing_many
from mixseq_io.blocks import warn
from mixseq_io.gltf.buffers import writing_buffer
from mixseq_io.vat.encoding import Encoded, Kind, encoded, in_two
from mixseq_io.vat.images import LARGEST, exr_library, png_of, write_exr
from mixseq_io.vat.texels import Texels, in_fours

VAT_EXTENSION = ".vat"
TextureName = Literal["png16", "exr"]
TEXTURES: tuple[TextureName, ...] = get_args(TextureName)

_SHADERS = ("webgl2.js", "godot.gdshader", "unity.shader", "unreal.hlsl")
_TRIES = 6
_CAUTION = 0.98
"""What of the error is left to the fit at first; the rest is for rounding."""

_UNEVEN = 1e-3

_NEGLIGIBLE = 1e-4
"""Coefficients this small, relative to the largest of a part, say nothing of normals; ours."""


@dataclass(frozen=True)
class VatReport:
    """What was written, and how far it is off.

    Attributes
    ----------
    kind : {"plain", "low rank"}
        See the head of this module.
    rank : int
        Number of basis vectors, 0 of plain textures.
    max_error, rms_error : float
        Largest and root mean square distance of a vertex, in diagonals.
    normal_degrees : float
        Root mean square angle of the normals.
    file_bytes, memory_bytes : int
        Of the textures, as files and in the memory of a graphics card.
    """

    kind: str
    rank: int
    max_error: float
    rms_error: float
    normal_degrees: float
    file_bytes: int
    memory_bytes: int


@dataclass(frozen=True, eq=False)
class _Made:
    """Textures by name, what ``vat.json`` tells besides, points and normals of all frames as a shader has them."""

    textures: dict[str, Encoded]
    told: dict[str, Any]
    rank: int
    points: NDArray[np.float64]
    normals: NDArray[np.float64]


@public
def write_vat(
    path: str | os.PathLike[str],
    sequence: MeshSequence,
    max_error: float | None = None,
    texture: TextureName = "png16",
    progress: Progress = silent,
) -> VatReport:
    """Write a sequence as vertex animation textures: a folder with pictures, a mesh, ``vat.json`` and shaders.

    Parameters
    ----------
    path : path-like
        The folder, whose name ends in ``.vat``.
    sequence : MeshSequence
        What to write.
    max_error : float, optional
        Write low-rank textures that are off by at most so many diagonals, in all frames; by default a texel for every
        vertex and frame.
    texture : {"png16", "exr"}
        PNG with 16 bits, or EXR with 32-bit floats.
    progress : callable
        Told how far the work is.

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
    if max_error is None:
        made = _plain(sequence, texels, kind)
    else:
        made = _bounded(sequence, texels, kind, max_error, progress)
    report = _measured(sequence, texels, made)
    texels.add_vertices(np.asarray(sequence.points[0]), len(made.textures["points"].pixels) // texels.rows)
    folder.mkdir(exist_ok=True)
    with replacing_many(folder / "vat.json") as temporary:
        report = replace(report, file_bytes=sum(_write_textures(temporary, made, texture)))
        mesh = temporary / "mesh.glb"
        with writing_buffer(mesh, mesh, texels.layout):
            pass
        told = _told(sequence, texels, made, texture, report)
        (temporary / "vat.json").write_text(json.dumps(told, indent=1), encoding="utf-8")
        for name in _SHADERS:
            (temporary / name).write_text(_shader(name, told), encoding="utf-8")
    return report


def check_vat_target(path: Path) -> None:
    """Refuse what is no name of a folder of textures.

    Raises
    ------
    OutputError
        If it does not end in .vat.
    """
    if path.suffix.lower() != VAT_EXTENSION:
        raise OutputError(f"{path}: vertex animation textures are a folder; end its name in {VAT_EXTENSION}")
    if path.exists() and not path.is_dir():
        raise OutputError(f"{path} is a file, and vertex animation textures are a folder; give another name")


def _frames(texels: Texels, points: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return the normals of all frames ``(T, N, 3)``."""
    return np.concatenate([texels.normals_of(each[None]) for each in points])


def _plain(sequence: MeshSequence, texels: Texels, kind: Kind) -> _Made:
    points = np.asarray(sequence.points, dtype=np.float64)[:, texels.vertices]
    low, high = points.min(axis=(0, 1)), points.max(axis=(0, 1))
    textures = {
        "points": encoded(texels.stacked(points, "frames"), low, high, kind),
        "normals": encoded(
            texels.stacked(_frames(texels, sequence.points), "frames"),
            -1,
            1,
            np.uint8 if kind is np.uint16 else kind,
        ),
    }
    return _Made(
        textures,
        {"kind": "plain", "layers": 1, "part_scale": 0},
        0,
        _unstacked(textures["points"], texels),
        _unstacked(textures["normals"], texels),
    )


def _unstacked(texture: Encoded, texels: Texels) -> NDArray[np.float64]:
    numbers = texture.numbers
    layers = numbers.reshape(len(numbers) // texels.rows, -1, numbers.shape[-1])
    return layers[:, : texels.count]


def _bounded(
    sequence: MeshSequence, texels: Texels, kind: Kind, max_error: float, progress: Progress
) -> _Made:
    """Return low-rank textures within an error, of which rounding takes a share."""
    if not max_error > 0:
        raise SettingsError(f"max_error is {max_error:g}; a positive number of diagonals is expected")
    bound = _CAUTION * max_error
    for _ in range(_TRIES):
        made = _low_rank(fit_low_rank(sequence, bound, progress=progress), sequence, texels, kind)
        excess = _measured(sequence, texels, made).max_error - max_error
        if excess <= 0:
            return made
        bound -= 1.5 * excess
        if bound <= 0:
            break
    raise SettingsError(
        f"max_error is {max_error:g}, and rounding to 16 bits alone takes about {max_error + excess - bound:.1g}; "
        "allow more, or write EXR (--texture exr)"
    )


def _low_rank(fitted: LowRank, sequence: MeshSequence, texels: Texels, kind: Kind) -> _Made:
    basis = in_fours(fitted.basis[texels.vertices])
    layers, columns = len(basis), 4 * len(basis)
    frames, parts = fitted.coefficients.shape[:2]
    coefficients = np.zeros((frames, parts, columns, 3))
    coefficients[:, :, : fitted.rank] = fitted.coefficients
    if parts * columns > LARGEST:
        raise SettingsError(
            f"{parts} parts with {columns} basis vectors are too wide for a texture; allow more error"
        )
    if 2 * frames > LARGEST:
        raise SettingsError(f"{frames} frames are too high for a texture of coefficients; write fewer")
    largest = float(np.abs(coefficients).max(initial=0)) or 1.0
    table, seen = in_two(coefficients.reshape(frames, -1, 3), largest, kind)
    seen = seen.reshape(coefficients.shape)
    own = fitted.parts[texels.vertices]
    normals = in_fours(_normal_basis(_frames(texels, sequence.points), own, seen))
    steepest = float(np.abs(normals).max(initial=0)) or 1.0
    first = np.zeros((1, texels.count, 4))
    first[..., 0] = own  # a whole number, which pixels have as it is
    scale = 65535.0 if kind is np.uint16 else 1.0
    numbers = encoded(basis, -1, 1, kind)
    pixels = texels.stacked(
        np.concatenate([first.astype(numbers.pixels.dtype), numbers.pixels]), "basis vectors"
    )
    textures = {
        "points": Encoded(pixels, numbers.offset, numbers.scale),
        "normals": encoded(texels.stacked(normals, "basis vectors"), -steepest, steepest, kind),
        "coefficients": table,
    }
    told = {"kind": "low rank", "layers": layers, "part_scale": scale}
    both = (_unstacked(textures["points"], texels)[1:], _unstacked(textures["normals"], texels))
    points, directions = (_summed(each, own, seen) for each in both)
    return _Made(textures, told, fitted.rank, points, directions)


def _summed(
    basis: NDArray[np.float64], parts: NDArray[np.int64], coefficients: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return what a shader makes of basis vectors ``(layers, N, 4)``: ``(T, N, 3)``."""
    flat = basis.swapaxes(0, 1).reshape(len(parts), -1)
    return np.stack([np.einsum("nk,nki->ni", flat, each[parts]) for each in coefficients])


def _normal_basis(
    normals: NDArray[np.float32], parts: NDArray[np.int64], coefficients: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return basis vectors ``(N, K)`` whose sums come closest to normals ``(T, N, 3)``."""
    found = np.zeros((normals.shape[1], coefficients.shape[2]))
    for part in np.unique(parts).tolist():
        own = parts == part
        columns = coefficients[:, part].swapaxes(0, 1).reshape(coefficients.shape[2], -1)
        inverse = np.linalg.pinv(columns, rcond=_NEGLIGIBLE)
        found[own] = normals[:, own].swapaxes(0, 1).reshape(int(own.sum()), -1) @ inverse
    return found


def _measured(sequence: MeshSequence, texels: Texels, made: _Made) -> VatReport:
    points = np.asarray(sequence.points, dtype=np.float64)
    diagonal = bounding_diagonal(points[0]) or 1.0
    squares = np.square(made.points - points[:, texels.vertices]).sum(axis=2)
    normals = _frames(texels, sequence.points).astype(np.float64)
    lengths = np.linalg.norm(made.normals, axis=2)
    cosines = np.sum(made.normals * normals, axis=2) / np.where(lengths > 0, lengths, 1)
    angles = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
    return VatReport(
        kind=made.told["kind"],
        rank=made.rank,
        max_error=float(np.sqrt(squares.max(initial=0))) / diagonal,
        rms_error=float(np.sqrt(squares.mean())) / diagonal,
        normal_degrees=float(np.sqrt(np.square(angles).mean())),
        file_bytes=0,
        memory_bytes=sum(_memory(each) for each in made.textures.values()),
    )


def _memory(texture: Encoded) -> int:
    """Return the bytes of a texture on a graphics card, which has four channels."""
    pixels = texture.pixels
    height, width, _ = pixels.shape
    return int(height * width * 4 * pixels.itemsize)


def _write_textures(folder: Path, made: _Made, texture: TextureName) -> list[int]:
    sizes = []
    for name, each in made.textures.items():
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
    sequence: MeshSequence, texels: Texels, made: _Made, texture: TextureName, report: VatReport
) -> dict[str, Any]:
    """Return what ``vat.json`` holds."""
    header = sequence.header
    points = np.asarray(sequence.points)
    textures = {}
    for name, each in made.textures.items():
        height, width = each.pixels.shape[:2]
        # One number is enough where all channels have the same.
        same = name == "coefficients" or made.rank > 0
        offset = float(each.offset[0]) if same else each.offset.tolist()
        scale = float(each.scale[0]) if same else each.scale.tolist()
        textures[name] = {
            "file": _file(name, texture),
            "width": width,
            "height": height,
            "offset": offset,
            "scale": scale,
        }
    return {
        "format": "mixseq vertex animation texture",
        "version": 1,
        **made.told,
        "rank": made.rank,
        "texture": texture,
        "mesh": "mesh.glb",
        "frames": header.frame_count,
        "fps": header.fps,
        "start": float(header.times[0]),
        "vertices": header.vertex_count,
        "texels": texels.count,
        "width": textures["points"]["width"],
        "height": textures["points"]["height"],
        "rows": texels.rows,
        "textures": textures,
        "bounds": {"min": points.min(axis=(0, 1)).tolist(), "max": points.max(axis=(0, 1)).tolist()},
        "up_axis": header.up_axis,
        "metres_per_unit": header.metres_per_unit,
        "error": {
            "max": report.max_error,
            "rms": report.rms_error,
            "normal_degrees": report.normal_degrees,
        },
    }


def _shader(name: str, told: dict[str, Any]) -> str:
    """Return a shader with the numbers of a file."""
    text = files("mixseq_io.vat").joinpath("shaders", name).read_text(encoding="utf-8")
    values = {key.upper(): str(told[key]) for key in ("frames", "width", "height", "rows", "layers", "fps")}
    values["FPS"] = (
        f"{float(told['fps']):.9g}" if "." in f"{float(told['fps']):.9g}" else f"{told['fps']:.1f}"
    )
    values["LOW_RANK"] = str(int(told["kind"] != "plain"))
    values["PART_SCALE"] = f"{told['part_scale']:.1f}"
    values["NORMALS_HEIGHT"] = str(told["textures"]["normals"]["height"])
    for key in ("points", "normals", "coefficients"):
        texture = told["textures"].get(key, {"offset": 0.0, "scale": 1.0})
        for part in ("offset", "scale"):
            numbers = texture[part] if isinstance(texture[part], list) else [texture[part]]
            values[f"{key}_{part}".upper()] = ", ".join(repr(float(each)) for each in numbers)
    for key, value in values.items():
        text = text.replace(f"@{key}@", value)
    return text
