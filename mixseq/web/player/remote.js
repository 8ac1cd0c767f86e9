// A sequence that is decoded in a Worker, so that the page stays responsive: both ends, which bundles of this module have, too.
import { MixseqError } from "../decoder/errors.js";
import { open } from "../decoder/sequence.js";
import { uvsOf } from "../decoder/surface.js";
import { drawnMesh } from "./drawn_mesh.js";

/** The name of Workers that decode. */
const NAME = "mixseq";

/** Methods of a sequence that can be called. */
const COPIED = ["polygons", "triangles", "fields", "load", "share", "drawn"];

/** Methods whose results are new arrays, which are transferred. */
const TRANSFERRED = ["uvs", "weights", "residuals", "at", "frame"];

/** Answer the messages {number, method, given} of a port with {number, result}, or {number, error}. */
function serve(port) {
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

/**
 * Open a sequence in a Worker: `text` and `streams` as for `open`. `address` is that of a module
 * that contains this one, by default this one itself.
 *
 * The result has the facts of a `Sequence`; its methods, `uvs`, and `drawn` (`drawnMesh`) return promises. `decode(told)` decodes
 * all fields, then all chunks, and reports the completed share; other calls are answered in between. `close()` ends the Worker.
 */
export async function openRemote(text, streams, address = import.meta.url) {
  const worker = new Worker(address, { type: "module", name: NAME }), waiting = new Map();
  let last = 0, ended = null;

  const call = (method, ...given) => new Promise((resolve, reject) => {
    if (ended) throw ended;
    waiting.set(++last, { resolve, reject });
    worker.postMessage({ number: last, method, given });
  });

  function close(reason = "the sequence was closed") {
    ended = new MixseqError(reason);
    worker.terminate();
    waiting.forEach(({ reject }) => reject(ended));
    waiting.clear();
  }

  worker.onmessage = ({ data: { number, result, error } }) => {
    const { resolve, reject } = waiting.get(number);
    waiting.delete(number);
    if (error === undefined) resolve(result);
    else reject(new MixseqError(error));
  };
  worker.onerror = ({ message }) => close(message || "the decoder did not start");

  try {
    const { facts, sizes } = await call("open", text, streams);
    const methods = Object.fromEntries([...COPIED, ...TRANSFERRED].map((method) => [method, (...given) => call(method, ...given)]));
    return { ...facts, ...methods, decode: (told) => decodeAll(call, sizes, told), close };
  } catch (error) {
    close();
    throw error;
  }
}

/**
 * Open a sequence that a Worker decodes and this thread plays synchronously: a `sequence` whose mesh, fields and first chunk are
 * decoded, and its `drawnMesh`, `drawn`. The other chunks follow. A chunk that is used earlier, and everything if no Worker starts,
 * is decoded in this thread.
 */
export async function openDecoded(text, streams, address) {
  const sequence = await open(text, streams), remote = await openRemote(text, streams, address).catch(() => null);
  if (!remote) return { sequence, drawn: drawnMesh(sequence) };
  try {
    const [drawn, first] = await Promise.all([remote.drawn(), remote.share(0)]);
    sequence.take(first);
    takeOthers(sequence, remote);
    return { sequence, drawn };
  } catch (error) {
    remote.close();
    throw error;
  }
}

async function takeOthers(sequence, remote) {
  try {
    for (let number = 1; number < sequence.chunks.length; number++) sequence.take(await remote.share(number));
  } catch { // reported when these frames are used
  } finally {
    remote.close();
  }
}

async function decodeAll(call, sizes, told = () => {}) {
  const whole = sizes.reduce((sum, size) => sum + size, 0);
  let done = 0;
  for (let k = 0; k < sizes.length; k++) {
    await call(...(k ? ["load", k - 1] : ["begin"]));
    told((done += sizes[k]) / whole);
  }
}
