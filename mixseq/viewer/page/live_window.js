// The window of the live page: what it says when its server has ended, and where the panel is on a phone.
"use strict";

var mixseqWindow = (function () {
  const ENDED = "This viewer has ended, or the line to it is lost: what you see is its last picture. If the line comes back, the page goes on by itself; " +
    "otherwise start mixseq view again, and open the address that it prints.";
  // where it is so narrow viser has a sheet at the bottom in place of docks
  const STYLE = `
#mixseq-ended { position: fixed; inset: 0 0 auto; z-index: 1000; padding: 10px 16px; text-align: center;
  font: 14px/20px system-ui, sans-serif; color: #fff; background: rgb(150 20 20 / 94%); }
@media (max-width: 36em) {
  .mixseq-sheet { width: 100% !important; max-height: 45% !important; }
  .mixseq-sheet .mantine-ScrollArea-content > div { width: 100% !important; }
}`;
  const note = document.createElement("div");
  let sheet = null, picture = null;

  note.id = "mixseq-ended";
  note.setAttribute("role", "alert");
  document.head.append(Object.assign(document.createElement("style"), { textContent: STYLE }));
  document.body.append(note);
  say(false);

  /** Say that the server has ended, or no longer. */
  function say(ended) {
    if (note.hidden === !ended) return;
    note.hidden = !ended;
    note.textContent = ended ? ENDED : "";
  }

  /** On a phone the sheet is as wide as the window, and the picture, which is before it, ends where it begins. */
  function arrange() {
    if (!sheet?.isConnected) {
      sheet = [...document.querySelectorAll("#root .mantine-Paper-root")].find(({ style }) => style.position === "fixed" && style.bottom === "0px") ?? null;
      sheet?.classList.add("mixseq-sheet");
      picture = sheet?.previousElementSibling ?? picture;
    }
    const height = sheet ? `calc(100% - ${sheet.offsetHeight}px)` : "100%";
    if (picture && picture.style.height !== height) picture.style.height = height;
  }

  return { say, arrange };
})();
