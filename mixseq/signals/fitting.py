"""Fit models to mesh sequences: shape space, encoding, and signals of a given detail.

How poses are predicted, and the share of lengths and angles, are chosen by leaving frames out: inner frames are
predicted from the others, in each way, and compared by positions, edge lengths and hinge angles.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike

from mixseq.choices import POSE_FORMS, PlacementName, PoseForm, SpaceName
from mixseq.errors import SettingsError
from mixseq.mesh.measures import wrap_angles
from mixseq.runtime.low_memory import LargeArray
from mixseq.runtime.parallel import Executor, one_blas_thread, thread_executor
from mixseq.runtime.progress import Progress, StagedProgress, no_progress
from mixseq.runtime.public import public
from mixseq.sequence.sequence import Frames, check_frames, load_frames
from mixseq.shells.gauss_newton import ShellSettings
from mixseq.shells.kernels import lengths_and_angles
from mixseq.signals.detail import (
    EXACT_ROUNDING_STEP,
    EXACT_TOLERANCE,
    MAX_TRIAL_MODELS,
    VISUALLY_LOSSLESS_TOLERANCE,
    Detail,
    EncodedSequence,
    build_model,
    encode_sequence,
    fit_within_tolerance,
    verify_tolerance,
)
from mixseq.signals.model import Model
from mixseq.spaces.edge import EdgeSettings
from mixseq.spaces.making import SPACE_STAGES, MixedSettings, SpaceOptions, make_space, space_settings
from mixseq.spaces.mixed.mixed_space import MixedBlocks, MixedSpace
from mixseq.spaces.temporal import FrameWeights
from mixseq.types import Float, Index, evenly_spaced

MAX_VALIDATION_FRAMES = 16
"""Largest number of frames that are left out, one by one."""

MAX_VALIDATION_VERTICES = 2_000_000
"""Largest number of vertices of all frames that are left out."""

MIN_VALIDATION_FRAMES = 3
"""Least number of frames that are left out, for meshes of any size."""

CANDIDATE_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Shares of lengths and angles to choose from."""

SUFFICIENT_GAIN = 0.8
"""Fraction of the largest gain that suffices: the smallest share with it is taken."""

ERROR_FLOOR = 1e-12
"""Errors below this, in diagonals or radians, are rounding."""


def tune_interpolation(encoded: EncodedSequence, frames: LargeArray) -> EncodedSequence:
    """Choose how parts are predicted between frames ``(T, V, 3)``, and the share of lengths and angles."""
    space = encoded.space
    if not isinstance(space, MixedSpace) or space.placement == "free" or len(frames) < 4:
        return encoded
    trial = CrossValidation.from_sequence(encoded, space, frames)
    in_body = len(space.decomposition.parts) > 1 and trial.improves_in_body_axes()
    if not space.joint_faces.any() or space.projection.steps:
        return replace(encoded, in_body_axes=in_body)
    share = trial.choose_share(in_body)
    return replace(
        encoded, in_body_axes=in_body, space=replace(space, projection=replace(space.projection, share=share))
    )


