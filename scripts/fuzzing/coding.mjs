// Decode the .glb of every line of stdin: write times, corners and positions of its first frames beside it as float64, or print why not.
import { readFileSync, writeFileSync } from "node:fs";
import { createInterface } from "node:readline";
import { open } from "../../mixseq/web/decoder/sequence.js";
import { coloursOf, hardEdgesOf, uvsOf } from "../../mixseq/web/decoder/surface.js";
import { drawnMesh } from "../../mixseq/web/player/drawn_mesh.js";
import { readGlb } from "../../mixseq/web/player/glb.js";

async function decode(name, most) {
  const { text, streams } = readGlb(new Uint8Array(readFileSync(name)).buffer), sequence = await open(text, streams);
  const frames = Math.min(sequence.frameCount, most), size = 3 * sequence.vertexCount;
  const positions = new Float32Array(frames * size), { corners } = sequence.polygons();
  for (let frame = 0; frame < frames; frame++) sequence.frame(frame, positions.subarray(frame * size, (frame + 1) * size));
  sequence.chunks.forEach((_, number) => sequence.share(number));
  drawnMesh(sequence);
  [uvsOf, coloursOf, hardEdgesOf].forEach((read) => read(sequence));
  if (sequence.frame(0).some((number) => !Number.isFinite(number))) throw new Error("positions are not finite");
  writeFileSync(`${name}.f8`, new Float64Array([...sequence.times.subarray(0, frames), ...corners, ...positions]));
}

Object.freeze(Object.prototype); // names in files must not change what all objects have
for await (const name of createInterface({ input: process.stdin })) {
  const refused = await decode(name, Number(process.argv[2])).then(() => "", (error) => {
    if (error.name !== "MixseqError") throw error;
    return error.message;
  });
  console.log(JSON.stringify(refused));
}
