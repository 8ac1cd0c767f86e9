"""Meshes of an archive, and the choice of those to read; instances appear as the objects they stand for.

Specification: https://docs.alembic.io/reference/index.html (``AbcGeom``)
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mixseq.errors import FormatError
from mixseq_io.alembic.library import Abc, AbcGeom
from mixseq_io.blocks import warn
from mixseq_io.choosing import SceneObject, chosen, listed, moving

_MOST_OBJECTS = 1_000_000
LAID_OVER = "mixseq_laid_over"
"""Metadata of meshes laid over an archive: frames at their points' times only, velocities as rates in mesh space."""

_DEEPEST = 200
"""Largest depth of objects; instances of their own ancestors would nest without end."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Unread mesh: its object, place, schema, and transforms above, the nearest first.

    `hidden` and `flickers`: it or an ancestor is hidden at all times, or at some.
    """

    node: Any
    place: SceneObject
    schema: Any
    above: tuple[Any, ...]
    hidden: bool
    flickers: bool

    @property
    def path(self) -> str:
        """Full name."""
        return self.place.path

    @property
    def name(self) -> str:
        """Own name."""
        return self.place.name

    @property
    def subdivided(self) -> bool:
        """Whether it is a SubD."""
        return bool(AbcGeom.ISubD.matches(self.node.getMetaData()))

    @property
    def laid_over(self) -> bool:
        """Whether mixseq laid its points over an archive."""
        return bool(self.node.getMetaData().get(LAID_OVER))

    @property
    def moves(self) -> bool:
        """Whether its points have several samples, even equal ones, or a transform above changes."""
        sampled = self.schema.getPositionsProperty().getNumSamples() > 1
        return sampled or not all(each.isConstant() for each in self.above)


def choose_meshes(path: Path, archive: Any, prim: str | None) -> list[Mesh]:
    """Return the meshes to read, in the archive's order."""
    meshes, others = find_meshes(path, archive)
    if not meshes:
        found = (
            ", ".join(f"{count} {kind}" for kind, count in sorted(others.items())) or "nothing else either"
        )
        raise FormatError(f"{path} has no mesh; it has {found}. Export meshes, as PolyMesh or SubD")
    if prim is not None:
        named = [meshes[i] for i in chosen(path, [mesh.place for mesh in meshes], prim)]
        picked = [mesh for mesh in named if not mesh.hidden] or named
    else:
        shown = [mesh for mesh in meshes if not mesh.hidden]
        if not shown:
            hidden = listed([mesh.path for mesh in meshes])
            raise FormatError(f"{path}: its meshes are hidden; name one by prim (--prim): {hidden}")
        numbers = moving(path, [mesh.place for mesh in shown], [mesh.moves for mesh in shown])
        picked = [shown[i] for i in numbers]
    flickering = [mesh.path for mesh in picked if mesh.flickers]
    if flickering:
        warn(f"{path}: {listed(flickering)} are hidden at times; they are taken as visible")
    return picked


def find_meshes(path: Path, archive: Any) -> tuple[list[Mesh], Counter[str]]:
    """Return all meshes with points, and the number of objects by other kind."""
    meshes: list[Mesh] = []
    others: Counter[str] = Counter()
    top = SceneObject("/", ())
    stack: list[tuple[Any, SceneObject, tuple[Any, ...], bool, bool, int]] = [
        (archive.getTop(), top, (), False, False, 0)
    ]
    seen = 0
    while stack:
        node, place, above, hidden, flickers, depth = stack.pop()
        seen += 1
        if depth > _DEEPEST or seen > _MOST_OBJECTS:
            raise FormatError(
                f"{path}: its objects nest without end; it is damaged, or an instance contains itself"
            )
        metadata = node.getMetaData()
        visibility = AbcGeom.GetVisibilityProperty(node) if depth else None
        if visibility is not None and visibility.valid() and visibility.getNumSamples():
            if visibility.isConstant():
                hidden |= visibility.getValue() == 0  # 1 is visible, -1 leaves it to the parent
            else:
                flickers = True
        existing = Abc.WrapExistingFlag.kWrapExisting
        if AbcGeom.IPolyMesh.matches(metadata) or AbcGeom.ISubD.matches(metadata):
            kind = AbcGeom.IPolyMesh if AbcGeom.IPolyMesh.matches(metadata) else AbcGeom.ISubD
            schema = kind(node, existing).getSchema()
            if schema.getPositionsProperty().getNumSamples():
                meshes.append(Mesh(node, place, schema, above, hidden, flickers))
        elif AbcGeom.IXform.matches(metadata):
            above = (AbcGeom.IXform(node, existing).getSchema(), *above)
        elif not AbcGeom.IFaceSet.matches(metadata) and metadata.get("schema"):
            others[metadata.get("schema").removeprefix("AbcGeom_").partition("_")[0]] += 1
        children = [node.getChild(index) for index in range(node.getNumChildren())]
        stack += [
            (
                child,
                SceneObject(str(child.getFullName()), (str(child.getName()),), place),
                above,
                hidden,
                flickers,
                depth + 1,
            )
            for child in reversed(children)
        ]
    return meshes, others
