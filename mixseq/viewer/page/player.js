// The page: opens its meshes, and connects controls, clock and renderer.
"use strict";

(async function () {
  const element = (id) => document.getElementById(id);
  const { decoder, data, description } = mixseqPage;
  const canvas = element("view");
  const SLOW_FRAME = 90; // milliseconds per frame above which the resolution is halved
  const POSES_AHEAD = 8; // poses that are decoded before they are shown
  const STEPS = 4; // poses per frame, between which vertices move along straight lines
  const MAX_DECODING = 0.5; // share of the time of playback in which poses are decoded; beyond, there are fewer
  const darkness = window.matchMedia("(prefers-color-scheme: dark)");

  // Contents of the page ------------------------------------------------------------------------------------------

  function fail(text) {
    element("bar").hidden = element("side").hidden = true;
    mixseqFail(text);
  }

  const look = () => ({ ...mixseqTheme(), wires: state.wires, grid: state.grid });

  const damaged = (error) => fail(`The page is damaged: ${error.message}. Download or export it again.`);

  /** Unpack stored colours, of all poses one after the other or once for all. */
  async function unpackColours(colouring, { vertices, times }, bytes) {
    const rows = new Uint8Array(await mixseqInflated(bytes)), all = rows.length === vertices * times.length;
    for (let k = 0; k < rows.length; k++) {
      const first = k % vertices === 0;
      rows[k] += (first ? 0 : rows[k - 1]) + (k < vertices ? 0 : rows[k - vertices]) - (first || k < vertices ? 0 : rows[k - vertices - 1]);
    }
    colouring.of = (pose) => rows.subarray(all ? pose * vertices : 0).subarray(0, vertices);
  }

  /** Open a mesh: its triangles, times and stored colours. */
  async function openItem(item) {
    const [streams, ...stored] = data.splice(0, 1 + item.colourings.filter((colouring) => colouring.data).length);
    const opened = await source.ask("open", { coding: item.coding, streams });
    Object.assign(item, opened, { times: item.times ?? opened.times, last: null });
    for (const colouring of item.colourings) if (colouring.data) await unpackColours(colouring, item, stored[colouring.data - 1]);
  }

  const items = description.items, source = mixseqPoseSource(decoder, () => opened && redraw(), damaged);
  let opened = false;
  const opening = Promise.all(items.map(openItem)); // while the shaders are compiled
  const state = { wires: false, grid: true, overlaid: description.overlaid && items.length > 1, following: description.following, colour: "" };
  source.want(items.map((_, mesh) => request(mesh, 0)));
  let renderer = mixseqRenderer(canvas);
  if (!renderer) {
    return fail("This browser cannot draw the page: WebGL 2 is missing or disabled. Use another browser, or enable hardware acceleration.");
  }
  renderer.warmUp(look());
  try {
    await opening;
  } catch (error) {
    return damaged(error);
  }
  opened = true;
  let meshes = items.map(renderer.meshOf);

  // State ---------------------------------------------------------------------------------------------------------

  const period = description.period, clock = mixseqClock(items, period, redraw);
  const still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  let panels = [], drawn = 0, isRequested = false, last = null, frameTime = 0;

  const stage = mixseqStage(element("stage"), element("names"), element("legend"));
  const camera = mixseqCamera(canvas, redraw, centreOf);
  const showTransport = mixseqTransport(element("transport"), clock, camera, base, { c: nextColour, "?": () => element("help").showModal() });

  /** Centre of the panel under a pointer, in pixels of the window. */
  function centreOf({ clientX, clientY }) {
    const corner = canvas.getBoundingClientRect(), x = clientX - corner.left, y = clientY - corner.top;
    const inside = ({ box: [left, top, width, height] }) => x >= left && x < left + width && y >= top && y < top + height;
    const [left, top, width, height] = (panels.find(inside) || panels[0]).box;
    return [corner.left + left + width / 2, corner.top + top + height / 2];
  }

  // Drawing -------------------------------------------------------------------------------------------------------

  function redraw() {
    if (!isRequested) requestAnimationFrame(draw);
    isRequested = true;
  }

  function draw(now) {
    isRequested = false;
    if (clock.playing && last !== null) {
      clock.advance((now - last) / 1000);
      frameTime = 0.8 * frameTime + 0.2 * (now - last);
    }
    const shown = items.map(shownOf);
    source.want(upcoming());
    if (shown.every(Boolean)) show(shown);
    last = clock.playing && drawn ? now : null; // playback starts with the first drawn pose
    showTime();
    if (clock.playing && drawn) redraw();
  }

  /** Request for a pose of a mesh, a number of steps from the first frame, with its measured colours if they are shown. */
  function request(mesh, pose) {
    const { name, top, data: stored } = items[mesh].colourings[colouringOf(items[mesh])], times = items[mesh].times ?? [0];
    const before = times[Math.floor(pose / STEPS)], after = times[Math.ceil(pose / STEPS)];
    return { mesh, pose, time: before + ((pose % STEPS) / STEPS) * (after - before), frame: Math.round(pose / STEPS), ...(top && !stored ? { measure: name, top } : {}) };
  }

  /** Current pose of an item, the steps to the next one, and its weight, which jumps half-way between frames at a cut. */
  function poseAt(item) {
    const { pose, share } = clock.poseAt(item), place = STEPS * (pose + share), rate = source.seconds() * item.fps * items.length * clock.speed;
    let steps = 1;
    while (clock.playing && steps < STEPS && (STEPS / steps) * rate > MAX_DECODING) steps *= 2;
    const first = Math.floor(place / steps) * steps;
    const edge = item.cuts.map((frame) => STEPS * (frame - 0.5)).find((each) => each > first && each <= first + steps);
    return { pose: first, steps, share: edge === undefined ? (place - first) / steps : Number(place >= edge) };
  }

  /** Requests for the current poses and the following ones, in order. */
  function upcoming() {
    const ahead = (item, mesh, k) => {
      const { pose, steps } = poseAt(item);
      return request(mesh, (pose + k * steps) % (STEPS * (item.times.length - 1) + steps));
    };
    return Array.from({ length: POSES_AHEAD }, (_, k) => items.map((item, mesh) => ahead(item, mesh, k))).flat();
  }

  /** Two poses of a mesh at the current time and their interpolation weight; the last ones until they are decoded. */
  function shownOf(item, mesh) {
    const { pose, steps, share } = poseAt(item), now = source.find(request(mesh, pose)), next = share > 0 ? source.find(request(mesh, pose + steps)) : now;
    item.ready = Boolean(now && next);
    if (item.ready) item.last = { now, next, share, colouring: colouringOf(item) };
    return item.last;
  }

  function show(shown) {
    const drawable = shown.map((each, k) => ({ ...each, mesh: meshes[k], tint: stage.tint(k, tinted()), moved: movedBy(each, items[k]) }));
    panels = stage.panels(items, camera, state);
    panels.forEach((panel, k) => (panel.shown = state.overlaid ? drawable : [drawable[k]]));
    renderer.draw(panels, look(), quality());
    element("message").hidden = true;
    drawn++;
  }

  /** Distance by which the camera follows a body. */
  function movedBy({ now, next, share }, { centre }) {
    return now.middle.map((value, k) => (state.following && k !== 1 ? value + share * (next.middle[k] - value) + centre[k] : 0));
  }

  /** Half the resolution while playing on slow machines. */
  const quality = () => (clock.playing && frameTime > SLOW_FRAME ? 0.5 : 1);

  const tinted = () => state.overlaid && state.colour === "clay";

  /** Index of the selected colouring of an item, or of its first one if it lacks that. */
  function colouringOf({ colourings }) {
    return Math.max(colourings.findIndex(({ name }) => name === state.colour), 0);
  }

  function showTime() {
    showTransport();
    charts?.at(chosenSignals.start + Math.min(clock.time, chosenSignals.end - chosenSignals.start));
  }

  function arrange() {
    panels = stage.panels(items, camera, state);
    stage.placeNames(items, panels, state.overlaid, tinted());
    redraw();
  }

  // Signals -------------------------------------------------------------------------------------------------------

  const withSignals = items.filter((item) => item.signals);
  let charts = null, chosen = withSignals[0], chosenSignals = chosen?.signals;

  /** The mesh whose times are displayed: the one whose charts are shown, or the first. */
  function base() {
    return chosen ?? items[0];
  }

  function makeCharts() {
    if (!withSignals.length) return;
    charts?.remove();
    charts = mixseqCharts(element("charts"), { onSeek: seekInSignals }, { editable: false, dark: darkness.matches });
    charts.show(chosenSignals);
  }

  function seekInSignals(seconds) {
    clock.play(false);
    clock.seek(seconds - chosenSignals.start);
  }

  function fold(open) {
    element("side").hidden = !open;
    press("fold", open);
    if (open) charts.resize();
  }

  // Controls ------------------------------------------------------------------------------------------------------

  const press = (id, on) => element(id).setAttribute("aria-pressed", `${on}`);

  function toggle(id, of, key) {
    element(id).onclick = () => {
      of[key] = !of[key];
      press(id, of[key]);
      redraw();
    };
  }

  function fillColours() {
    const all = new Map(items.flatMap((item) => item.colourings.map((colouring) => [colouring.name, colouring])));
    const select = element("colour");
    for (const name of all.keys()) select.add(new Option(mixseqCapital(name), name));
    element("colour-choice").hidden = all.size < 2;
    element("legend").dataset.wanted = [...all.keys()].some((name) => name !== "clay");
    select.onchange = () => {
      state.colour = select.value;
      stage.legend(all.get(state.colour));
      arrange();
    };
    select.onchange();
  }

  function nextColour() {
    const select = element("colour");
    select.selectedIndex = (select.selectedIndex + 1) % select.options.length;
    select.onchange();
  }

  function showFacts() {
    element("help-title").textContent = description.title;
    const number = (value) => value.toLocaleString("en");
    const frames = ({ times, start, fps }) => [...new Set([0, times.length - 1])].map((k) => mixseqFrame((start + times[k]) * fps)).join(" to ");
    const facts = items.map((item) => ({ ...item, numbers: frames(item) })).map(({ name, vertices, faces, times, numbers, error, between }) =>
      `${name}: ${number(vertices)} vertices, ${number(faces.length / 3)} triangles, ${number(times.length)} ${times.length > 1 ? "frames" : "frame"} (${numbers}), ` +
      `vertex error at most ${error} units in every frame` + (between === null ? "" : `, ${between} units from the model between frames`));
    facts.push(`Made with mixseq ${description.version}.`);
    element("facts").replaceChildren(...facts.map((text) => Object.assign(document.createElement("p"), { textContent: text })));
  }

  function connect() {
    element("speed").onchange = (event) => (clock.speed = +event.target.value);
    element("layout").value = state.overlaid ? "over" : "side";
    element("layout").onchange = (event) => {
      state.overlaid = event.target.value === "over";
      arrange();
    };
    toggle("loop", clock, "loop");
    toggle("smooth", clock, "smooth");
    toggle("wires", state, "wires");
    toggle("follow", state, "following");
    press("follow", state.following);
    toggle("ground", state, "grid");
    element("reset").onclick = camera.reset;
    element("about").onclick = () => element("help").showModal();
    element("fold").onclick = () => fold(element("side").hidden);
    element("layout-choice").hidden = items.length < 2;
    for (const id of ["transport", "speed-choice", "loop", "smooth", "follow"]) element(id).hidden = !period;
    element("fold").hidden = !withSignals.length;
    element("side-choice").hidden = withSignals.length < 2;
    withSignals.forEach(({ name }, k) => element("side-item").add(new Option(name, k)));
    element("side-item").onchange = (event) => {
      chosen = withSignals[event.target.value];
      chosenSignals = chosen.signals;
      charts.show(chosenSignals);
      redraw();
    };
    darkness.addEventListener("change", () => {
      makeCharts();
      redraw();
    });
    new ResizeObserver(arrange).observe(element("stage"));
    // a lost context, after sleep or by another page, is restored empty
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => {
      renderer = mixseqRenderer(canvas);
      meshes = items.map(renderer.meshOf);
      redraw();
    });
  }

  element("bar").hidden = false;
  connect();
  showFacts();
  fillColours();
  makeCharts();
  if (withSignals.length) fold(window.innerWidth > 860);
  arrange();
  clock.play(!still);

  // For tests: the state of the player.
  window.mixseqPlayer = {
    seek: clock.seek, play: clock.play, items, source,
    state: () => {
      const { time, playing, speed, loop, smooth, moments } = clock, { yaw, pitch, zoom, pan } = camera;
      return { ...state, time, playing, speed, loop, smooth, drawn, period, moments: moments.length, frame: clock.number(), yaw, pitch, zoom, pan };
    },
    /** Wait until everything is decoded and drawn. */
    settled: async () => {
      while (isRequested || !items.every((item) => item.ready)) await new Promise(requestAnimationFrame);
    },
  };
  document.documentElement.dataset.state = "ready";
})();
