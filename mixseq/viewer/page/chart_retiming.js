// The retiming: source time over output time, a curve through keys.
"use strict";

(function (parts) {
  const HINT = "drag a key · double-click adds or removes";
  const MIN_KEY_DISTANCE = 1e-3; // between output times, as a fraction of the source's duration

  /**
   * Monotone cubic interpolation of keys (Fritsch and Carlson 1980), as in the Python class Retiming: weighted harmonic
   * means of slopes inside, three-point formulas at the ends. Returns a function from output time to [source, speed].
   */
  parts.monotone = function (keys) {
    const n = keys.length, steps = [], slopes = [];
    for (let k = 0; k + 1 < n; k++) {
      steps.push(keys[k + 1][0] - keys[k][0]);
      slopes.push((keys[k + 1][1] - keys[k][1]) / steps[k]);
    }
    const end = (h0, h1, d0, d1) => {
      const slope = ((2 * h0 + h1) * d0 - h0 * d1) / (h0 + h1);
      if (Math.sign(slope) !== Math.sign(d0)) return 0;
      return Math.sign(d0) !== Math.sign(d1) && Math.abs(slope) > 3 * Math.abs(d0) ? 3 * d0 : slope;
    };
    const tangents = keys.map((_, k) => {
      if (n === 2) return slopes[0];
      if (k === 0) return end(steps[0], steps[1], slopes[0], slopes[1]);
      if (k === n - 1) return end(steps[n - 2], steps[n - 3], slopes[n - 2], slopes[n - 3]);
      if (slopes[k - 1] * slopes[k] <= 0) return 0;
      const before = 2 * steps[k] + steps[k - 1], after = steps[k] + 2 * steps[k - 1];
      return (before + after) / (before / slopes[k - 1] + after / slopes[k]);
    });
    const outputs = keys.map((key) => key[0]);
    return (time) => {
      const k = parts.interval(outputs, time), h = steps[k], u = (time - outputs[k]) / h;
      const [s0, s1, m0, m1] = [keys[k][1], keys[k + 1][1], h * tangents[k], h * tangents[k + 1]];
      const c = 3 * (s1 - s0) - 2 * m0 - m1, d = 2 * (s0 - s1) + m0 + m1;
      return [s0 + u * (m0 + u * (c + u * d)), (m0 + u * (2 * c + 3 * u * d)) / h];
    };
  };

  parts.retimingChart = function (pane, shared, handlers) {
    const look = pane.look;
    let keys = [], source = [0, 1];  // keys [output, source]; start and end of the source
    let outputs = [0, 1];            // range of the output axis, with space to drag the ends
    let axes = null, drag = null, hovered = -1, reading = null;

    const places = () => keys.map(([output, time]) => [axes.x(output), axes.y(time)]);
    const copy = () => keys.map((key) => key.slice());

    function draw() {
      const context = pane.begin();
      axes = null;
      if (!shared.signals || !pane.width) return;
      if (keys.length < 2) return parts.writeNote(context, pane, "one frame: nothing to retime");
      const span = source[1] - source[0], formatTime = shared.timeFormatter(span), room = 0.06 * span;
      axes = parts.axes(context, pane, outputs, [source[0] - room, source[1] + room], "output (s)", shared.now, formatTime);
      parts.drawText(context, look, "source (s)", axes.left + 5, axes.top, { align: "left", baseline: "top", colour: look.quiet });
      const low = Math.max(source[0], outputs[0]), high = Math.min(source[1], outputs[1]);
      Object.assign(context, { strokeStyle: look.faint, lineWidth: 1 });
      context.setLineDash([3, 4]);
      parts.trace(context, [low, high].map((time) => [axes.x(time), axes.y(time)]));
      context.stroke();
      context.setLineDash([]);

      const curve = parts.monotone(keys), first = axes.x(keys[0][0]), last = axes.x(keys[keys.length - 1][0]);
      const count = Math.max(2, Math.ceil((last - first) / 2));
      const line = Array.from({ length: count + 1 }, (_, k) => {
        const output = keys[0][0] + (k / count) * (keys[keys.length - 1][0] - keys[0][0]);
        return [axes.x(output), axes.y(curve(output)[0])];
      });
      Object.assign(context, { strokeStyle: look.lines[0], lineWidth: 1.8 });
      parts.trace(context, line);
      context.stroke();
      parts.playhead(context, pane, axes, shared.now, formatTime);

      places().forEach(([x, y], k) => {
        const held = drag?.number === k, size = held || k === hovered ? 8 : 6.5;
        parts.trace(context, [[x - size, y], [x, y - size], [x + size, y], [x, y + size]]);
        context.closePath();
        const lit = held || k === hovered;
        Object.assign(context, { fillStyle: held ? look.hand : look.background, strokeStyle: lit ? look.hand : look.ink, lineWidth: lit ? 2.5 : 1.5 });
        context.fill();
        context.stroke();
      });
      const at = drag ? keys[drag.number][0] : reading;
      if (at === null) return pane.hint(HINT);
      const [time, speed] = curve(at);
      if (!drag && hovered < 0) {
        context.fillStyle = look.hand;
        context.beginPath();
        context.arc(axes.x(at), axes.y(time), 3.5, 0, 2 * Math.PI);
        context.fill();
      }
      const rate = speed.toFixed(2).replace("-", "\u2212");
      pane.hint(`output ${formatTime(at)} shows ${formatTime(time)} · speed ${rate}×`);
    }

    /** Set the range of the output axis: the times of keys and source, and space to drag the ends. */
    function fit() {
      const [first, last] = [keys[0][0], keys[keys.length - 1][0]], span = Math.max(last - first, source[1] - source[0]);
      outputs = [Math.min(first, source[0]) - 0.05 * span, Math.max(last, source[1]) + 0.15 * span];
    }

    function put(number, [x, y]) {
      const gap = MIN_KEY_DISTANCE * (source[1] - source[0]);
      const low = number ? keys[number - 1][0] + gap : outputs[0], high = number + 1 < keys.length ? keys[number + 1][0] - gap : outputs[1];
      keys[number] = [parts.clamp(axes.fromX(x), low, high), parts.clamp(axes.fromY(y), ...source)];
    }

    const notify = (done) => handlers.onRetime?.({ keys: copy(), done });

    function remove(number) {
      if (number <= 0 || number >= keys.length - 1) return;
      keys.splice(number, 1);
      hovered = -1;
      notify(true);
      shared.redraw();
    }

    parts.follow(pane, {
      down(place, event) {
        const number = axes ? parts.nearest(places(), place, pane.reach(event)) : -1;
        if (number < 0) return false;
        if (event.altKey) {
          remove(number);
          return false;
        }
        const at = places()[number];
        drag = { number, down: place, grip: [at[0] - place[0], at[1] - place[1]], moved: false };
        pane.canvas.style.cursor = "grabbing";
        shared.redraw();
        return true;
      },
      move(place) {
        if (!drag.moved && parts.distance(place, drag.down) <= parts.DRAG_THRESHOLD) return;
        drag.moved = true;
        put(drag.number, [place[0] + drag.grip[0], place[1] + drag.grip[1]]);
        notify(false);
        shared.redraw();
      },
      up() {
        const moved = drag.moved;
        drag = null;
        pane.canvas.style.cursor = "";
        if (moved) {
          notify(true);
          fit();
        }
        shared.redraw();
      },
      hover(place, event) {
        hovered = place && axes ? parts.nearest(places(), place, pane.reach(event)) : -1;
        const output = place && axes ? axes.fromX(place[0]) : NaN;
        reading = output >= keys[0]?.[0] && output <= keys[keys.length - 1][0] ? output : null;
        if (hovered >= 0) reading = keys[hovered][0];
        pane.canvas.style.cursor = hovered >= 0 ? (event.altKey ? "not-allowed" : "grab") : "";
        shared.redraw();
      },
    });

    pane.canvas.addEventListener("dblclick", (event) => {
      if (!axes) return;
      const place = pane.place(event), number = parts.nearest(places(), place, pane.reach(event));
      if (number >= 0) return remove(number);
      const output = axes.fromX(place[0]), after = keys.findIndex((key) => key[0] > output);
      if (after <= 0) return;  // outside of the output
      keys.splice(after, 0, [output, parts.clamp(parts.monotone(keys)(output)[0], ...source)]);
      notify(true);
      shared.redraw();
    });

    return {
      draw,
      show() {
        if (drag) return;
        const signals = shared.signals;
        keys = signals.keys.map((key) => key.slice());
        source = signals.source ?? [signals.start, signals.end]; // of the model before a retiming
        if (keys.length > 1) fit();
        pane.hint(keys.length > 1 ? HINT : "");
        pane.describe(keys.map(([output, time]) => `output ${parts.short(output)} s shows ${parts.short(time)} s`).join(", "));
      },
      keyPixels: () => (axes ? places().map(pane.outside) : []),
      keys: copy,
    };
  };
})(mixseqChartParts);
