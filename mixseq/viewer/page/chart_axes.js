// Axes with round ticks.
"use strict";

(function (parts) {
  /** Up to `maxCount` round numbers from low to high, and a function that formats them. */
  parts.ticks = function (low, high, maxCount) {
    const ten = 10 ** Math.floor(Math.log10((high - low) / (maxCount + 1)));
    const count = (step) => Math.floor(high / step + 1e-9) - Math.ceil(low / step - 1e-9) + 1;
    const step = [1, 2, 5, 10, 20].map((k) => k * ten).find((size) => count(size) <= maxCount);
    const digits = parts.clamp(-Math.floor(Math.log10(step) + 1e-9), 0, 12), values = [];
    for (let k = Math.ceil(low / step - 1e-9); k <= high / step + 1e-9; k++) values.push(k * step);
    const format = (value) => (Math.abs(value) < step / 2 ? 0 : value).toFixed(digits).replace("-", "\u2212");
    return { values, write: format };
  };

  /** Largest length of 1, 2 or 5 times a power of ten that is not above another. */
  parts.roundBelow = function (length) {
    const ten = 10 ** Math.floor(Math.log10(length) + 1e-9);
    return ten * [5, 2, 1].find((k) => k * ten <= length * (1 + 1e-9));
  };

  /** Format a time, with the digits that a chart of a duration can resolve. */
  parts.seconds = (time, span) => time.toFixed(span > 20 ? 1 : span > 2 ? 2 : 3).replace("-", "\u2212") + " s";

  /** Format a time without trailing zeros, where its width may change. */
  parts.brief = (time, span) => String(Number(time.toFixed(span > 20 ? 1 : span > 2 ? 2 : 3))).replace("-", "\u2212") + " s";

  /**
   * Draw axes in a pane, and return the conversions between values and pixels.
   * `x` and `y` are the ranges [low, high], `label` is that of the x axis. The current time `now` is kept free of ticks;
   * `formatTime` formats it.
   */
  parts.axes = function (context, pane, x, y, label, now, formatTime) {
    const look = pane.look, inner = { top: 7, bottom: pane.height - 20 };
    const up = parts.ticks(y[0], y[1], parts.clamp(Math.floor((inner.bottom - inner.top) / 26), 3, 8));
    const labels = up.values.map(up.write);
    inner.left = Math.ceil(Math.max(...labels.map((label) => context.measureText(label).width), 12)) + 8;
    inner.right = pane.width - 10;
    const width = Math.max(inner.right - inner.left, 1), height = Math.max(inner.bottom - inner.top, 1);
    const axes = {
      ...inner,
      x: (value) => inner.left + (width * (value - x[0])) / (x[1] - x[0]),
      y: (value) => inner.bottom - (height * (value - y[0])) / (y[1] - y[0]),
      fromX: (place) => x[0] + ((x[1] - x[0]) * (place - inner.left)) / width,
      fromY: (place) => y[0] + ((y[1] - y[0]) * (inner.bottom - place)) / height,
    };
    const along = parts.ticks(x[0], x[1], parts.clamp(Math.floor(width / 56), 3, 11));
    const line = (x0, y0, x1, y1) => (context.beginPath(), context.moveTo(x0, y0), context.lineTo(x1, y1), context.stroke());
    Object.assign(context, { lineWidth: 1, strokeStyle: look.grid, fillStyle: look.quiet });
    for (const value of up.values) line(inner.left, axes.y(value), inner.right, axes.y(value));
    for (const value of along.values) line(axes.x(value), inner.top, axes.x(value), inner.bottom);
    Object.assign(context, { textAlign: "right", textBaseline: "middle" });
    up.values.forEach((value, k) => context.fillText(labels[k], inner.left - 6, axes.y(value)));
    const free = inner.right - context.measureText(label).width - 8;
    axes.chip = (time) => {
      const half = context.measureText(formatTime(time)).width / 2 + 5;
      return [parts.clamp(axes.x(time), half + 1, pane.width - half - 1), half];
    };
    const [taken, reach] = axes.chip(now);
    Object.assign(context, { textAlign: "center", textBaseline: "top" });
    for (const value of along.values) {
      const text = along.write(value), half = context.measureText(text).width / 2;
      const clear = Math.abs(axes.x(value) - taken) > half + reach + 2;
      if (clear && axes.x(value) + half <= free) context.fillText(text, axes.x(value), inner.bottom + 5);
    }
    context.textAlign = "right";
    if (taken + reach <= free + 6) context.fillText(label, inner.right, inner.bottom + 5);
    return axes;
  };

  /** Draw the playhead, with its time on the axis. */
  parts.playhead = function (context, pane, axes, time, formatTime) {
    const place = axes.x(time), [middle, half] = axes.chip(time);
    if (place < axes.left - 1 || place > axes.right + 1) return;
    Object.assign(context, { strokeStyle: pane.look.now, lineWidth: 1.5 });
    context.beginPath();
    context.moveTo(place, axes.top);
    context.lineTo(place, axes.bottom);
    context.stroke();
    context.fillStyle = pane.look.now;
    context.beginPath();
    context.roundRect(middle - half, axes.bottom + 2, 2 * half, 17, 4);
    context.fill();
    Object.assign(context, { fillStyle: pane.look.background, textAlign: "center", textBaseline: "middle" });
    context.fillText(formatTime(time), middle, axes.bottom + 11);
  };

  /** Write the reason why a chart is empty. */
  parts.writeNote = function (context, pane, text) {
    parts.drawText(context, pane.look, text, pane.width / 2, pane.height / 2, { colour: pane.look.quiet });
  };
})(mixseqChartParts);
