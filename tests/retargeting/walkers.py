"""Walkers in closed form, in their own size: a body on two legs of thigh, shank and foot, in turn on the ground."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mixseq.retargeting.contacts import PlantedMotion, remove_footskate
from mixseq.retargeting.limbs import ArticulatedBody, Contact
from mixseq.types import Float

CYCLE, DUTY, STRIDE, LIFT = 40, 0.6, 0.25, 0.04
BONES = {"thigh": 0.25, "shank": 0.225, "foot": 0.03}
HIP = 0.43 + BONES["foot"]  # height of the hip: knees stay bent
PHASES = (0.0, 0.5)


@dataclass(frozen=True, eq=False)
class Walk:
    """A source, and its motion carried to a target."""

    source: ArticulatedBody
    target: ArticulatedBody
    source_contacts: list[Contact]
    contacts: list[Contact]
    rotations: Float
    centres: Float
    paths: list[Float]
    fps: float = 30.0
    axis: int = 1  # that points up

    def planted(self) -> PlantedMotion:
        return remove_footskate(
            self.target, self.rotations, self.centres, self.contacts, self.paths, self.axis, self.fps
        )

    def joints(self, rotations: Float, centres: Float) -> Float:
        """Where both parts of every link have their pivot, ``(2, T, n, 3)``."""
        places = (self.target.pose_points(self.target.pivots, side, rotations, centres) for side in self.target.pairs.T)
        return np.stack(list(places))

    def feet(self, rotations: Float, centres: Float) -> Float:
        paths = [self.target.pose_points(c.points, c.parts, rotations, centres).mean(axis=1) for c in self.contacts]
        return np.stack(paths, axis=1)

    def moved(self, rotation: Float, shift: Float) -> Walk:
        """All motions by a rigid motion of the world."""
        return replace(
            self,
            rotations=rotation @ self.rotations,
            centres=self.centres @ rotation.T + shift,
            paths=[path @ rotation.T + shift for path in self.paths],
        )


def foot(phase: Float) -> tuple[Float, Float, NDArray[np.bool_]]:
    """Way forward and height of the sole, and whether it rests, by a phase in cycles."""
    cycle = np.floor(phase + 1e-9)
    air = np.clip((phase - cycle - DUTY) / (1 - DUTY), 0.0, 1.0)
    swing = air**2 * (3 - 2 * air)
    return STRIDE * (cycle + swing + DUTY / 2), LIFT * np.sin(np.pi * air) ** 2, air == 0


def about_z(angle: Float) -> Float:
    c, s, o = np.cos(angle), np.sin(angle), np.zeros_like(angle)
    rows = np.stack([np.stack([c, -s, o], -1), np.stack([s, c, o], -1), np.stack([o, o, o + 1], -1)], -2)
    return np.asarray(rows)


def body(legs: float) -> tuple[ArticulatedBody, list[Contact]]:
    """The walker at rest on straight legs: parts 0, and 1 to 3, 4 to 6."""
    lengths = legs * np.array(list(BONES.values()))
    top = lengths.sum()
    centres, pivots, links, contacts = [[0.0, top + 0.1, 0.0]], [], [], []
    for leg, side in enumerate((-0.05, 0.05)):
        height = top
        for bone, length in enumerate(lengths):
            part = 3 * leg + bone + 1
            pivots.append([0.0, height, side])
            links.append([part, part - 1] if bone else [0, part])
            centres.append([0.0, height - length / 2, side])
            height -= length
        sole = np.array([[-0.025, 0.0, side], [0.025, 0.0, side - 0.01], [0.025, 0.0, side + 0.01]])
        contacts.append(Contact("right" if leg else "left", sole, np.full(3, 3 * leg + 3)))
    return ArticulatedBody(np.array(centres), np.array(links), np.array(pivots), 0), contacts


def walk(legs: float = 1.4, travel: float = 1.0, frames: int = 100) -> Walk:
    """Source of legs 1, target of legs `legs` whose root travels `travel` times as far."""
    source, source_contacts = body(1.0)
    target, contacts = body(legs)
    phase = np.arange(frames) / CYCLE
    rotations = np.tile(np.eye(3), (frames, 7, 1, 1))
    sway = 0.005 * np.sin(4 * np.pi * phase)
    hip = np.stack([STRIDE * phase, HIP + sway], axis=-1)
    for leg, offset in enumerate(PHASES):
        forward, height, _ = foot(phase + offset)
        ankle = np.stack([forward - STRIDE * offset, height + BONES["foot"]], axis=-1)
        away = ankle - hip
        reach = np.linalg.norm(away, axis=1)
        thigh, shank = BONES["thigh"], BONES["shank"]
        bend = np.arccos((thigh**2 + reach**2 - shank**2) / (2 * thigh * reach))
        upper = np.arctan2(away[:, 0], -away[:, 1]) + bend
        knee = hip + thigh * np.stack([np.sin(upper), -np.cos(upper)], axis=-1)
        lower = np.arctan2((ankle - knee)[:, 0], -(ankle - knee)[:, 1])
        rotations[:, 3 * leg + 1], rotations[:, 3 * leg + 2] = about_z(upper), about_z(lower)
    way = np.zeros((frames, 3))
    way[:, :2] = hip - [0.0, sum(BONES.values())]
    theirs = hung(source, rotations, source.centres[0] + way)
    centres = hung(target, rotations, target.centres[0] + travel * way)
    paths = [source.pose_points(c.points, c.parts, rotations, theirs) for c in source_contacts]
    return Walk(source, target, source_contacts, contacts, rotations, centres, paths)


def hung(walker: ArticulatedBody, rotations: Float, root: Float) -> Float:
    """Centres of parts that hang together, by their rotations and the centre of the root."""
    centres = np.repeat(root[:, None], len(walker.centres), axis=1)
    for part, (above, number) in walker.parents.items():
        pivot = walker.pose_points(walker.pivots[number], [above], rotations, centres)[:, 0]
        arm = walker.centres[part] - walker.pivots[number]
        centres[:, part] = pivot + rotations[:, part] @ arm
    return centres
