// The time line at the bottom of the live page: playback, frame numbers, the section between in and out, and their keys.
"use strict";

/**
 * Make a time line that sends messages to Python with `send`. Times are seconds of the mesh whose frame numbers are shown.
 * Returns {element, show(state), state()}, with the state of mixseq.viewer.live.controls.PlayControls.
 */
var mixseqTimeline = function (send) {
  const MARGIN = 18; // pixels beside the first and the last frame
  const LABEL_PIXELS = 44; // least distance of frame numbers
  const PATIENCE = 2000; // milliseconds in which what was asked of Python stays shown, while older frames arrive
  const parts = mixseqChartParts, element = document.createElement("section");
  const icon = (path) => `<svg viewBox="0 0 16 16" aria-hidden="true"><path d="${path}"/></svg>`;
  const button = (name, title, path) => `<button type="button" data-name="${name}" aria-label="${title}" title="${title}">${icon(path)}</button>`;
  const PLAY = "M4 2.5v11l9-5.5z", PAUSE = "M3.5 2.5h3v11h-3zM9.5 2.5h3v11h-3z";
  element.id = "mixseq-timeline";
  element.setAttribute("aria-label", "Time line");
  element.innerHTML = button("back", "Previous frame ([)", "M12 3v10L5 8zM3.5 3h1.6v10H3.5z") + button("play", "Play", PLAY) +
    button("forward", "Next frame (])", "M4 3v10l7-5zM10.9 3h1.6v10h-1.6z") + button("loop", "Loop (L)", "M4 5h6V2.5L14 6l-4 3.5V7H5.5v2.5h-1.5zM12 11H6v2.5L2 10l4-3.5V9h4.5V7.5H12z") +
    '<canvas tabindex="0" role="slider" aria-label="Frame" title="Drag to scrub; drag [ and ] to mark a section"></canvas><output></output>';
  const [back, play, forward, loop, canvas, output] = element.children, context = canvas.getContext("2d");
  const look = document.querySelector("[data-mantine-color-scheme=dark]") ? parts.DARK : parts.LIGHT;
  element.classList.toggle("dark", look === parts.DARK);
  let state = null, held = null, width = 0; // held: "time", "in" or "out" while a pointer is down
  let asked = {}, askedUntil = 0; // time and section that were asked for

  const x = (time) => MARGIN + ((time - state.start) / (state.end - state.start || 1)) * (width - 2 * MARGIN);
  /** Time of the frame that is nearest to a place. */
  const at = (pixel) => snap(state.start + ((pixel - MARGIN) / (width - 2 * MARGIN)) * (state.end - state.start));
  const snap = (time) => parts.clamp(state.start + Math.round((time - state.start) * state.rate) / state.rate, state.start, state.end);
  const number = (time) => mixseqFrame(time * state.fps);

  function draw() {
    if (!state) return;
    const ratio = window.devicePixelRatio || 1, box = canvas.getBoundingClientRect(), height = box.height;
    width = box.width;
    if (!width) return;
    Object.assign(canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    Object.assign(context, { font: parts.font, textAlign: "center", textBaseline: "top", lineWidth: 1 });
    const [first, last] = state.section.map(x), now = x(state.time), line = (place, top, colour) => {
      context.fillStyle = colour;
      context.fillRect(Math.round(place), top, 1, height - top);
    };
    context.fillStyle = look.grid;
    context.fillRect(first, 18, last - first, height - 18);
    const frames = (state.end - state.start) * state.fps, room = (width - 2 * MARGIN) / Math.max(frames, 1);
    const step = [1, 2, 5].flatMap((unit) => [0, 1, 2, 3, 4, 5].map((power) => unit * 10 ** power)).sort((a, b) => a - b).find((each) => each * room >= LABEL_PIXELS) ?? frames;
    const small = step * room >= 10 * LABEL_PIXELS / 2 || room >= 5 ? 1 : Math.max(step / 5, 1);
    for (let k = Math.ceil(state.start * state.fps - 1e-6); k <= state.end * state.fps + 1e-6; k += 1) {
      if (k % small) continue;
      const place = x(k / state.fps);
      line(place, k % step ? height - 5 : height - 10, look.faint);
      context.fillStyle = look.quiet;
      if (k % step === 0 && Math.abs(place - now) > LABEL_PIXELS - 4) context.fillText(`${k}`, place, 3);
    }
    for (const [place, turn] of [[first, 1], [last, -1]]) { // in and out
      context.fillStyle = look.hand;
      context.fillRect(place - 1, 18, 2, height - 18);
      context.fillRect(Math.min(place, place + 7 * turn), 18, 7, 3);
      context.fillRect(Math.min(place, place + 7 * turn), height - 3, 7, 3);
    }
    const text = number(state.time), half = context.measureText(text).width / 2 + 5;
    context.fillStyle = look.now;
    context.fillRect(now - 1, 16, 2, height - 16);
    context.beginPath();
    context.roundRect(parts.clamp(now - half, 0, width - 2 * half), 0, 2 * half, 17, 4);
    context.fill();
    context.fillStyle = look.background;
    context.fillText(text, parts.clamp(now, half, width - half), 3);
  }

  function seek(time) {
    ask({ time: snap(time) });
    send({ kind: "seek", time: state.time });
  }

  /** Set the section to start and end, if it has at least two frames. */
  function mark(start, end) {
    if (end - start < 0.5 / state.rate) return;
    ask({ section: [start, end] });
    send({ kind: "mark", start, end });
  }

  function ask(change) {
    asked = { ...asked, ...change };
    askedUntil = performance.now() + PATIENCE;
    show(state);
  }

  /** Forget what was asked for when it has come, or does not come. */
  function settle({ rate, time, section, playing }) {
    const near = (a, b) => Math.abs(a - b) < 0.4 / rate;
    if (held) return;
    if (performance.now() > askedUntil || playing) asked = {};
    if (asked.time !== undefined && near(asked.time, time)) delete asked.time;
    if (asked.section?.every((end, k) => near(end, section[k]))) delete asked.section;
  }

  const actions = {
    back: () => seek(state.time - 1 / state.rate),
    play: () => send({ kind: "play", on: !state.playing }),
    forward: () => seek(state.time + 1 / state.rate),
    loop: () => send({ kind: "play", loop: !state.loop }),
  };
  const keys = { " ": actions.play, l: actions.loop, i: () => mark(state.time, state.section[1]), o: () => mark(state.section[0], state.time) };
  const own = { ArrowLeft: actions.back, ArrowRight: actions.forward, Home: () => seek(state.start), End: () => seek(state.end) };

  element.addEventListener("click", ({ target }) => actions[target.closest("button")?.dataset.name]?.());
  element.addEventListener("keydown", (event) => {
    if (event.target !== canvas || !own[event.key]) return;
    event.preventDefault();
    event.stopPropagation();
    own[event.key]();
  });
  document.addEventListener("keydown", (event) => {
    const { key, target, ctrlKey, metaKey, altKey } = event, action = keys[key.toLowerCase()];
    if (!state || !action || ctrlKey || metaKey || altKey || target.closest?.("button, input:not([type=checkbox]), textarea, dialog")) return;
    event.preventDefault();
    action();
  });
  function move([place]) {
    const [start, end] = state.section, time = at(place);
    if (held === "time") seek(time);
    else if (held === "in") mark(time, end);
    else mark(start, time);
  }
  parts.follow({ canvas, place: (event) => [event.clientX - canvas.getBoundingClientRect().left] }, {
    down([place], event) {
      const reach = event.pointerType === "touch" ? 16 : 7, [first, last] = state.section.map((time) => Math.abs(x(time) - place));
      const low = event.clientY - canvas.getBoundingClientRect().top > 18; // above are frame numbers, to scrub
      held = low && Math.min(first, last) <= reach ? (first < last ? "in" : "out") : "time";
      if (held === "time") move([place]);
      return true;
    },
    move,
    up: () => (held = null),
    hover: () => {},
  });
  new ResizeObserver(draw).observe(canvas);

  function show(next) {
    if (next !== state) settle(next);
    state = { ...next, ...asked };
    play.querySelector("path").setAttribute("d", state.playing ? PAUSE : PLAY);
    play.setAttribute("aria-label", state.playing ? "Pause" : "Play");
    play.title = `${state.playing ? "Pause" : "Play"} (space)`;
    loop.setAttribute("aria-pressed", `${state.loop}`);
    const text = `${number(state.time)} / ${number(state.end)} · ${state.time.toFixed(3)} s`;
    output.textContent = text;
    for (const [name, value] of [["min", state.start], ["max", state.end], ["now", state.time]]) canvas.setAttribute(`aria-value${name}`, `${+(value * state.fps).toFixed(3)}`);
    canvas.setAttribute("aria-valuetext", `frame ${number(state.time)} of ${number(state.end)}; in ${number(state.section[0])}, out ${number(state.section[1])}`);
    draw();
  }

  return { element, show, state: () => state };
};
