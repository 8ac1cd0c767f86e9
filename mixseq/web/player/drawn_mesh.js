// The mesh of a sequence for graphics cards: triangles, and vertices that are split where their corners have different
// texture coordinates, colours or normals.
import { triangulated } from "../decoder/connectivity.js";
import { coloursOf, hardEdgesOf, uvsOf } from "../decoder/surface.js";

/**
 * `triangles` of split vertices; for every vertex its number in the sequence, `vertices`; its group with a common normal,
 * `groups`; its texture coordinates, `uvs`, v downwards as in glTF; and its red, green, blue and alpha, `colours`. Null for none.
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
 * Number equal rows, given as columns, in order of first use: the `numbers` of all rows, and the first row of each number,
 * `firsts`. Columns are combined one by one, so that the time does not depend on the values.
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

/** Copy the positions of split vertices from those of the sequence. */
export function takePositions(positions, vertices, out) {
  for (let k = 0; k < vertices.length; k++) {
    for (let axis = 0; axis < 3; axis++) out[3 * k + axis] = positions[3 * vertices[k] + axis];
  }
  return out;
}

/** Normals of vertices, weighted by area: sums over the triangles around their group. */
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
