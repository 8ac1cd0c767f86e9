"""From a mesh sequence to a model: shape space, encoding, and signals that are as detailed as is asked for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import SettingsError
from mixseq.progress import Progress, silent
from mixseq.reconstruction.shells import ShellSettings
from mixseq.segmentation import MotionSettings, decompose, segment_by_labels, segment_by_motion
from mixseq.sequence import MeshSequence
from mixseq.signals.detail import Detail, PoseForm, build, encode
from mixseq.signals.model import Model
from mixseq.signals.tolerance import LOSSLESS_TO_THE_EYE, ROUNDS, within
from mixseq.spaces import ShapeSpace, VertexSpace, mixed_space
from mixseq.spaces.mixed import PlacementName
from mixseq.threads import one_blas_thread
from mixseq.topology import Topology

SpaceName = Literal["mixed", "vertex"]
SPACES: tuple[SpaceName, ...] = ("mixed", "vertex")

_STAGES = 4  # finding parts, growing joints, registering parts, encoding frames


def fit(
    sequence: MeshSequence,
    exact: bool = False,
    tolerance: float | None = None,
    rank: int | None = None,
    placement: PlacementName = "anchored",
    parts: int | ArrayLike | None = None,
    joint_width: int = 3,
    space: SpaceName = "mixed",
    *,
    knots: int | ArrayLike | None = None,
    pose: PoseForm = "modes",
    motion: MotionSettings | None = None,
    shell: ShellSettings | None = None,
    progress: Progress = silent,
) -> Model:
    r"""Turn a mesh sequence into a model: time, pose and shape signals in a shape space.

    Without `exact`, `tolerance`, `rank` or `knots` the model is lossless to the eye: no vertex of any frame is off by
    more than 0.0005 of the diagonal, half a pixel where the mesh fills a picture of 1000 pixels.

    Parameters
    ----------
    sequence : MeshSequence
        The animation.
    exact : bool
        Keep everything: the frames are reproduced up to rounding.
    tolerance : float, optional
        Largest distance of a vertex from the original, as a fraction of the bounding box's diagonal in the first
        frame. The model is decoded at all frames to make sure; number of modes and knots follow.
    rank : int, optional
        Number of shape modes; the placement of the parts stays exact.
    placement : {"anchored", "free"}
        How parts are placed: by six numbers each (default), or by registration and six numbers for every
        connected component (the paper's P_m).
    parts : int or (F,) int, optional
        Number of parts, or the part of every triangle; found from the motion if not given.
    joint_width : int
        Largest width of joints, in strips of triangles on each side of a boundary.
    space : {"mixed", "vertex"}
        The shape space: S_m, or vertex positions, which have no use for `placement`, `parts`, `joint_width`.
    knots : int or (n,) array_like, optional
        Inner knots of all curves: how many, evenly spread, or their times in seconds. By default one at (almost)
        every frame, or as few as `tolerance` allows.
    pose : {"modes", "keys"}
        What key shapes are: mean and modes, or frames of the sequence; see `mixseq.signals.pose`.
    motion, shell : optional
        Details of the segmentation and of the joint solves.
    progress : callable, optional
        Told about every stage.

    Returns
    -------
    Model

    Raises
    ------
    SettingsError
        If a setting is out of range, or two contradict each other.
    SegmentationError
        If given parts do not fit the mesh.

    Examples
    --------
    >>> import mixseq
    >>> from mixseq.creature import walk_cycle
    >>> walk = walk_cycle(frames=6)
    >>> mixseq.compare(walk, mixseq.fit(walk).sample()).max_error <= 0.0005
    True
    >>> mixseq.compare(walk, mixseq.fit(walk, exact=True).sample()).max_error < 1e-12
    True
    """
    _check(exact, tolerance, rank, knots, pose, space)
    direct = exact or rank is not None or knots is not None
    steps = _STAGES if direct else _STAGES + ROUNDS

    def tell(done: int, what: str) -> None:
        progress(done, steps, what)

    with one_blas_thread():
        shape_space = _make_space(sequence, space, placement, parts, joint_width, motion, shell, tell)
        tell(_STAGES - 1, "encoding frames")
        encoded = encode(sequence, shape_space, pose)
        tell(_STAGES, "encoding frames")
        if direct:
            return build(encoded, Detail(rank=rank, knots=knots))
        wanted = LOSSLESS_TO_THE_EYE if tolerance is None else float(tolerance)
        return within(encoded, sequence, wanted, lambda done, _, what: tell(_STAGES + done, what))


def _check(
    exact: bool,
    tolerance: float | None,
    rank: int | None,
    knots: int | ArrayLike | None,
    pose: PoseForm,
    space: SpaceName,
) -> None:
    if exact and not (tolerance is None and rank is None and knots is None):
        raise SettingsError("exact models keep everything; leave out tolerance, rank and knots, or exact")
    if tolerance is not None and not (rank is None and knots is None):
        raise SettingsError("tolerance chooses rank and knots; give either tolerance, or rank and knots")
    if tolerance is not None and not (np.isfinite(tolerance) and tolerance > 0):
        raise SettingsError(f"tolerance is {tolerance}; a positive number is expected (or exact=True)")
    if rank is not None and rank < 0:
        raise SettingsError(f"rank is {rank}; zero or more shape modes are expected")
    if pose not in ("modes", "keys"):
        raise SettingsError(f"pose is {pose!r}; 'modes' or 'keys' is expected")
    if space not in SPACES:
        raise SettingsError(f"space is {space!r}; {' or '.join(map(repr, SPACES))} is expected")


def _make_space(
    sequence: MeshSequence,
    space: SpaceName,
    placement: PlacementName,
    parts: int | ArrayLike | None,
    joint_width: int,
    motion: MotionSettings | None,
    shell: ShellSettings | None,
    tell: Callable[[int, str], None],
) -> ShapeSpace:
    if space == "vertex":
        return VertexSpace(sequence.vertex_count, sequence.diagonal or 1.0)
    tell(0, "finding parts")
    topology = Topology(sequence.faces, sequence.vertex_count)
    if parts is None or isinstance(parts, int | np.integer):
        count = None if parts is None else int(parts)
        labels = segment_by_motion(sequence.points, topology, count, motion)
    else:
        labels = segment_by_labels(parts, topology)
    tell(1, "growing joints")
    decomposition = decompose(topology, labels, joint_width, sequence.points)
    tell(2, "registering parts")
    return mixed_space(sequence.points, topology, decomposition, placement, shell)
