// Marks around a curve: dots, labels in free places, and scales of length and time.
"use strict";

(function (parts) {
  parts.dot = function (context, [x, y], radius) {
    context.beginPath();
    context.arc(x, y, radius, 0, 2 * Math.PI);
  };

  /** Write a label beside a point, as far as possible from others; returns points that it covers. */
  parts.label = function (context, pane, text, at, avoid) {
    const half = context.measureText(text).width / 2;
    let best = null;
    for (let k = 0; k < 12; k++) {
      const angle = (2 * Math.PI * k) / 12;
      const place = [at[0] + (16 + half) * Math.cos(angle), at[1] - 19 * Math.sin(angle)];
      if (place[0] < half + 2 || place[0] > pane.width - half - 2 || place[1] < 8 || place[1] > pane.height - 30) continue;
      const away = avoid.map((p) => Math.hypot(Math.max(Math.abs(p[0] - place[0]) - half, 0), p[1] - place[1]));
      const room = Math.min(...away, 40);
      if (!best || room > best.room + 1) best = { place, room };
    }
    const place = best ? best.place : at;
    parts.drawText(context, pane.look, text, ...place);
    return [-1, -0.5, 0, 0.5, 1].flatMap((part) => [-8, 8].map((up) => [place[0] + part * half, place[1] + up]));
  };

  /** Draw a scale bar of a round number of diagonals, of `scale` pixels each; returns its right end. */
  parts.scaleBar = function (context, pane, scale) {
    const length = parts.roundBelow(Math.min(90, pane.width / 4) / scale), y = pane.height - 9, left = 1;
    const right = left + length * scale;
    Object.assign(context, { strokeStyle: pane.look.quiet, lineWidth: 1.5 });
    parts.trace(context, [[left, y - 4], [left, y], [right, y], [right, y - 4]]);
    context.stroke();
    const text = `${Number(length.toPrecision(1))} diagonal${length === 1 ? "" : "s"}`;
    parts.drawText(context, pane.look, text, right + 7, y - 2, { align: "left", colour: pane.look.quiet });
    return right + 7 + context.measureText(text).width;
  };

  /** Draw the colour bar of times from start to end, if there is space to the right of `minLeft`. */
  parts.timeBar = function (context, pane, { start, end }, minLeft) {
    const y = pane.height - 14, width = 56, colour = pane.look.quiet;
    if (!(end > start)) return;
    const late = parts.brief(end, end - start), early = parts.brief(start, end - start);
    const right = pane.width - 2 - context.measureText(late).width - 5, left = right - width;
    if (left - context.measureText(early).width - 12 < minLeft) return;
    const fill = context.createLinearGradient(left, 0, right, 0);
    for (let k = 0; k <= 9; k++) fill.addColorStop(k / 9, parts.viridis(k / 9));
    context.fillStyle = fill;
    context.fillRect(left, y, width, 6);
    parts.drawText(context, pane.look, early, left - 5, y + 3, { align: "right", colour });
    parts.drawText(context, pane.look, late, right + 5, y + 3, { align: "left", colour });
  };
})(mixseqChartParts);
