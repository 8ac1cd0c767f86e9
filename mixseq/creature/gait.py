"""The walk: a pose of the skeleton for every phase of the cycle.

Spine, head and tail swing by a table of harmonics (forward kinematics). Paws follow a path that is planted during
stance, and the legs reach for them (inverse kinematics of two bones). The fox walks on the spot, as on a treadmill: a
planted paw moves backwards at constant speed. Everything has period 1 in the phase.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from mixseq.arrays import Float
from mixseq.creature.skeleton import HEADS, NAMES, PARENTS, TAILS

DUTY = 0.64  # share of the cycle with a paw on the ground
STEP = 0.30  # metres that the ground moves during that time
LIFT = 0.062  # metres that a paw rises in the air
SIDE = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Swing:
    """A swinging joint: ``degrees * cos(2 pi (cycles * phase - delay))`` about ``axis``.

    About x a bone rolls, about y it yaws (positive turns the nose left), about z it pitches (positive raises the nose).
    """

    bone: str
    axis: str
    degrees: float
    cycles: int
    delay: float


@dataclass(frozen=True)
class Leg:
    """A leg: its four bones, the phase at which its paw lands, and degrees that the pastern curls back in mid-air."""

    upper: str
    lower: str
    pastern: str
    paw: str
    landing: float
    curl: float


# The lateral sequence of a walk: left hind, left fore, right hind, right fore.
LEGS = (
    Leg("thigh.l", "shank.l", "hindpastern.l", "hindpaw.l", landing=0.00, curl=20.0),
    Leg("arm.l", "forearm.l", "forepastern.l", "forepaw.l", landing=0.25, curl=40.0),
    Leg("thigh.r", "shank.r", "hindpastern.r", "hindpaw.r", landing=0.50, curl=20.0),
    Leg("arm.r", "forearm.r", "forepastern.r", "forepaw.r", landing=0.75, curl=40.0),
)

SWINGS = (
    Swing("pelvis", "y", 3.0, 1, 0.05),
    Swing("pelvis", "x", 2.5, 1, 0.30),
    Swing("pelvis", "z", 0.8, 2, 0.10),
    Swing("belly", "y", -3.0, 1, 0.05),
    Swing("belly", "x", -2.5, 1, 0.35),
    Swing("chest", "y", -3.0, 1, 0.05),
    Swing("chest", "z", 1.2, 2, 0.50),
    Swing("neck", "z", 5.0, 2, 0.15),
    Swing("neck", "y", 4.0, 1, 0.10),
    Swing("head", "z", -3.0, 2, 0.05),
    Swing("head", "y", 3.0, 1, 0.15),
    Swing("ear.r", "z", 5.0, 2, 0.30),
    Swing("ear.l", "z", 5.0, 2, 0.40),
    Swing("tail1", "y", 8.0, 1, 0.20),
    Swing("tail2", "y", 9.0, 1, 0.32),
    Swing("tail3", "y", 10.0, 1, 0.44),
    Swing("tail4", "y", 10.0, 1, 0.56),
    Swing("tail1", "z", 3.0, 2, 0.10),
    Swing("tail2", "z", 4.0, 2, 0.25),
    Swing("tail3", "z", 4.0, 2, 0.40),
    Swing("tail4", "z", 4.0, 2, 0.55),
)


def pose(phase: Float) -> tuple[Float, Float]:
    """Pose the skeleton: phase ``(T,)``; result ``(T, B, 3, 3)``, ``(T, B, 3)``."""
    turns = np.tile(np.eye(3), (len(phase), len(NAMES), 1, 1))
    for swing in SWINGS:
        angle = np.radians(swing.degrees) * np.cos(2 * np.pi * (swing.cycles * phase - swing.delay))
        turns[:, NAMES.index(swing.bone)] @= _about("xyz".index(swing.axis), angle)

    rotations, heads = np.empty_like(turns), np.empty((len(phase), len(NAMES), 3))
    rotations[:, 0] = turns[:, 0]
    heads[:, 0] = HEADS[0] + _bob(phase)
    for bone, parent in list(enumerate(PARENTS))[1:]:
        rotations[:, bone] = rotations[:, parent] @ turns[:, bone]
        heads[:, bone] = heads[:, parent] + rotations[:, parent] @ (HEADS[bone] - HEADS[parent])
    for leg in LEGS:
        _place_leg(leg, phase, rotations, heads)
    return rotations, heads


def paw_path(phase: Float) -> tuple[Float, Float, Float]:
    """Return the path of a paw that lands at phase 0: phase ``(T,)``; result ``(T,)``, ``(T,)``."""
    phase = phase % 1.0
    air = np.clip((phase - DUTY) / (1 - DUTY), 0, 1)
    # in the air a cubic that leaves and lands at the speed of the ground
    overshoot = (1 - DUTY) / DUTY
    swing = air**2 * (3 - 2 * air) * (1 + overshoot) - overshoot * air
    forward = STEP * np.where(phase < DUTY, 0.5 - phase / DUTY, swing - 0.5)
    height = LIFT * np.sin(np.pi * air**0.85) ** 2
    pitch = np.radians(14 * _bump(phase, 0.93, 0.07) - 48 * _bump(phase, 0.72, 0.18))
    return forward, height, pitch


def _bob(phase: Float) -> Float:
    """Return the offset of the body ``(T, 3)``: down at each hind landing, towards the supporting leg."""
    once, twice = 2 * np.pi * phase, 4 * np.pi * phase
    return np.stack(
        [0.006 * np.sin(twice), -0.012 - 0.010 * np.cos(twice - 0.6), -0.010 * np.sin(once)], axis=1
    )


def _about(axis: int, angle: Float) -> Float:
    """Return rotations ``(T, 3, 3)`` about a coordinate axis by angles ``(T,)`` in radians."""
    return Rotation.from_rotvec(angle[:, None] * np.eye(3)[axis]).as_matrix()


def _bump(phase: Float, centre: float, width: float) -> Float:
    """Rise from 0 to 1 and back, smoothly, within ``width`` on either side of ``centre``."""
    offset = (phase - centre + 0.5) % 1.0 - 0.5
    return np.where(np.abs(offset) < width, np.cos(np.pi / 2 * offset / width) ** 2, 0.0)


def _place_leg(leg: Leg, phase: Float, rotations: Float, heads: Float) -> None:
    """Write the pose of one leg's four bones, so that its paw follows the path."""
    upper, lower, pastern, paw = (NAMES.index(name) for name in (leg.upper, leg.lower, leg.pastern, leg.paw))
    phase = (phase - leg.landing) % 1.0
    forward, height, pitch = paw_path(phase)

    lean = np.arctan(forward / HEADS[upper, 1])
    fold = np.radians(leg.curl) * _bump(phase, DUTY + 0.4 * (1 - DUTY), 0.5 * (1 - DUTY) + 0.04)
    rotations[:, paw] = _about(2, pitch)
    rotations[:, pastern] = _about(2, lean - fold)
    toes = TAILS[paw] + np.stack([forward, height, 0 * phase], axis=1)
    heads[:, paw] = toes - rotations[:, paw] @ (TAILS[paw] - HEADS[paw])
    heads[:, pastern] = heads[:, paw] - rotations[:, pastern] @ (HEADS[paw] - HEADS[pastern])

    heads[:, lower], side = _reach(heads[:, upper], heads[:, pastern], HEADS[[upper, lower, pastern]])
    rotations[:, upper] = _turn(heads[:, lower] - heads[:, upper], HEADS[lower] - HEADS[upper], side)
    rotations[:, lower] = _turn(heads[:, pastern] - heads[:, lower], HEADS[pastern] - HEADS[lower], side)


