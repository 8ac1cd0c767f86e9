"""Shaders, run by a browser: that of browsers, and those of engines with what engines put around them."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from mixseq.sequence.sequence import MeshSequence, bounding_diagonal
from mixseq_io.vat.textures import Texels
from mixseq_io.vat.writer import VatReport
from tests.formats.vat.shader import told
from tests.formats.vat.test_images import unpacked
from tests.viewer.conftest import browser, new_page, page

if TYPE_CHECKING:
    from playwright.sync_api import Page, Route

pytestmark = pytest.mark.slow

__all__ = ["browser", "new_page", "page"]

NEARLY = 1e-4
FRAMES = [*range(7), 7 - NEARLY, 3.5, 6.25]  # at the last one shaders begin again

FEEDBACK = """
const floats = (text) => new Float32Array(Uint8Array.from(atob(text), (each) => each.charCodeAt(0)).buffer);
const packed = (values) =>
  btoa(Array.from(new Uint8Array(values.buffer), (byte) => String.fromCharCode(byte)).join(""));

const link = (gl, vertexShader, outputs) => {
  const program = gl.createProgram();
  for (const [kind, text] of [
    [gl.VERTEX_SHADER, vertexShader],
    [gl.FRAGMENT_SHADER, "#version 300 es\\nvoid main() {}"],
  ]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  }
  gl.transformFeedbackVaryings(program, outputs, gl.SEPARATE_ATTRIBS);
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  gl.useProgram(program);
  return program;
};

const draw = (gl, program, input, lookup, outputs, times, setTime) => {
  const buffer = (data, use) => {
    const made = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, made);
    gl.bufferData(gl.ARRAY_BUFFER, data, use);
    return made;
  };
  buffer(lookup, gl.STATIC_DRAW);
  const place = gl.getAttribLocation(program, input);
  gl.enableVertexAttribArray(place);
  gl.vertexAttribPointer(place, 2, gl.FLOAT, false, 0, 0);
  const count = lookup.length / 2;
  const out = outputs.map(() => buffer(12 * count, gl.STREAM_READ));
  gl.bindBuffer(gl.ARRAY_BUFFER, null);
  gl.enable(gl.RASTERIZER_DISCARD);
  return times.map((time) => {
    setTime(time);
    out.forEach((each, index) => gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER, index, each));
    gl.beginTransformFeedback(gl.POINTS);
    gl.drawArrays(gl.POINTS, 0, count);
    gl.endTransformFeedback();
    return out.map((each) => {
      const values = new Float32Array(3 * count);
      gl.bindBuffer(gl.TRANSFORM_FEEDBACK_BUFFER, each);
      gl.getBufferSubData(gl.TRANSFORM_FEEDBACK_BUFFER, 0, values);
      return packed(values);
    });
  });
};
"""
"""JavaScript that runs a vertex shader, and returns its outputs at times; arrays are packed as base64."""

TRANSFORMED = f"""async ({{ shader, input, outputs, images, lookup, seconds }}) => {{
  {FEEDBACK}
  const gl = document.createElement("canvas").getContext("webgl2");
  const program = link(gl, shader, outputs);
  images.forEach(({{ sampler, width, height, pixels }}, unit) => {{
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, width, height, 0, gl.RGBA, gl.FLOAT, floats(pixels));
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    gl.uniform1i(gl.getUniformLocation(program, sampler), unit);
  }});
  const found = draw(gl, program, input, floats(lookup), outputs, seconds, (now) => {{
    gl.uniform4f(gl.getUniformLocation(program, "Clock"), now, 0, 0, 0);
  }});
  return {{ found, error: gl.getError() }};
}}"""
"""Points and normals of a vertex shader, at seconds."""


def packed(values: NDArray[np.floating]) -> str:
    """Pack an array as float32 for a page."""
    return base64.b64encode(values.astype("<f4").tobytes()).decode()


def floats(text: str) -> NDArray[np.float32]:
    """Unpack vectors ``(n, 3)`` from a page."""
    return np.frombuffer(base64.b64decode(text), "<f4").reshape(-1, 3)


class Engine(NamedTuple):
    """How an engine differs from glTF, and what it puts around a shader.

    Attributes
    ----------
    shader : callable
        GLSL of WebGL2, from the text of the file.
    mirror : callable
        Its points, from those of glTF.
    scale : float
        Their units in one of glTF.
    turned : bool
        Whether its importer turns pictures and v upside down.
    """

    shader: Callable[[str], str]
    mirror: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    scale: float = 1.0
    turned: bool = False


def godot(text: str) -> str:
    """Godot's language is GLSL with other names, values of uniforms and hints."""
    text = re.sub(r"shader_type.*;", "", text)
    text = re.sub(r"uniform sampler2D (\w+) *:[^;]*;", r"uniform highp sampler2D \1;", text)
    text = re.sub(r"uniform float (\w+) = ([^;]*);", r"const float \1 = \2;", text)
    return f"""#version 300 es
    precision highp float;
    uniform vec4 Clock[1];
    in vec2 lookup;
    out vec3 point_out;
    out vec3 normal_out;
    vec3 VERTEX;
    vec3 NORMAL;
    #define TIME Clock[0].x
    #define UV2 lookup
    {text}
    void main() {{ vertex(); point_out = VERTEX; normal_out = NORMAL; }}"""


