// Frames on the graphics card (WebGL 2): fields are textures, a frame is weights, and vertex shaders do the rest.
import { MixseqError } from "../decoder/errors.js";

/** Texels in a row of a texture, which all graphics cards support. */
const WIDTH = 2048;

/**
 * Fields as texels of four numbers: four fields of a part at its first vertex, at its second, and so on, then the next four.
 *
 * `places` has four integers for every vertex: its first texel, the stride to the next ones, their number, and the first row
 * of its weights. Texels are float32: half floats would cause errors of up to a quarter of a bound of 1e-3 diagonals.
 * `order` has the four fields of every row of weights, -1 for none.
 */
function fieldLayout({ parts }, vertexCount) {
  const rows = parts.map(({ fields }) => Math.ceil(fields.length / 4)), places = new Int32Array(4 * vertexCount);
  const texels = new Float32Array(4 * inRows(parts.reduce((sum, { vertices }, p) => sum + vertices.length * rows[p], 0)));
  const order = new Int32Array(4 * rows.reduce((sum, count) => sum + count, 0)).fill(-1);
  let first = 0, row = 0;
  parts.forEach(({ vertices, fields, values }, p) => {
    const size = vertices.length, count = fields.length;
    for (let i = 0; i < size; i++) {
      places.set([first + i, size, rows[p], row], 4 * vertices[i]);
      for (let k = 0; k < count; k++) texels[4 * (first + (k >> 2) * size + i) + (k & 3)] = values[i * count + k];
    }
    order.set(fields, 4 * row);
    first += size * rows[p];
    row += rows[p];
  });
  return { texels, places, order };
}

/** Weights as rows of three texels: x of the four fields of a row, y of these, z of these. */
function weightRows(order, weights, out) {
  order.forEach((field, slot) => {
    const place = 12 * (slot >> 2) + (slot & 3);
    for (let axis = 0; field >= 0 && axis < 3; axis++) out[place + 4 * axis] = weights[3 * field + axis];
  });
  return out;
}

/**
 * The triangles around vertices: `pairs` of the two other vertices of each, and in `places` the first pair of every vertex,
 * and their number. Vertices of one group have all triangles of the group.
 */
function ringLayout(triangles, groups) {
  const starts = new Int32Array(groups.reduce((most, group) => Math.max(most, group), 0) + 2), pairs = new Int32Array(2 * inRows(triangles.length));
  for (const vertex of triangles) starts[groups[vertex] + 1]++;
  for (let group = 1; group < starts.length; group++) starts[group] += starts[group - 1];
  const filled = starts.slice(), places = new Int32Array(2 * groups.length);
  triangles.forEach((vertex, corner) => {
    const first = corner - (corner % 3), beside = triangles[first + ((corner + 1) % 3)], last = triangles[first + ((corner + 2) % 3)];
    pairs.set([beside, last], 2 * filled[groups[vertex]]++);
  });
  groups.forEach((group, vertex) => places.set([starts[group], starts[group + 1] - starts[group]], 2 * vertex));
  return { pairs, places };
}

/** The least number of texels, from a number on, that fill their rows. */
const inRows = (count) => Math.max(Math.ceil(count / WIDTH), 1) * WIDTH;

