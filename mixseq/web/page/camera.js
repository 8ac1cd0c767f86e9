// The camera: an orthographic view with orbit, pan and zoom by mouse, touch and keys.
"use strict";

/** Rotation to the screen (right, up, towards the camera) of an orthographic view; as View.rotation in mixseq/pictures/scene.py. Degrees. */
var mixseqRotation = function (azimuth, elevation) {
  const [ca, sa, ce, se] = [azimuth, elevation].map((d) => (d * Math.PI) / 180).flatMap((a) => [Math.cos(a), Math.sin(a)]);
  return [[ca, 0, -sa], [-se * sa, ce, -se * ca], [ce * sa, se, ce * ca]];
};

/**
 * Make a camera that listens to an element. `onChange()` is called when it moves; `centreOf(event)` returns the centre of
 * the panel of an event, in pixels of the window.
 *
 * It has `yaw` and `pitch`, degrees relative to the initial view, `zoom`, and `pan`, in pixels.
 */
var mixseqCamera = function (element, onChange, centreOf) {
  const DEGREES_PER_PIXEL = 0.4, ZOOM_LIMITS = [0.2, 40];
  const initial = { yaw: 0, pitch: 0, zoom: 1, pan: [0, 0] };
  const camera = { ...initial, rotation, reset, orbit, zoomBy };
  const pointers = new Map();
  let minPitch = -90, maxPitch = 90;

  /** Current rotation to the screen of meshes with an initial view. */
  function rotation(azimuth, elevation) {
    [minPitch, maxPitch] = [-90 - elevation, 90 - elevation];
    return mixseqRotation(azimuth + camera.yaw, elevation + camera.pitch);
  }

  function reset() {
    Object.assign(camera, initial);
    onChange();
  }

  function orbit(right, down) {
    camera.yaw = (camera.yaw - right * DEGREES_PER_PIXEL) % 360;
    camera.pitch = Math.min(Math.max(camera.pitch + down * DEGREES_PER_PIXEL, minPitch), maxPitch);
    onChange();
  }

  function pan(right, down) {
    camera.pan = [camera.pan[0] + right, camera.pan[1] + down];
    onChange();
  }

  /** Zoom about a fixed point, in pixels from the centre. */
  function zoomBy(factor, fixed = [0, 0]) {
    const zoom = Math.min(Math.max(camera.zoom * factor, ZOOM_LIMITS[0]), ZOOM_LIMITS[1]), ratio = zoom / camera.zoom;
    camera.pan = camera.pan.map((value, k) => fixed[k] - (fixed[k] - value) * ratio);
    camera.zoom = zoom;
    onChange();
  }

  function offsetOf(event) {
    const [x, y] = centreOf(event);
    return [event.clientX - x, event.clientY - y];
  }

  /** Centre of all pointers, and their mean distance from it. */
  function spread() {
    const all = [...pointers.values()], count = all.length;
    const x = all.reduce((sum, pointer) => sum + pointer[0], 0) / count;
    const y = all.reduce((sum, pointer) => sum + pointer[1], 0) / count;
    return { x, y, size: all.reduce((sum, pointer) => sum + Math.hypot(pointer[0] - x, pointer[1] - y), 0) / count };
  }

  function drag(event) {
    if (!pointers.has(event.pointerId)) return;
    const before = spread();
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    const after = spread(), right = after.x - before.x, down = after.y - before.y;
    if (pointers.size > 1) {
      if (before.size > 0) zoomBy(after.size / before.size, offsetOf({ clientX: after.x, clientY: after.y }));
      pan(right, down);
    } else if (event.shiftKey || event.buttons & 6) pan(right, down);
    else orbit(right, down);
  }

  function wheel(event) {
    event.preventDefault();
    const pixels = event.deltaY * [1, 16, 400][event.deltaMode];
    // trackpads report a pinch as a wheel event with ctrl, in small steps
    zoomBy(Math.exp(-pixels * (event.ctrlKey ? 0.01 : 0.0015)), offsetOf(event));
  }

  element.addEventListener("pointerdown", (event) => {
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    element.setPointerCapture(event.pointerId);
  });
  element.addEventListener("pointermove", drag);
  for (const end of ["pointerup", "pointercancel"]) element.addEventListener(end, (event) => pointers.delete(event.pointerId));
  element.addEventListener("wheel", wheel, { passive: false });
  element.addEventListener("contextmenu", (event) => event.preventDefault());
  element.addEventListener("dblclick", reset);
  return camera;
};