HLSL_MAIN = """
struct Shown { float4 position : SV_Position; float3 at : POINT_OUT; float3 direction : NORMAL_OUT; };
Shown main(float2 lookup : LOOKUP) { Shown shown; BODY shown.position = float4(shown.at, 1); return shown; }
"""


def unity(text: str) -> str:
    """Between CGPROGRAM and ENDCG; of what Unity includes only what the shader names."""
    rate = re.search(r'_Rate \("[^"]*", Float\) = (\S+)', text)
    assert rate
    program = text[text.index("CGPROGRAM") + len("CGPROGRAM") : text.index("ENDCG")]
    program = re.sub(r"#(pragma|include).*\n", "", program).replace("float _Rate;", f"#define _Rate {rate.group(1)}")
    body = """appdata_full v; v.texcoord1 = float4(lookup, 0, 0); v.vertex = 0; v.normal = 0; vert(v);
    shown.at = v.vertex.xyz; shown.direction = v.normal;"""
    return from_hlsl(
        """struct appdata_full { float4 vertex; float3 normal; float4 texcoord1; };
        struct SurfaceOutputStandard { float3 Albedo; float Smoothness; };
        #define _Time float4(0, seconds, 0, 0)
        #define sampler2D Texture2D
        SamplerState nearest;
        #define tex2Dlod(image, at) image.SampleLevel(nearest, (at).xy, (at).w)
        """
        + program
        + HLSL_MAIN.replace("BODY", body)
    )


def unreal(text: str) -> str:
    """The body of a function of the inputs, and of outputs after the first."""
    fps, frames = re.search(r"times\n// (\S+), modulo (\d+)", text).groups()  # type: ignore[union-attr]
    body = f"""shown.direction = 0;
    shown.at = Custom(lookup, fmod(seconds * {fps}, {frames} - 1), 0, shown.direction);"""
    return from_hlsl(
        """Texture2D Points; Texture2D Normals; Texture2D Coefficients;
        float3 Custom(float2 Lookup, float Frame, float3 Rest, inout float3 Normal) {"""
        + text
        + "}"
        + HLSL_MAIN.replace("BODY", body)
    )


def from_hlsl(text: str) -> str:
    """Compile HLSL to SPIR-V, and that to GLSL; without the compilers the test is skipped."""
    if not (shutil.which("glslangValidator") and shutil.which("spirv-cross")):
        pytest.skip("needs glslangValidator and spirv-cross (Debian: glslang-tools, spirv-cross)")
    source = "cbuffer Clock { float seconds; };\n" + text
    with tempfile.TemporaryDirectory() as folder:
        spirv = Path(folder) / "shader.spv"
        options = ["-D", "-V", "-Od", "--stdin", "-S", "vert", "-e", "main", "-o", str(spirv)]
        compiled = subprocess.run(
            ["glslangValidator", *options], input=source, text=True, capture_output=True, check=False
        )
        assert compiled.returncode == 0, compiled.stdout
        glsl = ["spirv-cross", "--es", "--version", "300", "--flatten-ubo", str(spirv)]
        return subprocess.check_output(glsl, text=True)


