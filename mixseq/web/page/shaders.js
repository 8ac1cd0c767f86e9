// Shaders in GLSL. Lighting is that of mixseq/pictures/raster.py, shadows are similar to its shadows.
"use strict";

var mixseqShaders = (function () {
  // Attributes: a pose and the next one; `share` is the weight of the next one.
  const POSE = `#version 300 es
    in vec3 p0, p1;
    uniform float share;
    uniform vec3 origin;  // relative to the camera's target
    uniform mat3 model;
    vec3 place() { return origin + model * mix(p0, p1, share); }`;

  // Orthographic projection: scale, and position of the camera's target on the screen.
  const SCREEN = `
    uniform mat3 turn;
    uniform vec2 scale, shift;
    uniform float depth;
    vec4 screen(vec3 point) {
      vec3 seen = turn * point;
      return vec4(seen.xy * scale + shift, -seen.z * depth, 1.0);
    }`;

  const meshVertex = POSE + SCREEN + `
    in vec3 n0, n1;
    in float c0, c1;
    in vec3 paint;  // colour of the vertex, 1 without
    uniform sampler2D palette;
    uniform vec3 tint;
    centroid out vec3 normal, colour;
    vec3 unitOf(vec3 v) { return v / max(length(v), 1e-6); }
    vec3 entry(float number) { return texelFetch(palette, ivec2(int(number + 0.5), 0), 0).rgb; }
    void main() {
      gl_Position = screen(place());
      normal = turn * (model * mix(unitOf(n0), unitOf(n1), share));
      colour = mix(entry(c0), entry(c1), share) * tint * paint;
    }`;

  const meshFragment = `#version 300 es
    precision highp float;
    centroid in vec3 normal, colour;
    uniform float contrast;
    out vec4 pixel;
    const vec3 KEY = vec3(-0.45, 0.62, 0.64);
    const vec3 COOL = vec3(1.0, 0.6, 0.0);
    void main() {
      vec3 n = normal / max(length(normal), 1e-6);
      if (!gl_FrontFacing) n = -n;  // lit from both sides
      float light = 0.50 + 0.14 * n.y + 0.52 * max(dot(n, KEY), 0.0) + 0.06 * n.z;
      light = 1.0 + contrast * (light - 1.0);
      vec3 shade = 1.0 - 0.10 * contrast * clamp(1.0 - light, 0.0, 1.0) * COOL;
      pixel = vec4(clamp(colour * light * shade, 0.0, 1.0), 1.0);
    }`;

  const wireVertex = POSE + SCREEN + `
    void main() { gl_Position = screen(place()); }`;

  const wireFragment = `#version 300 es
    precision highp float;
    uniform vec4 ink;
    out vec4 pixel;
    void main() { pixel = ink; }`;

  // The shadow is an image of the ground from above, darker where the mesh is closer.
  const shadowVertex = POSE + `
    uniform float ground, reach, size;
    out float dark;
    void main() {
      vec3 point = place();
      gl_Position = vec4(point.x / reach, point.z / reach, 0.0, 1.0);
      dark = 0.4 + exp((ground - point.y) / (0.05 * size));
    }`;

  const shadowFragment = `#version 300 es
    precision highp float;
    in float dark;
    out vec4 pixel;
    void main() { pixel = vec4(dark / 1.4); }`;

  // A square over the whole image, for the two passes that blur the shadow.
  const squareVertex = `#version 300 es
    out vec2 place;
    void main() {
      vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1);
      place = corner;
      gl_Position = vec4(2.0 * corner - 1.0, 0.0, 1.0);
    }`;

  const blurFragment = `#version 300 es
    precision highp float;
    in vec2 place;
    uniform sampler2D picture;
    uniform vec2 sigma;  // in widths of the image, along one axis
    out vec4 pixel;
    void main() {
      float sum = 0.0, weights = 0.0;
      for (int k = -5; k <= 5; k++) {
        float t = 0.5 * float(k), weight = exp(-0.5 * t * t);
        sum += weight * texture(picture, place + t * sigma).r;
        weights += weight;
      }
      pixel = vec4(sum / weights);
    }`;

  // The ground: a grid that fades out, and the shadow.
  const groundVertex = `#version 300 es` + SCREEN + `
    uniform float ground, radius;
    out vec2 place;
    void main() {
      place = radius * (2.0 * vec2(gl_VertexID & 1, gl_VertexID >> 1) - 1.0);
      gl_Position = screen(vec3(place.x, ground, place.y));
    }`;

  const groundFragment = `#version 300 es
    precision highp float;
    in vec2 place;
    uniform sampler2D shadow;
    uniform vec2 origin;  // a crossing of grid lines
    uniform float radius, reach, cell, opacity;
    uniform vec4 line, shade;
    uniform vec4 window;  // left, bottom, right, top of the panel in pixels
    uniform float edge;   // pixels over which the ground fades out at its edge
    out vec4 pixel;
    float lines(float size) {
      vec2 at = (place - origin) / size, width = fwidth(at);
      vec2 distance = abs(fract(at - 0.5) - 0.5) / max(width, 1e-6);
      // lines that are closer than pixels become an even grey
      vec2 cover = mix(clamp(1.0 - distance, 0.0, 1.0), min(width, 1.0), smoothstep(0.3, 0.7, width));
      return max(cover.x, cover.y);
    }
    void main() {
      vec2 inner = min(gl_FragCoord.xy - window.xy, window.zw - gl_FragCoord.xy);
      float fade = (1.0 - smoothstep(0.35, 1.0, length(place) / radius)) * smoothstep(0.0, edge, min(inner.x, inner.y));
      float grid = line.a * fade * lines(cell);
      vec2 inside = 0.5 + 0.5 * place / reach;
      float cover = 1.4 * texture(shadow, inside).r * float(all(lessThan(abs(inside - 0.5), vec2(0.5))));
      float dark = shade.a * (1.0 - exp(-0.9 * cover));
      float alpha = dark + grid * (1.0 - dark);
      vec3 colour = (shade.rgb * dark + line.rgb * grid * (1.0 - dark)) / max(alpha, 1e-6);
      pixel = vec4(colour, alpha * opacity);
    }`;

  return {
    mesh: [meshVertex, meshFragment],
    wire: [wireVertex, wireFragment],
    shadow: [shadowVertex, shadowFragment],
    blur: [squareVertex, blurFragment],
    ground: [groundVertex, groundFragment],
  };
})();

/** Colours of a renderer in the light and the dark scheme of the browser; the background is that of the page. */
var mixseqTheme = function () {
  const LIGHT = { line: [0.45, 0.44, 0.42, 0.38], shade: [0.25, 0.24, 0.28, 0.42], ink: [0.1, 0.1, 0.12, 0.45] };
  const DARK = { line: [0.75, 0.75, 0.78, 0.26], shade: [0, 0, 0, 0.6], ink: [0.05, 0.05, 0.06, 0.5] };
  const background = getComputedStyle(document.body).backgroundColor.match(/[\d.]+/g).slice(0, 3).map((value) => value / 255);
  return { ...(window.matchMedia("(prefers-color-scheme: dark)").matches ? DARK : LIGHT), background };
};
