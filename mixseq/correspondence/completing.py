"""From a map of vertices, which may leave some out, to a whole correspondence.

*Triangles* of the target are moved by the source triangle of the same three vertices, or else by the closest to the
mean of their mapped corners, of those that face the same way. *Vertices that the map leaves out* follow the nearest
vertex of their component that it does not, and components that it leaves out follow one vertex, as if stuck to it.
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, Index, Mask
from mixseq.correspondence.dense import Correspondence
from mixseq.correspondence.surfaces import Surface


def complete(
    source: Surface, target: Surface, corners: Index, weights: Float, faces: Index
) -> Correspondence:
    """Complete a map of vertices.

    Parameters
    ----------
    source, target : Surface
        The meshes at rest.
    corners : (V', 3) int64
        Source vertices that every target vertex is between; all -1 where it is on nothing. One must be on something.
    weights : (V', 3) float64
        Their weights, which add to one.
    faces : (F',) int64
        The source triangle that moves every target triangle, as far as it is known; elsewhere -1.
    """
    matched = np.asarray((corners >= 0).all(axis=1))
    whole = np.asarray(matched[target.faces].all(axis=1))
    open_faces = np.flatnonzero(whole & (faces < 0))
    faces = np.where(whole, faces, -1)
    faces[open_faces] = _faces_of(source, target, corners, weights, open_faces)
    return Correspondence(
        (len(source.points), len(source.faces)),
        (len(target.points), len(target.faces)),
        corners,
        weights,
        faces,
        _leaders(target, matched),
    )


def _faces_of(source: Surface, target: Surface, corners: Index, weights: Float, chosen: Index) -> Index:
    """The source triangles that move chosen target triangles, by where their corners are."""
    triangles = target.faces[chosen]
    # A corner with all its weight on one vertex is that vertex, which may be written in several ways.
    heaviest = np.take_along_axis(corners, np.argmax(weights, axis=1)[:, None], axis=1)[:, 0]
    exact = _same_triangles(source.faces, heaviest[triangles])
    exact[~(weights.max(axis=1) == 1)[triangles].all(axis=1)] = -1
    rest = np.flatnonzero(exact < 0)
    if rest.size and len(source.faces):
        mapped = np.einsum("vk,vkc->vc", weights, source.points[corners])
        normals = np.einsum("vk,vkc->vc", weights, source.vertex_normals[corners])
        exact[rest] = closest_facing(
            source, mapped[triangles[rest]].mean(axis=1), normals[triangles[rest]].sum(axis=1)
        )[0]
    return exact


def _same_triangles(source: Index, wanted: Index) -> Index:
    """Number of the first source triangle ``(F, 3)`` of the same three vertices as each wanted one, or -1.

    Of two with the same vertices the one that runs the same way round comes first.
    """
    both = np.concatenate([source, wanted])
    first = np.argmin(both, axis=1)
    turned = np.take_along_axis(both, (first[:, None] + np.arange(3)) % 3, axis=1)
    result = np.full(len(wanted), -1)
    for keys in (np.sort(both, axis=1), turned):
        number = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)
        known = np.full(number.max(initial=-1) + 1, -1)
        known[number[: len(source)][::-1]] = np.arange(len(source))[::-1]
        found = known[number[len(source) :]]
        result = np.where(found >= 0, found, result)
    return result


def closest_facing(source: Surface, points: Float, normals: Float) -> tuple[Index, Float]:
    """Triangles, with weights, closest to points; of those that face the same way, if there are any."""
    from mixseq.geometry.nearest import Nearest

    nearest = Nearest.of(source.points, source.faces)
    found = nearest.query(points, normals)
    faces, weights = found.faces.copy(), found.weights.copy()
    lost = np.flatnonzero(faces < 0)
    if lost.size:
        again = nearest.query(points[lost])
        faces[lost], weights[lost] = again.faces, again.weights
    return faces, weights


def _leaders(target: Surface, matched: Mask) -> Index:
    """Whom vertices that are on nothing follow: see the head of this module."""
    from scipy.spatial import cKDTree

    leaders = np.arange(len(target.points))
    component = target.topology.component_of_vertex
    partly = np.isin(component, component[matched])
    near, lost = np.flatnonzero(matched), np.flatnonzero(partly & ~matched)
    # A fourth coordinate keeps components apart: further than anything is in the other three.
    apart = component * (2 * float(np.linalg.norm(np.ptp(target.points, axis=0))) or 1.0)
    places = np.column_stack([target.points, apart])
    leaders[lost] = near[cKDTree(places[near]).query(places[lost])[1]]
    whole = np.flatnonzero(~partly)
    leaders[whole] = target.anchors(whole, near)
    return leaders
