"""Integers as bytes, for zstd and lzma: zigzag numbers cut into planes of bytes, so that like stands beside like."""

from __future__ import annotations

import lzma

import numpy as np

from mixseq.types import Index

ZSTD_LEVEL = 19

# Planes of bytes have no alignment. A smaller dictionary than the preset's saves the time to allocate it.
_LZMA = {"id": lzma.FILTER_LZMA2, "preset": 9 | lzma.PRESET_EXTREME, "dict_size": 1 << 23, "lc": 0, "lp": 0, "pb": 0}


def width(values: Index) -> int:
    """Return how many bytes the largest number needs, at least one."""
    largest = int(_zigzag(values).max(initial=0))
    return max(1, (largest.bit_length() + 7) // 8)


def planes(values: Index, size: int) -> bytes:
    """Return all lowest bytes, then all second ones, ...

    Examples
    --------
    >>> planes(np.array([0, -1, 1, 300]), 2).hex()
    '0001025800000002'
    """
    low_first = _zigzag(values).reshape(-1).astype("<u8").view(np.uint8).reshape(-1, 8)
    return low_first[:, :size].T.tobytes()


def numbers(data: bytes, size: int) -> Index:
    """Undo `planes`: the numbers in one row."""
    cut = np.frombuffer(data, np.uint8).reshape(size, -1)
    whole = np.zeros((cut.shape[1], 8), np.uint8)
    whole[:, :size] = cut.T
    z = whole.view("<u8").reshape(-1)
    return (z >> np.uint64(1)).astype(np.int64) ^ -(z & np.uint64(1)).astype(np.int64)


def _zigzag(values: Index) -> np.ndarray[tuple[int, ...], np.dtype[np.uint64]]:
    """0, -1, 1, -2, ... become 0, 1, 2, 3, ..."""
    return ((values << 1) ^ (values >> 63)).astype(np.uint64)


def to_zstd(data: bytes) -> bytes:
    import zstandard

    return bytes(zstandard.ZstdCompressor(level=ZSTD_LEVEL).compress(data))


def from_zstd(data: bytes) -> bytes:
    import zstandard

    return bytes(zstandard.ZstdDecompressor().decompress(data))


def to_lzma(data: bytes) -> bytes:
    """Compress without any container."""
    return lzma.compress(data, format=lzma.FORMAT_RAW, filters=[_LZMA])


def from_lzma(data: bytes) -> bytes:
    return lzma.decompress(data, format=lzma.FORMAT_RAW, filters=[_LZMA])
