r"""Where parts are not rigid: vertices that blends of registered frames would pull together.

A part is blended by its vertices, which shortens every edge that turns against the part. Registered to the part, an
edge e points along :math:`d_t` in frame t and along :math:`\bar d` on average; blending two frames in which it is the
angle :math:`\varphi` off the mean on either side shortens it by the share

.. math:: 1 - \cos\varphi, \qquad \cos\varphi_e = \min_t\, d_t \cdot \bar d .

The paper's joints are strips around boundaries only. But the space does not ask where a joint is: it may as well be
in the middle of a part, under a shoulder blade or around an eye, and lengths and angles do there what vertices cannot.
This is ours, like the numbers below.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.arrays import Float, FloatArray, Index, Mask
from mixseq.errors import SettingsError
from mixseq.geometry.rigid import aligning_rotations
from mixseq.topology import Topology, spread

CORE = 0.1
"""Share of its triangles that a part keeps however soft it is: its stiffest ones."""

SOFT = 3
"""Depth of a soft vertex; its neighbours have one less."""

ROUNDS = 10
"""Rounds of registering the frames of a part, by those of its vertices that fit best."""


@dataclass(frozen=True, eq=False)
class StretchTolerance:
    """How far edges inside parts may be shortened by blending.

    Attributes
    ----------
    frames : (T, V, 3) float
        Some frames that stand for all.
    tolerance : float
        Share of its length that an edge may lose by blending.

    Raises
    ------
    SettingsError
        If the tolerance is not positive.
    """

    frames: FloatArray
    tolerance: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.tolerance) and self.tolerance > 0):
            raise SettingsError(
                f"stretch_tolerance is {self.tolerance}; a positive share of an edge's length is expected"
            )

    def depth(self, topology: Topology, parts: list[Mask]) -> Index:
        """Return the depth ``(V,)`` of vertices in joints inside parts, which are given by their vertices ``(V,)``."""
        soft, core = np.zeros((2, topology.vertex_count), dtype=bool)
        for inside in parts:
            faces = topology.faces[inside[topology.faces].all(axis=1)]
            if not len(faces):
                continue
            vertices = np.unique(faces)
            corners = np.searchsorted(vertices, faces)
            loss = _shortening(self.frames[:, vertices].astype(np.float64), corners)
            of_face = loss[corners].max(axis=1)
            soft[vertices] |= loss > self.tolerance
            core[faces[of_face <= np.quantile(of_face, CORE)]] = True
        depth = spread(topology, np.where(soft & ~core, SOFT, 0))
        return np.where(core, np.minimum(depth, 1), depth)


def _shortening(points: Float, faces: Index) -> Float:
    """Largest share ``(n,)`` that an edge at every vertex of a part ``(T, n, 3)`` loses by blending."""
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    aligned = _registered(points)
    direction = aligned[:, edges[:, 1]] - aligned[:, edges[:, 0]]
    direction = _unit(direction)
    cosines = np.einsum("tei,ei->te", direction, _unit(direction.mean(axis=0)))
    loss = np.zeros(points.shape[1])
    np.maximum.at(loss, edges, (1.0 - cosines.min(axis=0))[:, None])
    return loss


def _registered(points: Float) -> Float:
    """Register the frames of a part ``(T, n, 3)`` to each other, by their stiff vertices rather than by all."""
    weights = np.full(points.shape[1], 1.0 / points.shape[1])
    mean = points[0]
    for _ in range(ROUNDS):
        moved = points - np.einsum("n,tni->ti", weights, points)[:, None]
        rotations = aligning_rotations(np.einsum("n,tni,nj->tij", weights, moved, mean))
        aligned = moved @ rotations
        mean = aligned.mean(axis=0)
        away = np.linalg.norm(aligned - mean, axis=2).max(axis=0)
        usual = max(float(np.median(away)), 1e-9 * float(np.ptp(mean)) + np.finfo(np.float64).tiny)
        weights = np.square(1.0 / (1.0 + np.square(away / usual)))
        weights /= weights.sum()
    return np.asarray(aligned)


def _unit(vectors: Float) -> Float:
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.maximum(lengths, np.finfo(np.float64).tiny))