@dataclass(frozen=True, eq=False)
class CrossValidation:
    """Frames that are left out, and their predictions."""

    encoded: EncodedSequence  # the encoded sequence
    space: MixedSpace  # its mixed shape space
    frame_ids: Index  # (n,) left-out frames
    weights: FrameWeights  # weights of the others
    points: Float  # (n, V, 3) their points, in diagonals

    @classmethod
    def from_sequence(
        cls, encoded: EncodedSequence, space: MixedSpace, frames: LargeArray
    ) -> CrossValidation:
        """Leave some inner frames ``(T, V, 3)`` out."""
        left, rows = encoded.operator.leave_one_out()
        most = int(
            np.clip(
                MAX_VALIDATION_VERTICES // space.vertex_count, MIN_VALIDATION_FRAMES, MAX_VALIDATION_FRAMES
            )
        )
        some = evenly_spaced(len(left), most)
        points = frames[left[some]].astype(np.float64) / space.scale
        return cls(encoded, space, left[some], rows.select(some), points)

    def improves_in_body_axes(self) -> bool:
        """Whether predictions in bodies improve positions, lengths and angles on the whole."""
        world, body = (
            self._rms_errors(self.space.skin(self._interpolated_vectors(way))) for way in (False, True)
        )
        return bool(np.log(np.maximum(body, ERROR_FLOOR) / np.maximum(world, ERROR_FLOOR)).sum() < 0.0)

    def choose_share(self, in_body: bool) -> float:
        """Return the share of lengths and angles that nearly minimises the larger of their two errors."""
        blocks = self.space.split(self._interpolated_vectors(in_body))
        posed = self.space.skin(self.space.join(blocks))
        plain = np.maximum(self._rms_errors(posed)[1:], ERROR_FLOOR)
        scores = []
        for share in CANDIDATE_SHARES:
            rows = zip(posed, blocks.lengths, blocks.angles, strict=True)
            moved = np.stack([self.space.joint_projection.project(x, le, an, share) for x, le, an in rows])
            scores.append(float((self._rms_errors(moved)[1:] / plain).max()))
        gain = 1.0 - min(scores)
        return next(
            s
            for s, score in zip(CANDIDATE_SHARES, scores, strict=True)
            if 1.0 - score >= SUFFICIENT_GAIN * gain - 1e-12
        )

    @cached_property
    def _interpolated_shapes(self) -> Float:
        """Shapes ``(n, S)`` of the frames, from the others, frame by frame to save memory."""
        shapes = np.zeros((len(self.frame_ids), self.space.shape_dim))
        for number, (frames, weights) in enumerate(
            zip(self.weights.frame_ids, self.weights.weights, strict=True)
        ):
            for frame, weight in zip(frames, weights, strict=True):
                shapes[number] += weight * self.encoded.shapes[frame : frame + 1][0]
        return shapes

    def _interpolated_vectors(self, in_body: bool) -> Float:
        """Vectors ``(n, D)`` of the frames, from the others."""
        space, encoded = self.space, self.encoded
        prediction = space.pose_interpolation(encoded.operator, encoded.poses, encoded.placement, in_body)
        placed, found = prediction.interpolate(self.weights)
        seen = space.articulation.add_relations(found)
        shapes = space.split(
            np.pad(self._interpolated_shapes, ((0, 0), (0, space.placement_dim + space.correction_dim)))
        )
        none = np.zeros((len(self.frame_ids), space.correction_dim))
        return space.join(MixedBlocks(*shapes[:3], *seen, *placed, none))

    def _rms_errors(self, points: Float) -> Float:
        """Root mean square errors of positions, relative lengths and angles in frames ``(n, V, 3)``."""
        squares = np.zeros(3)
        topology = self.space.topology
        for made, real in zip(points, self.points, strict=True):
            (lengths, angles), (wanted, expected) = (
                lengths_and_angles(np.ascontiguousarray(x, dtype=np.float64), topology.edges, topology.hinges)
                for x in (made, real)
            )
            strain = lengths / np.maximum(wanted, 1e-12) - 1.0
            squares += [
                float(np.square(made - real).sum(axis=1).mean()),
                float(np.square(strain).mean()) if len(strain) else 0.0,
                float(np.square(wrap_angles(angles - expected)).mean()) if len(angles) else 0.0,
            ]
        return np.sqrt(squares / len(points))


FIT_STAGES = 2 + SPACE_STAGES
"""Stages of progress, without the search of a tolerance: reading frames, making the space, encoding frames."""

_FRAME_TO_SHELL_TOLERANCE_RATIO = 10.0
"""Ratio of the tolerance of frames to that of fits to lengths and angles."""


class FitOptions(SpaceOptions, total=False):
    """Further settings of `fit`, by name."""

    knots: int | ArrayLike | None
    pose: PoseForm


