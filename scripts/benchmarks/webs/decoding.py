"""What JavaScript takes to decode a compressed sequence, beside Python: CPU seconds, of both in turn in one run.

Decoding is mesh, basis and all coefficients; what is left to do for a frame is told apart. Python has decoded the
sequence before, so that nothing is compiled. JavaScript is measured twice: the first time in a new process, as a page
does, and when it has decoded the sequence some times, as Python's loops are compiled ahead.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median

import h5py

import mixseq
from scripts.benchmarks.common.harness import animation
from scripts.benchmarks.common.node import node_executable

COLUMNS = (
    "sequence", "vertices", "frames", "kB", "Python", "JavaScript, first", "JavaScript", "ratio", "ms a frame, Python",
    "JavaScript", "ratio",
)  # fmt: skip

MAX_ERROR = 1e-3
ROUNDS = 3

_DECODER = Path(mixseq.__file__).parent / "web/decoder/sequence.js"

_SCRIPT = """
import { readFileSync } from "node:fs";
import { open } from "DECODER";
const folder = process.argv[2], rounds = 12, opened = [], frames = [];
const text = readFileSync(`${folder}/text`, "latin1"), streams = new Uint8Array(readFileSync(`${folder}/streams`));
for (let round = 0; round < rounds; round++) {
  const seconds = () => { const { user, system } = process.cpuUsage(); return (user + system) / 1e6; };
  const begin = seconds(), sequence = await open(text, streams);
  sequence.fields();
  sequence.chunks.forEach((_, chunk) => sequence.load(chunk));
  const middle = seconds(), positions = new Float32Array(3 * sequence.vertexCount);
  for (let frame = 0; frame < sequence.frameCount; frame++) sequence.frame(frame, positions);
  opened.push(middle - begin);
  frames.push((seconds() - middle) / sequence.frameCount);
}
const settled = (seconds) => seconds.slice(-5).sort((a, b) => a - b)[2];
console.log(JSON.stringify([opened[0], settled(opened), settled(frames)]));
"""


def rows(name: str) -> Iterator[tuple[str, ...]]:
    """Measure an animation, compressed with a bound."""
    sequence = animation(name)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "coded.h5")
        mixseq.save(path, mixseq.compress(sequence, max_error=MAX_ERROR))
        with h5py.File(path) as file:
            Path(folder, "text").write_bytes(bytes(file.attrs["coding"]))
            Path(folder, "streams").write_bytes(file["streams"][...].tobytes())
        _in_python(path)
        both = [(_in_python(path), _in_javascript(folder)) for _ in range(ROUNDS)]
        size = path.stat().st_size
    python, frame = (median(each) for each in zip(*(python for python, _ in both), strict=True))
    first, later, drawn = (median(each) for each in zip(*(script for _, script in both), strict=True))
    yield (
        name,
        f"{sequence.vertex_count:,}".replace(",", " "),
        str(len(sequence.times)),
        f"{size / 1000:.1f}",
        *(f"{seconds:.2f} s" for seconds in (python, first, later)),
        f"{later / python:.2f}",
        *(f"{1000 * seconds:.2f}" for seconds in (frame, drawn)),
        f"{drawn / frame:.2f}",
    )


def _in_python(path: Path) -> tuple[float, float]:
    """Return the seconds of decoding, and of a frame."""
    begin = time.process_time()
    model = mixseq.load(path)
    middle = time.process_time()
    for _ in model.blocks(model.times):
        pass
    return middle - begin, (time.process_time() - middle) / len(model.times)


def _in_javascript(folder: str) -> tuple[float, float, float]:
    """Return the seconds of decoding for the first time and later, and of a frame."""
    script = Path(folder, "decode.mjs")
    script.write_text(_SCRIPT.replace("DECODER", _DECODER.as_uri()), encoding="utf-8")
    command = [node_executable() or "node", str(script), folder]
    told = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    first, later, frame = json.loads(told)
    return first, later, frame
