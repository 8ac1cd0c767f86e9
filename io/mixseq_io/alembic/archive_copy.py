"""Copy an archive object by object and property by property, except for the points of some meshes.

Properties, copied with metadata and sample times, determine an object's kind. Instances stay instances.

Specification: https://docs.alembic.io/reference/index.html (``Abc``)
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from mixseq.arrays import Float
from mixseq_io.alembic.archive_meshes import LAID_OVER
from mixseq_io.alembic.library import Abc, AbcCoreAbstract, selector, stored_array
from mixseq_io.alembic.samples import sample_times, samples_within, time_sampling

_SCHEMA = ".geom"
"""Compound property of all kinds of meshes."""

_OF_POINTS = frozenset(["P", ".velocities", "N", ".selfBnds", ".childBnds"])
"""Properties replaced on meshes with new points: the points, and what depends on them."""

_OF_CHILDREN = frozenset([".childBnds"])
_OF_THE_ARCHIVE = re.compile(r"\.childBnds|statistics|\d+\.samples")
"""Properties of the top object that summarise the archive, such as bounds; wrong with other points."""


Kept = tuple[range, int]
"""Samples of a property that are copied, and the index of their time sampling in the new archive."""


@dataclass(frozen=True, eq=False)
class Copied:
    """Result of copying an archive's objects."""

    schemas: dict[str, Any] = field(default_factory=dict)
    moving: dict[str, tuple[float, float]] = field(default_factory=dict)
    lost: list[str] = field(default_factory=list)


def copy_archive(source: Any, target: Any, moved: Collection[str], frames: Float, room: int) -> Copied:
    """Copy all objects of an archive, with the samples needed for frames at times ``(T,)`` in s."""
    window = float(frames[0]), float(frames[-1])
    return _Copier(target, moved, window, room).copy(source.getTop())


class _Copier:
    def __init__(self, target: Any, moved: Collection[str], window: tuple[float, float], room: int) -> None:
        self._target, self._moved, self._window, self._room = target, moved, window, room
        self._above = _at_or_above(moved)
        self._copied = Copied()

    def copy(self, top: Any) -> Copied:
        new = self._target.getTop()
        for header in top.getProperties().propertyheaders:
            if not _OF_THE_ARCHIVE.fullmatch(header.getName()):
                self._property("/", header, top.getProperties(), new.getProperties(), frozenset())
        made, instances, stack = {}, [], [(top, new)]
        while stack:
            node, parent = stack.pop()
            for child in [node.getChild(index) for index in range(node.getNumChildren())]:
                path = str(child.getFullName())
                if child.isInstanceRoot() and path not in self._above:
                    instances.append((child, parent))
                    continue
                made[path] = self._object(path, child, parent)
                stack.append((child, made[path]))
        for child, parent in instances:
            original = made.get(str(child.instanceSourcePath()))
            if original is None or not parent.addChildInstance(original, child.getName()):
                self._copied.lost.append(str(child.getFullName()))
        return self._copied

    def _object(self, path: str, node: Any, parent: Any) -> Any:
        metadata = AbcCoreAbstract.MetaData(node.getMetaData())
        if path in self._moved:
            metadata.set(LAID_OVER, "1")
        new = Abc.OObject(parent, node.getName(), metadata)
        stale = _OF_POINTS if path in self._moved else _OF_CHILDREN if path in self._above else frozenset()
        for header in node.getProperties().propertyheaders:
            made = self._property(path, header, node.getProperties(), new.getProperties(), stale)
            if path in self._moved and header.getName() == _SCHEMA:
                self._copied.schemas[path] = made
        return new

    def _property(self, path: str, header: Any, source: Any, target: Any, stale: Collection[str]) -> Any:
        """Copy a property of an object without its `stale` children; return the new one."""
        stored = source.getProperty(header.getName())
        if not header.isCompound():
            self._samples(path, header, stored, target, {})
            return None
        new = Abc.OCompoundProperty(target, header.getName(), header.getMetaData())
        fresh = [each for each in stored.propertyheaders if each.getName() not in stale]
        simple = [stored.getProperty(each.getName()) for each in fresh if not each.isCompound()]
        changing = {each.getNumSamples(): self._kept(each) for each in simple if not each.isConstant()}
        for each in fresh:
            if each.isCompound():
                self._property(path, each, stored, new, ())
            else:
                self._samples(path, each, stored.getProperty(each.getName()), new, changing)
        return new

    def _kept(self, stored: Any) -> Kept:
        """Return the samples of a property that frames need."""
        times, sampling = sample_times(stored), stored.getTimeSampling()
        kept = range(len(times))[samples_within(times, self._window)]
        if len(kept) < len(times):
            sampling = time_sampling(times[kept.start : kept.stop], float(times[1] - times[0]))
        return kept, self._target.addTimeSampling(sampling)

    def _samples(
        self, path: str, header: Any, stored: Any, target: Any, changing: Mapping[int, Kept]
    ) -> None:
        """Copy a property's samples; of a constant one, those kept of the `changing` properties beside it."""
        kind = Abc.OArrayProperty if header.isArray() else Abc.OScalarProperty
        constant, count = stored.isConstant(), stored.getNumSamples()
        kept, sampling = (changing.get(count) if constant else None) or self._kept(stored)
        if len(kept) == count:
            sampling = self._target.addTimeSampling(stored.getTimeSampling())
        try:
            # Read before anything is made that would stay empty.
            value = self._value(stored, kept[0]) if kept else None
            new = kind(target, header.getName(), header.getDataType(), header.getMetaData(), sampling)
            for sample in kept:
                if sample > kept[0] and constant:
                    new.setFromPrevious()
                else:
                    new.setValue(self._value(stored, sample) if sample > kept[0] else value)
        except (RuntimeError, TypeError):  # types that the library has no words for in Python
            self._copied.lost.append(f"{path}.{header.getName()}")
            return
        if not constant:
            times = sample_times(stored)
            first, last = self._copied.moving.get(path, (times[0], times[-1]))
            self._copied.moving[path] = min(first, times[0]), max(last, times[-1])

    def _value(self, stored: Any, sample: int) -> Any:
        if stored.isArray():
            return stored_array(stored, sample, self._room)
        return stored.getValue(selector(stored, sample))


def _at_or_above(paths: Collection[str]) -> set[str]:
    """Return paths and all their ancestors."""
    return {
        "/".join(names[:end])
        for names in (path.split("/") for path in paths)
        for end in range(2, len(names) + 1)
    }
