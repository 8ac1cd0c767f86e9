"""From markers to a dense correspondence: register, match, and say how good it is."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mixseq.correspondence.checks import check_markers, check_orientation
from mixseq.correspondence.dense import Correspondence
from mixseq.correspondence.markers import Markers
from mixseq.correspondence.matching import MatchingSettings, match
from mixseq.correspondence.pairing import pair_components
from mixseq.correspondence.quality import Quality, assess
from mixseq.correspondence.registration import RegistrationSettings, register
from mixseq.correspondence.surfaces import Surface
from mixseq.errors import SettingsError
from mixseq.progress import Progress, silent
from mixseq.sequence import MeshSequence
from mixseq.topology import Topology


@dataclass(frozen=True)
class CorrespondenceSettings:
    """How a correspondence is found: how the source is registered, and what matches."""

    registration: RegistrationSettings = field(default_factory=RegistrationSettings)
    matching: MatchingSettings = field(default_factory=MatchingSettings)


@dataclass(frozen=True, eq=False)
class Assessed:
    """A correspondence and how good it is."""

    correspondence: Correspondence
    quality: Quality


def correspond(
    source: MeshSequence,
    target: MeshSequence,
    markers: Markers,
    rest: int = 0,
    settings: CorrespondenceSettings | None = None,
    progress: Progress = silent,
) -> Correspondence:
    """Find which point of a source every vertex of a target is, from a few markers.

    Parameters
    ----------
    source : MeshSequence
        The mesh that moves.
    target : MeshSequence
        The mesh that shall move like it; its first frame is used.
    markers : Markers
        At least four pairs of vertices, spread over the meshes.
    rest : int
        The frame of the source whose pose is most like the target's.
    settings : CorrespondenceSettings, optional
        How it is done.
    progress : callable
        Told how far it is.

    Returns
    -------
    Correspondence
        Components of the target that have no marker follow the rest.

    Raises
    ------
    SettingsError
        If there are fewer than four markers, markers cannot be meant as they are (see `check_markers`), the frame does
        not exist, a mesh has no faces, or one is inside out.

    Warns
    -----
    MixseqWarning
        If markers seem exchanged or wrong, or components are inside out.
    """
    return correspond_and_assess(source, target, markers, rest, settings, progress).correspondence


def correspond_and_assess(
    source: MeshSequence,
    target: MeshSequence,
    markers: Markers,
    rest: int = 0,
    settings: CorrespondenceSettings | None = None,
    progress: Progress = silent,
) -> Assessed:
    """Find a correspondence like `correspond`, and how good it is."""
    settings = CorrespondenceSettings() if settings is None else settings
    if not -source.frame_count <= rest < source.frame_count:
        raise SettingsError(
            f"the source has no frame {rest}; the rest pose is one of 0 ... {source.frame_count - 1}"
        )
    start, goal = _surface(source, rest, "source"), _surface(target, 0, "target")
    check_markers(markers, start.points, goal.points, start.topology, goal.topology)
    pairings = pair_components(start.topology, goal.topology, markers)
    points = register(start, goal, pairings, markers, settings.registration, progress).points
    check_orientation(start.points, start.faces, goal.points, goal.faces, points)
    registered = Surface(points, start.topology)
    matches = match(registered, goal, pairings, settings.matching)
    quality = assess(registered, goal, pairings, markers, matches, settings.matching)
    return Assessed(matches.correspondence, quality)


def _surface(sequence: MeshSequence, frame: int, what: str) -> Surface:
    if not len(sequence.faces):
        raise SettingsError(f"the {what} has no faces; a correspondence is between surfaces")
    points = np.asarray(sequence.points[frame], dtype=np.float64)
    return Surface(points, Topology(sequence.faces, sequence.vertex_count))
