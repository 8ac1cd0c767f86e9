"""Damage ends in one error: flipped bits, also where all checksums are right, and texts that ask for too much."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mixseq
from mixseq.compression.encoder.compress import compress
from mixseq.sequence.sequence import MeshSequence
from tests.compression.encoder.test_inbetweens import with_parts, with_random_inbetweens
from tests.compression.test_golden import stored
from tests.meshes import bar, rotation, torus
from tests.web.conftest import Node
from tests.web.played import write_container

pytestmark = pytest.mark.slow

DAMAGE = """
import { readFileSync } from "node:fs";
import { crc32 } from "decoder/arithmetic.js";
import { MixseqError, open } from "decoder/sequence.js";
import { uvsOf } from "decoder/surface.js";
const folder = process.argv[2], rounds = Number(process.argv[3]), texts = JSON.parse(process.argv[4]);
const text = readFileSync(`${folder}/text`, "latin1"), whole = new Uint8Array(readFileSync(`${folder}/streams`));
let state = Number(process.argv[5]);
const random = (below) => {
  state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
  return Math.floor((state / 2 ** 32) * below);
};

/** All that a sequence has, as one checksum. */
async function all(text, bytes) {
  const sequence = await open(text, bytes), { times } = sequence, moments = [...times, (times[0] + 2 * times[1]) / 3];
  const found = moments.map((time) => crc32(new Uint8Array(sequence.at(time).buffer)));
  return JSON.stringify([found, uvsOf(sequence)?.length]);
}

/** The same streams with the checksums of what they are now. */
function repaired(text, bytes, { byteOffset: start, byteLength: size }) {
  const view = new DataView(bytes.buffer), word = (at) => view.getUint32(at, true);
  const middle = 16 + word(4), end = middle + word(8);
  view.setUint32(middle, crc32(new TextEncoder().encode(text)), true);
  const old = crc32(whole.subarray(start, start + size)), own = new DataView(whole.buffer, whole.byteOffset);
  for (let at = middle + 4; size && at < end; at += 4) {
    if (own.getUint32(at, true) === old) view.setUint32(at, crc32(bytes.subarray(start, start + size)), true);
  }
  view.setUint32(12, crc32(bytes.subarray(16, end)), true);
  return bytes;
}

async function outcome(text, bytes) {
  const start = performance.now();
  let told = "";
  try {
    told = (await all(text, bytes)) === sound ? "the same" : "other frames";
  } catch (error) {
    if (!(error instanceof MixseqError)) throw error;
    told = error.message;
  }
  longest = Math.max(longest, performance.now() - start);
  return told;
}

let longest = 0;
const sound = await all(text, whole), told = [], { streams } = await open(text, whole);
const parts = [streams.connectivity, streams.times, streams.uvs, streams.labels, ...streams.basis];
parts.push(...streams.chunks.flatMap((chunk) => [chunk.coefficients, chunk.residuals, chunk.inbetweens]));
const some = parts.filter((part) => part?.length).map(({ byteOffset, byteLength }) =>
  ({ byteOffset: byteOffset - whole.byteOffset, byteLength }));
