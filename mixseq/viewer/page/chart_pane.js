// Common parts of all charts: panes with a heading and a canvas, pointer events, and colours.
"use strict";

var mixseqChartParts = {};

(function (parts) {
  const FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif";
  parts.font = "12px " + FONT;

  // Orange is the current time, blue is a drag; red is reserved for joints.
  parts.LIGHT = {
    background: "#ffffff", ink: "#3a3a3a", quiet: "#6d6a65", faint: "#b9b6b0", grid: "#e9e7e3", dotEdge: "#ffffff",
    curve: "#a5a29c", now: "#c2410c", hand: "#1c7ed6", lines: ["#31688e", "#d08c2c", "#4a9d6e", "#8d5fa8", "#8a8a8a"],
  };
  parts.DARK = {
    background: "#1f2023", ink: "#e4e2de", quiet: "#a09d97", faint: "#65625d", grid: "#34353a", dotEdge: "#e4e2de",
    curve: "#85827c", now: "#ff922b", hand: "#4dabf7", lines: ["#6ea8d8", "#e6ab58", "#6cc592", "#bb90d6", "#a9a9a9"],
  };

  const VIRIDIS = ["#440154", "#482878", "#3e4989", "#31688e", "#26828e", "#1f9e89", "#35b779", "#6ece58", "#b5de2b", "#fde725"];
  const STOPS = VIRIDIS.map((hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16)));

  /** Colour of a number from 0 to 1 in viridis (Smith and van der Walt 2015), interpolated between ten of its colours. */
  parts.viridis = function (share) {
    const place = Math.min(Math.max(share, 0), 1) * (STOPS.length - 1);
    const first = Math.min(Math.floor(place), STOPS.length - 2);
    const mixed = STOPS[first].map((low, k) => Math.round(low + (place - first) * (STOPS[first + 1][k] - low)));
    return `rgb(${mixed.join(",")})`;
  };

  /** A number with three digits, in texts about charts. */
  parts.short = (number) => String(Number(number.toPrecision(3)));

  /** Pixels that a pointer may move without a drag. */
  parts.DRAG_THRESHOLD = 3;

  parts.distance = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);

  parts.clamp = (value, low, high) => Math.min(Math.max(value, low), high);

  /** Index of the interval of increasing times that contains a time, the first or last one outside. */
  parts.interval = function (times, time) {
    let low = 0, high = times.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (times[middle] <= time) low = middle; else high = middle;
    }
    return low;
  };

  /** Point of a polyline at a time. */
  parts.pointAt = function (times, points, time) {
    const first = parts.interval(times, time), next = Math.min(first + 1, times.length - 1);
    const share = next > first ? parts.clamp((time - times[first]) / (times[next] - times[first]), 0, 1) : 0;
    return points[first].map((value, k) => value + share * (points[next][k] - value));
  };

  const STYLE = `
.mixseq-charts { box-sizing: border-box; display: grid; gap: 12px 28px; padding: 10px; overflow: auto; height: 100%;
  font: 12px/16px ${FONT}; grid-template-columns: minmax(0, 1fr); grid-template-rows: minmax(200px, 6fr);
  grid-auto-rows: minmax(112px, 3fr); }
.mixseq-charts.wide { grid-template-columns: minmax(0, 5fr) minmax(0, 6fr); grid-template-rows: none; }
.mixseq-charts.wide.editable > section:first-of-type { grid-row: 1 / span 2; }
.mixseq-charts section { display: flex; flex-direction: column; min-height: 0; }
.mixseq-charts header { display: flex; column-gap: 10px; flex: none; max-height: 32px; overflow: hidden; }
.mixseq-charts header:has(span) { flex-wrap: wrap; }
.mixseq-charts header b { font-weight: 600; white-space: nowrap; }
.mixseq-charts header i { font-style: normal; font-size: 11px; margin-left: auto; white-space: nowrap; overflow: hidden;
  text-overflow: ellipsis; font-variant-numeric: tabular-nums; }
.mixseq-charts header span { white-space: nowrap; }
.mixseq-charts header span::before { content: ""; display: inline-block; width: 10px; height: 3px; border-radius: 2px;
  margin-right: 4px; vertical-align: 3px; background: var(--line); }
.mixseq-charts div { position: relative; flex: 1; min-height: 0; }
.mixseq-charts canvas { position: absolute; inset: 0; width: 100%; height: 100%; touch-action: none; outline-offset: -1px; }`;

  function child(parent, name, text) {
    const made = parent.appendChild(document.createElement(name));
    if (text) made.textContent = text;
    return made;
  }

  /** Replace the content of an element by charts. */
  parts.initialize = function (root, look, editable) {
    root.replaceChildren();
    root.classList.add("mixseq-charts");
    root.classList.toggle("editable", editable);
    Object.assign(root.style, { background: look.background, color: look.ink });
    child(root, "style", STYLE);
  };

  /** Make a canvas with a heading. `begin` clears it and returns its context; lengths are CSS pixels. */
  parts.pane = function (root, look, title) {
    const section = child(root, "section"), header = child(section, "header");
    child(header, "b", title);
    const legend = child(header, "span"), hint = child(header, "i");
    legend.remove();
    hint.style.color = look.quiet;
    const canvas = child(child(section, "div"), "canvas");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", title);
    const context = canvas.getContext("2d");
    const pane = { canvas, look, width: 0, height: 0 };

    pane.hint = function (text) {
      if (hint.textContent !== text) hint.textContent = hint.title = text;
    };
    /** Set what screen readers say instead of the chart. */
    pane.describe = (text) => canvas.setAttribute("aria-label", `${title}: ${text}`);
    pane.legend = function (names, colours) {
      header.querySelectorAll("span").forEach((old) => old.remove());
      names.forEach((name, k) => {
        const entry = header.insertBefore(legend.cloneNode(), hint);
        entry.textContent = name;
        entry.style.setProperty("--line", colours[k]);
      });
    };
    pane.begin = function () {
      const ratio = window.devicePixelRatio || 1, box = canvas.getBoundingClientRect();
      pane.width = box.width;
      pane.height = box.height;
      const width = Math.round(box.width * ratio), height = Math.round(box.height * ratio);
      if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
      context.setTransform(ratio, 0, 0, ratio, 0, 0);
      context.clearRect(0, 0, box.width, box.height);
      Object.assign(context, { font: parts.font, lineJoin: "round", lineCap: "round" });
      return context;
    };
    /** Position of a pointer on the canvas. */
    pane.place = function (event) {
      const box = canvas.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    /** Position in the window of a point of the canvas. */
    pane.outside = function ([x, y]) {
      const box = canvas.getBoundingClientRect();
      return [x + box.left, y + box.top];
    };
    /** Distance within which a pointer picks something, larger for touch. */
    pane.reach = (event) => (event.pointerType === "touch" ? 24 : 11);
    return pane;
  };

  /** Handle drags on a pane: `down(place, event)` returns whether a drag starts; hover is called otherwise. */
  parts.follow = function (pane, { down, move, up, hover }) {
    const canvas = pane.canvas;
    let taken = null;
    canvas.addEventListener("pointerdown", (event) => {
      if (taken !== null || event.button !== 0 || !down(pane.place(event), event)) return;
      taken = event.pointerId;
      canvas.setPointerCapture(taken);
      event.preventDefault();
    });
    canvas.addEventListener("pointermove", (event) => {
      if (event.pointerId === taken) move(pane.place(event), event);
      else if (taken === null) hover(pane.place(event), event);
    });
    const end = (event) => {
      if (event.pointerId !== taken) return;
      taken = null;
      up(pane.place(event), event);
    };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
    canvas.addEventListener("pointerleave", (event) => taken === null && hover(null, event));
  };

  /** Index of the point nearest to another within reach, or -1. */
  parts.nearest = function (places, from, reach) {
    let best = -1, least = reach;
    places.forEach((place, k) => {
      const distance = parts.distance(place, from);
      if (distance <= least) [best, least] = [k, distance];
    });
    return best;
  };

  /** Draw text with a halo, readable on lines. */
  parts.drawText = function (context, look, text, x, y, { align = "center", baseline = "middle", colour = look.ink } = {}) {
    Object.assign(context, { textAlign: align, textBaseline: baseline, lineWidth: 4, strokeStyle: look.background, fillStyle: colour });
    context.strokeText(text, x, y);
    context.fillText(text, x, y);
  };

  /** Begin a path through points. */
  parts.trace = function (context, places) {
    context.beginPath();
    for (const [x, y] of places) context.lineTo(x, y);
  };
})(mixseqChartParts);
