// The camera: an orthographic view that is turned, moved and zoomed by mouse, fingers and keys.
"use strict";

/** The rotation to the screen (right, up, towards the camera) of an orthographic view, as mixseq/plots/camera.py has it; degrees. */
var mixseqRotation = function (azimuth, elevation) {
  const [ca, sa, ce, se] = [azimuth, elevation].map((d) => (d * Math.PI) / 180).flatMap((a) => [Math.cos(a), Math.sin(a)]);
  return [[ca, 0, -sa], [-se * sa, ce, -se * ca], [ce * sa, se, ce * ca]];
};

/**
 * Make a camera that listens to an element. `changed()` is told when it moved; `middleOf(event)` is the middle of the
 * picture that an event is in, in pixels of the window.
 *
 * It has `yaw` and `pitch`, degrees that are added to where meshes are seen from first, `zoom`, and `pan`, in pixels.
 */
var mixseqCamera = function (element, changed, middleOf) {
  const DEGREES_PER_PIXEL = 0.4, ZOOM = [0.2, 40];
  const start = { yaw: 0, pitch: 0, zoom: 1, pan: [0, 0] };
  const camera = { ...start, rows, reset, turn, zoomBy };
  const fingers = new Map();
  let lowest = -90, highest = 90;

  /** The rotation to the screen for what is first seen from somewhere. */
  function rows(azimuth, elevation) {
    [lowest, highest] = [-90 - elevation, 90 - elevation];
    return mixseqRotation(azimuth + camera.yaw, elevation + camera.pitch);
  }

  function reset() {
    Object.assign(camera, start);
    changed();
  }

  function turn(right, down) {
    camera.yaw = (camera.yaw - right * DEGREES_PER_PIXEL) % 360;
    camera.pitch = Math.min(Math.max(camera.pitch + down * DEGREES_PER_PIXEL, lowest), highest);
    changed();
  }

  function move(right, down) {
    camera.pan = [camera.pan[0] + right, camera.pan[1] + down];
    changed();
  }

  /** Zoom such that a place, in pixels from the middle, stays where it is. */
  function zoomBy(factor, place = [0, 0]) {
    const zoom = Math.min(Math.max(camera.zoom * factor, ZOOM[0]), ZOOM[1]), share = zoom / camera.zoom;
    camera.pan = camera.pan.map((value, k) => place[k] - (place[k] - value) * share);
    camera.zoom = zoom;
    changed();
  }

  function placeOf(event) {
    const [x, y] = middleOf(event);
    return [event.clientX - x, event.clientY - y];
  }

  /** The middle of all fingers, and how far they are from it. */
  function spread() {
    const all = [...fingers.values()], count = all.length;
    const x = all.reduce((sum, finger) => sum + finger[0], 0) / count;
    const y = all.reduce((sum, finger) => sum + finger[1], 0) / count;
    return { x, y, size: all.reduce((sum, finger) => sum + Math.hypot(finger[0] - x, finger[1] - y), 0) / count };
  }

  function drag(event) {
    if (!fingers.has(event.pointerId)) return;
    const before = spread();
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    const after = spread(), right = after.x - before.x, down = after.y - before.y;
    if (fingers.size > 1) {
      if (before.size > 0) zoomBy(after.size / before.size, placeOf({ clientX: after.x, clientY: after.y }));
      move(right, down);
    } else if (event.shiftKey || event.buttons & 6) move(right, down);
    else turn(right, down);
  }

  function wheel(event) {
    event.preventDefault();
    const pixels = event.deltaY * [1, 16, 400][event.deltaMode];
    // a trackpad's pinch comes as a wheel with ctrl, in small steps
    zoomBy(Math.exp(-pixels * (event.ctrlKey ? 0.01 : 0.0015)), placeOf(event));
  }

  element.addEventListener("pointerdown", (event) => {
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    element.setPointerCapture(event.pointerId);
  });
  element.addEventListener("pointermove", drag);
  for (const end of ["pointerup", "pointercancel"]) element.addEventListener(end, (event) => fingers.delete(event.pointerId));
  element.addEventListener("wheel", wheel, { passive: false });
  element.addEventListener("contextmenu", (event) => event.preventDefault());
  element.addEventListener("dblclick", reset);
  return camera;
};
