// The decoder in a Worker: it answers the calls of `player/remote.js`, one after another.
import { open } from "../decoder/sequence.js";
import { uvsOf } from "../decoder/surface.js";
import { drawnMesh } from "./drawn_mesh.js";

/** The name of Workers that decode. */
export const NAME = "mixseq";

/** Methods of a sequence that can be called. */
export const COPIED = ["polygons", "triangles", "fields", "load", "share", "drawn"];

/** Methods whose results are new arrays, which are transferred. */
export const TRANSFERRED = ["uvs", "weights", "residuals", "at", "frame"];

/** Answer the messages {number, method, given} of a port with {number, result}, or {number, error}. */
export function serve(port) {
  let sequence;

  async function answer(method, given) {
    if (method === "open") sequence = await open(...given);
    if (method === "begin") sequence.fields();
    if (method === "uvs") return uvsOf(sequence);
    if (method === "drawn") return drawnMesh(sequence);
    if (COPIED.includes(method) || TRANSFERRED.includes(method)) return sequence[method](...given);
    const { streams, surface, ...facts } = sequence, sizes = streams.chunks.map(({ coefficients }) => coefficients.length);
    const first = streams.basis.reduce((sum, group) => sum + group.length, streams.connectivity.length);
    return method === "open" ? { facts, sizes: [first, ...sizes] } : null;
  }

  port.onmessage = async ({ data: { number, method, given } }) => {
    try {
      const result = await answer(method, given);
      port.postMessage({ number, result }, TRANSFERRED.includes(method) && result ? [result.buffer] : []);
    } catch (error) {
      port.postMessage({ number, error: error.message });
    }
  };
}

if (typeof WorkerGlobalScope !== "undefined" && globalThis.name === NAME) serve(globalThis);
