"""Bytes of a motion in the files in which the web is sent one.

gltfpack is npm's: MIXSEQ_NODE_MODULES names the folder that it is in; without it its column is empty.
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import DracoPy
import numpy as np
from click.testing import CliRunner

import mixseq
from mixseq.cli import main as command_line
from scripts.benchmarks.common.harness import DATA
from scripts.benchmarks.common.node import node_executable

DRACO_BITS = {1e-3: 10, 1e-4: 14}
"""Bits of a coordinate that keep a bound, in diagonals, with room to spare."""

COLUMNS = (
    "sequence", "max error", "GLB of mixseq, kB", "exported page, kB", "GLB with morph targets, kB", "gltfpack -cc, kB",
    "Draco, frame by frame, kB", "gltfpack / GLB", "without textures",
)  # fmt: skip


def rows(name: str) -> Iterator[tuple[str, ...]]:
    """Count an animation's bytes, with either bound."""
    original = next(path for path in (DATA / f"npz/{name}.npz", DATA / f"gltf/{name}.glb") if path.is_file())
    sequence = mixseq.read(original)
    for bound, bits in DRACO_BITS.items():
        with tempfile.TemporaryDirectory() as folder:
            ours, page, morphs = (Path(folder, each) for each in ("shot.glb", "index.html", "morphs.glb"))
            mixseq.save(ours, mixseq.compress(sequence, max_error=bound))
            told = ["view", str(original), "--export", str(page), "-q", "--max-error", f"{bound:g}"]
            result = CliRunner().invoke(command_line, told)
            assert result.exit_code == 0, result.output
            mixseq.write(morphs, sequence)
            packed = _packed(morphs)
            textures = _texture_bytes(ours)
            sizes = [file.stat().st_size if file else None for file in (ours, page, morphs, packed)]
        frames = (
            DracoPy.encode(
                points.astype(np.float32),
                sequence.faces.astype(np.uint32),
                quantization_bits=bits,
                compression_level=10,
            )
            for points in sequence.points
        )
        sizes.append(sum(map(len, frames)))
        ratios = ["", ""]
        if sizes[0] and sizes[3]:
            ratios = [f"{sizes[3] / sizes[0]:.1f}", f"{(sizes[3] - textures) / (sizes[0] - textures):.1f}"]
        yield name, f"{bound:g}", *(f"{size / 1000:.1f}" if size else "" for size in sizes), *ratios


def _packed(file: Path) -> Path | None:
    """Pack a .glb by gltfpack, if it is there."""
    if "MIXSEQ_NODE_MODULES" not in os.environ:
        return None
    packed = file.with_name("packed.glb")
    tool = Path(os.environ["MIXSEQ_NODE_MODULES"], "gltfpack/cli.js")
    words = [node_executable() or "node", tool, "-cc", "-i", file, "-o", packed]
    subprocess.run([str(word) for word in words], check=True, capture_output=True)
    return packed


def _texture_bytes(file: Path) -> int:
    """Return the bytes of the images in a .glb."""
    data = file.read_bytes()
    content = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    views = (each["bufferView"] for each in content.get("images", ()))
    return sum(int(content["bufferViews"][view]["byteLength"]) for view in views)
