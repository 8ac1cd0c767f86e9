"""What JavaScript makes of a compressed sequence, as arrays."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

import mixseq
from mixseq.compression.bitstream.compressed_sequence import CompressedSequence
from mixseq.types import Float, FloatArray, IntArray
from tests.web.conftest import Node

PLAY = """
import { readFileSync, writeFileSync } from "node:fs";
import { open } from "decoder/sequence.js";
import { coloursOf, hardEdgesOf, uvsOf } from "decoder/surface.js";
const folder = process.argv[2], bytes = (name) => new Uint8Array(readFileSync(`${folder}/${name}`));
const sequence = await open(new TextDecoder().decode(bytes("text")), bytes("streams"));
const write = (name, array) => writeFileSync(`${folder}/${name}`, array ?? new Uint8Array(0));
const { streams, chunks, ...facts } = sequence, times = new Float64Array(bytes("wanted").buffer);
const { counts, corners } = sequence.polygons(), fields = sequence.fields();
const positions = new Float32Array(3 * sequence.vertexCount * times.length), loaded = [];
const exact = new Float64Array(positions.length);
times.forEach((time, k) => {
  const range = [3 * sequence.vertexCount * k, 3 * sequence.vertexCount * (k + 1)];
  for (const out of [positions, exact]) sequence.at(time, out.subarray(...range));
  loaded.push(chunks.filter((chunk) => chunk.loaded).length);
});
const triangles = sequence.triangles(), uvs = uvsOf(sequence), edges = hardEdgesOf(sequence);
const colours = coloursOf(sequence);
const arrays = { counts, corners, triangles, uvs, colours, edges, positions, exact, times: sequence.times };
Object.entries(arrays).forEach((one) => write(...one));
fields.parts.forEach(({ vertices, fields, values }, part) => {
  write(`vertices${part}`, vertices);
  write(`fields${part}`, fields);
  write(`values${part}`, Float64Array.from(values));
});
console.log(JSON.stringify({ ...facts, times: 0, loaded, count: fields.count, parts: fields.parts.length }));
"""


@dataclass(frozen=True)
class Played:
    """Facts, mesh, fields of parts (vertices, numbers of fields, their values), and positions at the times wanted."""

    facts: dict[str, Any]
    counts: IntArray
    corners: IntArray
    triangles: IntArray
    times: Float
    uvs: FloatArray
    colours: FloatArray
    hard_edges: IntArray
    parts: list[tuple[IntArray, IntArray, FloatArray]]
    positions: FloatArray
    exact: Float


def write_container(folder: Path, coded: CompressedSequence | Path) -> None:
    """Write text and streams of a compressed sequence, or of a file with one, to ``text`` and ``streams``."""
    path = coded if isinstance(coded, Path) else folder / "coded.h5"
    if not isinstance(coded, Path):
        mixseq.save(path, coded)
    with h5py.File(path) as file:
        (folder / "text").write_bytes(bytes(file.attrs["coding"]))
        (folder / "streams").write_bytes(file["streams"][...].tobytes())


def played(node: Node, folder: Path, coded: CompressedSequence | Path, times: Float) -> Played:
    """Return what JavaScript makes of it."""
    write_container(folder, coded)
    times.tofile(folder / "wanted")
    facts = json.loads(node(PLAY, folder))

    def array(name: str, kind: str) -> Any:
        return np.fromfile(folder / name, kind)

    return Played(
        facts,
        array("counts", "<u4"),
        array("corners", "<u4"),
        array("triangles", "<u4"),
        array("times", "<f8"),
        array("uvs", "<f4").reshape(-1, 2),
        array("colours", "<f4").reshape(-1, 4),
        array("edges", "<i4"),
        [
            (array(f"vertices{k}", "<u4"), array(f"fields{k}", "<u4"), array(f"values{k}", "<f8"))
            for k in range(facts["parts"])
        ],
        array("positions", "<f4").reshape(len(times), -1, 3),
        array("exact", "<f8").reshape(len(times), -1, 3),
    )
