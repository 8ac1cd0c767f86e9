"""Choice of a scene's meshes: those that `prim` names, or those that move.

Readers make a `SceneObject` of every mesh and its ancestors; the chosen meshes are indices in their order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mixseq.errors import AmbiguousError, FormatError
from mixseq_io.blocks import warn

_LONGEST_LIST = 20


@dataclass(frozen=True, eq=False)
class SceneObject:
    """An object of a scene, with or without a mesh."""

    path: str
    names: tuple[str, ...]
    above: SceneObject | None = None

    @property
    def name(self) -> str:
        """Name to show, "" if it has none."""
        return next(filter(None, self.names), "")

    @property
    def lineage(self) -> list[SceneObject]:
        """The object and its ancestors, the root last."""
        found, here = [], self
        while True:
            found.append(here)
            if here.above is None:
                return found
            here = here.above


def chosen(
    file: Path, meshes: Sequence[SceneObject], prim: str, among: Sequence[SceneObject] | None = None
) -> list[int]:
    """Return the indices of the meshes at or below an object, given by path or name."""
    among = meshes if among is None else among
    if not prim.strip("/"):
        return list(range(len(among)))
    root = _path_of(file, meshes, prim)
    return [number for number, place in enumerate(among) if root in (each.path for each in place.lineage)]


def _path_of(file: Path, meshes: Sequence[SceneObject], prim: str) -> str:
    """Return the path of the object named by `prim`: a listed path, a name, or a path without its end slashes."""
    paths = {each.path.strip("/"): each.path for mesh in meshes for each in mesh.lineage}
    path = paths.get(prim.strip("/"))
    if path == prim:
        return path
    # The outermost of those that are in each other.
    named = {each.path for mesh in meshes for each in _called(mesh, prim)[-1:]}
    if len(named) > 1:
        raise AmbiguousError(f"{file}: {prim!r} is in several places, {listed(sorted(named))}; give its path")
    found = next(iter(named), path)
    if found is None:
        raise FormatError(
            f"{file} has no mesh at or below {prim!r}; its meshes are {listed([mesh.path for mesh in meshes])}"
        )
    return found


def _called(mesh: SceneObject, name: str) -> list[SceneObject]:
    return [each for each in mesh.lineage if name in each.names]


def moving(file: Path, meshes: Sequence[SceneObject], moves: Sequence[bool]) -> list[int]:
    """Return the indices of the meshes that move; all if none moves."""
    still = [mesh.path for mesh, it_moves in zip(meshes, moves, strict=True) if not it_moves]
    if not any(moves):
        return list(range(len(meshes)))
    if still:
        warn(
            f"{file}: meshes that stand still are left out; prim='/' (--prim / on the command line) takes them, too: "
            f"{listed(still)}"
        )
    return [number for number, it_moves in enumerate(moves) if it_moves]


def common_name(meshes: Sequence[SceneObject]) -> str:
    """Return the name of the only mesh, or of the deepest named common ancestor; "" if there is none."""
    shared = set.intersection(*({each.path for each in mesh.lineage} for mesh in meshes))
    return next((each.name for each in meshes[0].lineage if each.path in shared and each.name), "")


def listed(names: Sequence[str]) -> str:
    """Return at most 20 names, quoted, for a message."""
    more = len(names) - _LONGEST_LIST
    return ", ".join(map(repr, names[:_LONGEST_LIST])) + (f" and {more} more" if more > 0 else "")
