// What follows from the triangles of a mesh: normals at its vertices, and its edges.
"use strict";

var mixseqGeometry = (function () {
  let sums = new Float32Array(0);

  /**
   * Normals of the vertices, not of unit length: the sum of those of the triangles around them, by area. They are to be
   * used before the next ones are computed, which take the same memory.
   */
  function normals({ faces, vertices }, places) {
    if (sums.length < 3 * vertices) sums = new Float32Array(3 * vertices);
    const result = sums.subarray(0, 3 * vertices).fill(0), y = vertices, z = 2 * vertices;
    for (let k = 0; k < faces.length; k += 3) {
      const a = faces[k], b = faces[k + 1], c = faces[k + 2];
      const ax = places[a], ay = places[y + a], az = places[z + a];
      const ux = places[b] - ax, uy = places[y + b] - ay, uz = places[z + b] - az;
      const vx = places[c] - ax, vy = places[y + c] - ay, vz = places[z + c] - az;
      const nx = uy * vz - uz * vy, ny = uz * vx - ux * vz, nz = ux * vy - uy * vx;
      for (const corner of [3 * a, 3 * b, 3 * c]) {
        result[corner] += nx;
        result[corner + 1] += ny;
        result[corner + 2] += nz;
      }
    }
    return result;
  }

  /** Every edge of the triangles once, as pairs of vertices. */
  function edges({ faces, vertices }) {
    const keys = new Float64Array(faces.length);
    for (let k = 0; k < faces.length; k++) {
      const a = faces[k], b = faces[k % 3 === 2 ? k - 2 : k + 1];
      keys[k] = Math.min(a, b) * vertices + Math.max(a, b);
    }
    const pairs = [];
    keys.sort().forEach((key, k) => key !== keys[k - 1] && pairs.push(Math.floor(key / vertices), key % vertices));
    return new Uint32Array(pairs);
  }

  return { normals, edges };
})();
