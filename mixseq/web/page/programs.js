// Shader programs: compiled from GLSL, with uniforms by name.
"use strict";

/**
 * Compile programs `{name: [vertex, fragment]}` with the attribute locations of a list. Returns `use(name, values)`, which
 * activates a program and sets its uniforms; values without a uniform are ignored, so that programs can share them.
 */
var mixseqPrograms = function (gl, texts, attributes) {
  const programs = Object.fromEntries(Object.entries(texts).map(([name, each]) => [name, newProgram(...each)]));

  function newProgram(vertex, fragment) {
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) throw new Error(gl.getShaderInfoLog(shader));
    }
    attributes.forEach((name, place) => gl.bindAttribLocation(program, place, name));
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) throw new Error(gl.getProgramInfoLog(program));
    const setters = {};
    for (let k = 0; k < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); k++) {
      const { name, type } = gl.getActiveUniform(program, k), place = gl.getUniformLocation(program, name);
      setters[name] = setter(type, place);
    }
    return { program, setters };
  }

  function setter(type, place) {
    if (type === gl.FLOAT_MAT3) return (value) => gl.uniformMatrix3fv(place, true, value.flat()); // given by rows
    if (type === gl.FLOAT_VEC4) return (value) => gl.uniform4fv(place, value);
    if (type === gl.FLOAT_VEC3) return (value) => gl.uniform3fv(place, value);
    if (type === gl.FLOAT_VEC2) return (value) => gl.uniform2fv(place, value);
    if (type === gl.SAMPLER_2D) return (value) => gl.uniform1i(place, value);
    return (value) => gl.uniform1f(place, value);
  }

  return function use(name, values) {
    const { program, setters } = programs[name];
    gl.useProgram(program);
    for (const key in values) setters[key]?.(values[key]);
  };
};
