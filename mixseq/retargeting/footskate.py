"""Remove footskate: contacts of the target rest where those of the source rest.

Stances are found by `mixseq.retargeting.stance`. Then the whole body moves as far as its feet agree
(`mixseq.retargeting.footing`), and limbs rotate by the rest (`mixseq.retargeting.inverse_kinematics`). A foot in the
air keeps its path, although its limb may share parts with others.

The scheme (constraints found in the motion, the root first, then the limbs, blends in between) is that of Kovar,
Schreiner and Gleicher 2002, "Footskate cleanup for motion capture editing".
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mixseq.arrays import Float, FloatArray
from mixseq.errors import MixseqWarning, SettingsError
from mixseq.retargeting.articulated_body import ArticulatedBody, Contact
from mixseq.retargeting.footing import body_shift, faded, misses
from mixseq.retargeting.inverse_kinematics import move_contacts
from mixseq.retargeting.stance import Stance, StanceSettings, axis_of, stances

NEGLIGIBLE = 1e-9
"""Sliding distance below which feet are left unchanged, in diagonals."""


@dataclass(frozen=True)
class GroupReport:
    """Sliding of one contact, before and after, in diagonals of the target."""

    name: str  # the contact
    stances: tuple[Stance, ...]  # its stances
    before: float  # path length of its middle in all stances, as transferred
    after: float  # path length of its middle in all stances, as corrected
    residual: float  # largest stretch of its limb, where rotation did not suffice


@dataclass(frozen=True)
class ContactReport:
    """Sliding of all contacts, and the motions that removed it."""

    groups: tuple[GroupReport, ...] = ()  # one for each contact
    shift: float = 0.0  # largest shift of the whole body, in diagonals of the target
    turn: float = 0.0  # largest rotation of a part of a limb, in degrees


@dataclass(frozen=True, eq=False)
class PlantedMotion:
    """Motions of parts without sliding feet."""

    rotations: Float  # (T, p, 3, 3) of the parts
    centres: Float  # (T, p, 3) where their rest centres go
    report: ContactReport  # report of the changes


def remove_footskate(
    body: ArticulatedBody,
    rotations: Float,
    centres: Float,
    contacts: Sequence[Contact],
    trajectories: Sequence[FloatArray],
    up: str,
    fps: float,
    diagonal: float,
    settings: StanceSettings | None = None,
) -> PlantedMotion:
    """Move parts so that contacts do not slide while those of the source rest; motions without sliding are unchanged.

    Rotations and centres are ``(T, p, 3, 3), (T, p, 3)``; trajectories ``(T, k, 3)`` are those of the source's contact
    points, in the target's units, as is the diagonal.
    """
    lengths = [len(path) for path in trajectories]
    if lengths != len(contacts) * [len(centres)]:
        raise SettingsError(
            f"there are {len(contacts)} contacts and motions of {len(centres)} frames, but {len(lengths)} paths of "
            f"{', '.join(map(str, lengths)) or 'no'} frames; give one path for each contact, over all frames"
        )
    for contact in contacts:
        body.limb(contact)
    axis = axis_of(up)
    found = tuple(
        stances(contact.name, path, up, fps, diagonal, settings)
        for contact, path in zip(contacts, trajectories, strict=True)
    )
    _warn_of_restless(contacts, found)
    before = _paths(body, contacts, rotations, centres)
    missed = misses(before, found, NEGLIGIBLE * diagonal)
    if not missed.any():
        groups = _groups(contacts, found, before, before, np.zeros(len(contacts)), diagonal)
        return PlantedMotion(rotations, centres, ContactReport(groups))
    shift, left = body_shift(missed, found, axis, fps)
    moves = np.stack([faded(*pair, fps) for pair in zip(left, found, strict=True)], axis=1)
    result = move_contacts(body, rotations, centres + shift[:, None], contacts, moves)
    after = _paths(body, contacts, result.rotations, result.centres)
    residuals = np.linalg.norm(result.left, axis=2).max(axis=0)
    groups = _groups(contacts, found, before, after, residuals, diagonal)
    report = ContactReport(
        groups, float(np.linalg.norm(shift, axis=1).max()) / diagonal, _angle(result.turns)
    )
    return PlantedMotion(result.rotations, result.centres, report)


def _warn_of_restless(contacts: Sequence[Contact], found: Sequence[Sequence[Stance]]) -> None:
    for contact, some in zip(contacts, found, strict=True):
        if not some:
            warnings.warn(
                f"contact '{contact.name}' never rests on the ground in the source, so nothing holds it; if the source "
                "walks on the spot, move it over the ground first",
                MixseqWarning,
                stacklevel=3,
            )


def _paths(body: ArticulatedBody, contacts: Sequence[Contact], rotations: Float, centres: Float) -> Float:
    """Return the middles ``(g, T, 3)`` of contacts."""
    paths = [body.path(each, rotations, centres).mean(axis=1) for each in contacts]
    return np.array(paths).reshape(len(contacts), len(centres), 3)


def _angle(turns: Float) -> float:
    """Return the largest angle of rotations, in degrees."""
    lowest = np.trace(turns, axis1=2, axis2=3).min(initial=3.0)
    return float(np.degrees(np.arccos(np.clip((lowest - 1.0) / 2.0, -1.0, 1.0))))


def _groups(
    contacts: Sequence[Contact],
    found: Sequence[tuple[Stance, ...]],
    before: Float,
    after: Float,
    residuals: Float,
    diagonal: float,
) -> tuple[GroupReport, ...]:
    def slide(path: Float, some: Sequence[Stance]) -> float:
        steps = [np.linalg.norm(np.diff(path[stance.frames], axis=0), axis=1).sum() for stance in some]
        return float(sum(steps)) / diagonal

    rows = zip(contacts, found, before, after, residuals.tolist(), strict=True)
    return tuple(
        GroupReport(contact.name, some, slide(old, some), slide(new, some), residual / diagonal)
        for contact, some, old, new, residual in rows
    )
