// Vertex animation textures written by mixseq, for WebGL2: an ES module without dependencies.
//
//     const vat = await open("walk.vat/");           // vat.json and its pictures (png16)
//     const shader = `#version 300 es
//     ${glsl(vat)}
//     in vec2 lookup;                                // TEXCOORD_1 of mesh.glb
//     uniform float frame;                           // 0 to frames - 1; between them motion is straight
//     void main() { gl_Position = projection * vec4(vatPoint(lookup, frame), 1.0); }`;   // vatNormal(lookup, frame)
//     bind(gl, program, textures(gl, vat));          // before drawing; textures are made once
//
// Browsers decode PNG to 8 bits; these have 16, so they are unpacked here.

const SIGNATURE = [0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a];

const MAX_SIDE = 16384; // texels, of textures in WebGL2
const TEXTURES = new Map([["plain", ["normals", "points"]], ["low rank", ["coefficients", "normals", "points"]]]);

/** Verify what goes into shaders and addresses: the file may come from others. */
function verify(vat) {
  const isCount = (value) => Number.isInteger(value) && value > 0 && value <= MAX_SIDE;
  const areNumbers = (values) => [values].flat().every(Number.isFinite);
  const names = TEXTURES.get(vat?.kind);
  const counts = [vat?.width, vat?.height, vat?.rows, vat?.frames, ...(vat?.kind === "plain" ? [] : [vat?.layers])];
  const isSound = names && counts.every(isCount) && Object.keys(vat.textures ?? {}).sort().join() === names.join() &&
    names.every((name) => {
      const { file, width, height, offset, scale } = vat.textures[name] ?? {};
      return file === `${name}.png` && isCount(width) && isCount(height) && areNumbers(offset) && areNumbers(scale);
    });
  if (!isSound) throw new Error("vat.json is damaged, or of another version");
}

/** What is in the folder: the numbers of vat.json, and `images` by name. */
export async function open(folder) {
  const vat = await (await fetch(new URL("vat.json", new URL(folder, document.baseURI)))).json();
  if (vat.texture !== "png16") throw new Error(`the textures are ${vat.texture}; write png16 for WebGL2`);
  verify(vat);
  const names = Object.keys(vat.textures);
  const images = await Promise.all(
    names.map(async (name) => {
      const file = new URL(vat.textures[name].file, new URL(folder, document.baseURI));
      const image = await unpacked(new Uint8Array(await (await fetch(file)).arrayBuffer()));
      const { width, height } = vat.textures[name];
      if (image.width !== width || image.height !== height) throw new Error(`${name}.png is not ${width} by ${height}`);
      return image;
    }),
  );
  vat.images = Object.fromEntries(names.map((name, number) => [name, images[number]]));
  return vat;
}

/** The pixels of a PNG that mixseq wrote: 8 or 16 bits, RGB or RGBA, filters none, sub and up. */
export async function unpacked(bytes) {
  if (SIGNATURE.some((byte, place) => bytes[place] !== byte)) throw new Error("this is not PNG");
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const width = view.getUint32(16);
  const height = view.getUint32(20);
  const bits = bytes[24];
  if (!(width <= MAX_SIDE && height <= MAX_SIDE && (bits === 8 || bits === 16))) throw new Error("this PNG is damaged");
  const channels = bytes[25] === 6 ? 4 : 3;
  const parts = [];
  for (let at = 8; at < bytes.length; at += view.getUint32(at) + 12) {
    const kind = String.fromCharCode(...bytes.subarray(at + 4, at + 8));
    if (kind === "IDAT") parts.push(bytes.subarray(at + 8, at + 8 + view.getUint32(at)));
  }
  const stream = new Blob(parts).stream().pipeThrough(new DecompressionStream("deflate"));
  const pixel = (channels * bits) / 8;
  const row = width * pixel;
  const lines = await readExactly(stream, height * (row + 1));
  const rows = new Uint8Array(height * row);
  for (let y = 0; y < height; y++) {
    const filter = lines[y * (row + 1)];
    const from = y * (row + 1) + 1;
    const to = y * row;
    for (let x = 0; x < row; x++) {
      let before = 0;
      if (filter === 1 && x >= pixel) before = rows[to + x - pixel];
      if (filter === 2 && y > 0) before = rows[to + x - row];
      rows[to + x] = lines[from + x] + before;
    }
  }
  if (bits === 8) return { width, height, channels, pixels: rows };
  const pixels = new Uint16Array(rows.length / 2);
  for (let place = 0; place < pixels.length; place++) pixels[place] = (rows[2 * place] << 8) | rows[2 * place + 1];
  return { width, height, channels, pixels };
}

