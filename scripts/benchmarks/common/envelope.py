"""How far a mesh is from the lengths and angles that it should have."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixseq.mesh.measures import dihedral_angles, edge_lengths, wrap_angles
from mixseq.mesh.topology import Topology
from mixseq.types import Float


class Envelope(NamedTuple):
    """Errors at 99 %, 99.9 % and the largest: relative lengths, and dihedral angles in degrees."""

    lengths: tuple[float, ...]
    degrees: tuple[float, ...]

    def texts(self) -> tuple[str, str]:
        lengths, degrees = (" / ".join(f"{value:.2g}" for value in values) for values in self)
        return lengths, degrees


def envelope(topology: Topology, points: Float, lengths: Float, angles: Float) -> Envelope:
    """Compare points ``(V, 3)`` with target lengths ``(E,)``, in the same unit, and angles ``(H,)``."""
    strain = np.abs(edge_lengths(points, topology.edges) / lengths - 1.0)
    bend = np.abs(np.degrees(wrap_angles(dihedral_angles(points, topology.hinges) - angles)))
    return Envelope(_largest(strain), _largest(bend))


def _largest(errors: Float) -> tuple[float, ...]:
    return tuple(float(value) for value in (*np.quantile(errors, [0.99, 0.999]), errors.max()))
