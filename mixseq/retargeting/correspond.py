"""Find a dense correspondence from markers: register, match, and measure its quality."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field

import numpy as np

from mixseq.errors import MixseqWarning, SettingsError
from mixseq.mesh.topology import Topology
from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.retargeting.checks import check_facing, check_markers, check_orientation, check_rest
from mixseq.retargeting.markers import Correspondence, Markers, Pairing, pair_components
from mixseq.retargeting.matching import CorrespondenceQuality, MatchingSettings, assess, match
from mixseq.retargeting.registration import RegistrationSettings, register
from mixseq.runtime.parallel import one_blas_thread
from mixseq.runtime.progress import Progress, no_progress
from mixseq.runtime.public import public
from mixseq.sequence.sequence import MeshSequence

LITTLE = 0.5
"""Share of a mesh's area in components with markers below which a warning is given."""

FILLED, FLIPPED = 0.05, 0.01
"""Shares of target triangles without a match, or flipped, that are worth a warning; tried pairs have < 0.01 and 0."""


@dataclass(frozen=True)
class CorrespondenceSettings:
    """Settings of registration and matching."""

    registration: RegistrationSettings = field(default_factory=RegistrationSettings)
    matching: MatchingSettings = field(default_factory=MatchingSettings)


@public
def correspond(
    source: MeshSequence,
    target: MeshSequence,
    markers: Markers,
    rest: int = 0,
    settings: CorrespondenceSettings | None = None,
    progress: Progress = no_progress,
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
        Settings of registration and matching.
    progress : callable
        Called with the progress.

    Returns
    -------
    Correspondence
        Components of the target without a marker follow the rest.

    Raises
    ------
    SettingsError
        If there are fewer than four markers, markers are invalid (see `check_markers`), the frame does not exist, a
        mesh has no faces or no area where it is marked, or one is inside out.

    Warns
    -----
    MixseqWarning
        If markers seem exchanged or wrong, components are inside out, or most of a mesh has no markers.
    """
    return correspond_and_assess(source, target, markers, rest, settings, progress)[0]


@one_blas_thread()
def correspond_and_assess(
    source: MeshSequence,
    target: MeshSequence,
    markers: Markers,
    rest: int = 0,
    settings: CorrespondenceSettings | None = None,
    progress: Progress = no_progress,
) -> tuple[Correspondence, CorrespondenceQuality]:
    """Find a correspondence like `correspond`, and its quality."""
    settings = CorrespondenceSettings() if settings is None else settings
    check_rest(source, rest)
    start, goal = _mesh(source, rest, "source"), _mesh(target, 0, "target")
    check_markers(markers, start.points, goal.points, start.topology, goal.topology)
    pairings = pair_components(start.topology, goal.topology, markers)
    _check_areas(start, goal, pairings)
    check_orientation(start.points, start.faces, goal.points, goal.faces)
    points = register(start, goal, pairings, markers, settings.registration, progress).points
    check_facing(points, start.faces, goal.points, goal.faces)
    registered = TriangleMesh(points, start.topology)
    matches = match(registered, goal, pairings, settings.matching)
    quality = assess(registered, goal, pairings, markers, matches, settings.matching)
    _warn_of(quality, matches.correspondence)
    return matches.correspondence, quality


def _warn_of(quality: CorrespondenceQuality, correspondence: Correspondence) -> None:
    """Warn if much of the target has no counterpart, or a flipped one."""
    mapped = max(int(np.count_nonzero(correspondence.faces >= 0)), 1)
    for count, most, what in (
        (
            quality.filled_face_count,
            FILLED,
            "found nothing near that faces the same way, and move like their neighbours",
        ),
        (quality.flipped_count, FLIPPED, "face away from what they correspond to"),
    ):
        if count > most * mapped:
            warnings.warn(
                f"{count} of the {mapped} triangles of the target that should have a counterpart {what}; are both "
                "meshes in the same pose, and all markers on the right component? The picture tells where limbs went",
                MixseqWarning,
                stacklevel=5,
            )


def _check_areas(source: TriangleMesh, target: TriangleMesh, pairings: tuple[Pairing, ...]) -> None:
    """Raise if marked components have no area; warn if they are a small part of the mesh."""
    for what, mesh, chosen in (
        ("source", source, [pairing.source_faces for pairing in pairings]),
        ("target", target, [pairing.target_faces for pairing in pairings]),
    ):
        marked = float(mesh.face_areas[np.concatenate(chosen)].sum())
        if not marked > 0:
            raise SettingsError(
                f"all markers of the {what} are on components whose triangles have no area; mark vertices of others"
            )
        share = marked / float(mesh.face_areas.sum())
        if share < LITTLE:
            warnings.warn(
                f"components with markers are only {100 * share:.0f} % of the {what}'s area, and all others follow "
                "them as if stuck; mark them too, or weld vertices that are in one place",
                MixseqWarning,
                stacklevel=5,
            )


def _mesh(sequence: MeshSequence, frame: int, what: str) -> TriangleMesh:
    if not len(sequence.faces):
        raise SettingsError(f"the {what} has no faces; a correspondence is between surfaces")
    points = np.asarray(sequence.points[frame], dtype=np.float64)
    return TriangleMesh(points, Topology(sequence.faces, sequence.vertex_count))
