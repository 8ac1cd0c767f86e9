// Unpacks the page: what is in its streams, see mixseq/viewing/packing.py, and then its style, body and scripts.
"use strict";

(async function () {
  const UNFIT = [0, 13, 60], page = document, message = page.getElementById("message");

  window.mixseqFail = (text) => {
    message.textContent = text;
    message.hidden = false;
    message.setAttribute("role", "alert");
    page.documentElement.dataset.state = "failed";
  };

  /** The bytes of a script element: digits of 7 bits. */
  function bytesOf({ textContent: text, dataset }) {
    const bytes = new Uint8Array(+dataset.size);
    let held = 0, bits = 0, filled = 0;
    const take = (digit) => {
      held = ((held << 7) | digit) & 32767;
      bits += 7;
      if (bits > 7) bytes[filled++] = held >> (bits -= 8);
    };
    for (let k = 0; k < text.length; k++) {
      const code = text.charCodeAt(k);
      if (code > 127) take(UNFIT[(code >> 7) - 1]);
      take(code & 127);
    }
    return bytes;
  }

  window.mixseqInflated = (bytes) => new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();

  function add(parent, name, text) {
    parent.append(Object.assign(page.createElement(name), { textContent: text }));
  }

  if (!window.DecompressionStream) {
    return mixseqFail("This browser cannot unpack the page: it has no DecompressionStream. Browsers from 2023 on have it, such as Chrome 80, Firefox 113 and Safari 16.4.");
  }
  try {
    const [code, ...data] = [...page.querySelectorAll("script[data-size]")].map(bytesOf);
    const [style, body, decoder, scripts, description] = new TextDecoder().decode(await mixseqInflated(code)).split("\0");
    window.mixseqPage = { decoder, data, description: JSON.parse(description) };
    add(page.head, "style", style);
    message.insertAdjacentHTML("beforebegin", body);
    add(page.body, "script", scripts);
  } catch (error) {
    mixseqFail(`The page is damaged: ${error.message}. Try to get it again.`);
  }
})();
