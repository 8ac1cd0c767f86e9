// Triangles of polygons. Mirrors mixseq/mesh/polygons.py.

/**
 * The triangles `Uint32Array(3F)` of polygons: the fans about their first corners. `counts` are the numbers of corners,
 * `corners` their vertices.
 */
export function triangulated(counts, corners) {
  const faces = new Uint32Array(3 * (corners.length - 2 * counts.length));
  let start = 0, k = 0;
  for (const count of counts) {
    for (let corner = start + 1; corner < start + count - 1; corner++) {
      faces[k++] = corners[start];
      faces[k++] = corners[corner];
      faces[k++] = corners[corner + 1];
    }
    start += count;
  }
  return faces;
}
