r"""Deformation of edges and hinges: their largest variation between any two frames.

.. math:: \Delta\theta_h = \max_{s,t} \lvert \mathrm{wrap}(\theta_{h,s} - \theta_{h,t}) \rvert, \qquad
          \Delta l_e = \max_{s,t} \lvert l_{e,s} - l_{e,t} \rvert

Segmentations by boundaries, rather than by motions, start from these (paper, Sections 1.3 and 2.1). Values at vertices
are means over the incident hinges or edges, weighted by length in the first frame:

.. math:: \Delta\theta_v = \frac{\sum_h l_h \Delta\theta_h}{\sum_h l_h}, \qquad
          \epsilon_v = \frac{\sum_e \Delta l_e}{\sum_e l_e} .
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, FloatArray, Index
from mixseq.geometry.lengths_angles import dihedral_angles, edge_lengths, wrap
from mixseq.segmentation.observed import frames_to_look_at
from mixseq.topology import Topology

_TINY = np.finfo(np.float64).tiny


def some_frames(points: FloatArray, frames: int) -> Float:
    """Return at most `frames` evenly spread frames ``(T, V, 3)``, in diagonals of the first, or else of the largest."""
    x = points[frames_to_look_at(len(points), frames)].astype(np.float64)
    x -= x[0].mean(axis=0)
    diagonals = np.linalg.norm(np.ptp(x, axis=1), axis=1)
    return np.asarray(x / (diagonals[0] or diagonals.max() or 1.0))


def angle_variation(points: FloatArray, topology: Topology) -> Float:
    """Return the largest change ``(H,)`` of dihedral angles between frames ``(T, V, 3)``, wrapped, in radians."""
    angles = np.stack([dihedral_angles(frame, topology.hinges) for frame in points])
    largest = np.zeros(angles.shape[1])
    for frame in range(1, len(angles)):
        largest = np.maximum(largest, np.abs(wrap(angles[frame] - angles[:frame])).max(axis=0))
    return largest


def length_variation(points: FloatArray, topology: Topology) -> Float:
    """Return the largest change ``(E,)`` of edge lengths between two of the frames ``(T, V, 3)``."""
    lengths = np.stack([edge_lengths(frame, topology.edges) for frame in points])
    return np.asarray(np.ptp(lengths, axis=0), dtype=np.float64)


def vertex_bending(points: FloatArray, topology: Topology) -> Float:
    """Return the mean change ``(V,)`` of the dihedral angles at every vertex, in radians."""
    hinged = topology.edges[topology.hinge_edges]
    lengths = edge_lengths(points[0], hinged)
    count = topology.vertex_count
    change = _gathered(hinged, lengths * angle_variation(points, topology), count)
    return change / np.maximum(_gathered(hinged, lengths, count), _TINY)


def vertex_strain(points: FloatArray, topology: Topology) -> Float:
    """Return the mean relative change ``(V,)`` of edge lengths at every vertex."""
    count = topology.vertex_count
    lengths = _gathered(topology.edges, edge_lengths(points[0], topology.edges), count)
    change = _gathered(topology.edges, length_variation(points, topology), count)
    return np.where(lengths > 0.0, change / np.maximum(lengths, _TINY), 0.0)


def _gathered(edges: Index, values: Float, count: int) -> Float:
    """Sum the values ``(n,)`` of edges ``(n, 2)`` at their vertices ``(count,)``."""
    return np.asarray(np.bincount(edges.reshape(-1), np.repeat(values, 2), count), dtype=np.float64)
