// The window of the live page: a notice when the server has ended, and the layout on phones.
"use strict";

var mixseqWindow = (function () {
  const ENDED = "This viewer has ended, or the connection is lost: the page shows the last frame. It continues when the connection returns; " +
    "otherwise start mixseq view again and open the address that it prints.";
  // in narrow windows, viser has a sheet at the bottom instead of docked panels
  const STYLE = `
#mixseq-ended { position: fixed; inset: 0 0 auto; z-index: 1000; padding: 10px 16px; text-align: center;
  font: 14px/20px system-ui, sans-serif; color: #fff; background: rgb(150 20 20 / 94%); }
@media (max-width: 36em) {
  .mixseq-sheet { width: 100% !important; max-height: 45% !important; }
  .mixseq-sheet .mantine-ScrollArea-content > div { width: 100% !important; }
}`;
  const notice = document.createElement("div");
  let sheet = null, viewport = null;

  notice.id = "mixseq-ended";
  notice.setAttribute("role", "alert");
  document.head.append(Object.assign(document.createElement("style"), { textContent: STYLE }));
  document.body.append(notice);
  showEnded(false);

  /** Show or hide the notice that the server has ended. */
  function showEnded(ended) {
    if (notice.hidden === !ended) return;
    notice.hidden = !ended;
    notice.textContent = ended ? ENDED : "";
  }

  /** On phones, end the viewport at the top of the sheet. */
  function arrange() {
    if (!sheet?.isConnected) {
      sheet = [...document.querySelectorAll("#root .mantine-Paper-root")].find(({ style }) => style.position === "fixed" && style.bottom === "0px") ?? null;
      sheet?.classList.add("mixseq-sheet");
      viewport = sheet?.previousElementSibling ?? viewport;
    }
    const height = sheet ? `calc(100% - ${sheet.offsetHeight}px)` : "100%";
    if (viewport && viewport.style.height !== height) viewport.style.height = height;
  }

  return { showEnded, arrange };
})();
