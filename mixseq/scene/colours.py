"""Colourings of the meshes of a scene, computed on first use, with a common scale."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

from mixseq.choices import COLOURS
from mixseq.errors import SettingsError
from mixseq.frame_store import FrameStore
from mixseq.scene.colouring import Colouring, Original, clay, colourings_of
from mixseq.scene.items import Scene, SceneItem, check_starts, same_mesh

SAMPLES = 12
"""Number of frames from which the ends of scales are measured."""


@dataclass(frozen=True, eq=False)
class SceneColours:
    """The colourings of all meshes of a scene."""

    scene: Scene  # as it was opened: edits are measured against the first frames that it had then
    original: FrameStore | None = None  # what errors are measured against
    _found: dict[int, dict[str, Colouring]] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def _plain(self) -> list[Colouring]:
        return [clay(item.header.vertex_count) for item in self.scene.items]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the colourings that at least one mesh has."""
        there = {
            "own": any(item.header.surface.colours is not None for item in self.scene.items),
            "parts": any(item.decomposition is not None for item in self.scene.items),
            "error": any(self._original_of(item) is not None for item in self.scene.items),
        }
        return tuple(name for name in COLOURS if there.get(name, True))

    def of(self, index: int, name: str) -> Colouring:
        """Return a colouring of a mesh, clay if it lacks that."""
        if name == "clay":  # the first colour that is seen, and all others take time
            return self._plain[index]
        return self.each(index).get(name, self._plain[index])

    def each(self, index: int) -> dict[str, Colouring]:
        """Return all colourings of a mesh."""
        if index not in self._found:
            item = self.scene.items[index]
            moments = (self.scene.elapsed(frame) for frame in self.scene.samples(SAMPLES))
            poses = ((elapsed, item.pose(elapsed)) for elapsed in moments)
            original = self._original_of(item)
            self._found[index] = colourings_of(
                item.header, item.pose(0.0), item.decomposition, original, poses
            )
        return self._found[index]

    def shared(self, name: str) -> list[Colouring]:
        """Return the colourings of all meshes, with a common scale."""
        return with_one_scale([self.of(index, name) for index in range(len(self.scene.items))])

    def _original_of(self, item: SceneItem) -> Original | None:
        """Return the original's points at elapsed times, if it is the same mesh."""
        if self.original is None or not same_mesh(self.original.header, item.header):
            return None
        return SceneItem("the original", self.original).pose


def with_one_scale(colourings: list[Colouring]) -> list[Colouring]:
    """Return colourings of several meshes, with the scale of the largest end."""
    top = max((each.top for each in colourings if not each.constant), default=0.0)
    return [each if each.constant else each.scaled(top) for each in colourings]


def check_original(scene: Scene, original: FrameStore) -> None:
    """Raise SettingsError for an original that does not fit."""
    header = original.header
    same = [item for item in scene.items if same_mesh(item.header, header)]
    if not same:
        raise SettingsError(
            f"none of the meshes has the {header.vertex_count} vertices and {len(header.faces)} triangles of the "
            "original; errors need one mesh"
        )
    check_starts(same, header)
