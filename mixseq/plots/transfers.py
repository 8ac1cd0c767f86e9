"""The contact sheet of a transfer: source above, target below, at rest and in some frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from mixseq.arrays import FloatArray, Index
from mixseq.errors import SettingsError
from mixseq.plots.drawing import draw_mesh
from mixseq.plots.sheet_layout import Sheet, Target
from mixseq.scene.camera import View, of_aspect, shared_limits, three_quarter_view, y_up
from mixseq.scene.palettes import INK, part_colours

if TYPE_CHECKING:
    from mixseq.retargeting.transfer import Transfer


def transfer_sheet(
    target: Target,
    transfer: Transfer,
    frames: Sequence[int],
    points: FloatArray,
    title: str | None = None,
) -> None:
    """Draw source and target one above the other, as a PNG: points of the target ``(n, V', 3)``.

    Both have the same view, each at its own scale, with the pose at rest in the first column and common part colours.
    """
    headers = here, there = transfer.source.header, transfer.header
    if points.shape != (len(frames), there.vertex_count, 3):
        raise SettingsError(
            f"points have shape {points.shape}; {(len(frames), there.vertex_count, 3)} is expected, a pose of the "
            "target for every frame"
        )
    moving = transfer.source.points[np.asarray(frames, dtype=np.int64)]
    at_rest = transfer.source.rest, transfer.target
    poses = [np.concatenate([x[None], y]) for x, y in zip(at_rest, (moving, points), strict=True)]
    labels = parts_of_both(transfer)
    palette = part_colours(int(labels[0].max()) + 1)

    near = three_quarter_view(transfer.source.rest, here.up_axis)
    views = near, View(near.azimuth + heading(transfer), near.elevation)
    limits = [
        shared_limits(x, header.up_axis, view) for x, header, view in zip(poses, headers, views, strict=True)
    ]
    aspect = max((top - bottom) / (right - left) for left, right, bottom, top in limits)
    names = title or f"{here.name}: its motion on {there.name}"
    sheet = Sheet.of(2, 1 + len(frames), aspect, names, left=1.25)
    for row, (what, header) in enumerate(zip(("source", "target"), headers, strict=True)):
        sheet.label_row(row, f"{what}\n{header.vertex_count:,}\nvertices")
        ground = float(y_up(poses[row], header.up_axis)[..., 1].min())
        look = header.up_axis, views[row], of_aspect(limits[row], aspect), ground
        for ax, x in zip(sheet.panels[row], poses[row], strict=True):
            draw_mesh(ax, x, header.faces, palette[labels[row]], *look)
    columns = [
        "at rest",
        *(f"frame {here.frame_number(frame)}, {here.times[frame]:.3f} s" for frame in frames),
    ]
    for ax, text in zip(sheet.panels[0], columns, strict=True):
        ax.set_title(text, fontsize=9, color=INK, pad=2)
    sheet.save(target)


def parts_of_both(transfer: Transfer) -> tuple[Index, Index]:
    """Return the parts of source triangles ``(F,)``, and of the target triangles ``(F',)`` that they move.

    For transfers by gradients the parts of the source are found from its motion and mapped to the target.
    """
    from mixseq.retargeting.part_correspondence import carry_labels

    parts = transfer.method.parts
    if parts is not None:
        return parts.part_of_face
    labels = transfer.source.part_of_face()
    return labels, carry_labels(labels, transfer.correspondence, transfer.header.faces)


def heading(transfer: Transfer) -> float:
    """Return the best-fit turn of the target at rest from the source about the up axis, in degrees, 0 if unknown."""
    matched = transfer.correspondence.matched
    source = y_up(
        transfer.correspondence.carry(transfer.source.rest)[matched], transfer.source.header.up_axis
    )
    target = y_up(transfer.target[matched], transfer.header.up_axis)
    a, b = ((x - x.mean(axis=0))[:, [0, 2]] for x in (source, target))
    along, across = float((a * b).sum()), float((a[:, 1] * b[:, 0] - a[:, 0] * b[:, 1]).sum())
    return float(np.degrees(np.arctan2(across, along)))
