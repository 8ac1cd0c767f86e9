"""Palettes: clay for meshes, cool hues for parts, and a red reserved for joints."""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, FloatArray, IntArray

CLAY = (0.80, 0.77, 0.72)
JOINT_RED = (0.85, 0.20, 0.13)
INK = "#3a3a3a"

FIRST_HUE, LAST_HUE = 90.0, 330.0
"""Degrees on the OKLCH circle, from straw to mauve, equally far from the red of the joints at 30."""

SAGE = 0.3
"""Position of the first hue between those."""

GOLDEN = 0.61803
"""Step from hue to hue, in rounds, which separates the first n hues for any n."""

OKLAB_TO_LMS = np.array(
    [
        [1, 0.3963377774, 0.2158037573],
        [1, -0.1055613458, -0.0638541728],
        [1, -0.0894841775, -1.2914855480],
    ]
)
LMS_TO_RGB = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)


VIRIDIS = bytes.fromhex(
    "44015446085c471063481769481d6f482475472a7a46307e453781433d844142873f48893d4e8a"
    "3a538b38598c355e8d33638d31688e2e6d8e2c718e2a768e297b8e27808e25848e23898e218e8d"
    "20928c1f978b1e9c891fa18821a58524aa8328ae802eb37c35b7793dbc7446c06f50c46a5ac864"
    "65cb5e70cf577cd25089d54895d840a2da37b0dd2fbddf26cae11fd8e219e5e419f1e51dfde725"
)
"""Every fifth colour of matplotlib's map viridis (van der Walt and Smith 2015, CC0), three bytes each."""


def viridis() -> Float:
    """Return the map viridis ``(256, 3)`` without matplotlib, within 1.4 / 255 of it."""
    known = np.frombuffer(VIRIDIS, dtype=np.uint8).reshape(-1, 3) / 255
    steps = np.arange(0, 256, 5)
    return np.stack([np.interp(np.arange(256), steps, channel) for channel in known.T], axis=1)


def part_colours(count: int) -> Float:
    """Return muted, distinguishable, cool colours ``(count, 3)``: hues by the golden angle, alternating lightness."""
    share = np.asarray((SAGE + GOLDEN * np.arange(count)) % 1.0, dtype=np.float64)
    hue = FIRST_HUE + (LAST_HUE - FIRST_HUE) * share
    lightness = np.resize([0.78, 0.68, 0.85], count)
    return _oklch(lightness, 0.085, hue)


def segmentation_colours(part_of_face: IntArray, joint_of_face: IntArray) -> Float:
    """Return colours ``(F, 3)`` of part_of_face ``(F,)``, or `JOINT_RED` where joint_of_face ``(F,)`` is a joint."""
    palette = part_colours(int(np.max(part_of_face)) + 1)
    return np.where(np.asarray(joint_of_face)[:, None] >= 0, JOINT_RED, palette[part_of_face])


def _oklch(lightness: Float, chroma: float, hue: Float) -> Float:
    """Convert OKLCH (Ottosson 2020; hue in degrees) to sRGB ``(N, 3)``."""
    a, b = chroma * np.cos(np.radians(hue)), chroma * np.sin(np.radians(hue))
    lms = (np.stack([lightness, a, b], axis=-1) @ OKLAB_TO_LMS.T) ** 3
    return srgb(np.clip(lms @ LMS_TO_RGB.T, 0, 1))


def srgb(linear: FloatArray) -> Float:
    """Convert linear numbers from 0 to 1 to sRGB (IEC 61966-2-1)."""
    return np.asarray(np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055))
