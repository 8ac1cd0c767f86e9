"""From a mesh sequence to a model: segmentation, joints, registration, encoding."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import SettingsError
from mixseq.progress import Progress, silent
from mixseq.reconstruction.shells import ShellSettings
from mixseq.segmentation import MotionSettings, decompose, segment_by_labels, segment_by_motion
from mixseq.sequence import MeshSequence
from mixseq.signals.model import Model
from mixseq.spaces.mixed import PlacementName, mixed_space
from mixseq.threads import one_blas_thread
from mixseq.topology import Topology


def fit(
    sequence: MeshSequence,
    exact: bool = True,
    placement: PlacementName = "anchored",
    parts: int | ArrayLike | None = None,
    joint_width: int = 3,
    *,
    motion: MotionSettings | None = None,
    shell: ShellSettings | None = None,
    progress: Progress = silent,
) -> Model:
    """Take a mesh sequence into the mixed shape space S_m.

    Parameters
    ----------
    sequence : MeshSequence
        The animation.
    exact : bool
        Keep every frame. Only exact models can be made so far.
    placement : {"anchored", "free"}
        How parts are placed: by six numbers each (default), or by registration and six numbers for every
        connected component (the paper's P_m).
    parts : int or (F,) int, optional
        Number of parts, or the part of every triangle; found from the motion if not given.
    joint_width : int
        Largest width of joints, in strips of triangles on each side of a boundary.
    motion, shell : optional
        Details of the segmentation and of the joint solves.
    progress : callable, optional
        Told about every stage.

    Returns
    -------
    Model
        Reproduces the frames up to rounding.

    Raises
    ------
    SettingsError
        If a setting is out of range.
    SegmentationError
        If given parts do not fit the mesh.

    Examples
    --------
    >>> import mixseq
    >>> from mixseq.creature import walk_cycle
    >>> walk = walk_cycle(frames=6)
    >>> model = mixseq.fit(walk)
    >>> mixseq.compare(walk, model.sample()).max_error < 1e-12
    True
    """
    if not exact:
        raise SettingsError("only exact models can be made; leave out exact=False")
    with one_blas_thread():
        return _fit(sequence, placement, parts, joint_width, motion, shell, progress)


def _fit(
    sequence: MeshSequence,
    placement: PlacementName,
    parts: int | ArrayLike | None,
    joint_width: int,
    motion: MotionSettings | None,
    shell: ShellSettings | None,
    progress: Progress,
) -> Model:
    stages = 4
    progress(0, stages, "finding parts")
    topology = Topology(sequence.faces, sequence.vertex_count)
    if parts is None or isinstance(parts, int | np.integer):
        count = None if parts is None else int(parts)
        labels = segment_by_motion(sequence.points, topology, count, motion)
    else:
        labels = segment_by_labels(parts, topology)
    progress(1, stages, "growing joints")
    decomposition = decompose(topology, labels, joint_width, sequence.points)
    progress(2, stages, "registering parts")
    space = mixed_space(sequence.points, topology, decomposition, placement, shell)
    progress(3, stages, "encoding frames")
    vectors = space.encode(sequence.points)
    progress(4, stages, "encoding frames")
    return Model(header=sequence.header, space=space, vectors=vectors)
