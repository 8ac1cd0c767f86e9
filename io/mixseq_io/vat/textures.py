r"""Vertex animation textures of points and normals, plain or as sums of basis vectors.

Plain
    A texel per vertex and frame: its point between the bounds of all frames, and its normal.
Low rank
    :math:`x_t(v) = \sum_k b_k(v) u_{tk p_v}` (`mixseq.rigging.low_rank`): a texel per vertex and four basis vectors,
    after one with its part; coefficients are a separate texture of two rows per frame. Normals are sums with the same
    coefficients, their basis vectors fitted by least squares.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import FloatArray
from mixseq.errors import SettingsError
from mixseq.rigging.low_rank import LowRank
from mixseq_io.vat.encoding import Encoded, Kind, encoded, in_two
from mixseq_io.vat.images import LARGEST
from mixseq_io.vat.texels import Texels, in_fours

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
