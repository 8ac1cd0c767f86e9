// Strain and curvature of a pose at its vertices, as in mixseq/pictures/colours.py.
"use strict";

var mixseqMeasures = (function () {
  const DEGENERATE_HEIGHT_RATIO = 1e-6; // height of a triangle relative to its longest side below which it has no normal
  const subtract = (x, a, b) => [x[3 * b] - x[3 * a], x[3 * b + 1] - x[3 * a + 1], x[3 * b + 2] - x[3 * a + 2]];
  const cross = ([a, b, c], [d, e, f]) => [b * f - c * e, c * d - a * f, a * e - b * d];
  const dot = ([a, b, c], [d, e, f]) => a * d + b * e + c * f;

  /** Function from positions to the means at vertices of values measured on pairs of vertices. */
  function means(vertices, pairs, measure) {
    const counts = new Uint32Array(vertices).fill(0);
    pairs.forEach((vertex) => counts[vertex]++);
    return (places) => {
      const sums = new Float64Array(vertices);
      measure(places).forEach((value, k) => {
        sums[pairs[2 * k]] += value;
        sums[pairs[2 * k + 1]] += value;
      });
      return sums.map((sum, vertex) => (counts[vertex] ? sum / counts[vertex] : 0));
    };
  }

  /** Relative change of edge lengths, in percent. */
  function strain(mesh, rest) {
    const { edges } = mixseqTopology(mesh);
    const lengths = (places) => Float64Array.from({ length: edges.length / 2 }, (_, k) => Math.hypot(...subtract(places, edges[2 * k], edges[2 * k + 1])));
    const before = lengths(rest);
    return means(mesh.vertices, edges, (places) => lengths(places).map((length, k) => (before[k] > 0 ? 100 * Math.abs(length / before[k] - 1) : 0)));
  }

  /** Change of dihedral angles, in degrees. */
  function curvature({ faces, vertices }, rest) {
    const { hinges, end } = mixseqTopology({ faces, vertices });
    const pairs = Uint32Array.from({ length: hinges.length }, (_, k) => (k % 2 ? end(hinges[k - 1]) : faces[hinges[k]]));

    /** Normals of triangles, with twice the areas as lengths; null for degenerate triangles. */
    function normals(places) {
      return Array.from({ length: faces.length / 3 }, (_, k) => {
        const [a, b, c] = faces.subarray(3 * k, 3 * k + 3), u = subtract(places, a, b), v = subtract(places, a, c), w = subtract(places, b, c);
        const normal = cross(u, v), longest = Math.max(dot(u, u), dot(v, v), dot(w, w));
        return dot(normal, normal) > (DEGENERATE_HEIGHT_RATIO * longest) ** 2 ? normal : null;
      });
    }

    function angles(places) {
      const all = normals(places);
      return Float64Array.from({ length: hinges.length / 2 }, (_, k) => {
        const first = all[Math.floor(hinges[2 * k] / 3)], other = all[Math.floor(hinges[2 * k + 1] / 3)];
        if (!first || !other) return NaN;
        // the second triangle has the reverse edge if both have the same orientation
        const sign = faces[hinges[2 * k + 1]] === faces[hinges[2 * k]] ? -1 : 1;
        const second = other.map((value) => sign * value), edge = subtract(places, pairs[2 * k], pairs[2 * k + 1]);
        return Math.atan2(dot(cross(first, second), edge), dot(first, second) * Math.sqrt(dot(edge, edge)));
      });
    }

    const before = angles(rest);
    return means(vertices, pairs, (places) => angles(places).map((angle, k) => {
      const change = Math.abs(angle - before[k]), turn = Math.min(change, 2 * Math.PI - change);
      return turn > 0 ? (180 / Math.PI) * turn : 0; // 0 for NaN, where an angle is undefined
    }));
  }

  return { strain, curvature };
})();
