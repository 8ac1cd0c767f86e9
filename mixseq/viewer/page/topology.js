// Edges and hinges of a triangle mesh, as in mixseq/mesh/topology.py.
"use strict";

/**
 * Edges, as pairs of vertices, and hinges, as pairs of half-edges (sides) with the same vertices. Side k goes from corner k
 * of all corners to the next corner of its triangle.
 */
var mixseqTopology = function ({ faces, vertices }) {
  const end = (side) => faces[side % 3 === 2 ? side - 2 : side + 1];
  const lower = (side) => Math.min(faces[side], end(side)), upper = (side) => Math.max(faces[side], end(side));
  const starts = new Uint32Array(vertices + 1), order = new Uint32Array(faces.length), edges = [], hinges = [];
  for (let side = 0; side < faces.length; side++) starts[lower(side) + 1]++;
  for (let vertex = 0; vertex < vertices; vertex++) starts[vertex + 1] += starts[vertex];
  const filled = starts.slice();
  for (let side = 0; side < faces.length; side++) {
    const at = lower(side), up = upper(side);
    let place = filled[at]++;
    for (; place > starts[at] && upper(order[place - 1]) > up; place--) order[place] = order[place - 1];
    order[place] = side;
  }
  order.forEach((side, k) => {
    const before = k ? order[k - 1] : -1;
    if (!k || lower(side) !== lower(before) || upper(side) !== upper(before)) edges.push(lower(side), upper(side));
    else if (Math.floor(side / 3) !== Math.floor(before / 3)) hinges.push(before, side);
  });
  return { edges: new Uint32Array(edges), hinges: new Uint32Array(hinges), end };
};
