// Charts of a model's signals in an element of a page: the layout, coefficients over time and, to edit, the retiming.
"use strict";

/**
 * Make charts in an element. Times are seconds of the model, places are in diagonals.
 *
 * handlers, all optional:
 *   onDrag({time, to: [x, y], done})    a handle of the layout is dragged; done when it is let go
 *   onSketch([[x, y], ...])             a new curve was drawn
 *   onRetime({keys: [[output, source], ...], done})
 *   onSeek(seconds)                     the present time was chosen
 * options: editable (handles, sketching and retiming), dark.
 * Returns {show(signals), at(seconds), pen(on), resize(), remove()}; `signals` is what mixseq.viewer.signals makes.
 */
var mixseqCharts = function (root, handlers = {}, options = {}) {
  const parts = mixseqChartParts, look = options.dark ? parts.DARK : parts.LIGHT;
  const shared = { signals: null, now: 0, pen: false, seeking: false, editable: !!options.editable };
  let asked = 0;

  parts.furnish(root, look, shared.editable);
  const layout = parts.layoutChart(parts.pane(root, look, "Time curve"), shared, handlers);
  const coefficients = parts.coefficientChart(parts.pane(root, look, "Coefficients"), shared);
  const retiming = shared.editable ? parts.retimingChart(parts.pane(root, look, "Retiming"), shared, handlers) : null;
  const charts = [layout, coefficients, ...(retiming ? [retiming] : [])];

  function draw() {
    cancelAnimationFrame(asked);
    asked = 0;
    arrange();
    charts.forEach((chart) => chart.draw());
  }

  shared.redraw = function () {
    asked ||= requestAnimationFrame(draw);
  };
  shared.seek = function (seconds) {
    present(seconds);
    handlers.onSeek?.(seconds);
  };

  /** How times of signals that last `span` seconds are told: with the frame, or on pages, which move on between frames, the nearest. */
  shared.tell = (span) => (time) => {
    const number = time * shared.signals.fps;
    return `${parts.seconds(time, span)} \u00b7 ${mixseqFrame(shared.editable ? number : Math.round(number))}`;
  };

  function present(seconds) {
    if (seconds === shared.now) return;
    shared.now = seconds;
    shared.redraw();
  }

  function at(seconds) {
    if (shared.seeking || seconds === shared.now) return;  // what comes from outside is late while a hand moves the time
    shared.now = seconds;
    draw();  // at once, with the mesh that is drawn in this very frame
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

  /** Beside each other where there is room. Within a frame: an observer that changes sizes would call itself. */
  function arrange() {
    const { clientWidth, clientHeight } = root;
    root.classList.toggle("wide", clientWidth >= 640 && clientWidth > 1.5 * clientHeight);
  }

  const observer = new ResizeObserver(shared.redraw);
  observer.observe(root);
  root.querySelectorAll("canvas").forEach((canvas) => observer.observe(canvas));

  // For tests: where things are in the window of the page, in pixels.
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
    settled: () => asked === 0,
  };

  function remove() {
    observer.disconnect();
    cancelAnimationFrame(asked);
    root.replaceChildren();
    delete root.mixseqCharts;
  }

  arrange();
  return { show, at, pen, resize: shared.redraw, remove };
};