ENGINES = {
    "godot.gdshader": Engine(godot, lambda points: points),
    "unity.shader": Engine(unity, lambda points: points * [-1, 1, 1], turned=True),
    "unreal.hlsl": Engine(unreal, lambda points: 100 * points[:, [0, 2, 1]], scale=100.0),
}


def images(folder: Path, shader: str, turned: bool) -> list[dict[str, object]]:
    """Textures as engines have them, numbers between 0 and 1, by the samplers' names."""
    found = []
    for sampler in re.findall(r"uniform highp sampler2D (\w+);", shader):
        (name,) = (each for each in ("points", "normals", "coefficients") if each in sampler.lower())
        file = folder / f"{name}.png"
        if not file.exists():
            continue  # plain textures have no coefficients
        pixels = unpacked(file.read_bytes())
        shares = np.zeros((*pixels.shape[:2], 4), np.float32)
        shares[:, :, : pixels.shape[2]] = pixels / np.float32(np.iinfo(pixels.dtype).max)
        shares = shares[::-1] if turned else shares
        height, width = pixels.shape[:2]
        found.append({"sampler": sampler, "width": width, "height": height, "pixels": packed(shares)})
    return found


@pytest.mark.parametrize("name", ENGINES)
def test_engines_draw_the_frames(name: str, written: tuple[Path, VatReport], fox: MeshSequence, page: Page) -> None:
    """At frames, and between two of them, where motion is straight."""
    folder, report = written
    engine = ENGINES[name]
    shader = engine.shader((folder / name).read_text())
    vat = told(folder)
    x, y = np.arange(vat["texels"]) % vat["width"] + 0.5, np.arange(vat["texels"]) // vat["width"] + 0.5
    lookup = np.stack([x / vat["width"], y / vat["height"]], axis=1)
    if engine.turned:
        lookup[:, 1] = 1 - lookup[:, 1]
    shown = page.evaluate(
        TRANSFORMED,
        {
            "shader": shader,
            "input": re.findall(r"\bin vec2 (\w+);", shader)[0],
            "outputs": re.findall(r"\bout vec3 (\w+);", shader),
            "images": images(folder, shader, engine.turned),
            "lookup": packed(lookup),
            "seconds": [frame / fox.header.fps for frame in FRAMES],
        },
    )
    assert shown["error"] == 0
    texels, diagonal = Texels.from_header(fox.header), bounding_diagonal(engine.mirror(fox.points[0]))
    off = []
    for frame, (points, normals) in zip(FRAMES, shown["found"], strict=True):
        before, share = int(frame), frame % 1
        two = fox.points[[before, int(np.ceil(frame))]]
        expected = engine.mirror((1 - share) * two[0] + share * two[1])[texels.vertices]
        apart = np.linalg.norm(floats(points) - expected, axis=1).max() / diagonal
        assert apart <= report.max_error + 2e-6
        if min(share, 1 - share) <= 2 * NEARLY:
            sides = texels.normals_of(two[[round(share)]])[0] @ engine.mirror(np.eye(3) / engine.scale).T
            cosines = np.sum(floats(normals) * sides, axis=1)
            off.append(np.degrees(np.arccos(np.clip(cosines, -1, 1))))
    assert len(off) == len(fox)
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(report.normal_degrees, abs=0.02)


# The shader of browsers, with its own reader

DRAWN = f"""async ([folder, frames]) => {{
  {FEEDBACK}
  const module = await import(folder + "webgl2.js");
  const vat = await module.open(folder);
  const gl = document.createElement("canvas").getContext("webgl2");
  const outputs = ["point", "normal"];
  const program = link(gl, `#version 300 es
    ${{module.glsl(vat)}}
    in vec2 lookup;
    uniform float frame;
    out vec3 point;
    out vec3 normal;
    void main() {{ point = vatPoint(lookup, frame); normal = vatNormal(lookup, frame); }}`, outputs);
  const lookup = new Float32Array(2 * vat.texels);
  for (let texel = 0; texel < vat.texels; texel++) {{
    lookup[2 * texel] = ((texel % vat.width) + 0.5) / vat.width;
    lookup[2 * texel + 1] = (Math.floor(texel / vat.width) + 0.5) / vat.height;
  }}
  module.bind(gl, program, module.textures(gl, vat));
  const found = draw(gl, program, "lookup", lookup, outputs, frames, (frame) => {{
    gl.uniform1f(gl.getUniformLocation(program, "frame"), frame);
  }});
  return {{ found, error: gl.getError() }};
}}"""