/** The bytes of a stream, of a known size. */
async function readExactly(stream, size) {
  const bytes = new Uint8Array(size);
  const reader = stream.getReader();
  let end = 0;
  for (let part = await reader.read(); !part.done; part = await reader.read()) {
    if (end + part.value.length > size) throw new Error("this PNG has more pixels than it says");
    bytes.set(part.value, end);
    end += part.value.length;
  }
  if (end < size) throw new Error("this PNG ends early");
  return bytes;
}

/** Textures of a context, by name. */
export function textures(gl, vat) {
  const made = {};
  for (const [name, image] of Object.entries(vat.images)) {
    const short = image.pixels instanceof Uint16Array;
    const format = image.channels === 4 ? gl.RGBA_INTEGER : gl.RGB_INTEGER;
    const kinds = short ? [gl.RGB16UI, gl.RGBA16UI] : [gl.RGB8UI, gl.RGBA8UI];
    made[name] = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, made[name]);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    const type = short ? gl.UNSIGNED_SHORT : gl.UNSIGNED_BYTE;
    gl.texImage2D(
      gl.TEXTURE_2D, 0, kinds[image.channels - 3], image.width, image.height, 0, format, type, image.pixels,
    );
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  }
  return made;
}

/** Bind textures to the samplers of a program, from a texture unit on. */
export function bind(gl, program, made, first = 0) {
  gl.useProgram(program);
  Object.entries(made).forEach(([name, texture], unit) => {
    gl.activeTexture(gl.TEXTURE0 + first + unit);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.uniform1i(gl.getUniformLocation(program, `vat_${name}`), first + unit);
  });
}

/** GLSL of vec3 vatPoint(vec2 lookup, float frame) and vatNormal; it comes first in a vertex shader. */
export function glsl(vat) {
  const samplers = Object.keys(vat.textures).map((name) => `uniform usampler2D vat_${name};`);
  const last = vat.frames - 1;
  const head = `precision highp float;
precision highp int;
precision highp usampler2D;
${samplers.join("\n")}
ivec2 vatPlace(vec2 lookup, int layer) {
  return ivec2(lookup * vec2(${vat.width}.0, ${vat.height}.0)) + ivec2(0, layer * ${vat.rows});
}
`;
  const body = vat.kind === "plain" ? plain(vat) : lowRank(vat);
  return `${head}${body}
vec3 vatPoint(vec2 lookup, float frame) { return vatAt_points(lookup, clamp(frame, 0.0, ${last}.0)); }
vec3 vatNormal(vec2 lookup, float frame) { return normalize(vatAt_normals(lookup, clamp(frame, 0.0, ${last}.0))); }
`;
}

function number(value) {
  return Number.isInteger(value) ? `${value}.0` : `${value}`;
}

function vector(values) {
  return `vec3(${values.map(number).join(", ")})`;
}

function plain(vat) {
  const one = (name) => {
    const { offset, scale } = vat.textures[name];
    const largest = vat.images[name].pixels instanceof Uint16Array ? 65535 : 255;
    return `vec3 vatOf_${name}(vec2 lookup, int frame) {
  vec3 texel = vec3(texelFetch(vat_${name}, vatPlace(lookup, frame), 0).rgb) / ${largest}.0;
  return ${vector(offset)} + ${vector(scale)} * texel;
}
vec3 vatAt_${name}(vec2 lookup, float frame) {
  int before = int(frame);
  int after = min(before + 1, ${vat.frames - 1});
  return mix(vatOf_${name}(lookup, before), vatOf_${name}(lookup, after), fract(frame));
}
`;
  };
  return one("points") + one("normals");
}

function lowRank(vat) {
  const { offset, scale } = vat.textures.coefficients;
  const one = (name) => `vec3 vatAt_${name}(vec2 lookup, float frame) {
  int before = int(frame);
  int after = min(before + 1, ${vat.frames - 1});
  int column = int(texelFetch(vat_points, vatPlace(lookup, 0), 0).r) * ${4 * vat.layers};
  vec3 sum = vec3(0.0);
  for (int layer = 0; layer < ${vat.layers}; layer++) {
    vec4 texel = vec4(texelFetch(vat_${name}, vatPlace(lookup, layer + ${name === "points" ? 1 : 0}), 0)) / 65535.0;
    vec4 basis = ${number(vat.textures[name].offset)} + ${number(vat.textures[name].scale)} * texel;
    for (int channel = 0; channel < 4; channel++) {
      vec3 there = mix(vatCoefficient(column, before), vatCoefficient(column, after), fract(frame));
      sum += basis[channel] * there;
      column++;
    }
  }
  return sum;
}
`;
  return `vec3 vatCoefficient(int column, int frame) {
  vec3 coarse = vec3(texelFetch(vat_coefficients, ivec2(column, frame), 0).rgb);
  vec3 fine = vec3(texelFetch(vat_coefficients, ivec2(column, frame + ${vat.frames}), 0).rgb);
  return ${number(offset)} + ${number(scale)} * ((coarse + fine / 65535.0) / 65535.0);
}
${one("points")}${one("normals")}`;
}
