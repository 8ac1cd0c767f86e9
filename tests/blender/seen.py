"""What Blender showed of a file, and how far it is from what it should show."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from mixseq.types import Float, Index

MESHES = ("body", "sword")


@dataclass(frozen=True, eq=False)
class Seen:
    """Arrays and names that `showing.py` left.

    ``points/NAME`` and ``velocities/NAME`` (T, V, 3) in the world, ``camera`` (T, 4, 4), ``vertices/NAME`` (V,) of
    glTF; names of meshes, objects, materials and texture coordinates, and the scene's range of frames.
    """

    arrays: dict[str, Float]
    names: dict[str, Any]

    @classmethod
    def read(cls, output: Path) -> Seen:
        """Read what stands in ``OUTPUT.npz`` and ``OUTPUT.json``."""
        with np.load(f"{output}.npz") as arrays:
            return cls(dict(arrays), json.loads(Path(f"{output}.json").read_text()))

    @property
    def has_meshes(self) -> bool:
        """Whether all meshes are there."""
        return {f"points/{name}" for name in MESHES} <= self.arrays.keys()

    @property
    def has_velocities(self) -> bool:
        """Whether all of them have velocities."""
        return {f"velocities/{name}" for name in MESHES} <= self.arrays.keys()

    def together(self, kind: str) -> Float:
        """Return ``points`` or ``velocities`` ``(T, V, 3)`` of all meshes, one after the other."""
        return np.concatenate([self.arrays[f"{kind}/{name}"] for name in MESHES], axis=1)

    @property
    def objects(self) -> list[str]:
        """Paths and types of all objects."""
        return [f"{path} ({kind})" for path, kind in self.names["objects"]]

    @property
    def camera(self) -> Float:
        """Its matrices ``(T, 4, 4)``."""
        return self.arrays["camera"]

    @property
    def scene_range(self) -> tuple[float, float]:
        """First and last frame of the scene."""
        return self.names["frame_start"], self.names["frame_end"]

    @property
    def action_range(self) -> tuple[float, float]:
        """First and last key of all actions; glTF tells Blender no other range."""
        ranges = np.array(self.names["actions"] or [[np.nan, np.nan]])
        return float(ranges[:, 0].min()), float(ranges[:, 1].max())


@dataclass(frozen=True, eq=False)
class Surface:
    """What is on the meshes, told by the vertices of the truth ``(V, 3)``, so that orders and splits do not count."""

    seen: Seen
    vertices: Index

    @classmethod
    def found(cls, seen: Seen, truth: Seen) -> Surface:
        """Find which vertices of the truth those that are seen are."""
        return cls(seen, matched(seen.together("points"), truth.together("points")))

    @cached_property
    def _corners(self) -> list[tuple[str, Index]]:
        """Material and vertices of every polygon."""
        found, first = [], 0
        for name in MESHES:
            mesh = self.seen.names["meshes"][name]
            for material, corners in zip(mesh["materials"], mesh["corners"], strict=True):
                found.append((material, self.vertices[first + np.array(corners)]))
            first += self.seen.arrays[f"points/{name}"].shape[1]
        return found

    def has_materials_of(self, other: Surface) -> bool:
        """Tell whether every polygon has the material that the same polygon has in the other one."""
        own, theirs = (
            {frozenset(map(int, corners)): material for material, corners in each._corners} for each in (self, other)
        )
        return own == theirs

    def has_uvs_of(self, other: Surface) -> bool:
        """Tell whether sets have the same names, and corners the same texture coordinates to 1e-4."""
        own, theirs = self._uvs(), other._uvs()
        return own.keys() == theirs.keys() and all(_same(own[name], theirs[name]) for name in own)

    def _uvs(self) -> dict[str, Float]:
        """Return of every set the vertex and both coordinates of every corner, ``(C, 3)``."""
        found: dict[str, list[Float]] = {}
        polygons = iter(self._corners)
        for name in MESHES:
            mesh = self.seen.names["meshes"][name]
            corners = np.concatenate([next(polygons)[1] for _ in mesh["corners"]])
            for title, values in mesh["uvs"].items():
                found.setdefault(f"{name} {title}", []).append(np.column_stack([corners, values]))
        return {title: np.concatenate(values) for title, values in found.items()}


def _same(a: Float, b: Float) -> bool:
    """Tell whether each row of two tables is one of the other."""
    return all(float(np.max(cKDTree(x).query(y)[0])) < 1e-4 for x, y in ((a, b), (b, a)))


def matched(points: Float, truth: Float) -> Index:
    """Return which vertex of the truth ``(T, V, 3)`` each of the points ``(T, W, 3)`` is: the one that goes its way.

    Three frames tell vertices apart that touch each other in one.
    """
    some = np.unique([0, len(truth) // 2, len(truth) - 1])
    ways = (np.concatenate(list(each[some]), axis=1) for each in (truth, points))
    return np.asarray(cKDTree(next(ways)).query(next(ways))[1])


def root_mean_square(vectors: Float) -> float:
    """Return the root mean square length of vectors ``(..., 3)``."""
    return float(np.sqrt((vectors**2).sum(axis=-1).mean()))
