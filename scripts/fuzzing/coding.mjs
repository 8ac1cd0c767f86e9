// Decode a .glb: the times, corners and positions of its first frames as float64.
import { readFileSync, writeFileSync } from "node:fs";
import { open } from "../../mixseq/web/decoder/sequence.js";
import { coloursOf, hardEdgesOf, uvsOf } from "../../mixseq/web/decoder/surface.js";
import { drawnMesh } from "../../mixseq/web/player/drawn_mesh.js";
import { readGlb } from "../../mixseq/web/player/glb.js";
const [, , name, out, most] = process.argv, file = new Uint8Array(readFileSync(name)).buffer;
try {
  const { text, streams } = readGlb(file), sequence = await open(text, streams);
  const frames = Math.min(sequence.frameCount, Number(most)), size = 3 * sequence.vertexCount;
  const positions = new Float32Array(frames * size), { counts, corners } = sequence.polygons();
  for (let frame = 0; frame < frames; frame++) sequence.frame(frame, positions.subarray(frame * size, (frame + 1) * size));
  sequence.chunks.forEach((_, number) => sequence.share(number));
  drawnMesh(sequence);
  [uvsOf, coloursOf, hardEdgesOf].forEach((read) => read(sequence));
  if (sequence.frame(0).some((number) => !Number.isFinite(number))) throw new Error("positions are not finite");
  writeFileSync(out, new Float64Array([...sequence.times.subarray(0, frames), ...corners, ...positions]));
} catch (error) {
  if (error.name !== "MixseqError") throw error;
  console.log(`refused: ${error.message}`);
}
