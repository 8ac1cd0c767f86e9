"""The parts of frames, registered to their mean shapes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixseq.geometry.rigid import kabsch
from mixseq.geometry.rotations import continuous_vectors
from mixseq.reconstruction.links import Links, make_links
from mixseq.segmentation.joints import Decomposition
from mixseq.sequence import FloatArray
from mixseq.topology import Topology

Float = NDArray[np.float64]

SMALLEST = 1e-3
"""Radius of a part that has none, in diagonals."""


def registered(shapes: Float, decomposition: Decomposition, x: FloatArray) -> tuple[Float, Float, Float]:
    """Register the parts of frames ``(T, V, 3)`` to their mean shapes.

    Returns the vertices as aligned to the shapes ``(T, N, 3)``, rotations ``(T, p, 3, 3)`` and centres ``(T, p, 3)``.
    """
    aligned, rotations, centres = [], [], []
    start = 0
    for vertices in decomposition.parts:
        rotation, centre = kabsch(shapes[start : start + len(vertices)], x[:, vertices])
        aligned.append((x[:, vertices] - centre[:, None]) @ rotation)
        rotations.append(rotation)
        centres.append(centre)
        start += len(vertices)
    return np.concatenate(aligned, axis=1), np.stack(rotations, axis=1), np.stack(centres, axis=1)


def radii_of_gyration(shapes: Float, decomposition: Decomposition) -> Float:
    """Return the radii of gyration ``(p,)`` of centred shapes ``(N, 3)``, part by part, at least `SMALLEST`."""
    squares = np.square(shapes).sum(axis=1)
    sizes = [len(vertices) for vertices in decomposition.parts]
    starts = np.cumsum([0, *sizes[:-1]])
    return np.maximum(np.sqrt(np.add.reduceat(squares, starts) / sizes), SMALLEST)


def links_between(
    points: FloatArray, topology: Topology, decomposition: Decomposition, shapes: Float
) -> Links:
    """Find the links between the parts of a sequence ``(T, V, 3)``, in diagonals; see `make_links`."""
    _, turned, centres = registered(shapes, decomposition, points)
    rotations = continuous_vectors(turned)
    radii = radii_of_gyration(shapes, decomposition)
    return make_links(points, topology, decomposition.part_of_face, rotations, centres, radii)
