// Unpacks the page: its streams (see mixseq/viewer/export_data.py), then its style, body and scripts.
"use strict";

(async function () {
  const page = document, message = page.getElementById("message");

  window.mixseqFail = (text) => {
    message.textContent = text;
    message.hidden = false;
    message.setAttribute("role", "alert");
    page.documentElement.dataset.state = "failed";
  };

  /** Bytes of a script element: two per code unit; after U+0001 the highest bit is flipped. */
  function bytesOf({ textContent: text, dataset }) {
    const bytes = new Uint8Array(+dataset.size);
    for (let k = 0, place = 0; k < text.length; k++, place += 2) {
      const code = text.charCodeAt(k), unit = code === 1 ? text.charCodeAt(++k) ^ 32768 : code;
      bytes[place] = unit & 255;
      bytes[place + 1] = unit >> 8;
    }
    return bytes;
  }

  window.mixseqInflated = (bytes) => new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();

  function add(parent, name, text) {
    parent.append(Object.assign(page.createElement(name), { textContent: text }));
  }

  if (!window.DecompressionStream) {
    return mixseqFail("This browser is too old for the page: it has no DecompressionStream. Use Chrome 80, Firefox 113, Safari 16.4 or later.");
  }
  try {
    const [code, ...data] = [...page.querySelectorAll("script[data-size]")].map(bytesOf);
    const [style, body, decoder, scripts, description] = new TextDecoder().decode(await mixseqInflated(code)).split("\0");
    window.mixseqPage = { decoder, data, description: JSON.parse(description) };
    add(page.head, "style", style);
    message.insertAdjacentHTML("beforebegin", body);
    add(page.body, "script", scripts);
  } catch (error) {
    mixseqFail(`The page is damaged: ${error.message}. Download or export it again.`);
  }
})();
