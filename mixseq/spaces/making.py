"""Make the shape space of a sequence by its name."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.choices import SPACES, PlacementName, ProjectionName, SpaceName
from mixseq.errors import SettingsError
from mixseq.mesh.topology import Topology
from mixseq.runtime.parallel import Executor, serial_executor
from mixseq.runtime.progress import Progress, StagedProgress, no_progress
from mixseq.segmentation.joints import (
    PartMotion,
    PartShapes,
    decompose,
    join_part_motion,
    measure_part_motion,
    sample_frame_ids,
)
from mixseq.segmentation.methods import Segmentation, resolve_segmentation, segment, segment_by_labels
from mixseq.sequence.sequence import FrameStore, MeshSequence, bounding_diagonal, iterate_blocks
from mixseq.shells.gauss_newton import ShellSettings
from mixseq.spaces.base import ShapeSpace, mean_edge_lengths
from mixseq.spaces.edge import EdgeSettings, EdgeSpace
from mixseq.spaces.gradient import GradientSpace
from mixseq.spaces.lri import LRISpace
from mixseq.spaces.mixed.construction import Purpose, mixed_space
from mixseq.spaces.mixed.mixed_space import MixedSpace
from mixseq.spaces.vertex import VertexSpace

SPACE_STAGES = 3
"""Number of stages; each counts as much progress as one pass over all frames."""


@dataclass(frozen=True, eq=False)
class MixedSettings:
    """Settings of the mixed space."""

    placement: PlacementName = "anchored"  # how parts are placed
    parts: int | ArrayLike | None = None  # number of parts, or part (F,) of triangles; None finds them
    joint_width: int = 3  # largest width of joints, in strips of triangles on each side of a boundary
    segmentation: Segmentation = "motion"  # method that finds parts, or its settings
    purpose: Purpose = "sequence"  # use of the space, see `mixed_space`


@dataclass(frozen=True)
class NoSettings:
    """Empty settings of spaces without options."""


SpaceSettings = MixedSettings | EdgeSettings | NoSettings


class SpaceOptions(TypedDict, total=False):
    """Settings of spaces by name, except the parameters of `mixseq.fit` itself."""

    segmentation: Segmentation
    projection: ProjectionName
    volume: float
    shell: ShellSettings | None


def space_settings(name: SpaceName, **given: Any) -> SpaceSettings:
    """Make the settings of a space from the options by name."""
    _check_name(name)
    known = _default_options(name)
    for setting, value in given.items():
        owners = [other for other in SPACES if setting in _default_options(other)]
        if not owners:
            names = sorted({setting for space in SPACES for setting in _default_options(space)})
            raise SettingsError(f"there is no setting {setting}; settings of spaces are {', '.join(names)}")
        default = _default_options(owners[0])[setting]
        chosen = value is not default and not (np.ndim(value) == 0 and value == default)
        if chosen and setting not in known:
            others = " or ".join(f"space={other!r}" for other in owners)
            raise SettingsError(
                f"the {name} space has no use for {setting}; leave it out, or choose {others}"
            )
    return _SETTINGS[name](**{setting: value for setting, value in given.items() if setting in known})


_SETTINGS: dict[SpaceName, type[SpaceSettings]] = {
    "mixed": MixedSettings,
    "vertex": NoSettings,
    "gradient": NoSettings,
    "lri": NoSettings,
    "edge": EdgeSettings,
}


def _default_options(name: SpaceName) -> dict[str, Any]:
    """Return the options of a space by name, with their defaults."""
    found = {field.name: field.default for field in fields(_SETTINGS[name])}
    found.pop("purpose", None)  # follows from what the space is for
    return found


def _check_name(name: SpaceName) -> None:
    if name not in SPACES:
        raise SettingsError(f"space is {name!r}; one of {', '.join(SPACES)} is expected")


def make_space(
    frames: FrameStore | MeshSequence,
    name: SpaceName = "mixed",
    settings: SpaceSettings | None = None,
    workers: Executor = serial_executor,
    progress: Progress = no_progress,
) -> ShapeSpace:
    """Make the shape space of a sequence."""
    _check_name(name)
    settings = settings or _SETTINGS[name]()
    if not isinstance(settings, _SETTINGS[name]):
        raise SettingsError(
            f"settings are {type(settings).__name__}; the {name} space takes {_SETTINGS[name].__name__}"
        )
    if isinstance(settings, MixedSettings):
        return _make_mixed_space(
            frames, settings, workers, StagedProgress(progress, SPACE_STAGES, len(frames.points))
        )
    header, points = frames.header, frames.points
    first = points[:1][0].astype(np.float64)
    scale = bounding_diagonal(first) or 1.0
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
    lengths = mean_edge_lengths(points, topology.edges, scale, workers, progress)
    return EdgeSpace(
        topology, scale, reference, lengths, replace(settings, shell=settings.shell or ShellSettings())
    )


def segment_faces(
    frames: FrameStore | MeshSequence, settings: MixedSettings, topology: Topology
) -> NDArray[np.int64]:
    """Return the part ``(F,)`` of every triangle in the mixed space, given or found."""
    points, parts = frames.points, settings.parts
    if not (parts is None or isinstance(parts, int | np.integer)):
        return segment_by_labels(parts, topology)
    name, details = resolve_segmentation(settings.segmentation)
    some = points[sample_frame_ids(len(points), details.frames)]
    return segment(some, topology, name, None if parts is None else int(parts), details)


def _make_mixed_space(
    frames: FrameStore | MeshSequence, settings: MixedSettings, workers: Executor, stages: StagedProgress
) -> MixedSpace:
    """Find parts, grow joints between them, and register the parts."""
    header, points = frames.header, frames.points
    stages.at(0)(0, 1, "finding parts")
    topology = Topology(header.faces, header.vertex_count)
    labels = segment_faces(frames, settings, topology)
    watched = PartShapes.from_labels(topology, labels, points[sample_frame_ids(len(points))])
    observed = join_part_motion(
        _with_progress(
            workers(measure_part_motion, watched, iterate_blocks(points)), len(points), stages.at(1)
        )
    )
    decomposition = decompose(topology, labels, settings.joint_width, observed)
    return mixed_space(points, topology, decomposition, settings.placement, settings.purpose, stages.at(2))


def _with_progress(blocks: Iterator[PartMotion], frames: int, progress: Progress) -> Iterator[PartMotion]:
    done = 0
    for block in blocks:
        yield block
        done += len(block.rotations)
        progress(done, frames, "growing joints")
