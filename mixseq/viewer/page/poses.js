// Decodes poses of compressed meshes, with normals and measured colours. Runs in a worker, or in the page without workers.
"use strict";

var mixseqPoses = (function () {
  const AXES = { X: [2, 0, 1], Y: [0, 1, 2], Z: [1, 2, 0] }; // axes that become x, y and z, with y up
  const meshes = [];
  let last = Promise.resolve(); // requests are answered in order

  /** Open a mesh from its description and streams; returns its triangles, and the times of its frames since the first. */
  async function open({ coding, streams }) {
    const sequence = await mixseqDecoder.open(coding, streams), faces = sequence.triangles();
    meshes.push({ sequence, faces, vertices: sequence.vertexCount, measures: {} });
    return { faces, vertices: sequence.vertexCount, times: Array.from(sequence.times, (time) => time - sequence.times[0]) };
  }

  /** Vertex positions at a time since the first frame, Y up: x, y and z of one after the other. */
  function placesOf({ sequence }, time) {
    const points = sequence.at(sequence.times[0] + time), axes = AXES[sequence.upAxis];
    return sequence.upAxis === "Y" ? points : points.map((_, k) => points[k - (k % 3) + axes[k % 3]]);
  }

  /** Mean of the vertices along the ground. */
  function middleOf(places) {
    const sum = [0, 0, 0];
    for (let k = 0; k < places.length; k += 3) {
      sum[0] += places[k];
      sum[2] += places[k + 2];
    }
    return sum.map((value) => (3 * value) / places.length);
  }

  /** Pose of a mesh at a time, with palette entries of a measured colouring whose scale ends at `top`. */
  function pose({ mesh: number, time, measure, top }) {
    const mesh = meshes[number], places = placesOf(mesh, time), normals = mixseqNormals(mesh, places);
    if (!measure) return { places, normals, middle: middleOf(places) };
    mesh.measures[measure] ??= mixseqMeasures[measure](mesh, placesOf(mesh, 0));
    const colours = Uint8Array.from(mesh.measures[measure](places), (value) => Math.round(255 * Math.min(value / top, 1)));
    return { places, normals, middle: middleOf(places), colours };
  }

  /** Answer a request {ask: "open" or "pose", about}; failures are answered with {error}. */
  function answer({ ask, about }) {
    last = last.then(() => (ask === "open" ? open(about) : pose(about))).catch(({ message }) => ({ error: message }));
    return last;
  }

  if (typeof document === "undefined") {
    onmessage = async ({ data }) => {
      const result = await answer(data);
      postMessage(result, [result.places, result.normals].filter(Boolean).map(({ buffer }) => buffer));
    };
  }
  return { answer };
})();
