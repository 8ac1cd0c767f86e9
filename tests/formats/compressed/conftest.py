"""A compressed sequence with streams of any bytes, and its file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.compression.bitstream.compressed_sequence import Chunk, CompressedSequence
from mixseq_io.coded.packing import pack
from mixseq_io.gltf.mesh_sequence import StillBody, write_bodies
from tests.formats.compressed.stream_cases import BETWEEN, PARAMETERS, any_bytes
from tests.meshes import bar


@pytest.fixture
def coded() -> CompressedSequence:
    """Three groups of basis vectors; chunks of 4, 4, 4 and 2 frames, the third of which has only coefficients."""
    header = replace(bar(5, 15, 14).header, name="Füchsin", up_axis="Z", metres_per_unit=0.01)
    sizes = [(4, 301, 50, 20), (4, 302, 60, 30), (4, 303, 0, 0), (2, 304, 40, 10)]
    chunks = tuple(
        Chunk(4 * number, count, *map(any_bytes, of_streams)) for number, (count, *of_streams) in enumerate(sizes)
    )
    groups = tuple(any_bytes(size) for size in (500, 600, 700))
    return CompressedSequence(header, PARAMETERS, groups, chunks, between=BETWEEN)


@pytest.fixture
def h5(tmp_path: Path, coded: CompressedSequence) -> Path:
    file = tmp_path / "small.h5"
    mixseq.save(file, coded)
    return file


@pytest.fixture
def glb(tmp_path: Path, coded: CompressedSequence) -> Path:
    """The same as a .glb; what is decoded of any bytes would be no still."""
    file = tmp_path / "small.glb"
    points = bar(5, 15, 14).points[0]
    write_bodies(file, [StillBody(pack(coded), coded.header, points, np.zeros(3))], "none")
    return file


@pytest.fixture(params=["h5", "glb"])
def path(request: pytest.FixtureRequest) -> Path:
    """Files of both kinds."""
    file: Path = request.getfixturevalue(request.param)
    return file
