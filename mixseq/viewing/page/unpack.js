// From the text of the page to numbers: undoes mixseq/viewing/packing.py.
"use strict";

var mixseqUnpack = (function () {
  const ARRAYS = { 1: Uint8Array, 2: Int16Array, 4: Uint32Array };

  /** Whether this browser can. */
  const possible = () => typeof DecompressionStream === "function";

  /**
   * The numbers of a script element, all rows one after the other; the element is emptied.
   * `read(characters)` is told about the text that was read.
   */
  async function unpack(element, read) {
    const { rows, width, bytes } = element.dataset;
    const table = newTable(+rows, +width, +bytes);
    const lines = element.textContent.trim().split("\n");
    element.textContent = "";
    const reader = bytesOf(lines, read).pipeThrough(new DecompressionStream("deflate")).getReader();
    for (;;) {
      const { done, value } = await reader.read();
      if (done) break;
      table.take(value);
    }
    return table.numbers();
  }

  /** A stream of what base64 in lines stands for, a line at a time. */
  function bytesOf(lines, read) {
    let next = 0;
    return new ReadableStream({
      async pull(controller) {
        if (next === lines.length) return controller.close();
        const line = lines[next];
        lines[next++] = "";
        read(line.length);
        await breath();
        const text = atob(line), bytes = new Uint8Array(text.length);
        for (let k = 0; k < bytes.length; k++) bytes[k] = text.charCodeAt(k);
        controller.enqueue(bytes);
      },
    });
  }

  /** Lets the browser draw. */
  const breath = () => new Promise((resume) => setTimeout(resume));

  /** Rows that become numbers as soon as all their bytes are there. */
  function newTable(rows, width, bytes) {
    const values = new ARRAYS[bytes](rows * width), row = new Uint8Array(width * bytes);
    let filled = 0, done = 0;

    function take(chunk) {
      for (let start = 0; start < chunk.length; ) {
        const length = Math.min(row.length - filled, chunk.length - start);
        row.set(chunk.subarray(start, start + length), filled);
        start += length;
        filled += length;
        if (filled === row.length) {
          addSteps(values, row, done++, width, bytes);
          filled = 0;
        }
      }
    }

    function numbers() {
      if (done !== rows || filled) throw new Error(`${done} of ${rows} rows are there`);
      return values;
    }
    return { take, numbers };
  }

  /** A row of steps, its lowest bytes first, to numbers: sums along the row, added to the row before. */
  function addSteps(values, row, number, width, bytes) {
    const here = number * width, before = here - width;
    let sum = 0;
    for (let k = 0; k < width; k++) {
      let code = row[k];
      for (let byte = 1; byte < bytes; byte++) code |= row[byte * width + k] << (8 * byte);
      sum = (sum + ((code >>> 1) ^ -(code & 1))) | 0; // 0, -1, 1, -2, 2, ... are 0, 1, 2, 3, 4, ...
      values[here + k] = number ? values[before + k] + sum : sum; // wraps, as the type does
    }
  }

  return { possible, unpack };
})();
