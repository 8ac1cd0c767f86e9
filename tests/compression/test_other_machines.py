"""Golden streams decode to the same bits on other machines: without a compiler, and with fused sums."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.compression.test_golden import CASES

pytestmark = pytest.mark.slow

DECODE = """
import json, sys, zlib
from mixseq.runtime import jit
if {fused}:
    jit._NUMBA_OPTIONS["fastmath"] = {{"contract"}}
from mixseq.compression.bitstream.compressed_sequence import decode_basis, decode_coefficients
from mixseq.compression.bitstream.signal_graph import mesh_graph
from tests.compression.test_golden import stored

found = {{}}
for name in {names}:
    coded = stored(name)[0]
    basis = decode_basis(coded, mesh_graph(coded.header.faces, coded.header.vertex_count))
    arrays = [block.vectors for block in basis.part_bases]
    arrays += [decode_coefficients(coded, chunk, basis) * basis.norms[basis.varying, None] for chunk in coded.chunks]
    found[name] = [zlib.crc32((array / coded.parameters.step).round(6).tobytes()) for array in arrays]
print(json.dumps(found))
"""

MACHINES: dict[str, dict[str, str]] = {
    "this one": {},
    "no compiler": {"NUMBA_DISABLE_JIT": "1"},
    "fused sums": {"NUMBA_CPU_FEATURES": "+fma,+avx2"},
}


def decoded(machine: str, cache: Path | None = None) -> dict[str, list[int]]:
    """Return checksums of what golden streams decode to. Sums are fused where there is a cache for that."""
    script = DECODE.format(names=list(CASES), fused=cache is not None)
    environment = {**os.environ, **MACHINES[machine]}
    if cache is not None:
        environment["NUMBA_CACHE_DIR"] = str(cache)
    run = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True)
    found: dict[str, list[int]] = json.loads(run.stdout)
    return found


@pytest.fixture(scope="module")
def here() -> dict[str, list[int]]:
    return decoded("this one")


def test_streams_are_the_same_without_a_compiler(here: dict[str, list[int]]) -> None:
    assert decoded("no compiler") == here


def test_fused_sums_do_not_matter(here: dict[str, list[int]], tmp_path: Path) -> None:
    assert decoded("fused sums", tmp_path) == here
