// The clock: the current time of playback.
"use strict";

/**
 * Make a clock for items with increasing `times`. Playback starts again after a period; a period of 0 is a still image.
 * `onChange()` is called when the time changes, and when playback starts or stops.
 *
 * It has `moments`, the times of all items, the current `time`, `playing`, `speed`, and whether to `loop` and to
 * interpolate between the moments (`smooth`).
 */
var mixseqClock = function (items, period, onChange) {
  const TIME_TOLERANCE = 1e-6; // seconds, for the rounding of stored times
  const MAX_STEP = 0.25; // seconds: playback continues where it was after the page was suspended
  const all = [...new Set(items.flatMap((item) => item.times))].sort((a, b) => a - b);
  const moments = all.filter((time, k) => !k || time - all[k - 1] > TIME_TOLERANCE), end = moments[moments.length - 1];
  const clock = { moments, time: 0, playing: false, speed: 1, loop: true, smooth: true, number, poseAt, seek, scrub, step, play, advance };

  /** Index of the last of increasing times that is not after a time. */
  function lastBefore(times, time) {
    let low = 0, high = times.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (times[middle] <= time + TIME_TOLERANCE) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  function nearest(times, time) {
    const before = lastBefore(times, time), after = Math.min(before + 1, times.length - 1);
    return times[after] - time < time - times[before] ? after : before;
  }

  /** Index of the moment nearest to the current time. */
  function number() {
    return nearest(moments, clock.time);
  }

  /** Index of an item's pose, and the weight of the next pose; after its end, an item holds its last pose. */
  function poseAt({ times }) {
    if (!clock.smooth) return { pose: nearest(times, clock.time), share: 0 };
    const pose = lastBefore(times, clock.time);
    if (pose === times.length - 1) return { pose, share: 0 };
    const share = (clock.time - times[pose]) / (times[pose + 1] - times[pose]);
    return { pose, share: share > 1e-4 ? share : 0 };
  }

  function seek(time) {
    clock.time = Math.min(Math.max(time, 0), end);
    onChange();
  }

  /** Stop and go to a time, or to the nearest moment without interpolation. */
  function scrub(time) {
    play(false);
    seek(clock.smooth ? time : moments[nearest(moments, time)]);
  }

  function step(by) {
    play(false);
    const to = number() + by, count = moments.length;
    seek(moments[clock.loop ? (to + count) % count : Math.min(Math.max(to, 0), count - 1)]);
  }

  /** Start or stop playback; it stops at a stored moment. */
  function play(on) {
    if (on && !clock.loop && clock.time >= end - TIME_TOLERANCE) clock.time = 0;
    if (!on && clock.playing) clock.time = moments[number()];
    clock.playing = on && period > 0;
    onChange();
  }

  function advance(seconds) {
    clock.time += Math.min(seconds, MAX_STEP) * clock.speed;
    if (clock.time < period) return;
    if (clock.loop) clock.time %= period;
    else {
      clock.time = end;
      play(false);
    }
  }

  return clock;
};