@public
def fit(
    sequence: Frames,
    exact: bool = False,
    tolerance: float | None = None,
    rank: int | None = None,
    placement: PlacementName = MixedSettings.placement,
    parts: int | ArrayLike | None = None,
    joint_width: int = MixedSettings.joint_width,
    space: SpaceName = "mixed",
    *,
    progress: Progress = no_progress,
    workers: Executor | None = None,
    **settings: Unpack[FitOptions],
) -> Model:
    """Turn a mesh sequence into a model: time, pose and shape signals in a shape space.

    The sequence may be larger than memory: give the result of `mixseq.open_sequence`. Its points are read once, and
    kept with their vectors in a temporary file. In memory are a few frames at a time, the signals, and square matrices
    of the number of frames, or of coordinates of a shape if these are fewer. The model is the same, to the last bit, as
    of a `MeshSequence`.

    Without `exact`, `tolerance`, `rank` or `knots` the model is lossless to the eye: no vertex of any frame is off by
    more than 0.0005 of the diagonal, half a pixel where the mesh fills a picture of 1000 pixels.

    Between distant frames, such as poses of a set, lengths and angles are made to agree in the anchored placement, so
    that no face is torn half-way; not if `rank` or `knots` are given.

    Parameters
    ----------
    sequence : MeshSequence or SequenceReader
        The animation.
    exact : bool
        Reproduce the frames to some 1e-11 of the diagonal, the rounding of key shapes. The model is decoded at all
        frames to verify that no vertex is off by more than 1e-8 of the diagonal.
    tolerance : float, optional
        Largest distance of a vertex from the original, as a fraction of the bounding box's diagonal in the first
        frame, verified at all frames; number of modes and knots follow.
    rank : int, optional
        Number of shape modes; placements of parts stay exact.
    placement : {"anchored", "free"}
        How parts are placed: by their poses (default), or by lengths and angles, with six numbers for every body (the
        paper's).
    parts : int or (F,) int, optional
        Number of parts, or the part of every triangle; found from the motion if not given.
    joint_width : int
        Largest width of joints, in strips of triangles on each side of a boundary.
    space : {"mixed", "vertex", "gradient", "lri", "edge"}
        The shape space: S_m, vertex positions, deformation gradients, LRI coordinates, or edge lengths and dihedral
        angles. Only S_m has a use for `placement`, `parts`, `joint_width` and `segmentation`.
    progress : callable, optional
        Called for every stage.
    workers : Executor, optional
        Executor for blocks of frames, see `mixseq.runtime.parallel`; by default one thread per core.

    Other Parameters
    ----------------
    segmentation : {"motion", "silhouettes", "spanning-tree"}, optional
        How parts are found; settings of a method, such as `mixseq.segmentation.MotionSettings`, are that method.
    projection, volume, shell : optional
        Of the edge space, see `mixseq.spaces.EdgeSettings`.
    knots : int or (n,) array_like, optional
        Inner knots of all curves: their number, evenly spread, or their times in seconds. By default one at (almost)
        every frame, or as few as `tolerance` allows.
    pose : {"modes", "keys"}
        Key shapes: mean and modes (default), or frames of the sequence; see `mixseq.signals.pose`.

    Returns
    -------
    Model

    Raises
    ------
    SettingsError
        If a setting is out of range, two contradict each other, or the space has no use for one; or if the sequence is
        so far from the origin, relative to its size, that double precision has no digits for the tolerance.
    ReconstructionError
        If not even the most accurate model keeps the tolerance, for another reason.
    SegmentationError
        If given parts do not fit the mesh.
    FormatError, InvalidSequenceError
        If a sequence being read is damaged or unsound, or too small or too large for doubles.
    OutputError
        If there is no room for a temporary file.

    Examples
    --------
    >>> import mixseq
    >>> from mixseq.creature import walk_cycle
    >>> walk = walk_cycle(frames=6)
    >>> mixseq.compare(walk, mixseq.fit(walk).sample()).max_error <= 0.0005
    True
    >>> mixseq.compare(walk, mixseq.fit(walk, exact=True).sample()).max_error < 1e-9
    True
    """
    check_frames(sequence)
    knots, pose = settings.pop("knots", None), settings.pop("pose", "modes")
    _check_options(exact, tolerance, rank, knots, pose)
    chosen = space_settings(space, placement=placement, parts=parts, joint_width=joint_width, **settings)
    wanted = VISUALLY_LOSSLESS_TOLERANCE if tolerance is None else float(tolerance)
    is_reduced = rank is not None or knots is not None
    match chosen:
        case MixedSettings() if is_reduced:
            chosen = replace(chosen, purpose="reduced")
        case EdgeSettings(projection="dso", shell=None):
            chosen = replace(chosen, shell=ShellSettings(accuracy=wanted / _FRAME_TO_SHELL_TOLERANCE_RATIO))
    rounds = 1 if exact else 0 if is_reduced else MAX_TRIAL_MODELS
    stages = StagedProgress(progress, FIT_STAGES + rounds, sequence.header.frame_count)
    work = workers or thread_executor()
    with one_blas_thread():
        frames = load_frames(sequence, stages.at(0))
        shape_space = make_space(frames, space, chosen, work, stages.at(1, SPACE_STAGES))
        encoded = tune_interpolation(
            encode_sequence(frames, shape_space, pose, work, stages.at(1 + SPACE_STAGES)), frames.points
        )
        if exact:
            return verify_tolerance(
                build_model(encoded, Detail(step=EXACT_ROUNDING_STEP)),
                frames,
                EXACT_TOLERANCE,
                work,
                stages.at(FIT_STAGES),
            )
        if is_reduced:
            return build_model(encoded, Detail(rank=rank, knots=knots))
        return fit_within_tolerance(encoded, frames, wanted, stages.at(FIT_STAGES, MAX_TRIAL_MODELS), work)


def _check_options(
    exact: bool,
    tolerance: float | None,
    rank: int | None,
    knots: int | ArrayLike | None,
    pose: PoseForm,
) -> None:
    if exact and not (tolerance is None and rank is None and knots is None):
        raise SettingsError("exact models keep everything; leave out tolerance, rank and knots, or exact")
    if tolerance is not None and not (rank is None and knots is None):
        raise SettingsError("tolerance chooses rank and knots; give either tolerance, or rank and knots")
    if tolerance is not None and not (np.isfinite(tolerance) and tolerance > 0):
        raise SettingsError(f"tolerance is {tolerance}; a positive number is expected (or exact=True)")
    if rank is not None and not (isinstance(rank, int | np.integer) and rank >= 0):
        raise SettingsError(f"rank is {rank}; a whole number of shape modes, zero or more, is expected")
    if pose not in POSE_FORMS:
        raise SettingsError(f"pose is {pose!r}; 'modes' or 'keys' is expected")
