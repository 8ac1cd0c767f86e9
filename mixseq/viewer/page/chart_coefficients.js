// The coordinates of the time signal with the largest movement over time; click or drag to scrub.
"use strict";

(function (parts) {
  parts.coefficientChart = function (pane, shared) {
    const look = pane.look;
    let axes = null;

    function range(coefficients) {
      let low = 0, high = 0;
      for (const { values } of coefficients) for (const value of values) [low, high] = [Math.min(low, value), Math.max(high, value)];
      const room = 0.06 * (high - low) || 1;
      return [low - room, high + room];
    }

    function draw() {
      const context = pane.begin(), signals = shared.signals;
      axes = null;
      if (!signals || !pane.width) return;
      const { start, end, times, coefficients } = signals, formatTime = shared.timeFormatter(end - start);
      if (!coefficients.length) return parts.writeNote(context, pane, "the model has no shape modes");
      const ends = end > start ? [start, end] : [start - 0.5, start + 0.5];
      axes = parts.axes(context, pane, ends, range(coefficients), "time (s)", shared.now, formatTime);
      Object.assign(context, { strokeStyle: look.faint, lineWidth: 1 });
      parts.trace(context, [[axes.left, axes.y(0)], [axes.right, axes.y(0)]]);
      context.stroke();
      context.lineWidth = 1.6;
      coefficients.slice().reverse().forEach(({ values }, back) => {
        const k = coefficients.length - 1 - back;
        context.strokeStyle = context.fillStyle = look.lines[k % look.lines.length];
        parts.trace(context, values.map((value, n) => [axes.x(times[n]), axes.y(value)]));
        context.stroke();
        if (values.length === 1) context.fillRect(axes.x(times[0]) - 3, axes.y(values[0]) - 3, 6, 6);
      });
      parts.playhead(context, pane, axes, shared.now, formatTime);
    }

    const seek = ([x]) => shared.seek(parts.clamp(axes.fromX(x), shared.signals.start, shared.signals.end));

    parts.follow(pane, {
      down(place) {
        if (!axes) return false;
        shared.seeking = true;
        seek(place);
        return true;
      },
      move: (place) => axes && seek(place),
      up: () => (shared.seeking = false),
      hover: (place) => (pane.canvas.style.cursor = place && axes ? "ew-resize" : ""),
    });

    return {
      draw,
      show() {
        const names = shared.signals.coefficients.map((each) => each.name);
        pane.legend(names, look.lines);
        pane.hint(names.length ? "diagonals" : "");
        const ranges = shared.signals.coefficients.map(({ name, values }) => `${name} from ${parts.short(Math.min(...values))} to ${parts.short(Math.max(...values))}`);
        pane.describe(ranges.length ? `${ranges.join(", ")} diagonals` : "the model has no shape modes");
      },
      timePixel: (time) => (axes ? pane.outside([axes.x(time), (axes.top + axes.bottom) / 2]) : null),
    };
  };
})(mixseqChartParts);
