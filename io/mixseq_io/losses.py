"""Contents that a format cannot hold, in words, for its writer's single warning."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from mixseq.frame_numbers import NEAR
from mixseq.sequence import DEFAULT_FPS, SequenceHeader
from mixseq.surface import CornerValues, Surface
from mixseq_io.blocks import warn
from mixseq_io.colours import within_one

_SCALE = (" up", " metres per unit")


def lost_scale(header: SequenceHeader, moving: bool) -> list[str]:
    """Return the losses of formats without up axis, units and velocities."""
    lost = []
    if header.up_axis != "Y":
        lost.append(f"{header.up_axis} up")
    if header.metres_per_unit != 1.0:
        lost.append(f"{header.metres_per_unit:g} metres per unit")
    if moving:
        lost.append("velocities")
    return lost


def lost_times(header: SequenceHeader, first_number: float) -> list[str]:
    """Return the losses of formats that number frames from `first_number` on and are read at 24 frames per second."""
    if header.frame_count == 1:  # a single frame has no rate
        return []
    lost = []
    if header.fps != DEFAULT_FPS:
        lost.append(f"{header.fps:g} frames per second")
    if not np.abs(header.times * header.fps - (first_number + np.arange(header.frame_count))).max() <= NEAR:
        lost.append("the times of the frames")
    return lost


def lost_surface(header: SequenceHeader, held: Collection[str] = ()) -> list[str]:
    """Return the fields of `mixseq.surface.Surface` that are lost, all but those in `held`."""
    surface = header.surface
    present = {
        "uvs": surface.uvs is not None and "texture coordinates",
        "colours": surface.colours is not None and "colours",
        "hard_edges": surface.hard_edges is not None and "hard edges",
        "face_sets": bool(surface.face_sets) and "face sets",
        "objects": len(surface.objects) > 1 and f"the names of {len(surface.objects)} objects",
        "subdivision": lost_subdivision(surface),
    }
    return [words for name, words in present.items() if words and name not in held]


def lost_polygons(header: SequenceHeader) -> list[str]:
    """Return the losses of formats with triangles only."""
    return [] if header.polygons.only_triangles else ["polygons (they are cut into triangles)"]


def lost_colours(header: SequenceHeader, *, corners: bool = True, alpha: bool = True) -> list[str]:
    """Return the losses of formats with colours from 0 to 1; optionally of vertices only, or opaque."""
    colours = header.surface.colours
    if colours is None:
        return []
    values = colours.values[np.unique(colours.indices)]
    kept = values[:, : 4 if alpha else 3]
    written = CornerValues(within_one(colours.values[:, : kept.shape[1]]), colours.indices)
    below, above = bool((kept < 0).any()), bool((kept > 1).any())
    lost = {
        "colours below 0 and above 1 (0 and 1 are written)": below and above,
        "colours below 0 (0 is written)": below and not above,
        "colours above 1 (1 is written)": above and not below,
        "colours that are no numbers (0 is written)": np.isnan(kept).any(),
        "several colours at a vertex (that of its first corner is written)": not (
            corners or written.one_per_vertex(header.polygons.indices)
        ),
        "the alpha of colours": not (alpha or (values[:, 3] == 1).all()),
    }
    return [words for words, is_lost in lost.items() if is_lost]


def lost_subdivision(surface: Surface) -> str:
    """Return the words for lost subdivision, "" without a scheme."""
    schemes = [each for each in dict.fromkeys(surface.subdivisions) if each != "none"]
    return f"{' and '.join(schemes)} subdivision" if schemes else ""


def warn_of_losses(path: Path, files: str, lost: Sequence[str]) -> None:
    """Warn once of all losses of files of a kind ("OBJ files"), if there are any."""
    if lost:
        convert = "; convert_units (--convert-axes Y, --convert-units m) turns and scales the sequence"
        hint = convert if any(each.endswith(_SCALE) for each in lost) else ""
        warn(f"{path}: {files} cannot hold {', '.join(lost)}; USD, .npz and .h5 can{hint}")
