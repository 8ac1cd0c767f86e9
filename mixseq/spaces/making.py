"""The shape space of a sequence, by its name: what of the frames each space is made of."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.errors import SettingsError
from mixseq.frame_store import FrameStore, blocks_of
from mixseq.mapping import Executor, serially
from mixseq.progress import Progress, Stages, silent
from mixseq.segmentation import (
    Observed,
    Segmentation,
    Softening,
    Watched,
    chosen,
    decompose,
    frames_to_look_at,
    gather,
    observe,
    segment,
    segment_by_labels,
)
from mixseq.sequence import MeshSequence, bounding_diagonal
from mixseq.shells.fitting import ShellSettings
from mixseq.spaces.base import ShapeSpace
from mixseq.spaces.edge.space import EdgeSettings, EdgeSpace
from mixseq.spaces.gradient import GradientSpace
from mixseq.spaces.lri import LRISpace
from mixseq.spaces.mean_lengths import mean_lengths
from mixseq.spaces.mixed import NEVER, MixedSpace, PlacementName, mixed_space
from mixseq.spaces.vertex import VertexSpace
from mixseq.topology import Topology

SpaceName = Literal["mixed", "vertex", "gradient", "lri", "edge"]
SPACES: tuple[SpaceName, ...] = get_args(SpaceName)

MAKING = 3
"""Stages of the work, each of which counts as much as all frames."""


@dataclass(frozen=True, eq=False)
class SpaceSettings:
    """How spaces are made. Every space has a use for some of these only.

    Attributes
    ----------
    placement : {"anchored", "free"}
        Mixed space: how parts are placed.
    parts : int or (F,) int, optional
        Mixed space: number of parts, or the part of every triangle; found from the motion if not given.
    joint_width : int
        Mixed space: largest width of joints, in strips of triangles on each side of a boundary.
    segmentation : {"motion", "silhouettes", "spanning-tree"} or settings of one of these
        Mixed space: how parts are found.
    shrink : float, optional
        Mixed space: joints go on inside parts where blending would shorten an edge by more than this share of its
        length, see `mixseq.segmentation.softness`; by default they are at boundaries only.
    settling_from : float
        Mixed space: from where on lengths and angles are made to agree, see `mixseq.spaces.mixed_space`.
    shell : ShellSettings, optional
        Edge space, projection "dso": the weight of angles, and when Gauss-Newton stops.
    edge : EdgeSettings, optional
        Edge space: which projection, and what else it keeps.
    """

    placement: PlacementName = "anchored"
    parts: int | ArrayLike | None = None
    joint_width: int = 3
    segmentation: Segmentation = "motion"
    shrink: float | None = None
    settling_from: float = NEVER
    shell: ShellSettings | None = None
    edge: EdgeSettings | None = None


_USES: dict[SpaceName, tuple[str, ...]] = {
    "mixed": ("placement", "parts", "joint_width", "segmentation", "shrink", "settling_from"),
    "edge": ("shell", "edge"),
}


def check_space(name: SpaceName, settings: SpaceSettings, usual: SpaceSettings) -> None:
    """Refuse a space that does not exist, and settings that were chosen for nothing.

    Parameters
    ----------
    name : str
        Name of the space.
    settings : SpaceSettings
        The settings.
    usual : SpaceSettings
        What they are where nobody chose any.

    Raises
    ------
    SettingsError
        If the name is none of `SPACES`, or the space has no use for a setting that is not the usual one.
    """
    if name not in SPACES:
        raise SettingsError(f"space is {name!r}; one of {', '.join(SPACES)} is expected")
    uses = _USES.get(name, ())
    for setting in (field.name for field in fields(SpaceSettings)):
        given, default = getattr(settings, setting), getattr(usual, setting)
        chosen = given is not default and not (np.ndim(given) == 0 and given == default)
        if chosen and setting not in uses:
            others = " or ".join(f"space={other!r}" for other in SPACES if setting in _USES.get(other, ()))
            raise SettingsError(
                f"the {name} space has no use for {setting}; leave it out, or choose {others}"
            )


def make_space(
    frames: FrameStore | MeshSequence,
    name: SpaceName = "mixed",
    settings: SpaceSettings | None = None,
    workers: Executor = serially,
    progress: Progress = silent,
) -> ShapeSpace:
    """Make the shape space of a sequence.

    Parameters
    ----------
    frames : FrameStore or MeshSequence
        The sequence. Its first frame is the reference, and its diagonal the unit.
    name : str
        One of `SPACES`.
    settings : SpaceSettings, optional
        How it is made.
    workers : Executor, optional
        Who looks at the frames; the space is the same whoever does.
    progress : callable, optional
        Told about every block of frames.

    Raises
    ------
    SettingsError
        If there is no such space, or a setting is out of range.
    SegmentationError
        If given parts do not fit the mesh.
    """
    settings = settings or SpaceSettings()
    check_space(name, settings, settings)
    header, points = frames.header, frames.points
    if name == "mixed":
        return _mixed(frames, settings, workers, Stages(progress, MAKING, len(points)))
    first = points[:1][0].astype(np.float64)
    scale = bounding_diagonal(first) or 1.0
    if name == "vertex":
        return VertexSpace(header.vertex_count, scale)
    topology, reference = Topology(header.faces, header.vertex_count), first / scale
    if name == "gradient":
        return GradientSpace(topology, scale, reference)
    if name == "lri":
        return LRISpace(topology, scale, reference)
    shell, edge = settings.shell or ShellSettings(), settings.edge or EdgeSettings()
    if settings.shell is not None and edge.projection != "dso":
        raise SettingsError(
            f"projection {edge.projection!r} has no use for shell; leave it out, or choose "
            "edge=EdgeSettings('dso')"
        )
    lengths = mean_lengths(points, topology.edges, scale, workers, progress)
    return EdgeSpace(topology, scale, reference, lengths, shell, edge)


def part_of_faces(frames: FrameStore | MeshSequence, settings: SpaceSettings) -> NDArray[np.int64]:
    """Return the part ``(F,)`` of every triangle in the mixed space: given, or found.

    Raises
    ------
    SettingsError
        If the number of parts is out of range.
    SegmentationError
        If given parts do not fit the mesh.
    """
    header, points, parts = frames.header, frames.points, settings.parts
    topology = Topology(header.faces, header.vertex_count)
    if not (parts is None or isinstance(parts, int | np.integer)):
        return segment_by_labels(parts, topology)
    name, details = chosen(settings.segmentation)
    some = points[frames_to_look_at(len(points), details.frames)]
    return segment(some, topology, name, None if parts is None else int(parts), details)


def _mixed(
    frames: FrameStore | MeshSequence, settings: SpaceSettings, workers: Executor, stages: Stages
) -> MixedSpace:
    """Find the parts, grow the joints between them, register the parts."""
    header, points = frames.header, frames.points
    stages.at(0)(0, 1, "finding parts")
    topology = Topology(header.faces, header.vertex_count)
    labels = part_of_faces(frames, settings)
    looked_at = points[frames_to_look_at(len(points))]
    watched = Watched.of(topology, labels, looked_at)
    observed = gather(_told(workers(observe, watched, blocks_of(points)), len(points), stages.at(1)))
    softening = None if settings.shrink is None else Softening(looked_at, settings.shrink)
    decomposition = decompose(topology, labels, settings.joint_width, observed, softening)
    return mixed_space(
        points, topology, decomposition, settings.placement, settings.settling_from, workers, stages.at(2)
    )


def _told(blocks: Iterator[Observed], frames: int, progress: Progress) -> Iterator[Observed]:
    done = 0
    for block in blocks:
        yield block
        done += len(block.rotations)
        progress(done, frames, "growing joints")
