// The mesh of a sequence as graphics cards have it: triangles, and vertices that are cut where a corner has other texture
// coordinates, or another normal, than the corner before.
import { triangulated } from "../decoder/polygons.js";
import { hardEdgesOf, uvsOf } from "../decoder/surface.js";

/**
 * `triangles` of vertices; `vertices` tells which of the sequence each is, `groups` which share a normal, `uvs` has their
 * texture coordinates, v downwards as in glTF, null if there are none.
 */
export function drawnMesh(sequence) {
  const { counts, corners } = sequence.polygons(), uvs = uvsOf(sequence), normals = byFirstUse(hardEdgesOf(sequence)) ?? corners;
  const first = new Int32Array(sequence.vertexCount).fill(-1), next = new Int32Array(corners.length);
  const cut = [], drawn = new Uint32Array(corners.length);
  const same = (a, b) => normals[a] === normals[b] && (!uvs || (uvs[2 * a] === uvs[2 * b] && uvs[2 * a + 1] === uvs[2 * b + 1]));
  for (let corner = 0; corner < corners.length; corner++) {
    let found = first[corners[corner]]; // of the vertices that this one of the sequence has been cut into
    while (found >= 0 && !same(cut[found], corner)) found = next[found];
    if (found < 0) {
      found = cut.push(corner) - 1;
      next[found] = first[corners[corner]];
      first[corners[corner]] = found;
    }
    drawn[corner] = found;
  }
  return {
    triangles: triangulated(counts, drawn),
    vertices: Uint32Array.from(cut, (corner) => corners[corner]),
    groups: Uint32Array.from(cut, (corner) => normals[corner]),
    uvs: uvs && Float32Array.from({ length: 2 * cut.length }, (_, k) => (k & 1 ? 1 - uvs[2 * cut[k >> 1] + 1] : uvs[2 * cut[k >> 1]])),
  };
}

/** Numbers 0, 1, 2, ... as they come, equal where these are. */
function byFirstUse(numbers) {
  const known = new Map();
  return numbers?.map((number) => known.get(number) ?? known.set(number, known.size).size - 1);
}

/** Take the positions of cut vertices from those of the sequence. */
export function takePositions(positions, vertices, out) {
  for (let k = 0; k < vertices.length; k++) {
    for (let axis = 0; axis < 3; axis++) out[3 * k + axis] = positions[3 * vertices[k] + axis];
  }
  return out;
}

/** Normals of vertices: sums over the triangles around their group, larger ones count for more. */
export function takeNormals(positions, triangles, groups, out) {
  const sums = new Float32Array(3 * (groups.reduce((most, group) => Math.max(most, group), -1) + 1));
  for (let k = 0; k < triangles.length; k += 3) {
    const a = 3 * triangles[k], b = 3 * triangles[k + 1], c = 3 * triangles[k + 2];
    const x = positions[b] - positions[a], y = positions[b + 1] - positions[a + 1], z = positions[b + 2] - positions[a + 2];
    const u = positions[c] - positions[a], v = positions[c + 1] - positions[a + 1], w = positions[c + 2] - positions[a + 2];
    for (let corner = k; corner < k + 3; corner++) {
      const group = 3 * groups[triangles[corner]];
      sums[group] += y * w - z * v;
      sums[group + 1] += z * u - x * w;
      sums[group + 2] += x * v - y * u;
    }
  }
  for (let k = 0; k < groups.length; k++) {
    const x = sums[3 * groups[k]], y = sums[3 * groups[k] + 1], z = sums[3 * groups[k] + 2], size = Math.sqrt(x * x + y * y + z * z);
    out[3 * k] = size > 0 ? x / size : 0;
    out[3 * k + 1] = size > 0 ? y / size : 0;
    out[3 * k + 2] = size > 0 ? z / size : 1;
  }
  return out;
}
