// The mesh of a sequence as graphics cards have it: triangles, and vertices that are cut where a corner has other texture
// coordinates, or another colour or normal, than the corner before.
import { triangulated } from "../decoder/polygons.js";
import { coloursOf, hardEdgesOf, uvsOf } from "../decoder/surface.js";

/**
 * `triangles` of vertices; `vertices` tells which of the sequence each is, `groups` which share a normal, `uvs` has their
 * texture coordinates, v downwards as in glTF, `colours` red, green, blue and alpha; null if there are none.
 */
export function drawnMesh(sequence) {
  const { counts, corners } = sequence.polygons(), uvs = uvsOf(sequence), colours = coloursOf(sequence), edges = hardEdgesOf(sequence);
  const normals = edges ? byFirstUse(edges).numbers : corners, on = [...axesOf(uvs, 2), ...axesOf(colours, 4)];
  const { numbers: drawn, firsts: cut } = byFirstUse(corners, ...(edges ? [normals] : []), ...on);
  return {
    triangles: triangulated(counts, drawn),
    vertices: Uint32Array.from(cut, (corner) => corners[corner]),
    groups: Uint32Array.from(cut, (corner) => normals[corner]),
    uvs: uvs && Float32Array.from({ length: 2 * cut.length }, (_, k) => (k & 1 ? 1 - uvs[2 * cut[k >> 1] + 1] : uvs[2 * cut[k >> 1]])),
    colours: colours && Float32Array.from({ length: 4 * cut.length }, (_, k) => colours[4 * cut[k >> 2] + (k & 3)]),
  };
}

/** The columns of rows of some width, none if there are no rows. */
function axesOf(rows, width) {
  return Array.from({ length: rows ? width : 0 }, (_, axis) => rows.filter((_, k) => k % width === axis));
}

/**
 * The `numbers` 0, 1, 2, ... of rows as they come, equal where these are, and where each is at first, `firsts`. Rows are given
 * column by column. One column after the other is joined to those before, so that it takes the same time whatever they are.
 */
function byFirstUse(...columns) {
  let numbers = null, firsts = [];
  for (const column of columns) {
    const width = firsts.length, ids = new Map(), known = new Map(), joined = new Uint32Array(column.length);
    firsts = [];
    for (let row = 0; row < joined.length; row++) {
      let id = ids.get(column[row]);
      if (id === undefined) ids.set(column[row], (id = ids.size));
      const key = numbers ? id * width + numbers[row] : id; // below 2^53, as both are below 2^26
      joined[row] = known.get(key) ?? known.set(key, firsts.push(row) - 1).get(key);
    }
    numbers = joined;
  }
  return { numbers, firsts };
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