def _reach(hip: Float, ankle: Float, rest: Float) -> tuple[Float, Float]:
    """Find the knee between hip and ankle ``(T, 3)``: rest ``(3, 3)``; result ``(T, 3)``, ``(T, 3)``."""
    thigh, shank = np.linalg.norm(np.diff(rest, axis=0), axis=1)
    span = np.linalg.norm(ankle - hip, axis=1, keepdims=True)
    down = (ankle - hip) / span
    side = SIDE - (down @ SIDE)[:, None] * down
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    along = (thigh**2 - shank**2 + span**2) / (2 * span)
    aside = np.sqrt(np.maximum(thigh**2 - along**2, 0))
    bend = np.sign(np.cross(rest[2] - rest[0], rest[1] - rest[0])[2])
    return hip + along * down + bend * aside * np.cross(side, down), side


def _turn(posed: Float, rest: Float, side: Float) -> Float:
    """Return rotations ``(T, 3, 3)`` that take a bone's rest direction to the posed one, and +z to ``side``."""
    return _frame(posed, side) @ np.swapaxes(_frame(rest[None], SIDE[None]), 1, 2)


def _frame(along: Float, side: Float) -> Float:
    """Return orthonormal frames ``(T, 3, 3)``, by columns: along, across, and nearly ``side``."""
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(side, along)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return np.stack([along, across, np.cross(along, across)], axis=2)
