// Controls of playback: buttons, slider and keys, the same on all pages.
"use strict";

/**
 * Fill an element with the controls of a clock and its camera, null if it has its own. `base()` returns start and fps of the frame numbers; `keys`
 * are further actions by key. Returns `show()`, which shows the time of the clock.
 */
var mixseqTransport = function (element, clock, camera, base, keys = {}) {
  const button = (id, label, keys, path) => `<button id="${id}" type="button" aria-label="${label}" title="${label} (${keys})"><svg viewBox="0 0 16 16">${path}</svg></button>`;
  element.innerHTML = '<input id="time" type="range" min="0" step="any" value="0" aria-label="Time">' +
    button("back", "Previous frame", "left arrow", '<path d="M12 3v10L5 8zM3.5 3h1.6v10H3.5z"/>') +
    button("play", "Play", "space", '<path class="play" d="M4 2.5v11l9-5.5z"/><path class="pause" d="M3.5 2.5h3v11h-3zM9.5 2.5h3v11h-3z"/>') +
    button("forward", "Next frame", "right arrow", '<path d="M4 3v10l7-5zM10.9 3h1.6v10h-1.6z"/>') +
    '<output id="now" for="time"></output>';
  const [slider, back, play, forward, now] = element.children, last = clock.moments[clock.moments.length - 1];
  const TIME_KEYS = {
    " ": () => clock.play(!clock.playing), ArrowLeft: () => clock.step(-1), ArrowRight: () => clock.step(1),
    Home: () => clock.scrub(0), End: () => clock.scrub(last),
  };
  const VIEW_KEYS = { "+": () => camera.zoomBy(1.2), "=": () => camera.zoomBy(1.2), "-": () => camera.zoomBy(1 / 1.2), 0: () => camera.reset() };
  const ORBIT_STEPS = { ArrowLeft: [-20, 0], ArrowRight: [20, 0], ArrowUp: [0, -20], ArrowDown: [0, 20] };
  const actions = { ...(last > 0 && TIME_KEYS), ...(camera && VIEW_KEYS), ...keys };
  slider.max = last;
  slider.oninput = () => clock.scrub(+slider.value);
  back.onclick = () => clock.step(-1);
  play.onclick = TIME_KEYS[" "];
  forward.onclick = () => clock.step(1);
  window.addEventListener("keydown", (event) => {
    const inside = event.target, typing = inside instanceof HTMLSelectElement || document.querySelector("dialog[open]");
    if (typing || event.ctrlKey || event.altKey || event.metaKey) return;
    if (event.key === " " && inside instanceof HTMLButtonElement) return; // presses the focused button
    const orbits = camera && event.shiftKey && ORBIT_STEPS[event.key], action = orbits ? () => camera.orbit(...orbits) : actions[event.key];
    if (!action) return;
    event.preventDefault();
    action();
  });

  function show() {
    const { start, fps } = base(), frame = (time) => mixseqFrame((start + time) * fps), end = frame(last);
    const number = frame(clock.moments[clock.number()]), seconds = (start + clock.time).toFixed(3);
    slider.value = clock.time;
    slider.setAttribute("aria-valuetext", `frame ${number} of ${end}, ${seconds} seconds`);
    now.textContent = `${number.padStart(end.length, "\u2007")} / ${end} · ${seconds} s`;
    play.classList.toggle("playing", clock.playing);
    play.setAttribute("aria-label", clock.playing ? "Pause" : "Play");
  }

  return show;
};