def serve(page: Page, folder: Path, changed: dict[str, bytes]) -> None:
    """Let a page find the files of a folder, some of them changed."""

    def answer(route: Route) -> None:
        name = route.request.url.rpartition("/")[2]
        file = folder / name
        kind = {".js": "text/javascript", ".json": "application/json"}.get(file.suffix, "application/octet-stream")
        body = changed.get(name) or (file.read_bytes() if file.is_file() else b"<!doctype html>")
        route.fulfill(body=body, content_type=kind if file.is_file() else "text/html")

    page.route("http://127.0.0.1/**", answer)
    page.goto("http://127.0.0.1/page")


OPENED = """async (folder) => {
  const module = await import(folder + "webgl2.js");
  return module.open(folder).then(() => "opened", (error) => error.message);
}"""


def test_a_browser_refuses_hostile_files(written: tuple[Path, VatReport], page: Page) -> None:
    """Neither shaders nor addresses take what is no number or no name, and pictures unpack to what they say."""
    folder, _ = written
    vat, png = told(folder), (folder / "points.png").read_bytes()
    width = vat["textures"]["points"]["width"]
    header = png[:16] + (width + 1).to_bytes(4, "big") + png[20:]
    many = {name: {**each, "width": 16384, "height": 16384} for name, each in vat["textures"].items()}
    elsewhere = vat["textures"] | {"points": {**vat["textures"]["points"], "file": "//example.org/points.png"}}
    scaled = vat["textures"] | {"normals": {**vat["textures"]["normals"], "scale": "1.0); while (true) {}"}}
    hostile = {
        "points.png is not 16384 by 16384": {"vat.json": json.dumps({**vat, "textures": many}).encode()},
        "this PNG ends early": {"points.png": header},
        "this PNG is damaged": {"points.png": png[:16] + b"\xff" * 8 + png[24:]},
    }
    for key, value in [
        ("frames", "1; } void main() { while (true) {} }"), ("rows", -1), ("width", 2**31), ("kind", "__proto__"),
        ("textures", None), ("textures", elsewhere), ("textures", scaled), ("textures", {"a b": {}}),
    ]:  # fmt: skip
        serve(page, folder, {"vat.json": json.dumps({**vat, key: value}).encode()})
        assert "vat.json is damaged" in page.evaluate(OPENED, "http://127.0.0.1/fox.vat/"), key
    for message, changed in hostile.items():
        serve(page, folder, changed)
        assert message in page.evaluate(OPENED, "http://127.0.0.1/fox.vat/")
    serve(page, folder, {})
    assert page.evaluate(OPENED, "http://127.0.0.1/fox.vat/") == "opened"


def test_a_browser_draws_the_frames(written: tuple[Path, VatReport], fox: MeshSequence, page: Page) -> None:
    """At frames, and half-way between two of them, where motion is straight."""
    folder, report = written
    serve(page, folder, {})
    shown = page.evaluate(DRAWN, ["http://127.0.0.1/fox.vat/", [0, 3, 3.5, 7, 9]])
    assert shown["error"] == 0
    vertices, diagonal = Texels.from_header(fox.header).vertices, bounding_diagonal(fox.points[0])
    expected = [fox.points[0], fox.points[3], (fox.points[3] + fox.points[4]) / 2, fox.points[7], fox.points[7]]
    for (points, normals), wanted in zip(shown["found"], expected, strict=True):
        apart = np.linalg.norm(floats(points) - wanted[vertices], axis=1).max() / diagonal
        assert apart <= report.max_error + 1e-6
        np.testing.assert_allclose(np.linalg.norm(floats(normals), axis=1), 1, atol=1e-5)
