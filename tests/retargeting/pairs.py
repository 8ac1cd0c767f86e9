"""Pairs of meshes whose correspondence is known from how they are made."""

from __future__ import annotations

import numpy as np

from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.retargeting.bodies import subdivide
from mixseq.retargeting.gradient_transfer import GradientTransfer, gradient_transfer
from mixseq.retargeting.markers import Correspondence
from mixseq.types import FloatArray
from tests.meshes import Mesh, topology_of


def surface(mesh: Mesh) -> TriangleMesh:
    return TriangleMesh(mesh[0], topology_of(mesh))


def subdivided(mesh: Mesh) -> Mesh:
    """Every triangle cut into four, the middle one last; the points it had come first, then middles of edges."""
    poses, topology = subdivide(mesh[0][None], topology_of(mesh))
    return np.asarray(poses[0], np.float64), topology.faces.astype(np.int64)


def to_subdivided(mesh: Mesh) -> Correspondence:
    """Where the vertices and triangles of `subdivided` are on the mesh."""
    points, faces = mesh
    edges = topology_of(mesh).edges
    own = np.arange(len(points))
    corners = np.concatenate([np.repeat(own[:, None], 3, axis=1), edges[:, [0, 1, 1]]])
    weights = np.repeat([[1.0, 0.0, 0.0], [0.5, 0.5, 0.0]], [len(points), len(edges)], axis=0)
    count = len(points) + len(edges)
    return Correspondence(
        (len(points), len(faces)),
        (count, 4 * len(faces)),
        corners,
        weights,
        np.repeat(np.arange(len(faces)), 4),
        np.arange(count),
    )


def from_subdivided(mesh: Mesh) -> Correspondence:
    """Where the vertices and triangles of the mesh are on `subdivided`."""
    points, faces = mesh
    there, own = to_subdivided(mesh), np.arange(len(points))
    return Correspondence(
        there.target_size,
        there.source_size,
        np.repeat(own[:, None], 3, axis=1),
        np.tile([1.0, 0.0, 0.0], (len(points), 1)),
        4 * np.arange(len(faces)) + 3,
        own,
    )


def same(mesh: Mesh) -> Correspondence:
    """A mesh and another with its triangles."""
    return Correspondence.identity(len(mesh[0]), len(mesh[1]))


def gradients(source: Mesh, target: Mesh, correspondence: Correspondence | None = None) -> GradientTransfer:
    """A transfer of gradients between meshes at rest."""
    return gradient_transfer(
        topology_of(source), source[0], topology_of(target), target[0], correspondence or same(source)
    )


def furthest(first: FloatArray, second: FloatArray) -> float:
    """The largest distance of points ``(..., 3)``."""
    return float(np.linalg.norm(first - second, axis=-1).max())
