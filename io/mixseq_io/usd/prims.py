"""USD, prims: opening a stage, walking through its prims, defining them, and telling about what they hold.

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
"""Instances of instances can be more than atoms in the universe, in a file of a few lines."""

_LONGEST_LIST = 20


def open_stage(path: Path) -> Usd.Stage:
    """Open a file as it is on the disk, with all payloads."""
    if not path.is_file():
        raise FormatError(f"{path} does not exist")
    # A process shares its layers by their identifier, with an application's unsaved edits in them, or with
    # what the file held before it was replaced. An argument that no one else gives makes this one our own.
    layer = Sdf.Layer.FindOrOpen(absolute(path), {"mixseq": token_hex(8)})
    if not layer:
        raise FormatError(f"{path} cannot be read as USD; it is damaged, truncated or of another type")
    for asset in layer.GetCompositionAssetDependencies():
        check_regular(layer.ComputeAbsolutePath(asset), f"a layer for {path}")
    return Usd.Stage.Open(layer, Usd.Stage.LoadAll)


def absolute(path: Path) -> str:
    """Return the path by which USD opens a file.

    Links are not followed: what a file refers to is searched from the folder in which it is named, and stores of data
    (git-annex, DVC) keep the file itself elsewhere, without its extension.
    """
    return os.path.abspath(path)  # noqa: PTH100 - Path.resolve follows links


def prims_of(path: Path, stage: Usd.Stage) -> Iterator[Usd.Prim]:
    """Yield the prims of a stage depth-first: native instances resolved, prototypes of point instancers left out."""
    prims = iter(Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()))
    for count, prim in enumerate(prims):
        if count == _MOST_PRIMS:
            raise FormatError(f"{path} holds more than {_MOST_PRIMS} prims; export what is needed only")
        if UsdGeom.PointInstancer(prim):
            prims.PruneChildren()
        yield prim


def lineage(prim: Usd.Prim) -> Iterator[Usd.Prim]:
    """Yield a prim and all that are above it."""
    while prim and not prim.IsPseudoRoot():
        yield prim
        prim = prim.GetParent()


def define(layer: Sdf.Layer, path: Sdf.Path, type_name: str) -> None:
    """Define a prim in a layer.

    Unlike ``Usd.Stage.DefinePrim`` it can be used in an `Sdf.ChangeBlock`: a stage composes all siblings anew for every
    prim that is added to them, or once for a block of them.
    """
    spec = Sdf.CreatePrimInLayer(layer, path)
    spec.specifier, spec.typeName = Sdf.SpecifierDef, type_name


@dataclass(frozen=True)
class Notes:
    """What is to be told about prims: one warning for all that have the same problem."""

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
    """Return a list for a message, cut where it gets long.

    Examples
    --------
    >>> shortened(["/a", "/b"])
    '/a, /b'
    """
    more = len(paths) - _LONGEST_LIST
    return ", ".join(paths[:_LONGEST_LIST]) + (f" and {more} more" if more > 0 else "")
