// Poses of compressed meshes: decoded, with their normals, and with what colours measure. It runs in a worker, or in the page where there are none.
"use strict";

var mixseqPoses = (function () {
  const AXES = { X: [2, 0, 1], Y: [0, 1, 2], Z: [1, 2, 0] }; // which become x, y and z, where y is up
  const meshes = [];
  let last = Promise.resolve(); // questions are answered in turn

  /** Open a mesh of the attribute coding and its streams; returns its triangles, and the times of its frames since the first. */
  async function open({ coding, streams }) {
    const sequence = await mixseqDecoder.open(coding, streams), faces = sequence.triangles();
    meshes.push({ sequence, faces, vertices: sequence.vertexCount, measures: {} });
    return { faces, vertices: sequence.vertexCount, times: Array.from(sequence.times, (time) => time - sequence.times[0]) };
  }

  /** Where vertices are at a time since the first frame, x, y and z of one after the other, Y up. */
  function placesOf({ sequence }, time) {
    const points = sequence.at(sequence.times[0] + time), axes = AXES[sequence.upAxis];
    return sequence.upAxis === "Y" ? points : points.map((_, k) => points[k - (k % 3) + axes[k % 3]]);
  }

  /** The mean of the vertices, on the ground. */
  function middleOf(places) {
    const sum = [0, 0, 0];
    for (let k = 0; k < places.length; k += 3) {
      sum[0] += places[k];
      sum[2] += places[k + 2];
    }
    return sum.map((value) => (3 * value) / places.length);
  }

  /** The pose of a mesh at a time; with the name of what colours measure, and where their scale ends, also places in their palette. */
  function pose({ mesh: number, time, measure, top }) {
    const mesh = meshes[number], places = placesOf(mesh, time), normals = mixseqNormals(mesh, places);
    if (!measure) return { places, normals, middle: middleOf(places) };
    mesh.measures[measure] ??= mixseqMeasures[measure](mesh, placesOf(mesh, 0));
    const colours = Uint8Array.from(mesh.measures[measure](places), (value) => Math.round(255 * Math.min(value / top, 1)));
    return { places, normals, middle: middleOf(places), colours };
  }

  /** Answer a question {ask: "open" or "pose", about}, with what went wrong as {error}. */
  function answer({ ask, about }) {
    last = last.then(() => (ask === "open" ? open(about) : pose(about))).catch(({ message }) => ({ error: message }));
    return last;
  }

  if (typeof document === "undefined") {
    onmessage = async ({ data }) => {
      const said = await answer(data);
      postMessage(said, [said.places, said.normals].filter(Boolean).map(({ buffer }) => buffer));
    };
  }
  return { answer };
})();
