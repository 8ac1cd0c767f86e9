// The window of the live page: a notice when the server has ended, and the layout on phones.
"use strict";

var mixseqWindow = (function () {
  const ENDED = "This viewer has ended, or the connection is lost: the page shows the last frame. It continues when the connection returns; " +
    "otherwise start mixseq view again and open the address that it prints.";
  const KEYS = { "Ctrl Z": "undo", "Ctrl Shift Z": "redo" };
  const POSE_KEYS = { "Enter": "apply a pose", "Esc": "cancel it" };
  const TIME_KEYS = { "Space  P": "play, pause", "[  ]": "frame by frame", "I  O": "in and out: the section that is played and edited", "L": "loop" };
  const MESH_KEYS = { "Shift drag": "turn one mesh by itself" };
  const MARKER_KEYS = { "Y": "accept a proposal", "N": "skip it", "X": "delete the selected pair", "O": "the same point of the other mesh" };
  const FOLDS = "mixseq-folds"; // which sections are open, in the storage of the browser
  // Notices are at the bottom, away from the meshes. In narrow windows, viser has a sheet at the bottom instead of docked panels.
  const STYLE = `
#mixseq-ended { position: fixed; inset: 0 0 auto; z-index: 1000; padding: 10px 16px; text-align: center;
  font: 14px/20px system-ui, sans-serif; color: #fff; background: rgb(150 20 20 / 94%); }
#mixseq-keys { padding: 20px 24px; border: 1px solid #dcd9d3; border-radius: 10px; font: 14px/20px system-ui, sans-serif; color: #3a3a3a; background: #fff; }
#mixseq-keys button { margin-top: 12px; height: 40px; padding: 0 16px; font: inherit; color: inherit; background: none; border: 1px solid #6d6a65; border-radius: 6px; cursor: pointer; }
#mixseq-keys td { padding: 3px 16px 3px 0; }
#mixseq-timeline { position: fixed; inset: auto 0 0; z-index: 11; display: flex; flex-wrap: wrap; gap: 6px; align-items: center; padding: 6px 12px; box-sizing: border-box;
  border-top: 1px solid #dcd9d3; background: #f5f4f1; color: #3a3a3a; font: 14px/20px system-ui, sans-serif; }
#mixseq-timeline.dark { border-color: #3f4046; background: #2a2b2f; color: #e4e2de; }
#mixseq-timeline button { width: 40px; height: 40px; display: grid; place-items: center; border: 1px solid #8884; border-radius: 6px; color: inherit; background: none; cursor: pointer; }
#mixseq-timeline button:hover { border-color: currentColor; }
#mixseq-timeline [aria-pressed=true] { border-color: #31688e; box-shadow: inset 0 -2px 0 #31688e; }
#mixseq-timeline svg { width: 16px; height: 16px; fill: currentColor; }
#mixseq-timeline canvas { flex: 1; min-width: 0; height: 44px; touch-action: none; cursor: ew-resize; }
#mixseq-timeline output { min-width: 10.5em; text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
.mantine-Notifications-root { top: auto !important; bottom: calc(1em + var(--timeline, 0px)) !important; justify-content: end; }
#root .mantine-Text-root label, #root .mantine-Notification-description { color: #5c6066 !important; } /* contrast 4.5; viser's is 3.3 */
:focus-visible { outline: 2px solid #31688e !important; outline-offset: 1px; }
@media (prefers-reduced-motion: reduce) { * { transition-duration: 0s !important; animation-duration: 0s !important; } }
@media (max-width: 36em) {
  .mixseq-sheet { width: 100% !important; max-height: 35% !important; }
  .mixseq-sheet .mantine-ScrollArea-content > div { width: 100% !important; }
  .mixseq-sheet :is(.mantine-Button-root, .mantine-ActionIcon-root, input:not([type=checkbox])) { min-height: 40px !important; }
  .mixseq-sheet input[type=checkbox] { width: 24px; height: 24px; }
  .mixseq-sheet .mantine-Slider-thumb { width: 24px; height: 24px; }
  .mantine-Notifications-root { position: fixed !important; left: 8px !important; width: auto !important; max-width: calc(100% - 16px); }
  #mixseq-timeline canvas { order: -1; flex: 1 0 100%; }
  #mixseq-timeline output { margin-left: auto; }
  #mixseq-charts { height: 560px !important; }
  .mixseq-sheet div:has(> div > .mantine-Tabs-root) { display: flex; flex-direction: column; }
  .mixseq-sheet div:has(> .mantine-Tabs-root) { order: -1; } /* curves first, one tap away */
}`;
  const notice = document.createElement("div"), keys = document.createElement("dialog"), seen = new WeakSet();
  let sheet = null, viewport = null;

  notice.id = "mixseq-ended";
  notice.setAttribute("role", "alert");
  document.head.append(Object.assign(document.createElement("style"), { textContent: STYLE }));
  keys.id = "mixseq-keys";
  keys.setAttribute("aria-label", "Keyboard shortcuts");
  document.body.append(notice, keys);
  showEnded(false);

  /** Show or hide the notice that the server has ended. */
  function showEnded(ended) {
    if (notice.hidden === !ended) return;
    notice.hidden = !ended;
    notice.textContent = ended ? ENDED : "";
  }

  const line = () => document.getElementById("mixseq-timeline");

  /** End the viewport at the top of the time line, and that at the top of the sheet on phones. */
  function arrange() {
    if (!sheet?.isConnected) {
      sheet = [...document.querySelectorAll("#root .mantine-Paper-root")].find(({ style }) => style.position === "fixed" && style.bottom === "0px") ?? null;
      sheet?.classList.add("mixseq-sheet");
    }
    if (!viewport?.isConnected) viewport = window.__viserMutable.canvas?.closest("[style*='background-color'][style*='flex-grow']");
    restoreFolds();
    const below = sheet?.offsetHeight ?? 0, height = `calc(100% - ${below + (line()?.offsetHeight ?? 0)}px)`;
    if (!viewport || viewport.style.height === height) return;
    viewport.style.height = height;
    document.documentElement.style.setProperty("--timeline", `${line()?.offsetHeight ?? 0}px`);
    if (line()) line().style.bottom = `${below}px`;
  }

  /** Sections of panels: folders, and on phones what is docked elsewhere, closed at first. */
  function sections() {
    const folders = [...document.querySelectorAll("#root :is(.tabler-icon-chevron-up, .tabler-icon-chevron-down)")].map((icon) => ({
      icon, head: icon.parentElement, open: icon.classList.contains("tabler-icon-chevron-up"),
    }));
    const docked = [...document.querySelectorAll(".mixseq-sheet .tabler-icon-chevron-right")].map((icon) => ({
      icon, head: icon.parentElement.parentElement, open: icon.style.transform !== "none",
    }));
    return [...folders, ...docked].map((section) => ({ ...section, name: section.head.textContent }));
  }

  /** Fold new sections as they were when the page was open last. */
  function restoreFolds() {
    const kept = JSON.parse(localStorage.getItem(FOLDS) ?? "{}");
    for (const { icon, head, open, name } of sections()) {
      if (seen.has(head)) continue;
      seen.add(head);
      if ((kept[name] ?? open) !== open) head.click();
    }
  }

  /** Name for screen readers what viser leaves without a name. */
  setInterval(() => {
    const name = (element, text) => element?.setAttribute("aria-label", text);
    for (const canvas of document.querySelectorAll("#root canvas:not([aria-label])")) {
      canvas.setAttribute("role", "img");
      name(canvas, "Meshes. Drag to orbit, right-drag to pan, wheel to zoom, ? for keys.");
    }
    for (const [icon, text] of [[".tabler-icon-list-search", "Commands"], [".tabler-icon-adjustments", "Settings of the page"], [".mantine-Notification-closeButton", "Dismiss"]]) {
      document.querySelectorAll(icon).forEach((each) => name(each.closest("button"), text));
    }
    for (const label of document.querySelectorAll("#root label[for]")) {
      if (!document.getElementById(label.htmlFor)) name(label.parentElement.parentElement.parentElement.querySelector("input"), label.textContent);
    }
  }, 1000);

  document.addEventListener("click", ({ isTrusted }) => isTrusted && setTimeout(() => {
    const kept = JSON.parse(localStorage.getItem(FOLDS) ?? "{}");
    localStorage.setItem(FOLDS, JSON.stringify({ ...kept, ...Object.fromEntries(sections().map(({ name, open }) => [name, open])) }));
  }, 300));

  document.addEventListener("keydown", ({ key, target }) => {
    if (key !== "?" || target.closest?.("input:not([type=checkbox]), textarea")) return;
    const is = (id) => document.getElementById(id);
    const shown = {
      ...(line() && TIME_KEYS), ...KEYS, ...(is("mixseq-steps") && POSE_KEYS), ...(window.__viserMutable.nodeRefFromName["/mesh/1"] && MESH_KEYS),
      ...(is("mixseq-hint") && MARKER_KEYS), "?": "this list",
    };
    keys.innerHTML = `<table>${Object.entries(shown).map(([name, what]) => `<tr><td><kbd>${name}</kbd></td><td>${what}</td></tr>`).join("")}</table><form method="dialog"><button>Close</button></form>`;
    keys.showModal();
  });

  return { showEnded, arrange };
})();
