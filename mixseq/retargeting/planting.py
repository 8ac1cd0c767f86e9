"""Keep named vertices of the target from sliding: find poses of its parts with resting contacts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from mixseq.arrays import Float, FloatArray, Index
from mixseq.disk_array import LargeArray
from mixseq.errors import SettingsError
from mixseq.frame_store import blocks_of
from mixseq.geometry.rotations import turned
from mixseq.mapping import Executor
from mixseq.progress import Progress, silent
from mixseq.retargeting.articulated_body import Contact, leg_ratio
from mixseq.retargeting.footskate import ContactReport, remove_footskate
from mixseq.retargeting.mixed_transfer import MixedTransfer
from mixseq.retargeting.part_correspondence import PartPoses, vertex_parts
from mixseq.sequence import SequenceHeader


@dataclass(frozen=True, eq=False)
class PlantedTransfer:
    """A transfer without sliding contacts."""

    method: MixedTransfer  # the transfer, with the stride of the target's legs
    poses: PartPoses  # of the target's parts in all frames, rotations (T, p', 3, 3) and centres (T, p', 3)
    report: ContactReport  # report of the changes


def plant_contacts(
    method: MixedTransfer,
    points: LargeArray,
    header: SequenceHeader,
    contacts: Mapping[str, ArrayLike],
    workers: Executor,
    progress: Progress = silent,
) -> PlantedTransfer:
    """Find poses in which contacts ``(k,)`` rest as those of the source ``(T, V, 3)``; travel scales with the legs."""
    target, source, correspondence = (
        method.gradients.target,
        method.gradients.source,
        method.gradients.correspondence,
    )
    vertices = {name: _vertices(name, given, header.vertex_count) for name, given in contacts.items()}
    part = vertex_parts(method.parts.target, target.topology)
    on_source = correspondence.carry(source.reference)
    own = [Contact(name, target.reference[chosen], part[chosen]) for name, chosen in vertices.items()]
    theirs = [Contact(name, on_source[chosen], part[chosen]) for name, chosen in vertices.items()]
    ratio = method.gradients.alignment.scale * source.scale / target.scale
    striding = replace(method, stride=leg_ratio(method.source_body, method.body, theirs, own) / ratio)

    chosen = np.concatenate(list(vertices.values()))
    rotations, centres, paths, soles, done = [], [], [], [], 0
    for poses, path, sole in workers(_measure, (striding, chosen, part[chosen]), blocks_of(points)):
        rotations.append(poses.rotations)
        centres.append(poses.centres)
        paths.append(path)
        soles.append(sole)
        done += len(path)
        progress(done, len(points), "placing feet")
    ends = np.cumsum([len(each) for each in vertices.values()])[:-1]
    ways = np.split(np.concatenate(paths) * ratio / source.scale, ends, axis=1)
    local = np.split(np.concatenate(soles), ends, axis=1)
    found = remove_footskate(
        method.body,
        np.concatenate(rotations),
        np.concatenate(centres),
        [replace(contact, local=each) for contact, each in zip(own, local, strict=True)],
        [method.gradients.alignment.turned_points(way) for way in ways],
        header.up_axis,
        header.fps,
        1.0,
    )
    return PlantedTransfer(striding, PartPoses(found.rotations, found.centres), found.report)


def _measure(shared: tuple[MixedTransfer, Index, Index], block: FloatArray) -> tuple[PartPoses, Float, Float]:
    """Return part poses in frames ``(B, V, 3)``, contact vertices on the source, and on the target's rest parts."""
    method, vertices, parts = shared
    poses, soles = [], []
    for x in block:
        smooth = method.by_gradients(x)
        _, moved = method.shapes.register(smooth)
        poses.append(method.poses(x, moved))
        # A paw may bend although it is one with its leg.
        back = np.swapaxes(moved.rotations[parts], 1, 2)
        soles.append(turned(back, smooth[vertices] - moved.centres[parts]) + method.shapes.centres[parts])
    path = np.stack([method.gradients.correspondence.carry(x)[vertices] for x in block])
    return PartPoses(*(np.stack(values) for values in zip(*poses, strict=True))), path, np.stack(soles)


def _vertices(name: str, given: ArrayLike, count: int) -> Index:
    vertices = np.asarray(given)
    if vertices.ndim != 1 or not vertices.size or not np.issubdtype(vertices.dtype, np.integer):
        raise SettingsError(f"contact '{name}' is no list of vertices; give at least one number")
    outside = vertices[(vertices < 0) | (vertices >= count)]
    if outside.size:
        raise SettingsError(
            f"contact '{name}' names vertex {outside[0]}, but those of the target are 0 to {count - 1}"
        )
    return vertices.astype(np.int64)
