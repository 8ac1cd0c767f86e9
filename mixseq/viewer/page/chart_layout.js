// The time signal in the plane of its principal directions: the curve, frames as dots, handles, the current time.
"use strict";

(function (parts) {
  const MARGIN = 24; // pixels around the curve, for labels

  /** Rise from 0 at start to 1 at end, as `smoothstep` of mixseq.operations.sculpt. */
  function smoothstep(time, start, end) {
    const x = 3 * parts.clamp((time - start) / (end - start), 0, 1);
    return (x ** 3 - 3 * Math.max(x - 1, 0) ** 3 + 3 * Math.max(x - 2, 0) ** 3) / 6;
  }

  const { distance, dot, DRAG_THRESHOLD } = parts;

  function boundsOf(points) {
    const xs = points.map((p) => p[0]), ys = points.map((p) => p[1]);
    return [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  }

  parts.layoutChart = function (pane, shared, handlers) {
    const look = pane.look;
    let bounds = [-1, 1, -1, 1];  // visible range, in diagonals
    let map = null;               // conversion between diagonals and pixels
    let drag = null;              // {kind: "handle" | "stroke" | "seek", ...} while a pointer is down
    let pending = null;           // last drag, until its result arrives
    let hovered = -1;

    /** The handle that is dragged, or was dropped and has no result yet. */
    const dragged = () => [drag, pending].find((each) => each?.kind === "handle" && each.moved) ?? null;

    /** Handles, the dragged one at the pointer. */
    function handles() {
      const held = dragged(), all = shared.signals.handles;
      if (!held || !all.length) return all;
      const own = all.reduce((a, b) => (Math.abs(b.time - held.time) < Math.abs(a.time - held.time) ? b : a));
      return all.map((handle) => (handle === own ? { time: held.time, at: held.to } : handle));
    }

    /** Fit the visible range to a curve, unless it is visible and large enough. */
    function fit(force) {
      const { path, frames, handles } = shared.signals;
      const [x0, x1, y0, y1] = boundsOf([...path, ...frames, ...handles.map((h) => h.at)]);
      const size = Math.max(x1 - x0, y1 - y0), shown = Math.max(bounds[1] - bounds[0], bounds[3] - bounds[2]);
      const inside = x0 >= bounds[0] && x1 <= bounds[1] && y0 >= bounds[2] && y1 <= bounds[3];
      if (!force && inside && size > 0.7 * shown) return;
      const half = size ? 0 : 0.5;
      bounds = [x0 - half, x1 + half, y0 - half, y1 + half];
    }

    function mapping() {
      const [x0, x1, y0, y1] = bounds, bottom = 22;
      const width = Math.max(pane.width - 2 * MARGIN, 10), height = Math.max(pane.height - bottom - 2 * MARGIN, 10);
      const scale = Math.min(width / (x1 - x0 || 1e-9), height / (y1 - y0 || 1e-9));
      const left = pane.width / 2 - (scale * (x0 + x1)) / 2, base = (pane.height - bottom) / 2 + (scale * (y0 + y1)) / 2;
      return {
        scale,
        to: ([x, y]) => [left + scale * x, base - scale * y],
        from: ([x, y]) => [(x - left) / scale, (base - y) / scale],
      };
    }

    const share = (time) => (time - shared.signals.start) / (shared.signals.end - shared.signals.start || 1);

    /** Preview of a drag: the changed section of the path (mixseq.operations.sketch). */
    function bent({ time, to }) {
      const { times, path, reach } = shared.signals;
      const from = parts.pointAt(times, path, time), change = to.map((value, axis) => value - from[axis]);
      if (Math.hypot(...change) * map.scale < DRAG_THRESHOLD) return [];
      const weight = (at) => smoothstep(at, time - reach, time) * (1 - smoothstep(at, time, time + reach));
      const near = times.map((at, k) => k).filter((k) => Math.abs(times[k] - time) < reach);
      return near.map((k) => map.to(path[k].map((value, axis) => value + weight(times[k]) * change[axis])));
    }

    function draw() {
      const context = pane.begin();
      if (!shared.signals || !pane.width) return;
      const { path, times, frames, frameTimes } = shared.signals;
      map = mapping();
      const places = path.map(map.to), dots = frames.map(map.to), radius = dots.length > 120 ? 2.5 : 3.5;
      parts.timeBar(context, pane, shared.signals, parts.scaleBar(context, pane, map.scale));

      Object.assign(context, { strokeStyle: look.curve, lineWidth: 1.5 });
      parts.trace(context, places);
      context.stroke();
      Object.assign(context, { strokeStyle: look.dotEdge, lineWidth: 0.6 });
      dots.forEach((place, k) => {
        dot(context, place, radius);
        context.fillStyle = parts.viridis(share(frameTimes[k]));
        context.fill();
        context.stroke();
      });

      const first = places[0], last = places[places.length - 1];
      Object.assign(context, { strokeStyle: look.ink, lineWidth: 1.3 });
      dot(context, first, 9.5);
      context.stroke();
      if (times.length > 1) context.strokeRect(last[0] - 8, last[1] - 8, 16, 16);

      const held = dragged();
      if (held) {
        Object.assign(context, { strokeStyle: look.hand, lineWidth: 1.8 });
        parts.trace(context, bent(held));
        context.stroke();
      }
      if (shared.editable) {
        handles().forEach((handle, k) => {
          const isDragged = drag?.kind === "handle" && drag.time === handle.time, lit = isDragged || k === hovered;
          dot(context, map.to(handle.at), lit ? 7 : 5);
          Object.assign(context, { fillStyle: isDragged ? look.hand : look.background, strokeStyle: lit ? look.hand : look.ink, lineWidth: lit ? 2.5 : 1.5 });
          context.fill();
          context.stroke();
        });
      }
      const stroke = drag?.kind === "stroke" ? drag.points : pending?.kind === "stroke" ? pending.points : null;
      if (stroke) {
        Object.assign(context, { strokeStyle: look.hand, lineWidth: 2.5, globalAlpha: drag ? 1 : 0.5 });
        parts.trace(context, stroke.map(map.to));
        context.stroke();
        context.globalAlpha = 1;
      }

      const now = nowPlace();
      dot(context, now, 7);
      Object.assign(context, { fillStyle: look.now, strokeStyle: look.background, lineWidth: 2 });
      context.fill();
      context.stroke();

      const avoid = [...places.filter((_, k) => k % 2 === 0), ...handles().map((h) => map.to(h.at)), now];
      if (times.length > 1 && distance(first, last) < 12) parts.label(context, pane, "start, end", first, avoid);
      else if (times.length > 1) parts.label(context, pane, "end", last, [...avoid, ...parts.label(context, pane, "start", first, avoid)]);
    }

    function nowPlace() {
      const { times, path } = shared.signals;
      return map.to(parts.pointAt(times, path, shared.now));
    }

    /** Time of the point of the path nearest to a pointer, null if it is out of reach. */
    function timeNear(place, reach) {
      const { times, path } = shared.signals;
      let best = null, least = reach;
      for (let k = 0; k + 1 < path.length; k++) {
        const a = map.to(path[k]), b = map.to(path[k + 1]), step = [b[0] - a[0], b[1] - a[1]];
        const along = ((place[0] - a[0]) * step[0] + (place[1] - a[1]) * step[1]) / (step[0] ** 2 + step[1] ** 2 || 1);
        const part = parts.clamp(along, 0, 1), away = distance(place, [a[0] + part * step[0], a[1] + part * step[1]]);
        if (away < least) [best, least] = [times[k] + part * (times[k + 1] - times[k]), away];
      }
      return best;
    }

    const handleAt = (place, event) =>
      shared.editable ? parts.nearest(handles().map((h) => map.to(h.at)), place, pane.reach(event)) : -1;
    const drawing = (event) => shared.editable && (shared.pen || event.shiftKey);

    function cursor(place, event) {
      if (!place || !map) return "";
      if (drawing(event)) return "crosshair";
      if (hovered >= 0) return "grab";
      return timeNear(place, pane.reach(event)) === null ? "" : "pointer";
    }

    parts.follow(pane, {
      down(place, event) {
        if (!map) return false;
        if (drawing(event)) {
          drag = { kind: "stroke", points: [map.from(place)] };
        } else {
          const number = handleAt(place, event);
          const time = number < 0 ? timeNear(place, pane.reach(event)) : handles()[number].time;
          if (time === null) return false;
          if (number < 0) {
            drag = { kind: "seek" };
            shared.seeking = true;
            shared.seek(time);
          } else {
            const at = handles()[number].at, seen = map.to(at);
            drag = { kind: "handle", time, to: at, down: place, grip: [seen[0] - place[0], seen[1] - place[1]], moved: false };
            pane.canvas.style.cursor = "grabbing";
          }
        }
        pending = null;
        shared.redraw();
        return true;
      },
      move(place, event) {
        if (drag.kind === "stroke") {
          for (const each of event.getCoalescedEvents?.() ?? []) extend(pane.place(each));
          extend(place);
        } else if (drag.kind === "seek") {
          const time = timeNear(place, Infinity);
          if (time !== null) shared.seek(time);
        } else if (drag.moved || distance(place, drag.down) > DRAG_THRESHOLD) {
          drag.moved = true;
          drag.to = map.from([place[0] + drag.grip[0], place[1] + drag.grip[1]]);
          handlers.onDrag?.({ time: drag.time, to: drag.to, done: false });
        }
        shared.redraw();
      },
      up() {
        const done = drag;
        drag = null;
        shared.seeking = false;
        pane.canvas.style.cursor = "";
        if (done.kind === "stroke" && lengthOf(done.points) * map.scale > 4 * DRAG_THRESHOLD) {
          pending = done;
          handlers.onSketch?.(done.points);
        } else if (done.kind === "handle" && done.moved) {
          pending = done;
          handlers.onDrag?.({ time: done.time, to: done.to, done: true });
        } else if (done.kind === "handle") {
          shared.seek(done.time);
        }
        shared.redraw();
      },
      hover(place, event) {
        const before = hovered;
        hovered = place && map && !drawing(event) ? handleAt(place, event) : -1;
        pane.canvas.style.cursor = cursor(place, event);
        if (hovered !== before) shared.redraw();
      },
    });

    function extend(place) {
      const points = drag.points, last = map.to(points[points.length - 1]);
      if (distance(last, place) >= 2) points.push(map.from(place));
    }

    function hint() {
      const editing = shared.pen ? "draw a new curve" : "drag a point · shift+drag draws a new curve";
      pane.hint(shared.editable && shared.signals?.handles.length ? editing : "click the curve to go there");
    }

    const lengthOf = (points) => points.slice(1).reduce((sum, p, k) => sum + distance(p, points[k]), 0);

    return {
      draw,
      show(first) {
        pending = null;
        if (drag === null || drag.kind === "seek") fit(first);
        hovered = Math.min(hovered, shared.signals.handles.length - 1);
        hint();
        const { path, frames, start, end } = shared.signals, [x0, x1, y0, y1] = boundsOf(path), short = parts.short;
        pane.describe(`${frames.length} frames from ${short(start)} to ${short(end)} s on a path of ${short(x1 - x0)} by ${short(y1 - y0)} diagonals, ` +
          `whose ends are ${short(distance(path[0], path[path.length - 1]))} apart`);
      },
      hint,
      handlePixels: () => (map && shared.editable ? handles().map((h) => pane.outside(map.to(h.at))) : []),
      pathPixels: () => (map ? shared.signals.path.map((p) => pane.outside(map.to(p))) : []),
      pointPixel: () => (map ? pane.outside(nowPlace()) : null),
      bentPixels: () => (map && dragged() ? bent(dragged()).map(pane.outside) : []),
      scale: () => (map ? map.scale : null),
      toPixels: (point) => pane.outside(map.to(point)),
    };
  };
})(mixseqChartParts);
