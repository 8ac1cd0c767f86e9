"""Golden streams decode to the same bits on other machines: without a compiler, and with fused sums."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import zlib

import pytest

from mixseq.compression.bitstream.compressed_sequence import decode_basis, decode_coefficients
from mixseq.compression.bitstream.signal_graph import mesh_graph
from tests.compression.bitstream.test_texture_coordinates import stored_uvs
from tests.compression.test_golden import CASES, stored

pytestmark = pytest.mark.slow

DECODE = """
import json
from tests.compression.test_other_machines import checksums
print(json.dumps(checksums()))
"""

FUSE = """
from numba.core.caching import NullCache
from mixseq.runtime import jit

def fused(usual):
    def compiled(function):
        if "loat" not in str(function.__annotations__):
            return usual(function)  # sums of integers, from the usual cache
        jit._NUMBA_OPTIONS["fastmath"] = {"contract"}
        dispatcher = usual(function)
        del jit._NUMBA_OPTIONS["fastmath"]
        dispatcher._cache = NullCache()
        return dispatcher
    return compiled

jit.compiled, jit.force_inlined = fused(jit.compiled), fused(jit.force_inlined)
"""
"""Lets all functions of floating-point numbers be compiled again, with fused products and sums."""

FUSED_INSTRUCTIONS = r"fn?m(add|sub|la|ls)"
"""Those of x86 and of ARM."""


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
    found["uvs"] = [zlib.crc32(stored_uvs()[0].tobytes())]
    return found


def run(code: str, **environment: str) -> list[str]:
    """Return the lines that another process prints."""
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, check=True)
    return done.stdout.splitlines()


@pytest.fixture(scope="module")
def here() -> dict[str, list[int]]:
    return checksums()


def test_streams_are_the_same_without_a_compiler(here: dict[str, list[int]]) -> None:
    [found] = run(DECODE, NUMBA_DISABLE_JIT="1")
    assert json.loads(found) == here


def test_fused_sums_do_not_matter(here: dict[str, list[int]]) -> None:
    solver = "from mixseq.compression.bitstream.predictor import solve_weights as solve\n"
    found, *code = run(f"{FUSE}{DECODE}{solver}print(*solve.inspect_asm().values())")
    assert json.loads(found) == here
    assert re.search(FUSED_INSTRUCTIONS, "\n".join(code))
