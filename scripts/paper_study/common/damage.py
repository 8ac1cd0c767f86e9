"""Poses that are damaged: noise on all vertices, and a patch that is pushed through the surface behind it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixseq.mesh.measures import corner_normals
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.rigid import kabsch
from mixseq.mesh.rotations import quat_to_matrix
from mixseq.pictures.scene import View, to_y_up
from mixseq.shells.face_frames import triangle_frames
from mixseq.types import Index, index_mask
from scripts.paper_study.common.poses import Poses

OPPOSITE = -0.7  # cosine of normals below which one side of a limb is opposite the other
BEYOND = 1.5  # distance by which a patch is pushed, over the thickness of the limb
SIZE = 0.6  # radius of the patch, over the thickness of the limb
SEEN = 0.5  # cosine between normal and camera above which a patch is seen
MAX_TRIED = 400  # approximate number of vertices that are tried


def noisy(poses: Poses, share: float, seed: int) -> Poses:
    """Move every vertex of every pose by normal noise, its deviation a share of the mean edge length."""
    size = share * float(poses.lengths.mean())
    return poses.moved(poses.points + np.random.default_rng(seed).normal(0, size, poses.points.shape))


def placement_noise(poses: Poses, share: float, seed: int) -> tuple[float, float, float]:
    """Return how far noise moves a mesh that is placed by a face or by registration, rms in mean edge lengths.

    The first face and the barycentre, as the paper says; the median of all faces; and the registered mesh.
    """
    x, faces = poses.points[0], poses.sequence.faces
    y = noisy(poses, share, seed).points[0]
    before, after = (quat_to_matrix(triangle_frames(points, faces)) for points in (x, y))
    turns = np.concatenate([after @ np.swapaxes(before, 1, 2), kabsch(x, y)[0][None]]) - np.eye(3)
    spread = np.cov(x.T, bias=True)
    moved = np.sqrt(np.einsum("fij,jk,fik->f", turns, spread, turns)) / float(poses.lengths.mean())
    return float(moved[0]), float(np.median(moved[:-1])), float(moved[-1])


class Pushed(NamedTuple):
    """Poses whose second one has a patch pushed through the surface, and the moved vertices ``(k,)``."""

    poses: Poses
    vertices: Index
    middle: int
    thickness: float


def pushed(poses: Poses, rigid: Index, view: View) -> Pushed:
    """Push a patch of a rigid part through the other side of its limb, in the second pose.

    Its middle is the vertex of `rigid` in the thinnest place whose patch is in `rigid` and whose normal points to the
    camera; there is a ValueError without one.
    """
    x, faces = poses.points[1], poses.sequence.faces
    normals = corner_normals(x[None], Polygons.from_triangles(faces))[0].astype(np.float64)
    inside = index_mask(rigid, len(x))
    edge = float(poses.lengths[1].mean())
    best: Pushed | None = None
    seen = rigid[to_y_up(normals[rigid], poses.sequence.up_axis) @ view.rotation[2] > SEEN]
    for vertex in seen[:: max(1, len(seen) // MAX_TRIED)].tolist():
        away = np.linalg.norm(x - x[vertex], axis=1)
        opposite = (normals @ normals[vertex] < OPPOSITE) & ((x - x[vertex]) @ normals[vertex] < -0.7 * away)
        if not opposite.any():
            continue
        thickness = float(away[opposite].min())
        patch = np.flatnonzero((away < SIZE * thickness) & (normals @ normals[vertex] > 0))
        if thickness < 5 * edge or not inside[patch].all() or (best and thickness >= best.thickness):
            continue
        bump = np.square(1 - np.square(away[patch] / (SIZE * thickness)))
        moved = poses.points.copy()
        moved[1, patch] -= BEYOND * thickness * bump[:, None] * normals[vertex]
        best = Pushed(poses.moved(moved), patch, vertex, thickness)
    if best is None:
        raise ValueError("no part is thin and large enough to push a patch of it through the other side")
    return best
