"""Shaders for vertex animation textures, with the numbers of one filled in."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

SHADERS = ("webgl2.js", "godot.gdshader", "unity.shader", "unreal.hlsl")
"""Names of the shaders."""


def shader(name: str, told: dict[str, Any]) -> str:
    """Return the text of a shader, given the contents of ``vat.json``."""
    text = files("mixseq_io.vat").joinpath("shaders", name).read_text(encoding="utf-8")
    values = {key.upper(): str(told[key]) for key in ("frames", "width", "height", "rows", "layers", "fps")}
    values["FPS"] = (
        f"{float(told['fps']):.9g}" if "." in f"{float(told['fps']):.9g}" else f"{told['fps']:.1f}"
    )
    values["LOW_RANK"] = str(int(told["kind"] != "plain"))
    values["PART_SCALE"] = f"{told['part_scale']:.1f}"
    values["COLUMNS"] = str(told["textures"].get("coefficients", {"width": 1})["width"])
    values["NORMALS_HEIGHT"] = str(told["textures"]["normals"]["height"])
    for key in ("points", "normals", "coefficients"):
        texture = told["textures"].get(key, {"offset": 0.0, "scale": 1.0})
        for part in ("offset", "scale"):
            numbers = texture[part] if isinstance(texture[part], list) else [texture[part]]
            values[f"{key}_{part}".upper()] = ", ".join(repr(float(each)) for each in numbers)
    for key, value in values.items():
        text = text.replace(f"@{key}@", value)
    return text
