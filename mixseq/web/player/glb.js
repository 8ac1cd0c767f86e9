// GLB files with a mesh sequence: the JSON of glTF, and the data of the extension MIXSEQ_mesh_sequence.
import { MixseqError } from "../decoder/errors.js";

const MAGIC = 0x46546c67, JSON_CHUNK = 0x4e4f534a, NAME = "MIXSEQ_mesh_sequence", VERSION = 1;

/**
 * Read a mesh sequence of a file, an `ArrayBuffer`: that of a body, by default the first of the names in `bodies`. `text` and `streams` are as for
 * `open`, `mesh` is where it is in the file's `json`, and `matrix` is that of the node that has it, 16 numbers, column by column.
 */
export function readGlb(file, body = null) {
  try {
    return readChunks(file, body);
  } catch (error) {
    throw error instanceof MixseqError ? error : new MixseqError(`this GLB file is damaged (${error.message})`);
  }
}

function readChunks(file, body) {
  const view = new DataView(file);
  if (file.byteLength < 20 || view.getUint32(0, true) !== MAGIC || view.getUint32(16, true) !== JSON_CHUNK) throw new MixseqError("this is not a GLB file");
  const size = view.getUint32(12, true), start = 28 + size, json = JSON.parse(new TextDecoder().decode(new Uint8Array(file, 20, size)));
  const meshes = (json.meshes ?? []).filter(({ extensions }) => extensions?.[NAME]), bodies = meshes.map(({ name = "" }) => name);
  if (!meshes.length) throw new MixseqError("this GLB file has no mesh sequence");
  const mesh = meshes[body === null ? 0 : bodies.indexOf(body)];
  if (!mesh) throw new MixseqError(`there is no body “${body}”; bodies are ${bodies.join(", ")}`);
  const extension = mesh.extensions[NAME];
  checkVersion(extension);
  const bytes = (number) => {
    const { byteOffset = 0, byteLength } = json.bufferViews[number], isWhole = [byteOffset, byteLength].every((size) => Number.isInteger(size) && size >= 0);
    if (!isWhole || start + byteOffset + byteLength > file.byteLength) throw new MixseqError("this GLB file is incomplete");
    return new Uint8Array(file, start + byteOffset, byteLength);
  };
  const node = json.nodes?.find((each) => each.mesh === json.meshes.indexOf(mesh));
  return {
    text: new TextDecoder().decode(bytes(extension.coding)), streams: bytes(extension.streams),
    bodies, json, mesh, matrix: node?.matrix ?? [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
  };
}

/** Verify that this decoder supports the version of an extension. */
export function checkVersion({ version }) {
  if (version === VERSION) return;
  throw new MixseqError(`this mesh sequence has version ${version}, this decoder reads ${VERSION}; take another decoder, or compress the original again`);
}
