"""Golden streams decode to the same bits on other machines: without a compiler, and with fused sums."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zlib
from pathlib import Path

import pytest

from mixseq.compression.bitstream.compressed_sequence import decode_basis, decode_coefficients
from mixseq.compression.bitstream.signal_graph import mesh_graph
from tests.compression.test_golden import CASES, stored

pytestmark = pytest.mark.slow

DECODE = """
import json
from mixseq.runtime import jit
if {fused}:
    jit._NUMBA_OPTIONS["fastmath"] = {{"contract"}}
from tests.compression.test_other_machines import checksums
print(json.dumps(checksums()))
"""

MACHINES: dict[str, dict[str, str]] = {
    "no compiler": {"NUMBA_DISABLE_JIT": "1"},
    "fused sums": {"NUMBA_CPU_FEATURES": "+fma,+avx2"},
}


def checksums() -> dict[str, list[int]]:
    """Return checksums of what golden streams decode to."""
    found = {}
    for name in CASES:
        coded = stored(name)[0]
        basis = decode_basis(coded, mesh_graph(coded.header.faces, coded.header.vertex_count))
        arrays = [block.vectors for block in basis.part_bases]
        norms = basis.norms[basis.varying, None]
        arrays += [decode_coefficients(coded, chunk, basis) * norms for chunk in coded.chunks]
        found[name] = [zlib.crc32((array / coded.parameters.step).round(6).tobytes()) for array in arrays]
    return found


def decoded(machine: str, cache: Path | None = None) -> dict[str, list[int]]:
    """Return the checksums on another machine. Sums are fused where there is a cache for that."""
    script = DECODE.format(fused=cache is not None)
    environment = {**os.environ, **MACHINES[machine]}
    if cache is not None:
        environment["NUMBA_CACHE_DIR"] = str(cache)
    run = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True)
    found: dict[str, list[int]] = json.loads(run.stdout)
    return found


@pytest.fixture(scope="module")
def here() -> dict[str, list[int]]:
    return checksums()


def test_streams_are_the_same_without_a_compiler(here: dict[str, list[int]]) -> None:
    assert decoded("no compiler") == here


def test_fused_sums_do_not_matter(here: dict[str, list[int]], tmp_path: Path) -> None:
    assert decoded("fused sums", tmp_path) == here