const HEAD = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp isampler2D;
ivec2 at(int texel) { return ivec2(texel % ${WIDTH}, texel / ${WIDTH}); }
`;

const POSITIONS = `${HEAD}
in ivec4 place; // first texel, texels to the next, number of texels, first row of weights
in int vertex;
uniform sampler2D fields, weights, residuals;
uniform int displaced;
out vec4 result;
void main() {
  vec3 sum = displaced == 0 ? vec3(0.0) : texelFetch(residuals, at(vertex), 0).xyz;
  for (int k = 0; k < place.z; k++) {
    vec4 field = texelFetch(fields, at(place.x + k * place.y), 0);
    int row = place.w + k;
    sum += vec3(dot(field, texelFetch(weights, ivec2(0, row), 0)), dot(field, texelFetch(weights, ivec2(1, row), 0)), dot(field, texelFetch(weights, ivec2(2, row), 0)));
  }
  result = vec4(sum, 1.0);
}`;

const NORMALS = `${HEAD}
in ivec2 place; // first pair, number of pairs
uniform sampler2D positions;
uniform isampler2D pairs;
out vec3 result;
void main() {
  vec3 sum = vec3(0.0);
  for (int k = 0; k < place.y; k++) {
    ivec2 pair = texelFetch(pairs, at(place.x + k), 0).xy;
    vec3 here = texelFetch(positions, at(gl_VertexID), 0).xyz;
    sum += cross(texelFetch(positions, at(pair.x), 0).xyz - here, texelFetch(positions, at(pair.y), 0).xyz - here);
  }
  float size = length(sum);
  result = size > 0.0 ? sum / size : vec3(0.0, 0.0, 1.0);
}`;

const NOTHING = `#version 300 es
void main() {}`;

/**
 * Positions and normals of vertices as buffers of the graphics card: four floats for each position, the last one 1, and
 * three for each normal. `evaluate` writes them for `Sequence.weights` and `Sequence.residuals`; `dispose` frees them.
 *
 * `fields` are those of the sequence. `vertices` are the numbers of vertices in the sequence, if vertices are split along
 * seams; `triangles` are of split vertices. Vertices of one of the `groups` share a normal, by default those of one vertex of
 * the sequence. `evaluate` unbinds the programs, textures and buffers that were bound.
 */
export function fieldTextures(gl, fields, triangles, vertices = null, groups = vertices) {
  const known = fields.parts.reduce((sum, part) => sum + part.vertices.length, 0), { texels, places, order } = fieldLayout(fields, known);
  const named = Int32Array.from(vertices ?? { length: known }, (vertex, k) => vertex ?? k), count = named.length;
  const own = Int32Array.from({ length: 4 * count }, (_, k) => places[4 * named[k >> 2] + (k & 3)]), ring = ringLayout(triangles, groups ?? named);
  const rows = order.length / 4, weightTexels = new Float32Array(12 * rows), largest = gl.getParameter(gl.MAX_TEXTURE_SIZE), made = [];
  if (Math.max(rows, texels.length / (4 * WIDTH), ring.pairs.length / (2 * WIDTH)) > largest) {
    throw new MixseqError("the sequence is too large for textures of this graphics card; take its positions from Sequence.at");
  }

  const textures = {
    fields: newTexture(gl.RGBA32F, WIDTH, texels.length / (4 * WIDTH)), weights: newTexture(gl.RGBA32F, 3, rows), residuals: newTexture(gl.RGB32F, WIDTH, inRows(known) / WIDTH),
    positions: newTexture(gl.RGBA32F, WIDTH, inRows(count) / WIDTH), pairs: newTexture(gl.RG32I, WIDTH, ring.pairs.length / (2 * WIDTH)),
  };
  const positions = newBuffer(new Float32Array(4 * inRows(count))), normals = newBuffer(new Float32Array(3 * count)), added = new Float32Array(3 * inRows(known));
  const place = newPass(POSITIONS, ["fields", "weights", "residuals"], { place: [4, own], vertex: [1, named] }, positions);
  const turn = newPass(NORMALS, ["positions", "pairs"], { place: [2, ring.places] }, normals);
  fill("fields", gl.RGBA, gl.FLOAT, texels);
  fill("pairs", gl.RG_INTEGER, gl.INT, ring.pairs);

  function evaluate(weights, residuals = null) {
    fill("weights", gl.RGBA, gl.FLOAT, weightRows(order, weights, weightTexels));
    if (residuals) {
      added.set(residuals);
      fill("residuals", gl.RGB, gl.FLOAT, added);
    }
    place(residuals ? 1 : 0);
    gl.bindBuffer(gl.PIXEL_UNPACK_BUFFER, positions); // shaders read buffers at their own vertex only, textures anywhere
    fill("positions", gl.RGBA, gl.FLOAT, 0);
    gl.bindBuffer(gl.PIXEL_UNPACK_BUFFER, null);
    turn(0);
  }

  function newTexture(format, width, height) {
    const texture = gl.createTexture();
    made.push(() => gl.deleteTexture(texture));
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
    return { texture, width, height };
  }

  function fill(name, format, type, data) {
    const { texture, width, height } = textures[name];
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 4);
    gl.pixelStorei(gl.UNPACK_FLIP_Y_WEBGL, false);
    gl.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, false);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, width, height, format, type, data);
  }

  function newBuffer(data) {
    const buffer = gl.createBuffer();
    made.push(() => gl.deleteBuffer(buffer));
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, data, gl.DYNAMIC_COPY);
    return buffer;
  }

  /** A shader over all vertices, with attributes of whole numbers, whose results go to a buffer. */
  function newPass(vertexShader, samplers, attributes, target) {
    const program = newProgram(vertexShader), array = gl.createVertexArray(), displaced = gl.getUniformLocation(program, "displaced");
    const feedback = gl.createTransformFeedback();
    made.push(() => [gl.deleteProgram(program), gl.deleteVertexArray(array), gl.deleteTransformFeedback(feedback)]);
    gl.bindVertexArray(array);
    for (const [name, [size, data]] of Object.entries(attributes)) {
      const location = gl.getAttribLocation(program, name);
      newBuffer(data);
      gl.enableVertexAttribArray(location);
      gl.vertexAttribIPointer(location, size, gl.INT, 0, 0);
    }
    gl.bindVertexArray(null);
    gl.useProgram(program);
    samplers.forEach((name, unit) => gl.uniform1i(gl.getUniformLocation(program, name), unit));
    return (given) => {
      gl.useProgram(program);
      gl.uniform1i(displaced, given);
      samplers.forEach((name, unit) => {
        gl.activeTexture(gl.TEXTURE0 + unit);
        gl.bindTexture(gl.TEXTURE_2D, textures[name].texture);
      });
      gl.bindVertexArray(array);
      gl.bindBuffer(gl.ARRAY_BUFFER, null); // where the target may be
      gl.bindTransformFeedback(gl.TRANSFORM_FEEDBACK, feedback);
      gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER, 0, target);
      gl.enable(gl.RASTERIZER_DISCARD);
      gl.beginTransformFeedback(gl.POINTS);
      gl.drawArrays(gl.POINTS, 0, count);
      gl.endTransformFeedback();
      gl.disable(gl.RASTERIZER_DISCARD);
      gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER, 0, null); // others may read it then
      gl.bindTransformFeedback(gl.TRANSFORM_FEEDBACK, null);
      gl.bindVertexArray(null);
      gl.activeTexture(gl.TEXTURE0);
    };
  }

  function newProgram(vertexShader) {
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertexShader], [gl.FRAGMENT_SHADER, NOTHING]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
      gl.deleteShader(shader); // with the program
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) throw new Error(gl.getShaderInfoLog(shader));
    }
    gl.transformFeedbackVaryings(program, ["result"], gl.INTERLEAVED_ATTRIBS);
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) throw new Error(gl.getProgramInfoLog(program));
    return program;
  }

  return { count, positions, normals, evaluate, dispose: () => made.forEach((free) => free()) };
}
