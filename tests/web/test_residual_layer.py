"""The residual layer in JavaScript: whole runs as in Python, and nothing of a run that is not what was coded."""

from __future__ import annotations

import json
from base64 import b64encode
from pathlib import Path
from typing import Any

import numpy as np

from mixseq.compression.bitstream.arithmetic import CHECKSUM_SIZE
from mixseq.compression.bitstream.residual_layer import FRAMES_PER_RUN, write_residuals
from mixseq.compression.bitstream.signal_graph import mesh_graph
from mixseq.types import Index
from tests.meshes import torus
from tests.web.conftest import Node

FACES = torus(8, 5)[1]
VERTICES = int(FACES.max()) + 1
GRAPH = mesh_graph(FACES, VERTICES)

LAYER = """
import { readFileSync } from "node:fs";
import { MixseqError } from "decoder/errors.js";
import { ResidualLayer } from "decoder/residual_layer.js";
import { meshGraph } from "decoder/signal_graph.js";
const given = JSON.parse(readFileSync(process.argv[2]));
const { graph } = meshGraph(Uint32Array.from(given.faces), given.vertices);
const times = Float64Array.from({ length: given.count }, (_, k) => k);
const residuals = Uint8Array.from(Buffer.from(given.stream, "base64"));
const layer = new ResidualLayer(times, [{ first: 0, count: given.count, residuals }], () => graph, 1);
console.log(JSON.stringify(given.wanted.map((time) => {
  const positions = new Float64Array(3 * given.vertices);
  try {
    layer.addTo(positions, time);
    return [...positions];
  } catch (error) {
    if (!(error instanceof MixseqError)) throw error;
    return { told: error.message, moved: positions.some((number) => number !== 0) };
  }
})));
"""


def residuals(count: int) -> Index:
    """Residuals ``(count, V, 3)`` of about a fifth of the vertices."""
    rng = np.random.default_rng(count)
    return rng.integers(-3, 4, (count, VERTICES, 3)) * (rng.random((count, VERTICES, 1)) < 0.2)


def coded(numbers: Index) -> bytes:
    """The stream of the residuals of all frames."""
    return write_residuals(lambda frame: numbers[frame], range(len(numbers)), GRAPH)


def shown(node: Node, folder: Path, stream: bytes, count: int, wanted: list[float]) -> list[Any]:
    """Return what is added to a mesh at the origin at some times, one after the other, or what is told instead."""
    given = {
        "faces": FACES.reshape(-1).tolist(),
        "vertices": VERTICES,
        "count": count,
        "stream": b64encode(stream).decode(),
        "wanted": wanted,
    }
    (folder / "given.json").write_text(json.dumps(given), encoding="utf-8")
    found: list[Any] = json.loads(node(LAYER, folder / "given.json"))
    return found


def test_runs_are_those_of_python_in_any_order(node: Node, tmp_path: Path) -> None:
    """Of eleven runs eight are kept: others are decoded again."""
    count = 10 * FRAMES_PER_RUN + 3
    numbers = residuals(count)
    numbers[2 * FRAMES_PER_RUN : 3 * FRAMES_PER_RUN] = 0
    wanted = [*range(count), *range(count - 1, -1, -7), 0]
    found = shown(node, tmp_path, coded(numbers), count, list(map(float, wanted)))
    np.testing.assert_array_equal(np.reshape(found, (-1, VERTICES, 3)), numbers[wanted])
    half = shown(node, tmp_path, coded(numbers), count, [FRAMES_PER_RUN - 0.5])
    np.testing.assert_array_equal(
        np.reshape(half, (VERTICES, 3)), (numbers[FRAMES_PER_RUN - 1] + numbers[FRAMES_PER_RUN]) / 2
    )


def test_a_run_with_a_wrong_residual_is_not_shown_at_all(node: Node, tmp_path: Path) -> None:
    """The last frames of a run are others than were coded: its first ones are refused, too, however often asked for."""
    count = 3 * FRAMES_PER_RUN
    stream = bytearray(coded(residuals(count)))
    lengths = np.frombuffer(bytes(stream[:12]), dtype="<u4")
    stream[12 + int(lengths[:2].sum()) - CHECKSUM_SIZE - 3] ^= 16  # the last bits of the run in the middle
    wanted = [
        FRAMES_PER_RUN,
        FRAMES_PER_RUN - 1,
        FRAMES_PER_RUN,
        FRAMES_PER_RUN + 0.5,
        2 * FRAMES_PER_RUN - 1,
        2 * FRAMES_PER_RUN,
        FRAMES_PER_RUN - 0.5,
    ]
    found = shown(node, tmp_path, bytes(stream), count, list(map(float, wanted)))
    sound = residuals(count)
    for time, one in zip(wanted, found, strict=True):
        if time in (FRAMES_PER_RUN - 1, 2 * FRAMES_PER_RUN):
            np.testing.assert_array_equal(np.reshape(one, (VERTICES, 3)), sound[int(time)])
        else:
            assert one["told"].startswith(f"the residuals of frames {FRAMES_PER_RUN} and on: ")
            assert not one["moved"] or time < FRAMES_PER_RUN  # half-way from the run before


def test_a_wrong_checksum_is_refused(node: Node, tmp_path: Path) -> None:
    stream = bytearray(coded(residuals(5)))
    stream[-1] ^= 1
    for one in shown(node, tmp_path, bytes(stream), 5, [0, 4, 0]):
        assert one["told"].startswith("the residuals of frames 0 and on: ")
        assert not one["moved"]
