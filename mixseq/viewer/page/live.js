// What the live page has beside viser: colours of vertices, charts, and messages to Python.
//
// viser has no meshes with a colour at every vertex. Python sends these as the colours of a hidden point cloud
// /paint/k beside every mesh /mesh/k, and here both are made to share one array. Where viser keeps its scene and its
// line to Python, __viserMutable, is not documented: tests/viewer/test_live.py notices if it moves.
"use strict";

window.mixseqLive ??= (function () {
  const self = Math.random().toString(36).slice(2); // several pages may talk to one server
  const seen = new Map(); // of every mesh: which positions and colours were drawn last
  let bridge = "", line = null, said = 0, charts = null;

  function say(message) {
    const value = JSON.stringify({ ...message, from: self, number: ++said });
    window.__viserMutable.sendMessage({ type: "GuiUpdateMessage", uuid: bridge, updates: { value } });
  }

  /** The first object of a node of the scene that has what is asked for. */
  function find(name, wanted) {
    let found = null;
    window.__viserMutable.nodeRefFromName[name]?.traverse((each) => {
      if (!found && wanted(each)) found = each;
    });
    return found;
  }

  /** Give a mesh its colours; returns whether anything about it is new. */
  function paint(name) {
    const mesh = find(name, (each) => each.isMesh && each.geometry?.attributes.position && !each.material.isShadowMaterial);
    const cloud = find(name.replace("/mesh/", "/paint/"), (each) => each.isPoints);
    if (!mesh) return false;
    const { position } = mesh.geometry.attributes, colours = cloud?.geometry.attributes.color;
    if (colours?.count === position.count) {
      if (mesh.geometry.attributes.color !== colours) mesh.geometry.setAttribute("color", colours);
      if (!mesh.material.vertexColors) {
        mesh.material.vertexColors = true;
        mesh.material.needsUpdate = true;
      }
    }
    const before = seen.get(name) ?? {};
    const now = { position, moved: position.version, colours, painted: colours?.version };
    seen.set(name, now);
    return Object.keys(now).some((key) => now[key] !== before[key]);
  }

  /** Keep the charts true to what Python wrote beside them. */
  function chart() {
    const root = document.getElementById("mixseq-charts");
    const signals = document.getElementById("mixseq-signals"), now = document.getElementById("mixseq-now");
    if (!root || !signals || !now) {
      charts = null; // the panel is folded away
      return;
    }
    if (charts?.root !== root) {
      const dark = root.closest("[data-mantine-color-scheme]")?.dataset.mantineColorScheme === "dark";
      const made = mixseqCharts(
        root,
        {
          onDrag: (drag) => say({ kind: "drag", ...drag }),
          onSketch: (points) => say({ kind: "sketch", points }),
          onRetime: (retiming) => say({ kind: "retime", ...retiming }),
          onSeek: (time) => say({ kind: "seek", time }),
        },
        { editable: true, dark }
      );
      charts = { root, made, version: null };
    }
    if (charts.version !== signals.dataset.version) {
      charts.version = signals.dataset.version;
      charts.made.show(JSON.parse(signals.textContent));
    }
    charts.made.pen(now.dataset.pen === "true");
    charts.made.at(Number(now.dataset.time));
  }

  function tick() {
    requestAnimationFrame(tick);
    if (!bridge || !window.__viserMutable?.nodeRefFromName) return;
    mixseqWindow.arrange();
    mixseqWindow.say(window.__viserMutable.sendMessage !== line); // viser puts another one there when its line is cut
    const meshes = Object.keys(window.__viserMutable.nodeRefFromName).filter((name) => /^\/mesh\/\d+$/.test(name));
    if (meshes.map(paint).some(Boolean)) {
      window.__viserMutable.requestRender?.();
      say({ kind: "drawn" });
    }
    chart();
  }
  tick();

  // the browser has a cookie now; the token need not be seen, nor stay among the pages that were visited
  const here = new URL(location.href);
  if (here.searchParams.has("token")) {
    here.searchParams.delete("token");
    history.replaceState(history.state, "", here);
  }

  // Keys that move a slider or are typed should not turn the camera as well, which listens farther out. Other keys of
  // a slider are for viser: P plays.
  for (const kind of ["keydown", "keyup"]) {
    document.getElementById("root").addEventListener(kind, (event) => {
      const slides = event.target.closest?.("[role=slider]") && /^(Arrow|Home|End|Page)/.test(event.key);
      if (slides || event.target.closest?.("input:not([type=checkbox]), textarea")) event.stopPropagation();
    });
  }
  // viser has no keys while a box to tick is in focus
  document.addEventListener("change", (event) => event.target.type === "checkbox" && event.target.blur());

  return {
    /** Talk to the text input of this name; again after every reconnection. */
    connect(to) {
      bridge = to;
      line = window.__viserMutable.sendMessage;
      seen.clear();
    },
  };
})();
