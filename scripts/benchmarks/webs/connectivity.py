"""What JavaScript takes to decode polygons and texture coordinates, beside Python: CPU seconds, in turn in one run.

The first time is in a new process, as on a page; the later one when the loops are compiled, as Python's are ahead.
Sequences without texture coordinates have some here: those of a map of the first frame from the front.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median

import numpy as np

import mixseq
from mixseq.compression.bitstream.connectivity import decode_polygons, encode_polygons
from mixseq.compression.bitstream.corner_values import decode_uvs
from mixseq.compression.encoder.uvs import encode_uvs
from scripts.benchmarks.common.animations import animation
from scripts.benchmarks.common.node import node_executable

NAMES = ("horse_gallop", "elephant_gallop", "q_man_run")

COLUMNS = (
    "sequence",
    "polygons",
    "what",
    "bytes",
    "Python",
    "JavaScript, first",
    "JavaScript",
    "ratio, first",
    "ratio",
)

ROUNDS = 5
STEPS = 4096

_DECODER = (Path(mixseq.__file__).parent / "web/decoder").as_uri()

_SCRIPT = """
import { readFileSync } from "node:fs";
import { decodePolygons } from "DECODER/connectivity.js";
import { decodeUvs } from "DECODER/texture_coordinates.js";
const [what, folder, ...sizes] = process.argv.slice(2), numbers = sizes.map(Number);
const [polygons, uvs] = ["polygons", "uvs"].map((name) => new Uint8Array(readFileSync(`${folder}/${name}`)));
const mesh = what === "uvs" ? decodePolygons(polygons, ...numbers) : null, taken = [];
for (let round = 0; round < 6; round++) {
  const begin = process.cpuUsage();
  if (mesh) decodeUvs(uvs, mesh.counts, mesh.corners, numbers[2]);
  else decodePolygons(polygons, ...numbers);
  const { user, system } = process.cpuUsage(begin);
  taken.push((user + system) / 1e6);
}
console.log(JSON.stringify([taken[0], taken.at(-1)]));
"""


def rows(name: str) -> Iterator[tuple[str, ...]]:
    """Measure the mesh of an animation."""
    sequence = animation(name)
    mesh, points = sequence.polygons, sequence.points[0].astype(np.float64)
    sizes = len(mesh.counts), mesh.indices.size, sequence.vertex_count
    flat = (points[:, :2] - points[:, :2].min(axis=0)) / np.ptp(points[:, :2], axis=0).max()
    polygons = encode_polygons(mesh, sequence.vertex_count)
    uvs = encode_uvs(mesh, sequence.vertex_count, np.rint(STEPS * flat).astype(np.int64)[mesh.indices])
    works: dict[str, tuple[bytes, Callable[[], object]]] = {
        "polygons": (polygons, lambda: decode_polygons(polygons, *sizes)),
        "uvs": (uvs, lambda: decode_uvs(uvs, mesh, sequence.vertex_count, STEPS)),
    }
    with tempfile.TemporaryDirectory() as folder:
        for what, (data, _) in works.items():
            Path(folder, what).write_bytes(data)
        script = Path(folder, "decode.mjs")
        script.write_text(_SCRIPT.replace("DECODER", _DECODER), encoding="utf-8")
        for what, (data, work) in works.items():
            work()
            taken = []
            for _ in range(ROUNDS):
                begin = time.process_time()
                work()
                middle = time.process_time()
                command = [node_executable() or "node", str(script), what, folder, *map(str, sizes)]
                told = subprocess.run(command, capture_output=True, text=True, check=True).stdout
                taken.append((middle - begin, *json.loads(told)))
            python, first, later = (median(each) for each in zip(*taken, strict=True))
            yield (
                name,
                f"{sizes[0]:,}".replace(",", " "),
                what,
                str(len(data)),
                *(f"{seconds:.3f} s" for seconds in (python, first, later)),
                f"{first / python:.2f}",
                f"{later / python:.2f}",
            )
