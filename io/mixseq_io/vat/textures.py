r"""Encode points and normals as vertex animation textures, plain or as sums of basis vectors.

Plain
    One texel per vertex and frame holds the point, relative to the bounds of all frames; another texture the normal.
Low rank
    :math:`x_t(v) = \sum_k b_k(v) u_{tk p_v}` (`mixseq.rigging.low_rank`). For every vertex, the first texel holds its
    part, and each further texel holds four basis vectors. Coefficients are a separate texture of two rows per frame.
    Normals are sums with the same coefficients; their basis vectors are fitted by least squares.

Shaders decode values as :math:`o + s\,p` from a pixel :math:`p` between 0 and 1. PNG stores `p` in 16 bits, or in 8
bits for plain normals. EXR stores the values, with o = 0 and s = 1. PNG is written with zlib, since Pillow cannot write
three channels of 16 bits; of each row, that filter is stored which has the smallest sum of magnitudes, as in libpng.

A texel represents a vertex with one normal; glTF vertices that differ only by texture coordinates or materials share a
texel. A *layer* holds one value of every texel, for a frame or for four basis vectors, in several rows of the texture.
The second texture coordinates locate a vertex in the first layer; shaders add an offset in rows for layer `n`.

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
from mixseq.mesh.measures import NO_ORIGIN
from mixseq.rigging.low_rank import LowRank
from mixseq.sequence.header import SequenceHeader
from mixseq.types import Float, FloatArray, Index
from mixseq_io.gltf.buffers import ARRAY_BUFFER, Layout
from mixseq_io.gltf.new_document import MovingMesh, create_scene

Pixels = NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.float32]
PixelType = type[np.uint8] | type[np.uint16] | type[np.float32]

_COARSE_LEVELS = 65535.0
_FINE_STEP = 1024.0


@dataclass(frozen=True, eq=False)
class EncodedImage:
    """Values encoded as pixels ``(height, width, channels)``."""

    pixels: Pixels
    offset: NDArray[np.float64]  # (channels,)
    scale: NDArray[np.float64]  # (channels,)

    @property
    def decoded(self) -> NDArray[np.float64]:
        """Values that a shader decodes from the pixels, in single precision."""
        largest = {"f": 1, "u": 2 ** (8 * self.pixels.itemsize) - 1}[self.pixels.dtype.kind]
        fractions = self.pixels.astype(np.float32) / np.float32(largest)
        return _decode_fractions(fractions, self.offset, self.scale)


def _decode_fractions(
    fractions: NDArray[np.float32], offset: NDArray[np.float64] | float, scale: NDArray[np.float64] | float
) -> NDArray[np.float64]:
    """Return o + s p of fractions p, computed in single precision as in shaders."""
    return np.asarray(np.float32(offset) + np.float32(scale) * fractions).astype(np.float64)


def encode_pixels(
    values: NDArray[np.floating],
    low: NDArray[np.floating] | float,
    high: NDArray[np.floating] | float,
    pixel_type: PixelType,
) -> EncodedImage:
    """Encode values ``(..., channels)`` relative to a lower and an upper limit of each channel."""
    channels = values.shape[-1]
    if pixel_type is np.float32:
        return EncodedImage(values.astype(np.float32), np.zeros(channels), np.ones(channels))
    offset = np.broadcast_to(np.asarray(low, np.float64), channels)
    scale = np.broadcast_to(np.asarray(high, np.float64), channels) - offset
    fractions = (values - offset) / np.where(scale > 0, scale, 1)
    largest = 255 if pixel_type is np.uint8 else 65535
    whole = np.rint(np.clip(fractions, 0, 1) * largest)
    pixels: Pixels = whole.astype(np.uint8) if pixel_type is np.uint8 else whole.astype(np.uint16)
    return EncodedImage(pixels, offset, scale)


def encode_coarse_and_fine(
    values: NDArray[np.floating], largest: float, pixel_type: PixelType
) -> tuple[EncodedImage, NDArray[np.float64]]:
    """Encode values ``(T, n, 3)`` with magnitudes up to `largest` in rows ``(2 T, n, 3)``; also return decoded values.

    Shaders decode :math:`o + s (p + p' / 65535)` with the pixel `p'`, T rows below `p`. `p'` has only 6 bits, since
    further bits are incompressible noise. In EXR `p'` is 0.
    """
    if pixel_type is np.float32:
        image = encode_pixels(np.concatenate([values, np.zeros_like(values)]), 0, 1, np.float32)
        return image, image.decoded[: len(values)]
    levels = np.rint(np.clip((values / largest + 1) / 2, 0, 1) * _COARSE_LEVELS**2)
    coarse, fine = np.divmod(levels, _COARSE_LEVELS)
    fine = np.minimum(np.rint(fine / _FINE_STEP) * _FINE_STEP, _COARSE_LEVELS)
    pixels = np.concatenate([coarse, fine]).astype(np.uint16)
    image = EncodedImage(pixels, np.full(3, -largest), np.full(3, 2 * largest))
    single, most = np.stack([coarse, fine]).astype(np.float32), np.float32(_COARSE_LEVELS)
    fractions = np.asarray((single[0] + single[1] / most) / most)
    return image, _decode_fractions(fractions, -largest, 2 * largest)


MAX_TEXTURE_SIDE_PIXELS = 16384
"""Largest width and height of a texture in pixels; many graphics cards have a smaller limit."""

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_COLOUR_TYPES = {3: 2, 4: 6}
_FILTER_NONE, _FILTER_SUB, _FILTER_UP = 0, 1, 2


def encode_png(pixels: NDArray[Any]) -> bytes:
    """Encode pixels ``(height, width, 3 or 4)``, uint8 or uint16, starting at the top left, as PNG."""
    height, width, channels = pixels.shape
    pixel_bytes = pixels.dtype.itemsize * channels
    rows = np.ascontiguousarray(pixels.astype(pixels.dtype.newbyteorder(">"))).view(np.uint8)
    rows = rows.reshape(height, width * pixel_bytes)
    left = np.pad(rows, ((0, 0), (pixel_bytes, 0)))[:, : width * pixel_bytes]
    above = np.pad(rows, ((1, 0), (0, 0)))[:height]
    candidates = np.stack([rows, rows - left, rows - above])
    magnitudes = np.abs(candidates.view(np.int8).astype(np.int16)).sum(axis=2)
    filter_ids = magnitudes.argmin(axis=0)
    filters = np.array([_FILTER_NONE, _FILTER_SUB, _FILTER_UP], np.uint8)[filter_ids][:, None]
    filtered_rows = np.concatenate([filters, candidates[filter_ids, np.arange(height)]], axis=1)
    bits = 8 * pixels.dtype.itemsize
    header = struct.pack(">IIBBBBB", width, height, bits, _COLOUR_TYPES[channels], 0, 0, 0)
    chunks = (b"IHDR", header), (b"IDAT", zlib.compress(filtered_rows.tobytes(), 9)), (b"IEND", b"")
    return _PNG_SIGNATURE + b"".join(_chunk(*part) for part in chunks)


def _chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def write_exr(path: Path, pixels: NDArray[np.float32]) -> None:
    """Write pixels ``(height, width, 3 or 4)``, starting at the top left, as an EXR file."""
    library = import_openexr(path)
    names = "RGBA"[: pixels.shape[2]]
    channels = {name: np.ascontiguousarray(pixels[..., i]) for i, name in enumerate(names)}
    header = {"compression": library.ZIP_COMPRESSION, "type": library.scanlineimage}
    with library.File(header, channels) as file:
        file.write(str(path))


def import_openexr(path: Path) -> Any:
    """Import the package OpenEXR, which writes EXR files."""
    try:
        import OpenEXR
    except ModuleNotFoundError as error:
        raise MissingExtraError(
            f"{path}: EXR textures need OpenEXR; get it with: pip install 'mixseq[exr]', or write png16"
        ) from error
    return OpenEXR


_MAX_TEXELS_PER_ROW = 4096
_BASIS_VECTORS_PER_TEXEL = 4


@dataclass(frozen=True, eq=False)
class Texels:
    """Texels of a sequence, and a glTF document to which `add_vertices` adds points."""

    origin: Float  # (3,) of points in textures and document
    layout: Layout
    meshes: list[MovingMesh]
    vertices: Index  # (N,)
    normals: Index  # (N,) normal of each texel, counted over all meshes
    primitive_texels: list[Index]  # for every primitive, the texels (n,) of its glTF vertices

    @staticmethod
    def from_header(header: SequenceHeader, origin: Float = NO_ORIGIN) -> Texels:
        """Find the texels of a sequence."""
        layout, meshes = create_scene(header, origin)
        pairs, first = [], 0
        for mesh in meshes:
            scene_mesh = mesh.scene_mesh
            for primitive in mesh.primitives:
                assert primitive.normal_ids is not None  # new documents have normal ids
                vertices = np.arange(header.vertex_count)[scene_mesh.vertices][primitive.vertex_ids]
                pairs.append(np.column_stack([vertices, primitive.normal_ids + first]))
            hard_edges = scene_mesh.hard_edges
            first += scene_mesh.vertex_count if hard_edges is None else int(hard_edges.max(initial=-1)) + 1
        distinct, ids = np.unique(np.concatenate(pairs), axis=0, return_inverse=True)
        primitive_texels = np.split(ids.reshape(-1), np.cumsum([len(own) for own in pairs])[:-1])
        return Texels(origin, layout, meshes, distinct[:, 0], distinct[:, 1], primitive_texels)

    @property
    def count(self) -> int:
        """Number N of texels."""
        return len(self.vertices)

    def normals_of(self, points: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the normals ``(n, N, 3)`` of texels in poses ``(n, V, 3)``."""
        normals = [mesh.compute_normals(points.astype(np.float32)) for mesh in self.meshes]
        return np.asarray(np.concatenate(normals, axis=1)[:, self.normals])

    @cached_property
    def width(self) -> int:
        """Smallest width of textures at which a layer has `rows` rows."""
        return -(-self.count // self.rows)

    @cached_property
    def rows(self) -> int:
        """Number of rows of a layer in the texture."""
        return -(-self.count // _MAX_TEXELS_PER_ROW)

    def check_height(self, count: int, content: str) -> None:
        """Raise an error if a number of layers takes too many rows of a texture."""
        if count * self.rows > MAX_TEXTURE_SIDE_PIXELS:
            raise SettingsError(
                f"{count} {content} of {self.count} texels take {count * self.rows} rows of a texture; graphics cards "
                f"take {MAX_TEXTURE_SIDE_PIXELS}; write fewer frames, or few basis vectors (--max-error)"
            )

    def stack_layers(self, layers: NDArray[np.floating], content: str) -> NDArray[np.floating]:
        """Stack layers ``(n, N, channels)`` into pixels ``(n * rows, width, channels)``, padded with zeros."""
        count, _, channels = layers.shape
        self.check_height(count, content)
        padded = np.pad(layers, ((0, 0), (0, self.rows * self.width - self.count), (0, 0)))
        return padded.reshape(count * self.rows, self.width, channels)

    def add_vertices(self, points: NDArray[np.floating], layers: int) -> None:
        """Add points ``(V, 3)``, their normals, and texture coordinates for `layers` layers to the document."""
        normals = self.normals_of(points[None])[0]
        rows, columns = np.divmod(np.arange(self.count), self.width)
        uvs = np.column_stack([(columns + 0.5) / self.width, (rows + 0.5) / (layers * self.rows)])
        uvs = uvs.astype(np.float32)
        positions = points.astype(np.float32)[self.vertices]
        primitives = (primitive for mesh in self.meshes for primitive in mesh.primitives)
        for primitive, texels in zip(primitives, self.primitive_texels, strict=True):
            attributes = primitive.entry["attributes"]
            attributes["POSITION"] = self.layout.add_points(positions[texels])
            attributes["NORMAL"] = self.layout.add_array(normals[texels], target=ARRAY_BUFFER)
            if "TEXCOORD_0" not in attributes:  # glTF needs a set of texture coordinates 0 before set 1
                zeros = np.zeros((len(texels), 2), np.float32)
                attributes["TEXCOORD_0"] = self.layout.add_array(zeros, target=ARRAY_BUFFER)
            attributes["TEXCOORD_1"] = self.layout.add_array(uvs[texels], target=ARRAY_BUFFER)


def pack_basis_vectors(basis: NDArray[np.floating]) -> NDArray[np.floating]:
    """Pack basis vectors ``(N, K)`` into layers ``(ceil(K / 4), N, 4)``, padded with zeros."""
    padded = np.pad(basis, ((0, 0), (0, -basis.shape[1] % _BASIS_VECTORS_PER_TEXEL)))
    return np.ascontiguousarray(padded.reshape(len(basis), -1, _BASIS_VECTORS_PER_TEXEL).swapaxes(0, 1))


_SINGULAR_VALUE_CUTOFF = 1e-4
"""Smallest singular value that the fit of normals uses, relative to the largest value of the part's coefficients."""


@dataclass(frozen=True, eq=False)
class VertexFrames:
    """Points and normals of N texels in every frame."""

    points: NDArray[np.float64]  # (T, N, 3)
    normals: NDArray[np.float64]  # (T, N, 3)

    @classmethod
    def from_points(cls, points: FloatArray, texels: Texels) -> VertexFrames:
        """Select the points of texels from poses ``(T, V, 3)``, and compute the normals."""
        normals = np.concatenate([texels.normals_of(frame[None]) for frame in points])
        return cls(np.asarray(points, dtype=np.float64)[:, texels.vertices], normals.astype(np.float64))


@dataclass(frozen=True, eq=False)
class Textures:
    """Encoded textures and the values that shaders decode from them."""

    images: dict[str, EncodedImage]  # textures by name
    metadata: dict[str, Any]  # entries for vat.json that describe the textures
    rank: int  # number of basis vectors, 0 for plain textures
    decoded: VertexFrames  # points and normals as shaders decode them


def encode_plain(frames: VertexFrames, texels: Texels, pixel_type: PixelType) -> Textures:
    """Encode frames as textures with one texel per vertex and frame."""
    low, high = frames.points.min(axis=(0, 1)), frames.points.max(axis=(0, 1))
    normal_type = np.uint8 if pixel_type is np.uint16 else pixel_type
    points = encode_pixels(texels.stack_layers(frames.points, "frames"), low, high, pixel_type)
    normals = encode_pixels(texels.stack_layers(frames.normals, "frames"), -1, 1, normal_type)
    decoded = VertexFrames(_unstack_layers(points, texels), _unstack_layers(normals, texels))
    metadata = {"kind": "plain", "layers": 1, "part_scale": 0}
    return Textures({"points": points, "normals": normals}, metadata, 0, decoded)


def _unstack_layers(image: EncodedImage, texels: Texels) -> NDArray[np.float64]:
    values = image.decoded
    layers = values.reshape(len(values) // texels.rows, -1, values.shape[-1])
    return layers[:, : texels.count]


def encode_low_rank(fitted: LowRank, frames: VertexFrames, texels: Texels, pixel_type: PixelType) -> Textures:
    """Encode a low-rank fit as textures of basis vectors and of coefficients."""
    basis = pack_basis_vectors(fitted.basis[texels.vertices])
    layers, columns = len(basis), 4 * len(basis)
    count, parts = fitted.coefficients.shape[:2]
    coefficients = np.pad(fitted.coefficients, ((0, 0), (0, 0), (0, columns - fitted.rank), (0, 0)))
    if parts * columns > MAX_TEXTURE_SIDE_PIXELS:
        raise SettingsError(f"{parts} parts with {columns} basis vectors are too wide for a texture; allow more error")
    largest = float(np.abs(coefficients).max(initial=0)) or 1.0
    table, decoded = encode_coarse_and_fine(coefficients.reshape(count, -1, 3), largest, pixel_type)
    decoded = decoded.reshape(coefficients.shape)
    part_of_texel = fitted.parts[texels.vertices]
    encoded = encode_pixels(basis, -1, 1, pixel_type)
    part_layer = np.zeros((1, texels.count, 4), encoded.pixels.dtype)
    part_layer[..., 0] = part_of_texel  # integers are exactly representable in pixels
    pixels = texels.stack_layers(np.concatenate([part_layer, encoded.pixels]), "basis vectors")
    points = EncodedImage(pixels, encoded.offset, encoded.scale)
    normal_basis = pack_basis_vectors(_fit_normal_basis(frames.normals, part_of_texel, decoded))
    largest = float(np.abs(normal_basis).max(initial=0)) or 1.0
    stacked = texels.stack_layers(normal_basis, "basis vectors")
    normals = encode_pixels(stacked, -largest, largest, pixel_type)
    images = {"points": points, "normals": normals, "coefficients": table}
    scale = 65535.0 if pixel_type is np.uint16 else 1.0
    metadata = {"kind": "low rank", "layers": layers, "part_scale": scale}
    bases = (_unstack_layers(points, texels)[1:], _unstack_layers(normals, texels))
    sums = (_sum_basis_vectors(own, part_of_texel, decoded) for own in bases)
    return Textures(images, metadata, fitted.rank, VertexFrames(*sums))


def _sum_basis_vectors(
    basis: NDArray[np.float64], parts: NDArray[np.int64], coefficients: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the sums ``(T, N, 3)`` of basis vectors ``(layers, N, 4)`` that shaders compute in single precision."""
    flat = basis.swapaxes(0, 1).reshape(len(parts), -1).astype(np.float32)
    frames = coefficients.astype(np.float32)
    return np.stack([np.einsum("nk,nki->ni", flat, frame[parts]) for frame in frames]).astype(np.float64)


def _fit_normal_basis(
    normals: NDArray[np.float64], parts: NDArray[np.int64], coefficients: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Fit basis vectors ``(N, K)`` to normals ``(T, N, 3)``."""
    basis = np.zeros((normals.shape[1], coefficients.shape[2]))
    for part in np.unique(parts).tolist():
        mask = parts == part
        columns = coefficients[:, part].swapaxes(0, 1).reshape(coefficients.shape[2], -1)
        inverse = np.linalg.pinv(columns, rcond=_SINGULAR_VALUE_CUTOFF)
        basis[mask] = normals[:, mask].swapaxes(0, 1).reshape(int(mask.sum()), -1) @ inverse
    return basis
