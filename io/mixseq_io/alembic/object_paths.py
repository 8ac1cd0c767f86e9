"""Where the meshes of a sequence are in an archive of its own.

They stay where they were in the file that the sequence came from, so that what refers to them by path finds them, such
as the cache modifiers of other programs. Meshes without such paths are below a transform of their name, because tools
name what they import by the transforms.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import takewhile

from mixseq.sequence import SequenceHeader
from mixseq_io.scene_meshes import SceneMesh

Place = tuple[str, ...]
"""Names from the root down to a mesh: all but the last are transforms."""


def object_places(header: SequenceHeader, scene_meshes: Sequence[SceneMesh]) -> list[Place]:
    """Return the places of all meshes of a sequence: ``/<name>/<object>/<object>``, or those they have.

    Paths are kept if all meshes have one with a transform, and what they have in common is named as the sequence is.
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
    """Return the name by which a reader calls the sequence: of its only mesh, or of what is above all.

    Examples
    --------
    >>> _common_name([("man", "body", "body")]), _common_name([("man", "body", "body"), ("man", "hat")])
    ('body', 'man')
    """
    shared = list(takewhile(lambda names: len(set(names)) == 1, zip(*places, strict=False)))
    return shared[-1][0] if shared else ""


def valid_name(name: str) -> str:
    """Return a name that an object can have: any but an empty one, without slashes."""
    return name.replace("/", "_") or "mesh"


def unique_names(names: Iterable[str]) -> list[str]:
    """Return valid names, those that occur again with a number.

    Examples
    --------
    >>> unique_names(["a", "a/b", "a", "a_2"])
    ['a', 'a_b', 'a_2', 'a_2_2']
    """
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
