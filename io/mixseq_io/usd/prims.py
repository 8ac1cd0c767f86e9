"""USD, prims: open a stage, traverse and define prims, and collect warnings about them.

Specification: https://openusd.org/release/api/class_usd_stage.html
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from secrets import token_hex

from pxr import Sdf, Usd, UsdGeom

from mixseq.errors import FormatError
from mixseq_io.blocks import warn
from mixseq_io.reader import check_regular

_MOST_PRIMS = 1_000_000
"""Largest number of prims visited; nested instances multiply without bound in a few lines."""

_LONGEST_LIST = 20


def open_stage(path: Path) -> Usd.Stage:
    """Open a file as it is on disk, with all payloads."""
    if not path.is_file():
        raise FormatError(f"{path} does not exist")
    # A process shares layers by identifier, with unsaved edits of an application or contents that were replaced on
    # disk. A unique argument makes this one private.
    layer = Sdf.Layer.FindOrOpen(absolute(path), {"mixseq": token_hex(8)})
    if not layer:
        raise FormatError(f"{path} cannot be read as USD; it is damaged, truncated or of another type")
    for asset in layer.GetCompositionAssetDependencies():
        check_regular(layer.ComputeAbsolutePath(asset), f"a layer for {path}")
    return Usd.Stage.Open(layer, Usd.Stage.LoadAll)


def absolute(path: Path) -> str:
    """Return the absolute path by which USD opens a file, without resolving links.

    References start at the link's folder, and data stores (git-annex, DVC) keep files elsewhere, without extension.
    """
    return os.path.abspath(path)  # noqa: PTH100 - Path.resolve follows links


def prims_of(path: Path, stage: Usd.Stage) -> Iterator[Usd.Prim]:
    """Yield a stage's prims depth-first, native instances resolved, without point instancers' prototypes."""
    prims = iter(Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()))
    for count, prim in enumerate(prims):
        if count == _MOST_PRIMS:
            raise FormatError(f"{path} holds more than {_MOST_PRIMS} prims; export what is needed only")
        if UsdGeom.PointInstancer(prim):
            prims.PruneChildren()
        yield prim


def lineage(prim: Usd.Prim) -> Iterator[Usd.Prim]:
    """Yield a prim and its ancestors."""
    while prim and not prim.IsPseudoRoot():
        yield prim
        prim = prim.GetParent()


def define(layer: Sdf.Layer, path: Sdf.Path, type_name: str) -> None:
    """Define a prim in a layer, also within an `Sdf.ChangeBlock`, where a stage recomposes siblings only once."""
    spec = Sdf.CreatePrimInLayer(layer, path)
    spec.specifier, spec.typeName = Sdf.SpecifierDef, type_name


@dataclass(frozen=True)
class Notes:
    """Warnings about prims, merged by problem."""

    path: Path
    found: dict[str, list[str]] = field(default_factory=dict)

    def add(self, prim: Usd.Prim, problem: str) -> None:
        """Note a problem, in words that the paths of the prims may follow."""
        self.found.setdefault(problem, []).append(str(prim.GetPath()))

    def warn(self) -> None:
        """Warn of all problems."""
        for problem, paths in self.found.items():
            warn(f"{self.path}: {problem}: {shortened(paths)}")


def shortened(paths: list[str]) -> str:
    """Return a list of paths for a message, truncated if long."""
    more = len(paths) - _LONGEST_LIST
    return ", ".join(paths[:_LONGEST_LIST]) + (f" and {more} more" if more > 0 else "")
