"""Find a dense correspondence from markers by registration and matching, and measure its quality."""

from __future__ import annotations

import warnings

import numpy as np

from mixseq.errors import MixseqWarning, SettingsError
from mixseq.mesh.topology import Topology
from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.retargeting.checks import check_facing, check_markers, check_orientation, check_rest_frame
from mixseq.retargeting.markers import Correspondence, Markers, Pairing, pair_components
from mixseq.retargeting.matching import CorrespondenceQuality, assess, match
from mixseq.retargeting.registration import LAST_STIFFNESS, STIFFNESS_STEPS, register
from mixseq.runtime.parallel import one_blas_thread
from mixseq.runtime.progress import Progress, no_progress
from mixseq.runtime.public import public
from mixseq.sequence.sequence import MeshSequence

MIN_MARKED_AREA_SHARE = 0.5  # share of a mesh's area in components with markers, below which a warning is issued
MAX_FILLED_FACE_SHARE = 0.05  # largest share of target triangles without a match; tested pairs have less than 0.01
MAX_FLIPPED_FACE_SHARE = 0.01  # largest share of flipped target triangles; tested pairs have none


@public
def correspond(
    source: MeshSequence,
    target: MeshSequence,
    markers: Markers,
    rest: int = 0,
    progress: Progress = no_progress,
) -> Correspondence:
    """Find a dense correspondence of two meshes from a few markers.

    Parameters
    ----------
    source : MeshSequence
        Mesh whose motion is transferred.
    target : MeshSequence
        Mesh that receives the motion; its first frame is used.
    markers : Markers
        At least four pairs of vertices, spread over the meshes.
    rest : int
        Frame of the source with a pose like the target's.
    progress : callable
        Called with the progress.

    Returns
    -------
    Correspondence
        Source points of the target's vertices. Target components without markers follow other components.

    Raises
    ------
    SettingsError
        If there are fewer than four markers, markers are invalid (see `check_markers`), the frame does not exist, a
        mesh has no faces, the marked components of a mesh have no area, a mesh is inside out, or markers were set on
        another mesh.

    Warns
    -----
    MixseqWarning
        If markers seem exchanged or wrong, components are inside out, or most of a mesh's area has no markers.
    """
    return correspond_and_assess(source, target, markers, rest, progress)[0]


@one_blas_thread()
def correspond_and_assess(
    source: MeshSequence,
    target: MeshSequence,
    markers: Markers,
    rest: int = 0,
    progress: Progress = no_progress,
    last_stiffness: float = LAST_STIFFNESS,
    steps: int = STIFFNESS_STEPS,
) -> tuple[Correspondence, CorrespondenceQuality]:
    """Find a correspondence like `correspond`, and return it with its quality."""
    check_rest_frame(source, rest)
    markers = markers.renumbered(source, target)
    source_mesh, target_mesh = _triangle_mesh(source, rest, "source"), _triangle_mesh(target, 0, "target")
    check_markers(markers, source_mesh.points, target_mesh.points, source_mesh.topology, target_mesh.topology)
    pairings = pair_components(source_mesh.topology, target_mesh.topology, markers)
    _check_areas(source_mesh, target_mesh, pairings)
    check_orientation(source_mesh, target_mesh)
    points = register(source_mesh, target_mesh, pairings, markers, progress, last_stiffness, steps)
    registered = TriangleMesh(points, source_mesh.topology)
    check_facing(registered, target_mesh)
    matches = match(registered, target_mesh, pairings)
    quality = assess(registered, target_mesh, pairings, markers, matches)
    _warn_of_poor_matches(quality, matches.correspondence)
    return matches.correspondence, quality


def _warn_of_poor_matches(quality: CorrespondenceQuality, correspondence: Correspondence) -> None:
    """Warn if many triangles of the target have no match or are flipped."""
    mapped_count = max(int(np.count_nonzero(correspondence.faces >= 0)), 1)
    unmatched = "have no source triangle nearby that faces the same way, and follow their neighbours"
    for count, max_share, problem in (
        (quality.filled_face_count, MAX_FILLED_FACE_SHARE, unmatched),
        (quality.flipped_count, MAX_FLIPPED_FACE_SHARE, "face away from their source triangles"),
    ):
        if count > max_share * mapped_count:
            warnings.warn(
                f"{count} of {mapped_count} mapped triangles of the target {problem}; give both meshes in the same "
                "pose, and check that all markers are on the right component. The picture shows where limbs went",
                MixseqWarning,
                stacklevel=5,
            )


def _check_areas(source: TriangleMesh, target: TriangleMesh, pairings: tuple[Pairing, ...]) -> None:
    """Raise if the marked components of a mesh have no area, and warn if their share of its area is small."""
    for side, mesh, component_faces in (
        ("source", source, [pairing.source_faces for pairing in pairings]),
        ("target", target, [pairing.target_faces for pairing in pairings]),
    ):
        marked_area = float(mesh.face_areas[np.concatenate(component_faces)].sum())
        if not marked_area > 0:
            raise SettingsError(
                f"all markers of the {side} are on components without area; mark vertices of other components"
            )
        share = marked_area / float(mesh.face_areas.sum())
        if share < MIN_MARKED_AREA_SHARE:
            warnings.warn(
                f"components with markers are only {100 * share:.0f} % of the {side}'s area, and all others follow "
                "them as if stuck; mark them too, or weld vertices that are in one place",
                MixseqWarning,
                stacklevel=5,
            )


def _triangle_mesh(sequence: MeshSequence, frame: int, side: str) -> TriangleMesh:
    if not len(sequence.faces):
        raise SettingsError(f"the {side} has no faces; a correspondence is between surfaces")
    points = np.asarray(sequence.points[frame], dtype=np.float64)
    return TriangleMesh(points, Topology(sequence.faces, sequence.vertex_count))
