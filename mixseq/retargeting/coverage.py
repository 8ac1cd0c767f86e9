"""Measure how much of a target has a counterpart on the source, and name the components that follow others."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float
from mixseq.correspondence.triangle_mesh import TriangleMesh
from mixseq.retargeting.transfer import Transfer
from mixseq.sequence import SequenceHeader
from mixseq.topology import Topology


@dataclass(frozen=True)
class Follower:
    """A component of the target, or some vertices of it, without a counterpart, and the vertex it follows."""

    name: str  # the component
    vertices: int  # number of following vertices
    leader: int  # the vertex they follow; the first of several
    leads: str  # the component of that vertex


@dataclass(frozen=True)
class Coverage:
    """Share of a target with a counterpart."""

    vertices: float  # share of its vertices on the source
    area: float  # share of its area whose triangles are moved by a triangle of the source
    source_area: float  # share of the source's area whose triangles move one of the target's
    followers: tuple[Follower, ...]  # following components

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        shares = {"vertices": self.vertices, "area": self.area, "source_area": self.source_area}
        return shares | {"followers": [asdict(follower) for follower in self.followers]}


def coverage(transfer: Transfer) -> Coverage:
    """Measure the share of the target with a counterpart on the source."""
    mapping, header = transfer.correspondence, transfer.header
    topology = Topology(header.faces, header.vertex_count)
    component = topology.component_of_vertex
    names = component_names(header, topology)
    followers = []
    for number in np.unique(component[~mapping.matched]).tolist():
        led = np.flatnonzero((component == number) & ~mapping.matched)
        leader = int(mapping.leaders[led[0]])
        followers.append(Follower(names[number], len(led), leader, names[int(component[leader])]))
    known = mapping.faces >= 0
    moving = np.zeros(len(transfer.source.header.faces), dtype=np.bool_)
    moving[mapping.faces[known]] = True
    return Coverage(
        vertices=float(mapping.matched.mean()),
        area=_share(known, TriangleMesh(transfer.target, topology).face_areas),
        source_area=_share(moving, TriangleMesh(transfer.source.rest, transfer.source.topology).face_areas),
        followers=tuple(followers),
    )


def component_names(header: SequenceHeader, topology: Topology) -> list[str]:
    """Name connected components by their object in the file, or by numbers from 1."""
    component = topology.component_of_vertex
    counts = [each.vertex_count for each in header.objects]
    owner = np.repeat(np.arange(len(counts)), counts)
    names = []
    for number in range(int(component.max()) + 1):
        own = np.unique(owner[component == number])
        name = header.objects[int(own[0])].name if len(counts) > 1 else ""
        whole = len(own) == 1 and int((component == number).sum()) == counts[int(own[0])]
        names.append(name if name and whole else f"component {number + 1}" + (f" of {name}" if name else ""))
    return names


def _share(chosen: NDArray[np.bool_], areas: Float) -> float:
    total = float(areas.sum())
    return float(areas[chosen].sum() / total) if total > 0 else float(chosen.mean())
