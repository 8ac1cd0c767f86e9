"""Make the shape space of a sequence by its name."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from mixseq.choices import SPACES, PlacementName, ProjectionName, SpaceName
from mixseq.errors import SettingsError
from mixseq.mesh.measures import edge_lengths
from mixseq.mesh.topology import Topology
from mixseq.runtime.low_memory import return_freed_memory
from mixseq.runtime.parallel import Executor, serial_executor
from mixseq.runtime.progress import Progress, StagedProgress, log_progress
from mixseq.segmentation.joints import (
    PartMotion,
    PartShapes,
    decompose,
    join_part_motion,
    measure_part_motion,
    sample_frame_ids,
)
from mixseq.segmentation.methods import Segmentation, resolve_segmentation, segment, segment_by_labels
from mixseq.sequence.sequence import FrameStore, MeshSequence, iterate_blocks
from mixseq.shells.fitting import ShellSettings
from mixseq.spaces.base import ShapeSpace, VertexSpace
from mixseq.spaces.edge import EdgeSettings, EdgeSpace
from mixseq.spaces.gradient import GradientSpace
from mixseq.spaces.lri import LRISpace
from mixseq.spaces.mixed.construction import Purpose, mixed_space
from mixseq.spaces.mixed.mixed_space import MixedSpace
from mixseq.types import Index

SPACE_STAGES = 3  # number of progress stages; each takes about as long as one pass over all frames


@dataclass(frozen=True, eq=False)
class MixedSettings:
    """Settings of the mixed space."""

    placement: PlacementName = "anchored"  # placement of parts
    parts: int | ArrayLike | None = None  # number of parts, or part (F,) of triangles; by default segmented
    joint_width: int = 3  # largest width of joints, in strips of triangles on each side of a boundary
    segmentation: Segmentation = "motion"  # segmentation method, or its settings
    purpose: Purpose = "sequence"  # use of the space, see `mixed_space`


@dataclass(frozen=True)
class NoSettings:
    """Settings of spaces without options."""


SpaceSettings = MixedSettings | EdgeSettings | NoSettings


class SpaceOptions(TypedDict, total=False):
    """Keyword settings of all spaces, except settings that are parameters of `mixseq.fit`."""

    segmentation: Segmentation
    projection: ProjectionName
    volume: float
    shell: ShellSettings | None


def space_settings(name: SpaceName, **options: Any) -> SpaceSettings:
    """Make the settings of a space from options by name."""
    _check_name(name)
    defaults = _default_options(name)
    for option, value in options.items():
        owners = [other for other in SPACES if option in _default_options(other)]
        if not owners:
            names = sorted({option for space in SPACES for option in _default_options(space)})
            from difflib import get_close_matches

            near = get_close_matches(option, [*names, "exact", "tolerance", "rank", "space"], n=1)
            cure = f"did you mean {near[0]}?" if near else f"settings of spaces are {', '.join(names)}"
            raise SettingsError(f"there is no setting {option}; {cure}")
        default = _default_options(owners[0])[option]
        is_changed = value is not default and not (np.ndim(value) == 0 and value == default)
        if is_changed and option not in defaults:
            others = " or ".join(f"space={other!r}" for other in owners)
            raise SettingsError(f"the {name} space has no use for {option}; leave it out, or choose {others}")
    return _SETTINGS[name](**{option: value for option, value in options.items() if option in defaults})


_SETTINGS: dict[SpaceName, type[SpaceSettings]] = {
    "mixed": MixedSettings,
    "vertex": NoSettings,
    "gradient": NoSettings,
    "lri": NoSettings,
    "edge": EdgeSettings,
}


def _default_options(name: SpaceName) -> dict[str, Any]:
    """Return the default values of the options of a space by name."""
    return {field.name: field.default for field in fields(_SETTINGS[name]) if field.name != "purpose"}


def _check_name(name: SpaceName) -> None:
    if name not in SPACES:
        raise SettingsError(f"space is {name!r}; one of {', '.join(SPACES)} is expected")


def make_space(
    frames: FrameStore | MeshSequence,
    name: SpaceName = "mixed",
    settings: SpaceSettings | None = None,
    workers: Executor = serial_executor,
    progress: Progress = log_progress,
) -> ShapeSpace:
    """Make the shape space of a sequence."""
    _check_name(name)
    settings = settings or _SETTINGS[name]()
    if not isinstance(settings, _SETTINGS[name]):
        raise SettingsError(
            f"settings are {type(settings).__name__}; the {name} space takes {_SETTINGS[name].__name__}"
        )
    if isinstance(settings, MixedSettings):
        stages = StagedProgress(progress, SPACE_STAGES, len(frames.points))
        return _make_mixed_space(frames, settings, workers, stages)
    header, points = frames.header, frames.points
    first = points[:1][0].astype(np.float64)
    scale = frames.diagonal or 1.0
    if name == "vertex":
        return VertexSpace(header.vertex_count, scale)
    topology, reference = Topology(header.faces, header.vertex_count), first / scale
    if name == "gradient":
        return GradientSpace(topology, scale, reference)
    if name == "lri":
        return LRISpace(topology, scale, reference)
    assert isinstance(settings, EdgeSettings)
    if settings.shell is not None and settings.projection != "dso":
        raise SettingsError(
            f"projection {settings.projection!r} has no use for shell; leave it out, or choose projection='dso'"
        )
    lengths, done = np.zeros(len(topology.edges)), 0
    for block in iterate_blocks(points):
        for frame in block:  # frame by frame, so that the sum does not depend on the blocks
            lengths += edge_lengths(frame.astype(np.float64), topology.edges)
        done += len(block)
        progress(done, len(points), "measuring edges")
    settings = replace(settings, shell=settings.shell or ShellSettings())
    return EdgeSpace(topology, scale, reference, lengths / (len(points) * scale), settings)


def segment_faces(frames: FrameStore | MeshSequence, settings: MixedSettings, topology: Topology) -> Index:
    """Return the part ``(F,)`` of every triangle, given in the settings or found by segmentation."""
    points, parts = frames.points, settings.parts
    if not (parts is None or isinstance(parts, int | np.integer)):
        return segment_by_labels(parts, topology)
    name, details = resolve_segmentation(settings.segmentation)
    sample = points[sample_frame_ids(len(points), details.frames)]
    return segment(sample, topology, name, None if parts is None else int(parts), details)


def _make_mixed_space(
    frames: FrameStore | MeshSequence, settings: MixedSettings, workers: Executor, stages: StagedProgress
) -> MixedSpace:
    """Segment parts, grow joints between them, and register the parts."""
    header, points = frames.header, frames.points
    stages.at(0)(0, 1, "finding parts")
    topology = Topology(header.faces, header.vertex_count)
    labels = segment_faces(frames, settings, topology)
    return_freed_memory()
    shapes = PartShapes.from_labels(topology, labels, points[sample_frame_ids(len(points))])
    blocks = workers(measure_part_motion, shapes, iterate_blocks(points))
    motion = join_part_motion(_with_progress(blocks, len(points), stages.at(1)))
    decomposition = decompose(topology, labels, settings.joint_width, motion)
    return_freed_memory()
    space = mixed_space(points, topology, decomposition, settings.placement, settings.purpose, stages.at(2))
    if space.joint_faces.any():
        return space
    return space.with_weights(topology=Topology(header.faces, header.vertex_count))  # needs no tables of edges


def _with_progress(blocks: Iterator[PartMotion], frames: int, progress: Progress) -> Iterator[PartMotion]:
    done = 0
    for block in blocks:
        yield block
        done += len(block.rotations)
        progress(done, frames, "growing joints")
