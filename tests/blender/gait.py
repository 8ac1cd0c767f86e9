"""The shot, and how a person walks: angles of the joints over one stride, and where the body is.

Two steps take a second. Angles are those of healthy adults on level ground, as curves of gait analysis show them, in a
few harmonics.
"""

from __future__ import annotations

from math import cos, pi, radians, sin

FIRST, LAST, BASE = 1001, 1096, 24
"""First and last frame of the shot, and its frames per second."""

RATES = (BASE, 120)
"""Frames per second at which it is exported: as it is given to mixseq, and finer."""

Turn = tuple[float, float, float]
"""Angles about the axes of the world, in radians: nodding, leaning, turning. The walker looks along -Y, Z is up."""

STRIDE = 1.0
"""Seconds from one step of a foot to its next one."""

SPEED = 1.3
"""Metres per second."""

HALF = {"left": 0.0, "right": 0.5}
"""Shares of a stride by which the right side is behind the left one."""


def place(time: float) -> tuple[float, float, float]:
    """Return where the walker's root is, in metres: forward, and a little to and fro with every step."""
    return 0.0, -SPEED * time + 0.012 * sin(4 * pi * time / STRIDE), 0.0


def sway(time: float) -> tuple[float, float, float]:
    """Return how far the hips are from the middle: sideways once in a stride, up and down with every step."""
    phase = 2 * pi * time / STRIDE
    return 0.02 * sin(phase), 0.0, 0.018 * cos(2 * phase)


def turns(time: float) -> dict[str, Turn]:
    """Return how every bone is turned against its parent."""
    phase = 2 * pi * time / STRIDE
    found: dict[str, Turn] = {
        "hips": (0.0, radians(3) * sin(phase), radians(5) * cos(phase)),
        "spine": (radians(3), -radians(3) * sin(phase), -radians(9) * cos(phase)),
        "head": (-radians(2) + radians(1.5) * cos(2 * phase), 0.0, radians(4) * cos(phase)),
    }
    for side, late in HALF.items():
        own = phase - 2 * pi * late
        swing = cos(own)
        lift = own - 2 * pi * 0.72  # the knee is bent most when 72 % of the stride are over
        found[f"thigh.{side}"] = (-radians(10 + 20 * cos(own + 0.3)), 0.0, 0.0)
        found[f"shin.{side}"] = (radians(25 + 22 * cos(lift) + 17 * cos(2 * lift)), 0.0, 0.0)
        found[f"foot.{side}"] = (radians(5 * cos(lift) + 8 * cos(2 * lift + 0.8)), 0.0, 0.0)
        found[f"arm.{side}"] = (radians(4 + 20 * swing), 0.0, 0.0)
        found[f"forearm.{side}"] = (-radians(22 - 10 * swing), 0.0, 0.0)
    return found
