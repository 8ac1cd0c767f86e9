"""Names of options in Python and on the command line, in a module that is quick to import.

The options are implemented in `mixseq.segmentation.METHODS`, `mixseq.spaces.making` and `mixseq.retargeting.transfer`.
"""

from __future__ import annotations

from typing import Literal, get_args

SpaceName = Literal["mixed", "vertex", "gradient", "lri", "edge"]
SPACES: tuple[SpaceName, ...] = get_args(SpaceName)
"""Shape spaces: parts and joints, vertices, deformation gradients, LRI coordinates, lengths and angles of edges."""

PlacementName = Literal["anchored", "free"]
PLACEMENTS: tuple[PlacementName, ...] = get_args(PlacementName)
"""Placements of parts in the mixed space: by a pose of each part, or by edge lengths and dihedral angles."""

SegmentationName = Literal["motion", "silhouettes", "spanning-tree"]
SEGMENTATIONS: tuple[SegmentationName, ...] = get_args(SegmentationName)
"""Methods of segmentation."""

ProjectionName = Literal["steps", "dso"]
PROJECTIONS: tuple[ProjectionName, ...] = get_args(ProjectionName)
"""Projections of the edge space to meshes: a few steps, or Gauss-Newton iteration until convergence."""

BetweenName = Literal["auto", "smooth", "linear", "hold", "vertices"]
BETWEENS: tuple[BetweenName, ...] = get_args(BetweenName)
"""Motion between frames: as found in them, smooth through repeated poses and keys, straight, none, or of vertices."""

TransferName = Literal["mixed", "gradients"]
TRANSFERS: tuple[TransferName, ...] = get_args(TransferName)
"""Methods of motion transfer: by parts and joints, or by deformation gradients."""

OrderName = Literal["keep", "vertices", "free"]
ORDERS: tuple[OrderName, ...] = get_args(OrderName)
"""Elements whose order a compressed file keeps: vertices and faces, only vertices, or no elements."""

StillName = Literal["draco", "plain", "none"]
STILLS: tuple[StillName, ...] = get_args(StillName)
"""Storage of the first frame in a .glb with a compressed model: compressed by Draco, as float32, or omitted."""

PictureKind = Literal[
    "embedding", "coefficients", "singular-values", "parts", "error-frames", "error-vertices", "values"
]
PICTURES: tuple[PictureKind, ...] = get_args(PictureKind)
"""Kinds of pictures of a model."""

UNITS = {"mm": 0.001, "cm": 0.01, "m": 1.0, "km": 1000.0, "in": 0.0254, "ft": 0.3048, "yd": 0.9144}
"""Units of length by name, in metres."""

Colour = Literal["values", "clay", "own", "parts", "error", "strain", "curvature"]
COLOURS: tuple[Colour, ...] = get_args(Colour)
"""Colourings of meshes in films."""
