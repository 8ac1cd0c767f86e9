"""Paths of a sequence's meshes in a stand-alone archive.

Original paths are kept, so that references such as cache modifiers of other programs find the meshes. Other meshes are
below a transform of their name, because tools name imports by transforms.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import takewhile

from mixseq.sequence import SequenceHeader
from mixseq_io.scene_meshes import SceneMesh

Place = tuple[str, ...]
"""Names from the root to a mesh; all but the last are transforms."""


def object_places(header: SequenceHeader, scene_meshes: Sequence[SceneMesh]) -> list[Place]:
    """Return the places of all meshes: ``/<name>/<object>/<object>``, or their own paths.

    Those are kept if all meshes have one with a transform, and their common ancestor is named as the sequence.
    """
    kept = [tuple(each.path.split("/")[1:]) for each in scene_meshes if each.path.startswith("/")]
    if len(kept) == len(scene_meshes) and _can_be(kept) and _common_name(kept) in ("", header.name):
        return kept
    root = valid_name(header.name)
    if len(scene_meshes) == 1:
        return [(root, root)]
    return [(root, name, name) for name in unique_names(each.name for each in scene_meshes)]


def _can_be(places: Sequence[Place]) -> bool:
    """Whether meshes can be at places: each with a transform above it, and nothing below another mesh."""
    meshes = set(places)
    above = {place[:end] for place in meshes for end in range(1, len(place))}
    named = all(len(place) > 1 and all(place) for place in meshes)
    return named and len(meshes) == len(places) and not meshes & above


def _common_name(places: Sequence[Place]) -> str:
    """Return the sequence's name for a reader: that of its only mesh, or of the common ancestor."""
    shared = list(takewhile(lambda names: len(set(names)) == 1, zip(*places, strict=False)))
    return shared[-1][0] if shared else ""


def valid_name(name: str) -> str:
    """Return a valid object name: without slashes and not empty."""
    return name.replace("/", "_") or "mesh"


def unique_names(names: Iterable[str]) -> list[str]:
    """Return valid names, repeated ones with a number: "a", "a_2"."""
    taken: dict[str, None] = {}
    numbers: dict[str, int] = {}
    for name in map(valid_name, names):
        number, free = numbers.get(name, 1), name
        while free in taken:
            number += 1
            free = f"{name}_{number}"
        numbers[name] = number
        taken[free] = None
    return list(taken)
