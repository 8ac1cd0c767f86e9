// Extensions of viser's page: vertex colours, charts, and messages to Python.
//
// viser has no meshes with vertex colours. Python sends them as the colours of a hidden point cloud /paint/k for every
// mesh /mesh/k/surface, and this script makes both share one array. The object with viser's scene and connection,
// __viserMutable, is not documented: tests/viewer/test_live.py fails if it changes.
"use strict";

window.mixseqLive ??= (function () {
  const self = Math.random().toString(36).slice(2); // several pages may be connected to one server
  const drawn = new Map(); // positions and colours of each mesh that were drawn last
  let inputId = "", connection = null, messageCount = 0, charts = null, shownState = "";

  function send(message) {
    const value = JSON.stringify({ ...message, from: self, number: ++messageCount });
    window.__viserMutable.sendMessage({ type: "GuiUpdateMessage", uuid: inputId, updates: { value } });
  }

  /** First object of a node of the scene that matches a condition. */
  function find(name, matches) {
    let found = null;
    window.__viserMutable.nodeRefFromName[name]?.traverse((each) => {
      if (!found && matches(each)) found = each;
    });
    return found;
  }

  /** Set the colours of a mesh; returns whether its positions or colours have changed. */
  function updateColours(name) {
    const mesh = find(name, (each) => each.isMesh && each.geometry?.attributes.position && !each.material.isShadowMaterial);
    const cloud = find(name.replace(/mesh(.*)\/surface/, "paint$1"), (each) => each.isPoints);
    if (!mesh) return false;
    const { position } = mesh.geometry.attributes, colours = cloud?.geometry.attributes.color;
    if (colours?.count === position.count) {
      if (mesh.geometry.attributes.color !== colours) mesh.geometry.setAttribute("color", colours);
      if (!mesh.material.vertexColors) {
        mesh.material.vertexColors = true;
        mesh.material.needsUpdate = true;
      }
    }
    const before = drawn.get(name) ?? {};
    const now = { position, moved: position.version, colours, painted: colours?.version };
    drawn.set(name, now);
    return Object.keys(now).some((key) => now[key] !== before[key]);
  }

  /** Update the charts from the elements that Python has written. */
  function updateCharts() {
    const root = document.getElementById("mixseq-charts");
    const signals = document.getElementById("mixseq-signals");
    if (!root || !signals || !timeline.state()) {
      charts = null; // the panel is collapsed
      return;
    }
    if (charts?.root !== root) {
      const dark = root.closest("[data-mantine-color-scheme]")?.dataset.mantineColorScheme === "dark";
      const made = mixseqCharts(
        root,
        {
          onDrag: (drag) => send({ kind: "drag", ...drag }),
          onSketch: (points) => send({ kind: "sketch", points }),
          onRetime: (retiming) => send({ kind: "retime", ...retiming }),
          onSeek: (time) => send({ kind: "seek", time }),
        },
        { editable: true, dark }
      );
      charts = { root, made, version: null };
    }
    if (charts.version !== signals.dataset.version) {
      charts.version = signals.dataset.version;
      const shown = JSON.parse(signals.textContent);
      charts.end = shown.end;
      charts.made.show(shown);
    }
    const { time, pen } = timeline.state();
    charts.made.pen(pen);
    charts.made.at(Math.min(time, charts.end));
  }

  /** Show the state of the playback that Python has written; the time line appears with the first. */
  function updateTimeline() {
    const now = document.getElementById("mixseq-now")?.dataset.state ?? shownState;
    if (now === shownState) return;
    if (!shownState) document.body.append(timeline.element);
    shownState = now;
    timeline.show(JSON.parse(now));
  }

  function tick() {
    requestAnimationFrame(tick);
    if (!inputId || !window.__viserMutable?.nodeRefFromName) return;
    mixseqWindow.arrange();
    mixseqWindow.showEnded(window.__viserMutable.sendMessage !== connection); // viser replaces it when it is disconnected
    const meshes = Object.keys(window.__viserMutable.nodeRefFromName).filter((name) => /^\/mesh\/\d+\/surface$/.test(name));
    if (meshes.map(updateColours).some(Boolean)) {
      window.__viserMutable.requestRender?.();
      send({ kind: "drawn" });
    }
    updateTimeline();
    updateCharts();
  }
  const timeline = mixseqTimeline(send);
  tick();

  // the browser has a cookie now; the token is removed from the address and the history
  const address = new URL(location.href);
  if (address.searchParams.has("token")) {
    address.searchParams.delete("token");
    history.replaceState(history.state, "", address);
  }

  // Keys that move a slider or are typed must not move the camera as well. Other keys are for viser: P plays.
  for (const kind of ["keydown", "keyup"]) {
    document.getElementById("root").addEventListener(kind, (event) => {
      const isSliderKey = event.target.closest?.("[role=slider]") && /^(Arrow|Home|End|Page)/.test(event.key);
      if (isSliderKey || event.target.closest?.("input:not([type=checkbox]), textarea")) event.stopPropagation();
    });
  }
  // a key after a press on the picture is not for the button that was pressed before: viser keeps its focus
  document.addEventListener("pointerdown", ({ target }) => target.tagName === "CANVAS" && document.activeElement?.blur(), true);
  // viser ignores keys while a checkbox has the focus
  document.addEventListener("change", (event) => event.target.type === "checkbox" && event.target.blur());

  return {
    /** Send messages to the text input of an ID; called after every reconnection. */
    connect(id) {
      inputId = id;
      connection = window.__viserMutable.sendMessage;
      drawn.clear();
    },
  };
})();
