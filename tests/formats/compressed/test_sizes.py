"""Files of compressed sequences have at most the size that was asked for, and nearly all of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.choices import StillName
from mixseq.errors import SizeError
from mixseq.mesh.surface import CornerValues, Surface
from mixseq.sequence.sequence import MeshSequence
from mixseq_io.coded.sizes import compress_to_size, file_size, static_size
from tests.meshes import bar, tube


@pytest.mark.parametrize("still", [None, "draco", "plain", "none"])
@pytest.mark.parametrize("inbetweens", [False, True])
def test_the_size_is_that_of_the_file(tmp_path: Path, still: StillName | None, inbetweens: bool) -> None:
    sequence = bar(sides=8, rings=20, frames=12)
    size = static_size(sequence, still).total + 700
    coded = compress_to_size(sequence, size, still, inbetweens=inbetweens)
    file = tmp_path / ("a.h5" if still is None else "a.glb")
    mixseq.save(file, coded, still=still or "draco")
    assert file.stat().st_size == file_size(coded, still)
    assert size - 250 < file.stat().st_size <= size


def test_stills_of_rough_frames_are_counted() -> None:
    """Draco takes more bytes for the rough decoded frame than for the exact one, whose faces are coplanar."""
    points, faces = tube(16, 24)
    waves = np.sin(3 * points[:, [2, 0, 1]] + 2 * np.arange(6)[:, None, None])
    sequence = MeshSequence.from_arrays(points + 0.2 * waves, faces)
    size = static_size(sequence, "draco").total + 700
    rough = mixseq.compress(sequence, size=700, inbetweens=False)
    assert file_size(rough, "draco") > size  # so that the test is about this
    coded = compress_to_size(sequence, size, "draco", inbetweens=False)
    assert 0.9 * size < file_size(coded, "draco") <= size
    assert coded.parameters.kg_percent > rough.parameters.kg_percent


def test_what_takes_the_bytes_and_what_to_leave_out_is_named() -> None:
    plain = bar(sides=8, rings=20)
    corners = len(plain.header.polygons.indices)
    uvs = CornerValues(np.random.default_rng(0).random((corners, 2)), np.arange(corners))
    textured = MeshSequence.from_header(replace(plain.header, surface=Surface(uvs=uvs)), plain.points)
    cases: list[tuple[MeshSequence, StillName | None, str]] = [
        (plain, "draco", r"leave out the first frame \(--still none\), or give more"),
        (textured, None, r"leave out texture coordinates \(--no-uvs\), or give more"),
        (plain, None, "give more"),
    ]
    for sequence, still, cures in cases:
        taken, parts, _ = static_size(sequence, still)
        assert sum(parts.values()) == taken
        with pytest.raises(SizeError, match=rf"size is 900 bytes, too few for any motion: {taken:,} .*; {cures}$"):
            compress_to_size(sequence, 900, still)
    with pytest.raises(SizeError, match=f"size is {taken + 4:,} bytes, too few"):
        compress_to_size(plain, taken + 4)
