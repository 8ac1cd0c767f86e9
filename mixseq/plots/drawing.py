"""One mesh in one panel: shaded polygons from back to front, above their shadow."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mixseq.arrays import Float, FloatArray, Index, IntArray
from mixseq.plots.shading import area_normals, ground_shadow, shade, smooth_normals
from mixseq.plots.sheet_layout import matplotlib_module
from mixseq.scene.camera import Limits, View, shared_limits, three_quarter_view, y_up
from mixseq.scene.palettes import CLAY
from mixseq.topology import Topology

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_mesh(
    ax: Axes,
    points: FloatArray,
    faces: IntArray,
    colours: ArrayLike = CLAY,
    up_axis: str = "Y",
    view: View | None = None,
    limits: Limits | None = None,
    ground: float | None = None,
    contrast: float = 1.0,
) -> None:
    """Draw a shaded mesh.

    Parameters
    ----------
    ax : matplotlib Axes
        Where to draw; its aspect becomes equal and its frame disappears.
    points : (V, 3) float
        Vertex positions.
    faces : (F, 3) int
        Triangles. Closed meshes are drawn without back faces, open ones from both sides.
    colours : (3,) or (F, 3) float
        RGB in 0..1 of the mesh or of each face.
    up_axis : {"X", "Y", "Z"}
        Axis that points up.
    view : View, optional
        The camera, by default `three_quarter_view`.
    limits : (4,) float, optional
        Screen rectangle from `shared_limits`, by default that of this pose.
    ground : float, optional
        Height of the ground that takes the shadow, by default the lowest vertex.
    contrast : float
        Strength of the shading, from 0 (flat colours) to 1.
    """
    view = view or three_quarter_view(points, up_axis)
    limits = limits or shared_limits(points, up_axis, view)
    world = y_up(points, up_axis)
    floor = float(world[:, 1].min()) if ground is None else ground
    shadow = ground_shadow(world, faces, floor, view, limits)
    ax.imshow(shadow, extent=limits, origin="lower", interpolation="bilinear", zorder=1)

    screen = world @ view.rows.T
    normals = area_normals(screen, faces)
    order = _back_to_front(screen, faces, normals)
    to_camera = np.where(normals[:, 2:] < 0, -1, 1)
    rgb = np.broadcast_to(np.asarray(colours, dtype=np.float64), (len(faces), 3))
    lit = shade(rgb, to_camera * smooth_normals(normals, faces, len(points)), contrast)[order]
    polygons = matplotlib_module("collections").PolyCollection(
        screen[faces[order], :2], facecolors=lit, edgecolors=lit, linewidths=0.25, zorder=2
    )
    ax.add_collection(polygons, autolim=False)
    ax.set(xlim=limits[:2], ylim=limits[2:], aspect="equal")
    ax.set_axis_off()


def _back_to_front(screen: Float, faces: IntArray, normals: Float) -> Index:
    """Sort faces for painting; back faces of a closed mesh are left out."""
    corners = screen[faces]
    inside_out = np.sum((corners[:, 0] - screen.mean(axis=0)) * normals) < 0
    hidden = (normals[:, 2] >= 0) if inside_out else (normals[:, 2] <= 0)
    # at the outline of an open mesh, front faces go above the back faces next to them
    depth = corners[..., 2].mean(axis=1) - 0.03 * np.ptp(screen[:, 2]) * hidden
    order = np.argsort(depth, kind="stable")
    return order[~hidden[order]] if _is_closed(Topology(faces, len(screen))) else order


def _is_closed(topology: Topology) -> bool:
    """Whether every edge has two faces, of the same orientation."""
    loose = topology.boundary_edges, topology.non_manifold_edges, topology.inconsistent_edges
    return not any(edges.size for edges in loose)
