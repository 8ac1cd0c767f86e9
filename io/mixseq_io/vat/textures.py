r"""Vertex animation textures of points and normals, plain or as sums of basis vectors, encoded as pictures.

Plain
    A texel per vertex and frame: its point between the bounds of all frames, and its normal.
Low rank
    :math:`x_t(v) = \sum_k b_k(v) u_{tk p_v}` (`mixseq.rigging.low_rank`): a texel per vertex and four basis vectors,
    after one with its part; coefficients are a separate texture of two rows per frame. Normals are sums with the same
    coefficients, their basis vectors fitted by least squares.

Shaders decode numbers as :math:`o + s\,p` of a pixel :math:`p` between 0 and 1. PNG holds `p` in 16 bits (8 for normals
of single frames), EXR the numbers themselves, with o = 0 and s = 1. PNG is written here with zlib, since Pillow has no
16 bits in three channels. Each row is filtered by none, the pixel to the left, or the one above, whichever has the
smallest sum of magnitudes, as in libpng.

A texel is a vertex with one normal; glTF vertices that differ only by texture coordinates or materials share it. A
*layer* is one value of all texels, a frame or four basis vectors, in some rows of the texture. Layers are stacked:
shaders find a vertex in layer `n` by an offset in rows from the first one, the second set of texture coordinates.

Specifications: https://www.w3.org/TR/png-3/, https://openexr.com/en/latest/OpenEXRFileLayout.html
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import MissingExtraError, SettingsError
from mixseq.rigging.low_rank import LowRank
from mixseq.sequence.header import SequenceHeader
from mixseq.types import FloatArray, Index
from mixseq_io.gltf.codecs import ARRAY_BUFFER, Layout
from mixseq_io.gltf.new_document import MovingMesh, create_scene

Pixels = NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.float32]
Kind = type[np.uint8] | type[np.uint16] | type[np.float32]

_COARSE, _FINE = 65535.0, 1024.0


@dataclass(frozen=True, eq=False)
class Encoded:
    """Numbers as pixels."""

    pixels: Pixels
    offset: NDArray[np.float64]
    scale: NDArray[np.float64]

    @property
    def numbers(self) -> NDArray[np.float64]:
        """Numbers decoded by a shader."""
        largest = {"f": 1, "u": 2 ** (8 * self.pixels.itemsize) - 1}[self.pixels.dtype.kind]
        return np.asarray(self.offset + self.scale * (self.pixels.astype(np.float64) / largest))


def encoded(
    numbers: NDArray[np.floating],
    low: NDArray[np.floating] | float,
    high: NDArray[np.floating] | float,
    kind: Kind,
) -> Encoded:
    """Encode numbers ``(..., channels)`` between two limits of their channels."""
    channels = numbers.shape[-1]
    if kind is np.float32:
        return Encoded(numbers.astype(np.float32), np.zeros(channels), np.ones(channels))
    offset = np.broadcast_to(np.asarray(low, np.float64), channels)
    scale = np.broadcast_to(np.asarray(high, np.float64), channels) - offset
    shares = (numbers - offset) / np.where(scale > 0, scale, 1)
    largest = 255 if kind is np.uint8 else 65535
    whole = np.rint(np.clip(shares, 0, 1) * largest)
    pixels: Pixels = whole.astype(np.uint8) if kind is np.uint8 else whole.astype(np.uint16)
    return Encoded(pixels, offset, scale)


def in_two(numbers: NDArray[np.floating], largest: float, kind: Kind) -> tuple[Encoded, NDArray[np.float64]]:
    """Encode numbers ``(T, n, 3)`` up to a largest magnitude in twice as many rows ``(2 T, n, 3)``.

    Shaders decode :math:`o + s (p + p' / 65535)` with the pixel `p'`, T rows below `p`. It has 6 bits, since more are
    incompressible noise; in EXR it is 0.
    """
    if kind is np.float32:
        made = encoded(np.concatenate([numbers, np.zeros_like(numbers)]), 0, 1, np.float32)
        return made, made.numbers[: len(numbers)]
    steps = np.rint(np.clip((numbers / largest + 1) / 2, 0, 1) * _COARSE**2)
    coarse, fine = np.divmod(steps, _COARSE)
    fine = np.minimum(np.rint(fine / _FINE) * _FINE, _COARSE)
    rows = np.concatenate([coarse, fine]).astype(np.uint16)
    made = Encoded(rows, np.full(3, -largest), np.full(3, 2 * largest))
    return made, -largest + 2 * largest * (coarse + fine / _COARSE) / _COARSE


LARGEST = 16384
"""Largest side in pixels, above the limit of many graphics cards."""

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_COLOUR_TYPES = {3: 2, 4: 6}
_NONE, _SUB, _UP = 0, 1, 2


def png_of(pixels: NDArray[Any]) -> bytes:
    """Return a PNG of pixels ``(height, width, 3 or 4)``, from the top left, uint8 or uint16."""
    height, width, channels = pixels.shape
    size = pixels.dtype.itemsize * channels
    rows = np.ascontiguousarray(pixels.astype(pixels.dtype.newbyteorder(">"))).view(np.uint8)
    rows = rows.reshape(height, width * size)
    left = np.pad(rows, ((0, 0), (size, 0)))[:, : width * size]
    above = np.pad(rows, ((1, 0), (0, 0)))[:height]
    candidates = np.stack([rows, rows - left, rows - above])
    magnitudes = np.abs(candidates.view(np.int8).astype(np.int16)).sum(axis=2)
    chosen = magnitudes.argmin(axis=0)
    filters = np.array([_NONE, _SUB, _UP], np.uint8)[chosen][:, None]
    lines = np.concatenate([filters, candidates[chosen, np.arange(height)]], axis=1)
    header = struct.pack(
        ">IIBBBBB", width, height, 8 * pixels.dtype.itemsize, _COLOUR_TYPES[channels], 0, 0, 0
    )
    parts = (b"IHDR", header), (b"IDAT", zlib.compress(lines.tobytes(), 9)), (b"IEND", b"")
    return _SIGNATURE + b"".join(_chunk(*part) for part in parts)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def write_exr(path: Path, pixels: NDArray[np.float32]) -> None:
    """Write an EXR of pixels ``(height, width, 3 or 4)``, from the top left."""
    library = exr_library(path)
    names = "RGBA"[: pixels.shape[2]]
    channels = {name: np.ascontiguousarray(pixels[..., i]) for i, name in enumerate(names)}
    header = {"compression": library.ZIP_COMPRESSION, "type": library.scanlineimage}
    with library.File(header, channels) as file:
        file.write(str(path))


def exr_library(path: Path) -> Any:
    """Return the package that writes EXR."""
    try:
        import OpenEXR
    except ModuleNotFoundError as error:
        raise MissingExtraError(
            f"{path}: EXR textures need OpenEXR; get it with: pip install 'mixseq[exr]', or write png16"
        ) from error
    return OpenEXR


_USUAL_WIDTH = 4096
_CHANNELS = 4


@dataclass(frozen=True, eq=False)
class Texels:
    """Texels of a sequence, N vertices ``(N,)`` and normals ``(N,)`` (`normals_of`), in a glTF document without points.

    `of_primitive` are the texels ``(n,)`` of every primitive's glTF vertices.
    """

    header: SequenceHeader
    layout: Layout
    meshes: list[MovingMesh]
    vertices: Index
    normals: Index
    of_primitive: list[Index]

    @staticmethod
    def of(header: SequenceHeader) -> Texels:
        """Find the texels of a sequence."""
        layout, meshes = create_scene(header)
        keys, first = [], 0
        for mesh in meshes:
            hard_edges = mesh.scene_mesh.hard_edges
            groups = (
                mesh.scene_mesh.vertex_count if hard_edges is None else int(hard_edges.max(initial=-1)) + 1
            )
            for each in mesh.primitives:
                assert each.normal_ids is not None  # new documents have some
                vertices = np.arange(header.vertex_count)[mesh.scene_mesh.vertices][each.vertex_ids]
                keys.append(np.column_stack([vertices, each.normal_ids + first]))
            first += groups
        distinct, numbers = np.unique(np.concatenate(keys), axis=0, return_inverse=True)
        ends = np.cumsum([len(each) for each in keys])[:-1]
        return Texels(
            header, layout, meshes, distinct[:, 0], distinct[:, 1], np.split(numbers.reshape(-1), ends)
        )

    @property
    def count(self) -> int:
        """Number N of texels."""
        return len(self.vertices)

    def normals_of(self, points: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the normals ``(n, N, 3)`` of texels for points ``(n, V, 3)``."""
        found = [mesh.compute_normals(points.astype(np.float32)) for mesh in self.meshes]
        return np.asarray(np.concatenate(found, axis=1)[:, self.normals])

    @cached_property
    def width(self) -> int:
        """Width of textures, no more than a layer's rows need."""
        return -(-self.count // self.rows)

    @cached_property
    def rows(self) -> int:
        """Rows of a layer in the texture."""
        return -(-self.count // _USUAL_WIDTH)

    def stacked(self, layers: NDArray[np.floating], what: str) -> NDArray[np.floating]:
        """Return layers ``(n, N, channels)`` as pixels ``(n * rows, width, channels)``, padded with zeros."""
        count, _, channels = layers.shape
        if count * self.rows > LARGEST:
            raise SettingsError(
                f"{count} {what} of {self.count} texels take {count * self.rows} rows of a texture, and graphics cards "
                f"take {LARGEST}; write fewer frames, or few basis vectors (--max-error)"
            )
        filled = np.zeros((count, self.rows * self.width, channels), layers.dtype)
        filled[:, : self.count] = layers
        return filled.reshape(count * self.rows, self.width, channels)

    def add_vertices(self, points: NDArray[np.floating], layers: int) -> None:
        """Give the document points ``(V, 3)``, their normals, and their places in a texture of `layers` layers."""
        normals = self.normals_of(points[None])[0]
        places = np.arange(self.count)
        lookup = np.column_stack(
            [(places % self.width + 0.5) / self.width, (places // self.width + 0.5) / (layers * self.rows)]
        ).astype(np.float32)
        here = points.astype(np.float32)[self.vertices]
        numbers = iter(self.of_primitive)
        for each in (primitive for mesh in self.meshes for primitive in mesh.primitives):
            texels, attributes = next(numbers), each.entry["attributes"]
            attributes["POSITION"] = self.layout.add_points(here[texels])
            attributes["NORMAL"] = self.layout.add_array(normals[texels], target=ARRAY_BUFFER)
            if "TEXCOORD_0" not in attributes:  # glTF counts sets of texture coordinates from 0 on
                none = np.zeros((len(texels), 2), np.float32)
                attributes["TEXCOORD_0"] = self.layout.add_array(none, target=ARRAY_BUFFER)
            attributes["TEXCOORD_1"] = self.layout.add_array(lookup[texels], target=ARRAY_BUFFER)


def in_fours(numbers: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return numbers ``(N, K)`` as layers ``(ceil(K / 4), N, 4)``, padded with zeros."""
    count, rank = numbers.shape
    layers = -(-rank // _CHANNELS)
    padded = np.zeros((count, layers * _CHANNELS), numbers.dtype)
    padded[:, :rank] = numbers
    return np.ascontiguousarray(padded.reshape(count, layers, _CHANNELS).swapaxes(0, 1))


_NEGLIGIBLE = 1e-4
"""Singular values of coefficients below this fraction of a part's largest are ignored for normals."""


@dataclass(frozen=True, eq=False)
class Frames:
    """Points and normals to show, in float64."""

    points: NDArray[np.float64]  # (T, N, 3) positions of the N texels in every frame
    normals: NDArray[np.float64]  # (T, N, 3) normals of the N texels in every frame

    @classmethod
    def of(cls, points: FloatArray, texels: Texels) -> Frames:
        """Make frames of points ``(T, V, 3)``."""
        normals = np.concatenate([texels.normals_of(each[None]) for each in points])
        return cls(np.asarray(points, dtype=np.float64)[:, texels.vertices], normals.astype(np.float64))


@dataclass(frozen=True, eq=False)
class Textures:
    """Textures and their decoded numbers."""

    images: dict[str, Encoded]  # by name
    told: dict[str, Any]  # further contents of vat.json
    rank: int  # number of basis vectors, 0 of plain textures
    shown: Frames  # points and normals as a shader has them


def plain(frames: Frames, texels: Texels, kind: Kind) -> Textures:
    """Return textures with a texel per vertex and frame."""
    low, high = frames.points.min(axis=(0, 1)), frames.points.max(axis=(0, 1))
    coarse = np.uint8 if kind is np.uint16 else kind
    images = {
        "points": encoded(texels.stacked(frames.points, "frames"), low, high, kind),
        "normals": encoded(texels.stacked(frames.normals, "frames"), -1, 1, coarse),
    }
    shown = Frames(_unstacked(images["points"], texels), _unstacked(images["normals"], texels))
    return Textures(images, {"kind": "plain", "layers": 1, "part_scale": 0}, 0, shown)


def _unstacked(texture: Encoded, texels: Texels) -> NDArray[np.float64]:
    numbers = texture.numbers
    layers = numbers.reshape(len(numbers) // texels.rows, -1, numbers.shape[-1])
    return layers[:, : texels.count]


def low_rank(fitted: LowRank, frames: Frames, texels: Texels, kind: Kind) -> Textures:
    """Return textures of basis vectors and of coefficients."""
    basis = in_fours(fitted.basis[texels.vertices])
    layers, columns = len(basis), 4 * len(basis)
    count, parts = fitted.coefficients.shape[:2]
    coefficients = np.zeros((count, parts, columns, 3))
    coefficients[:, :, : fitted.rank] = fitted.coefficients
    if parts * columns > LARGEST:
        raise SettingsError(
            f"{parts} parts with {columns} basis vectors are too wide for a texture; allow more error"
        )
    if 2 * count > LARGEST:
        raise SettingsError(f"{count} frames are too high for a texture of coefficients; write fewer")
    largest = float(np.abs(coefficients).max(initial=0)) or 1.0
    table, seen = in_two(coefficients.reshape(count, -1, 3), largest, kind)
    seen = seen.reshape(coefficients.shape)
    own = fitted.parts[texels.vertices]
    normals = in_fours(_normal_basis(frames.normals, own, seen))
    steepest = float(np.abs(normals).max(initial=0)) or 1.0
    first = np.zeros((1, texels.count, 4))
    first[..., 0] = own  # a whole number, which pixels have as it is
    scale = 65535.0 if kind is np.uint16 else 1.0
    numbers = encoded(basis, -1, 1, kind)
    pixels = texels.stacked(
        np.concatenate([first.astype(numbers.pixels.dtype), numbers.pixels]), "basis vectors"
    )
    images = {
        "points": Encoded(pixels, numbers.offset, numbers.scale),
        "normals": encoded(texels.stacked(normals, "basis vectors"), -steepest, steepest, kind),
        "coefficients": table,
    }
    told = {"kind": "low rank", "layers": layers, "part_scale": scale}
    both = (_unstacked(images["points"], texels)[1:], _unstacked(images["normals"], texels))
    return Textures(images, told, fitted.rank, Frames(*(_summed(each, own, seen) for each in both)))


def _summed(
    basis: NDArray[np.float64], parts: NDArray[np.int64], coefficients: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the shader's sums ``(T, N, 3)`` of basis vectors ``(layers, N, 4)``."""
    flat = basis.swapaxes(0, 1).reshape(len(parts), -1)
    return np.stack([np.einsum("nk,nki->ni", flat, each[parts]) for each in coefficients])


def _normal_basis(
    normals: NDArray[np.float64], parts: NDArray[np.int64], coefficients: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return basis vectors ``(N, K)`` fitted to normals ``(T, N, 3)``."""
    found = np.zeros((normals.shape[1], coefficients.shape[2]))
    for part in np.unique(parts).tolist():
        own = parts == part
        columns = coefficients[:, part].swapaxes(0, 1).reshape(coefficients.shape[2], -1)
        inverse = np.linalg.pinv(columns, rcond=_NEGLIGIBLE)
        found[own] = normals[:, own].swapaxes(0, 1).reshape(int(own.sum()), -1) @ inverse
    return found
