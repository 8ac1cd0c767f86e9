"""Damaged real files: an error of ours within bounded time and memory, or a sound sequence; never anything else."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from mixseq.errors import FormatError, InvalidSequenceError
from mixseq.sequence.sequence import MeshSequence
from mixseq_io import isolation, read

pytestmark = [pytest.mark.realdata, pytest.mark.slow]

FILES = (
    "usd/q_man_run_blender50.usdc",
    "usd/RiggedSimple.usdz",
    "alembic/Bone_Anim.abc",
    "gltf/KhronosFox.glb",
    "gltf/CesiumMan.glb",
    "npz/fox_run.npz",
)
CUTS, FLIPS_PER_END, OTHER_FLIPS = 12, 7, 4
"""Numbers of damaged versions of a file; `scripts/fuzz` makes as many as one has time for."""

SECONDS = 10.0
"""What a damaged file may take, on a busy machine too; whole files take a few tenths."""


@pytest.fixture(scope="module", autouse=True)
def strict_limits() -> Iterator[None]:
    """Let workers of the C++ libraries have little time and memory."""
    isolation.close_idle_workers()
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("MIXSEQ_READER_SECONDS", "5")
        environment.setenv("MIXSEQ_READER_MEMORY", "1")
        yield
    isolation.close_idle_workers()


@pytest.fixture(params=FILES)
def original(request: pytest.FixtureRequest, data: Path) -> Path:
    """Every file in turn."""
    return data / str(request.param)


def reading_damaged(path: Path, content: bytes) -> MeshSequence | None:
    """Read a damaged file; None if it is refused as it should be."""
    path.write_bytes(content)
    start = time.monotonic()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return read(path)
    except (FormatError, InvalidSequenceError) as error:
        assert path.name in str(error)
        return None
    finally:
        assert time.monotonic() - start < SECONDS


def test_cut_anywhere(original: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    content = original.read_bytes()
    ends = [len(content) * part // CUTS for part in range(CUTS)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        whole = read(original)
    refused = 0
    for end in ends:
        got = reading_damaged(tmp_path / f"cut{original.suffix}", content[:end])
        refused += got is None
        # What is missing may be no more than a texture, or the directory of a package.
        assert got is None or np.array_equal(got.points, whole.points)
    assert refused > 0.45 * CUTS
    assert capfd.readouterr() == ("", "")


def test_flipped_anywhere(original: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    content = original.read_bytes()
    rng = np.random.default_rng(len(content))
    # Structure is at the ends of most formats, and there is little of it among the numbers.
    near = np.minimum(rng.integers(0, 4096, FLIPS_PER_END), len(content) - 1)
    places = [*near, *(len(content) - 1 - near), *rng.integers(0, len(content), OTHER_FLIPS)]
    for number, place in enumerate(places):
        damaged = bytearray(content)
        width = int(rng.integers(1, 9))
        for at in range(place, min(place + width, len(content))):
            damaged[at] = (damaged[at] ^ (1 << int(rng.integers(8))), 255, 0)[number % 3]
        reading_damaged(tmp_path / f"flipped{original.suffix}", bytes(damaged))
    assert capfd.readouterr() == ("", "")