for (let round = 0; round < rounds; round++) {
  const bytes = whole.slice(), anywhere = { byteOffset: 0, byteLength: bytes.length };
  const part = round % 4 ? some[random(some.length)] : anywhere;
  for (let flips = 1 + random(3); flips > 0; flips--) {
    bytes[part.byteOffset + random(part.byteLength)] ^= 1 << random(8);
  }
  told.push(await outcome(text, round % 4 ? repaired(text, bytes, part) : bytes));
}
const nothing = { byteOffset: 0, byteLength: 0 };
for (const changed of texts) told.push(await outcome(changed, repaired(changed, whole.slice(), nothing)));
console.log(JSON.stringify({ told, longest }));
"""


def outcomes(node: Node, folder: Path, rounds: int, texts: list[str], seed: int = 1) -> dict[str, Any]:
    told: dict[str, Any] = json.loads(node(DAMAGE, folder, str(rounds), json.dumps(texts), str(seed)))
    return told


@pytest.mark.parametrize("name", ["bounded", "parts", "shapes"])
def test_flipped_bits_end_in_one_error(node: Node, tmp_path: Path, name: str) -> None:
    coded, of_parts = stored(name)[0], name != "bounded"
    write_container(tmp_path, with_random_inbetweens(with_parts(coded) if of_parts else coded, 2, of_parts))
    told = outcomes(node, tmp_path, 100, [])["told"]
    assert set(told) >= {"the sequence: the index is damaged, so nothing can be read"}
    assert "other frames" not in told
    assert sum(each == "the same" for each in told) < 4  # the last bits of a stream may not matter


def test_damage_is_named(node: Node, tmp_path: Path) -> None:
    points, faces = torus(5, 4)
    frames = [points @ rotation((0.2, frame / 5, 0.0)).T for frame in range(40)]
    times = np.cumsum(np.linspace(0.01, 0.1, 40))
    sequence = MeshSequence.from_arrays(np.stack(frames), faces, times)
    write_container(tmp_path, compress(sequence, kg=1, chunk=16, inbetweens=False))
    told = " ".join(outcomes(node, tmp_path, 200, [])["told"])
    for name in ("the connectivity", "the basis vectors", "the coefficients of frames 0 to 19", "the times"):
        assert f"{name}" in told


def test_texts_that_cannot_be_are_refused(node: Node, tmp_path: Path) -> None:
    write_container(tmp_path, stored("parts")[0])
    facts = json.loads((tmp_path / "text").read_text())

    def changed(**keys: Any) -> str:
        return json.dumps(facts | keys)

    def coded(**keys: Any) -> str:
        return json.dumps(facts | {"coding": facts["coding"] | keys})

    cases = {
        changed(vertex_count=10**9): "cannot hold 3000000000 numbers of its vertices",
        changed(corner_count=10**9): "cannot hold 1000000000 numbers of its corners",
        changed(fps=10**400): "a number is out of range",
        changed(metres_per_unit=0): "metres_per_unit",
        changed(up_axis="x"): "up_axis",
        changed(name=None): "name",
        changed(order="any"): "order",
        changed(vertex_count=0): "vertex_count",
        changed(vertex_count=241): "damaged",
        changed(vertex_count="240"): "vertex_count",
        changed(polygon_count=1): "damaged",
        changed(frame_count=10**6): "frame_count",
        changed(fps=-1): "fps",
        changed(fps=None): "fps",
        changed(first_time="0"): "first_time",
        changed(between={"length": 0.1, "cubic": [0, 1]}): "between",
        changed(between={"length": None, "cubic": [0]}): "between",
        changed(between=[]): "between",
        changed(between={"length": None, "cubic": [0, 1], "cuts": [0]}): "between",
        changed(between={"length": None, "cubic": [0, 1], "cuts": [2, 2]}): "between",
        changed(between={"length": None, "cubic": [0, 1], "cuts": [10**6]}): "between",
        coded(rank=10**6): "rank",
        coded(ranks=[2, 9]): "ranks",
        coded(ranks="ten"): "ranks",
        coded(ranks=[1] * 200): "ranks",
        coded(step=0): "step",
        coded(step=1e90): "single precision",
        coded(step=1e308): "a number is out of range",
        coded(diagonal=1e-320): "a number is out of range",
        coded(promised=1): "promised",
        coded(uv_steps=4): "uv_steps",
        coded(factors="both"): "factors",
        coded(speed=1): "the parameter speed is unknown to this decoder",
        "[]": "the text",
        '{"coding": []}': "the text",
        "{": "the text",
        "": "the text",
    }
    found = outcomes(node, tmp_path, 0, list(cases))
    for (text, expected), told in zip(cases.items(), found["told"], strict=True):
        assert expected in told, text[-200:]


def test_truncated_files_are_refused(node: Node) -> None:
    golden = Path(__file__).parents[1] / "formats/golden/compressed-v1-between.glb"
    source = """
import { readFileSync } from "node:fs";
import { readGlb } from "player/glb.js";
const file = new Uint8Array(readFileSync(process.argv[2]));
for (let size = 0; size < file.length - 4; size++) {
  try {
    readGlb(file.slice(0, size).buffer);
    console.log(size);
  } catch (error) {
    if (error.name !== "MixseqError") throw error;
  }
}
"""
    data = golden.read_bytes()
    size = int.from_bytes(data[12:16], "little")
    streams = json.loads(data[20 : 20 + size])["bufferViews"][1]
    extension_end = 28 + size + streams["byteOffset"] + streams["byteLength"]  # behind it is the still
    assert list(map(int, node(source, golden).split())) == list(range(extension_end, len(data) - 4))


def test_bodies_are_read_by_name(node: Node, tmp_path: Path) -> None:
    coded = compress(bar(5, 7, 4), max_error=1e-2)
    other = compress(replace(bar(6, 5, 4), name="other"), max_error=1e-2)
    mixseq.save(tmp_path / "two.glb", replace(coded, bodies=(other,)), still="none")
    source = """
import { readFileSync } from "node:fs";
import { open } from "decoder/sequence.js";
import { readGlb } from "player/glb.js";
const file = new Uint8Array(readFileSync(process.argv[2])).buffer, counts = [];
for (const body of [null, "bar", "other"]) {
  const { text, streams } = readGlb(file, body);
  counts.push((await open(text, streams)).vertexCount);
}
console.log(readGlb(file).bodies.join(), counts.join());
try {
  readGlb(file, "third");
} catch (error) {
  console.log(error.name, error.message);
}
"""
    count, other_count = coded.header.vertex_count, other.header.vertex_count
    assert node(source, tmp_path / "two.glb").splitlines() == [
        f"bar,other {count},{count},{other_count}",
        "MixseqError there is no body “third”; bodies are bar, other",
    ]


def test_files_of_other_versions_are_refused(node: Node, tmp_path: Path) -> None:
    data = (Path(__file__).parents[1] / "formats/golden/compressed-v1-between.glb").read_bytes()
    assert data.count(b'"version":1,') == 1
    (tmp_path / "other.glb").write_bytes(data.replace(b'"version":1,', b'"version":8,'))
    source = """
import { readFileSync } from "node:fs";
import { readGlb } from "player/glb.js";
try {
  readGlb(new Uint8Array(readFileSync(process.argv[2])).buffer);
} catch (error) {
  console.log(error.name, error.message);
}
"""
    assert node(source, tmp_path / "other.glb").startswith(
        "MixseqError this mesh sequence has version 8, this decoder reads 1; "
    )
