// The clock: which moment is shown, and how it goes on.
"use strict";

/**
 * Make a clock of items with increasing `times`, which starts again after a period; a period of 0 stands still.
 * `changed()` is told when another moment is shown, or when it starts or stops.
 *
 * It has `moments`, the times of all items, the present `time`, `playing`, `speed`, and whether to `loop` and to move
 * smoothly between the moments.
 */
var mixseqClock = function (items, period, changed) {
  const TOLERANCE = 1e-6; // seconds: the times of items are rounded
  const LONGEST = 0.25; // seconds: after a pause of the whole page it goes on where it was
  const all = [...new Set(items.flatMap((item) => item.times))].sort((a, b) => a - b);
  const moments = all.filter((time, k) => !k || time - all[k - 1] > TOLERANCE), end = moments[moments.length - 1];
  const clock = { moments, time: 0, playing: false, speed: 1, loop: true, smooth: true, number, poseAt, seek, scrub, step, play, advance };

  /** The last of increasing times that is not after another. */
  function lastBefore(times, time) {
    let low = 0, high = times.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (times[middle] <= time + TOLERANCE) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  function nearest(times, time) {
    const before = lastBefore(times, time), after = Math.min(before + 1, times.length - 1);
    return times[after] - time < time - times[before] ? after : before;
  }

  /** The number of the moment that is nearest to the present. */
  function number() {
    return nearest(moments, clock.time);
  }

  /** The pose of an item that is shown, and how far it is on its way to the next one; after its end it waits. */
  function poseAt({ times }) {
    if (!clock.smooth) return { pose: nearest(times, clock.time), share: 0 };
    const pose = lastBefore(times, clock.time);
    if (pose === times.length - 1) return { pose, share: 0 };
    const share = (clock.time - times[pose]) / (times[pose + 1] - times[pose]);
    return { pose, share: share > 1e-4 ? share : 0 };
  }

  function seek(time) {
    clock.time = Math.min(Math.max(time, 0), end);
    changed();
  }

  /** Go to a time, or to the moment nearest to it where there is nothing between. */
  function scrub(time) {
    play(false);
    seek(clock.smooth ? time : moments[nearest(moments, time)]);
  }

  function step(by) {
    play(false);
    const to = number() + by, count = moments.length;
    seek(moments[clock.loop ? (to + count) % count : Math.min(Math.max(to, 0), count - 1)]);
  }

  /** Start or stop; it stops at a moment that is stored. */
  function play(on) {
    if (on && !clock.loop && clock.time >= end - TOLERANCE) clock.time = 0;
    if (!on && clock.playing) clock.time = moments[number()];
    clock.playing = on && period > 0;
    changed();
  }

  function advance(seconds) {
    clock.time += Math.min(seconds, LONGEST) * clock.speed;
    if (clock.time < period) return;
    if (clock.loop) clock.time %= period;
    else {
      clock.time = end;
      play(false);
    }
  }

  return clock;
};
