"""How many frames a second headless Chromium makes of a compressed sequence, at random times.

Of the positions of all vertices: by `Sequence.at` on one processor, and by `player/field_textures.js` on the graphics
card, with normals. Machines without a card calculate that on processors as well, slowly: the renderer is told.
A name with ``*4``, ``*16`` is an animation whose triangles are split into so many each.
"""

from __future__ import annotations

import base64
import shutil
import tempfile
from collections.abc import Iterator
from math import log
from pathlib import Path

import h5py

import mixseq
from mixseq.web import bundled
from scripts.benchmarks.common.harness import animation, subdivided

NAMES = ("horse_gallop", "elephant_gallop", "q_man_run*16")

COLUMNS = ("sequence", "vertices", "fields of a vertex", "frames a second, processor", "card", "renderer")

MAX_ERROR = 1e-3

_ARGUMENTS = ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader"]

_SCRIPT = """
async ([module, text, streams]) => {
  const { open, fieldTextures } = await import(URL.createObjectURL(new Blob([module], { type: "text/javascript" })));
  const sequence = await open(text, Uint8Array.from(atob(streams), (letter) => letter.charCodeAt(0)));
  const gl = document.createElement("canvas").getContext("webgl2"), { times, vertexCount } = sequence;
  const { parts } = sequence.fields(), card = fieldTextures(gl, sequence.fields(), sequence.triangles());
  const out = new Float32Array(3 * vertexCount), last = times[times.length - 1], read = new Float32Array(4);
  const work = {
    processor: (time) => sequence.at(time, out),
    card: (time) => {
      card.evaluate(sequence.weights(time), sequence.residuals(time));
      gl.bindBuffer(gl.ARRAY_BUFFER, card.normals);
      gl.getBufferSubData(gl.ARRAY_BUFFER, 0, read); // waits until it is done
    },
  };
  const found = {};
  for (const [name, each] of Object.entries(work)) {
    const taken = [];
    for (let k = 0; k < 60; k++) {
      const time = times[0] + (last - times[0]) * ((k * 0.618034) % 1), begin = performance.now();
      each(time);
      taken.push(performance.now() - begin);
    }
    found[name] = 1000 / taken.slice(20).sort((a, b) => a - b)[20];
  }
  const size = parts.reduce((sum, { values }) => sum + values.length, 0);
  const told = gl.getExtension("WEBGL_debug_renderer_info"), name = told ? told.UNMASKED_RENDERER_WEBGL : gl.RENDERER;
  return { ...found, fields: size / vertexCount, renderer: gl.getParameter(name) };
}
"""


def rows(name: str) -> Iterator[tuple[str, ...]]:
    """Measure an animation, compressed with a bound."""
    sequence = _split(name)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "coded.h5")
        mixseq.save(path, mixseq.compress(sequence, max_error=MAX_ERROR))
        with h5py.File(path) as file:
            text, streams = bytes(file.attrs["coding"]).decode(), file["streams"][...].tobytes()
    told = _in_chromium(text, streams)
    yield (
        name,
        f"{sequence.vertex_count:,}".replace(",", " "),
        f"{told['fields']:.1f}",
        f"{told['processor']:.0f}",
        f"{told['card']:.0f}",
        str(told["renderer"]),
    )


def _split(name: str) -> mixseq.MeshSequence:
    name, _, times = name.partition("*")
    sequence = animation(name)
    for _ in range(round(log(int(times or 1), 4))):
        points, faces = subdivided(sequence)
        sequence = mixseq.MeshSequence.from_arrays(points, faces, sequence.times)
    return sequence


def _in_chromium(text: str, streams: bytes) -> dict[str, float | str]:
    from playwright.sync_api import sync_playwright

    executable = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=_ARGUMENTS)
        page = browser.new_page()
        given = [bundled("decoder/sequence.js", "player/field_textures.js"), text, base64.b64encode(streams).decode()]
        told: dict[str, float | str] = page.evaluate(_SCRIPT, given)
        browser.close()
    return told
