// Draws meshes with WebGL 2: poses, normals and colours are uploaded when a frame is shown.
"use strict";

/**
 * Make a renderer of a canvas; null without WebGL 2.
 *
 * `meshOf(item)` makes a mesh of {vertices, faces, centre, colourings: [{palette, top}]}, or of one whose positions and normals are on the graphics
 * card: {faces, card: {positions, normals}, paint: RGB of its vertices or null, model: rotation by rows}; `warmUp(look)` draws a point before
 * meshes are loaded; `draw(panels, look, quality)` draws panels, with a fraction of the pixels per side. A panel is {box: [left,
 * top, width, height] in CSS pixels, shown: [{mesh, now, next, share, colouring, tint, moved}], rows: rotation to the screen,
 * target of the camera, scale: pixels per unit, shift: pixels from the centre, ground: height, reach: half the side of the
 * shadow's square, size: of the meshes}. A look is {background, line, shade, ink, wires, grid}; colours are 0 to 1.
 */
var mixseqRenderer = function (canvas) {
  const ATTRIBUTES = ["p0", "p1", "n0", "n1", "c0", "c1", "paint"], IDENTITY = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
  const SHADOW_PIXELS = 256, HEAT_CONTRAST = 0.25;
  const gl = canvas.getContext("webgl2", { antialias: true, alpha: false });
  if (!gl) return null;

  const use = mixseqPrograms(gl, mixseqShaders, ATTRIBUTES);
  const arrays = gl.createVertexArray();
  const shadows = [newPicture(), newPicture()];
  let ratio = 1;

  // Meshes --------------------------------------------------------------------------------------------------------

  function meshOf(item) {
    const mesh = { model: IDENTITY, ...item, slots: item.card ? [] : [newSlot(item), newSlot(item)], edges: null, textures: item.colourings.map(newPalette) };
    if (item.paint) mesh.paint = newBuffer(gl.ARRAY_BUFFER, item.paint);
    mesh.triangles = newBuffer(gl.ELEMENT_ARRAY_BUFFER, item.faces);
    return mesh;
  }

  /** Buffers of one pose. Even poses are in one slot, odd poses in the other. */
  function newSlot({ vertices }) {
    const [places, normals, colours] = [12, 12, 1].map((bytes) => newBuffer(gl.ARRAY_BUFFER, bytes * vertices));
    return { pose: null, shown: null, places, normals, colours };
  }

  function newBuffer(target, dataOrSize) {
    const buffer = gl.createBuffer();
    gl.bindVertexArray(null); // index buffers would be bound to the vertex array
    gl.bindBuffer(target, buffer);
    gl.bufferData(target, dataOrSize, typeof dataOrSize === "number" ? gl.DYNAMIC_DRAW : gl.STATIC_DRAW);
    return buffer;
  }

  /** Texture of a palette; measured palettes are stored with fewer than 256 colours, and interpolated. */
  function newPalette({ palette, top }) {
    const texture = gl.createTexture(), last = palette.length - 1;
    const mixed = (place) => palette[Math.floor(place)].map((value, k) => value + (place % 1) * (palette[Math.ceil(place)][k] - value));
    const entry = (k) => (top ? mixed((k / 255) * last) : palette[Math.min(k, last)]);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, 256, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, Uint8Array.from({ length: 768 }, (_, k) => Math.round(entry(Math.floor(k / 3))[k % 3])));
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
    return texture;
  }

  /** Slot with a pose and its colours, uploaded if needed; the slot of another pose is kept. */
  function slotOf(mesh, pose, other, colouring) {
    const slot = mesh.slots.find((each) => each.pose === pose) ?? mesh.slots.find((each) => each.pose !== other);
    const shown = pose.colours ?? mesh.colourings[colouring].of?.(pose.frame) ?? new Uint8Array(mesh.vertices);
    if (slot.pose !== pose) {
      fill(slot.places, pose.places);
      fill(slot.normals, pose.normals);
    }
    if (slot.shown !== shown) fill(slot.colours, shown);
    return Object.assign(slot, { pose, shown });
  }

  function fill(buffer, data) {
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferSubData(gl.ARRAY_BUFFER, 0, data);
  }

  /** Edges of a mesh as an index buffer, created at first use. */
  function edgesOf(mesh) {
    if (!mesh.edges) {
      const { edges } = mixseqTopology(mesh);
      mesh.edges = { buffer: newBuffer(gl.ELEMENT_ARRAY_BUFFER, edges), count: edges.length };
    }
    return mesh.edges;
  }

  /** Bind the buffers of a mesh for drawing; returns its uniforms. */
  function bindPose({ mesh, now, next, share, colouring, moved }, target) {
    const card = mesh.card && { places: mesh.card.positions, stride: 16, normals: mesh.card.normals, colours: null };
    const slots = card ? [card, card] : [slotOf(mesh, now, next, colouring), slotOf(mesh, next, now, colouring)];
    gl.bindVertexArray(arrays);
    slots.forEach(({ places, stride = 0, normals, colours }, k) => {
      attribute("p" + k, places, 3, gl.FLOAT, stride);
      attribute("n" + k, normals, 3, gl.FLOAT);
      attribute("c" + k, colours, 1, gl.UNSIGNED_BYTE);
    });
    attribute("paint", mesh.paint, 3, gl.FLOAT);
    return { share, model: mesh.model, origin: mesh.centre.map((value, k) => value - target[k] - moved[k]) };
  }

  /** Bind an attribute; without a buffer, all vertices have the colour white, or the first of a palette. */
  function attribute(name, buffer, size, type, stride = 0) {
    const place = ATTRIBUTES.indexOf(name);
    gl.disableVertexAttribArray(place);
    if (!buffer) return size > 1 ? gl.vertexAttrib3f(place, 1, 1, 1) : gl.vertexAttrib1f(place, 0);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, size, type, false, stride, 0);
  }

  function drawElements(kind, buffer, count) {
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffer);
    gl.drawElements(kind, count, gl.UNSIGNED_INT, 0);
  }

  // Shadows -------------------------------------------------------------------------------------------------------

  /** Framebuffer of a shadow, with one channel. */
  function newPicture() {
    const texture = gl.createTexture(), frame = gl.createFramebuffer();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.R8, SHADOW_PIXELS, SHADOW_PIXELS);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.LINEAR);
    for (const wrap of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, wrap, gl.CLAMP_TO_EDGE);
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    return { texture, frame };
  }

  function drawShadow({ shown, target, ground, reach, size }) {
    gl.bindFramebuffer(gl.FRAMEBUFFER, shadows[0].frame);
    gl.viewport(0, 0, SHADOW_PIXELS, SHADOW_PIXELS);
    gl.disable(gl.SCISSOR_TEST);
    gl.disable(gl.DEPTH_TEST);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.enable(gl.BLEND);
    gl.blendEquation(gl.MAX); // the point closest to the ground counts
    for (const item of shown) {
      use("shadow", { ...bindPose(item, target), ground: ground - target[1], reach, size });
      drawElements(gl.TRIANGLES, item.mesh.triangles, item.mesh.faces.length);
    }
    gl.blendEquation(gl.FUNC_ADD);
    gl.disable(gl.BLEND);
    gl.bindVertexArray(null);
    const sigma = (0.019 * size) / (2 * reach);
    [[sigma, 0], [0, sigma]].forEach((along, k) => {
      gl.bindFramebuffer(gl.FRAMEBUFFER, shadows[1 - k].frame);
      gl.bindTexture(gl.TEXTURE_2D, shadows[k].texture);
      use("blur", { picture: 0, sigma: along });
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    });
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }

  // Pictures ------------------------------------------------------------------------------------------------------

  /** Draw a point with all programs: drivers finish compiling them at the first draw. */
  function warmUp(look) {
    const zero = [0, 0, 0], pose = { frame: 0, places: new Float32Array(3), normals: new Float32Array(3), colours: new Uint8Array(1) };
    const mesh = meshOf({ vertices: 1, faces: new Uint32Array(3), centre: zero, colourings: [{ palette: [zero] }] });
    const shown = [{ mesh, now: pose, next: pose, share: 0, colouring: 0, tint: zero, moved: zero }];
    draw([{ box: [0, 0, 1, 1], shown, rows: [[1, 0, 0], [0, 0, -1], [0, 1, 0]], target: zero, scale: 1, shift: zero, ground: 0, reach: 1, size: 1 }], look);
  }

  function draw(panels, look, quality = 1) {
    ratio = quality * Math.min(window.devicePixelRatio || 1, 2);
    const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    gl.disable(gl.SCISSOR_TEST);
    gl.clearColor(...look.background, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    // adjacent panels fade into each other
    panels.forEach((panel) => drawPanel(panel, { ...look, edge: panels.length > 1 ? 60 * ratio : 1e-3 }));
  }

  function drawPanel(panel, look) {
    if (look.grid) drawShadow(panel);
    const [left, top, width, height] = panel.box.map((value) => Math.round(value * ratio));
    const bottom = canvas.height - top - height;
    gl.viewport(left, bottom, width, height);
    gl.scissor(left, bottom, width, height);
    gl.enable(gl.SCISSOR_TEST);
    const screen = {
      turn: panel.rows,
      scale: [(2 * panel.scale) / panel.box[2], (2 * panel.scale) / panel.box[3]],
      shift: [(2 * panel.shift[0]) / panel.box[2], (-2 * panel.shift[1]) / panel.box[3]],
      depth: 0.2 / panel.size, // meshes are within a few times their size
    };
    if (look.grid) drawGround(panel, look, screen, [left, bottom, left + width, bottom + height]);
    gl.enable(gl.DEPTH_TEST);
    for (const item of panel.shown) drawMesh(item, panel, look, screen);
  }

  function drawGround({ shown, target, ground, reach, size, rows }, look, screen, window) {
    const cell = roundLength(size / 6), radius = 1.5 * Math.max(size, reach);
    gl.disable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.bindVertexArray(null);
    gl.bindTexture(gl.TEXTURE_2D, shadows[0].texture);
    use("ground", {
      ...screen, ground: ground - target[1], radius, reach, cell, shadow: 0, line: look.line, shade: look.shade, window, edge: look.edge,
      origin: [0, 2].map((k) => -(target[k] + shown[0].moved[k]) % cell), opacity: Math.min(Math.max(1 + 12 * upward(rows), 0), 1), // no ground from below
    });
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    gl.disable(gl.BLEND);
  }

  function drawMesh(item, { target }, look, screen) {
    const { mesh, colouring } = item, place = bindPose(item, target);
    gl.bindTexture(gl.TEXTURE_2D, mesh.textures[colouring]);
    use("mesh", { ...screen, ...place, palette: 0, tint: item.tint, contrast: mesh.colourings[colouring].top ? HEAT_CONTRAST : 1 });
    if (look.wires) gl.enable(gl.POLYGON_OFFSET_FILL); // draws edges in front of their triangles
    gl.polygonOffset(1, 1);
    drawElements(gl.TRIANGLES, mesh.triangles, mesh.faces.length);
    gl.disable(gl.POLYGON_OFFSET_FILL);
    if (!look.wires) return;
    const edges = edgesOf(mesh);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.bindVertexArray(arrays);
    use("wire", { ...screen, ...place, ink: look.ink });
    drawElements(gl.LINES, edges.buffer, edges.count);
    gl.disable(gl.BLEND);
  }

  /** Sine of the camera's elevation. */
  const upward = (rows) => rows[2][1];

  /** Round a length to 1, 2 or 5 times a power of ten. */
  function roundLength(length) {
    const power = 10 ** Math.floor(Math.log10(length)), first = length / power;
    return power * (first < 1.5 ? 1 : first < 3.5 ? 2 : first < 7.5 ? 5 : 10);
  }

  return { meshOf, warmUp, draw };
};
