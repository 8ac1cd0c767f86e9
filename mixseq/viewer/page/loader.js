// Unpacks the page: what is in its streams, see mixseq/viewer/export_data.py, and then its style, body and scripts.
"use strict";

(async function () {
  const page = document, message = page.getElementById("message");

  window.mixseqFail = (text) => {
    message.textContent = text;
    message.hidden = false;
    message.setAttribute("role", "alert");
    page.documentElement.dataset.state = "failed";
  };

  /** The bytes of a script element: two of a unit; after a 1 its highest bit is another one. */
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
