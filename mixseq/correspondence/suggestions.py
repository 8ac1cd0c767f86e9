"""Suggest markers of two meshes in the same pose: sure pairs of extremities, for a person to confirm.

Limbs, tail, head and ears are found; joints and flanks are for the person to set.
"""

from __future__ import annotations

import numpy as np

from mixseq.correspondence.coarse_surface import CoarseSurface
from mixseq.correspondence.extremities import Extremities
from mixseq.correspondence.extremity_matching import match_extremities
from mixseq.correspondence.markers import Markers
from mixseq.errors import SettingsError
from mixseq.public import public
from mixseq.sequence import MeshSequence
from mixseq.threads import one_blas_thread
from mixseq.topology import Topology


@public
def suggest_markers(source: MeshSequence, target: MeshSequence, rest: int = 0) -> Markers:
    """Suggest markers: tips of limbs, tails, noses and ears, as far as it is sure which is which.

    Both meshes stand in about the same pose, in any orientation and size.

    Parameters
    ----------
    source : MeshSequence
        The mesh that moves.
    target : MeshSequence
        The mesh that shall move like it; its first frame is used.
    rest : int
        The frame of the source whose pose is most like the target's.

    Returns
    -------
    Markers
        Pairs of vertices, those of limbs, tail and head first, each the surest first; none if nothing is sure, as of
        bodies without limbs, or of two different bodies.

    Raises
    ------
    SettingsError
        If the frame does not exist, or a mesh has no area.
    """
    if not -source.frame_count <= rest < source.frame_count:
        raise SettingsError(
            f"the source has no frame {rest}; the rest pose is one of 0 ... {source.frame_count - 1}"
        )
    with one_blas_thread():
        own, other = _extremities(source, rest), _extremities(target, 0)
    pairs = match_extremities(own, other)
    return Markers.of(
        np.array([(own.vertices[each.first], other.vertices[each.second]) for each in pairs], np.int64)
    )


def _extremities(sequence: MeshSequence, frame: int) -> Extremities:
    topology = Topology(sequence.faces, sequence.vertex_count)
    return Extremities.of(CoarseSurface.of(sequence.points[frame], topology))
