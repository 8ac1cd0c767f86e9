// Charts of a model's signals in an element of a page: time curve, coefficients and, if editable, retiming.
"use strict";

/**
 * Make charts in an element. Times are seconds of the model, points are in diagonals.
 *
 * handlers, all optional:
 *   onDrag({time, to: [x, y], done})    a handle of the time curve is dragged; done when it is released
 *   onSketch([[x, y], ...])             a new curve was drawn
 *   onRetime({keys: [[output, source], ...], done})
 *   onSeek(seconds)                     the current time was changed
 * options: editable (handles, sketching and retiming), dark.
 * Returns {show(signals), at(seconds), pen(on), resize(), remove()}; `signals` are made by mixseq.pictures.charts.chart_data.
 */
var mixseqCharts = function (root, handlers = {}, options = {}) {
  const parts = mixseqChartParts, look = options.dark ? parts.DARK : parts.LIGHT;
  const shared = { signals: null, now: 0, pen: false, seeking: false, editable: !!options.editable };
  let frameRequest = 0;

  parts.initialize(root, look, shared.editable);
  const layout = parts.layoutChart(parts.pane(root, look, "Time curve"), shared, handlers);
  const coefficients = parts.coefficientChart(parts.pane(root, look, "Coefficients"), shared);
  const retiming = shared.editable ? parts.retimingChart(parts.pane(root, look, "Retiming"), shared, handlers) : null;
  const charts = [layout, coefficients, ...(retiming ? [retiming] : [])];

  function draw() {
    cancelAnimationFrame(frameRequest);
    frameRequest = 0;
    arrange();
    charts.forEach((chart) => chart.draw());
  }

  shared.redraw = function () {
    frameRequest ||= requestAnimationFrame(draw);
  };
  shared.seek = function (seconds) {
    setTime(seconds);
    handlers.onSeek?.(seconds);
  };

  /** Function that formats times of a duration with their frame numbers, on exported pages with that of the nearest frame. */
  shared.timeFormatter = (span) => (time) => {
    const number = time * shared.signals.fps;
    return `${parts.seconds(time, span)} \u00b7 ${mixseqFrame(shared.editable ? number : Math.round(number))}`;
  };

  function setTime(seconds) {
    if (seconds === shared.now) return;
    shared.now = seconds;
    shared.redraw();
  }

  function at(seconds) {
    if (shared.seeking || seconds === shared.now) return;  // times from outside lag behind while the user scrubs
    shared.now = seconds;
    draw();  // at once, in the same frame as the mesh
  }

  function show(signals) {
    const first = shared.signals === null;
    shared.signals = signals;
    if (first) shared.now = signals.start;
    charts.forEach((chart) => chart.show(first));
    shared.redraw();
  }

  function pen(on) {
    const now = !!on && shared.editable;
    if (now === shared.pen) return;
    shared.pen = now;
    layout.hint();
    shared.redraw();
  }

  /** Arrange charts side by side if there is space. Called while drawing, as an observer that changes sizes would call itself. */
  function arrange() {
    const { clientWidth, clientHeight } = root;
    root.classList.toggle("wide", clientWidth >= 640 && clientWidth > 1.5 * clientHeight);
  }

  const observer = new ResizeObserver(shared.redraw);
  observer.observe(root);
  root.querySelectorAll("canvas").forEach((canvas) => observer.observe(canvas));

  // For tests: positions in the window, in pixels.
  root.mixseqCharts = {
    handlePixels: layout.handlePixels,
    pathPixels: layout.pathPixels,
    pointPixel: layout.pointPixel,
    bentPixels: layout.bentPixels,
    toPixels: layout.toPixels,
    scale: layout.scale,
    timePixel: coefficients.timePixel,
    keyPixels: () => (retiming ? retiming.keyPixels() : []),
    keys: () => (retiming ? retiming.keys() : []),
    settled: () => frameRequest === 0,
  };

  function remove() {
    observer.disconnect();
    cancelAnimationFrame(frameRequest);
    root.replaceChildren();
    delete root.mixseqCharts;
  }

  arrange();
  return { show, at, pen, resize: shared.redraw, remove };
};
