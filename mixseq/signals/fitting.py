r"""Fit models to mesh sequences: shape space, encoding, and signals of a given detail.

The share of lengths and angles in the projection is selected by cross-validation. Inner frames are left out and
interpolated in time from the other frames. Their errors are the root mean squares of errors of edge lengths and
dihedral angles,

.. math:: \hat l_e / l_e - 1, \qquad \mathrm{wrap}(\hat\theta_h - \theta_h) .
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Unpack, cast

import numpy as np
from numpy.typing import ArrayLike

from mixseq.choices import BETWEENS, BetweenName, PlacementName, SpaceName
from mixseq.errors import SettingsError
from mixseq.mesh.measures import choose_origin, dihedral_angles, edge_lengths, wrap_angles
from mixseq.mesh.topology import Topology
from mixseq.runtime.low_memory import LargeArray, return_freed_memory
from mixseq.runtime.parallel import Executor, one_blas_thread, thread_executor
from mixseq.runtime.progress import Progress, StagedProgress, log_progress
from mixseq.runtime.public import FileOr, HasFrames, public
from mixseq.sequence.events import CutChoice, SequenceEvents, distinct_poses, find_events
from mixseq.sequence.provenance import as_edited
from mixseq.sequence.sequence import (
    Frames,
    FrameStore,
    check_motion,
    is_rig,
    largest_coordinate,
    load_frames,
    own_parts,
    rounding_margin,
)
from mixseq.shells.fitting import ShellSettings
from mixseq.signals.decoding import Decodable, RigMotion
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
    largest_error,
    verify_tolerance,
)
from mixseq.signals.model import Model
from mixseq.spaces.edge import EdgeSettings
from mixseq.spaces.making import SPACE_STAGES, MixedSettings, SpaceOptions, make_space, space_settings
from mixseq.spaces.mixed.mixed_space import MixedBlocks, MixedSpace
from mixseq.spaces.temporal import FrameWeights, Timing
from mixseq.types import Float, FloatArray, Int32, evenly_spaced

MIN_VALIDATED_FRAMES = 4  # least number of frames of a sequence for cross-validation

MIN_VALIDATION_FRAMES, MAX_VALIDATION_FRAMES = 3, 16
"""Least number of left-out frames, also for large meshes, and largest number."""

MAX_VALIDATION_VERTICES = 2_000_000  # largest number of vertices in all left-out frames together
CANDIDATE_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)  # candidates for the share of lengths and angles, ascending
SUFFICIENT_GAIN = 0.8  # sufficient fraction of the largest gain: the smallest share with this gain is selected
ERROR_FLOOR = 1e-12  # least error in diagonals or radians; smaller errors are due to rounding


def select_share(encoded: EncodedSequence, frames: LargeArray) -> EncodedSequence:
    """Select the share of lengths and angles at joints to fit left-out frames of ``(T, V, 3)``.

    It is the smallest share that nearly minimises the larger of the errors of lengths and angles.
    """
    space = encoded.space
    if not isinstance(space, MixedSpace) or space.placement == "free" or space.projection.steps:
        return encoded
    if len(frames) < MIN_VALIDATED_FRAMES or not space.joint_faces.any():
        return encoded
    frame_ids, weights = encoded.operators[0].leave_one_out()
    limit = MAX_VALIDATION_VERTICES // space.vertex_count
    if not len(frame_ids):
        return encoded
    sample = evenly_spaced(len(frame_ids), min(max(limit, MIN_VALIDATION_FRAMES), MAX_VALIDATION_FRAMES))
    topology, is_first = space.topology, encoded.group_of_vertex == 0  # others may have no size in some frames
    edges, hinges = (each[is_first[each[:, 0]]] for each in (topology.edges, topology.hinges))
    elements = edges, hinges
    expected = [_lengths_and_angles(elements, frames[frame] / space.scale) for frame in frame_ids[sample]]
    blocks = space.split(_interpolated_vectors(encoded, space, weights.select(sample)))
    skinned = space.skin(space.join(blocks))
    errors_without = np.maximum(_rms_errors(elements, skinned, expected), ERROR_FLOOR)
    gains = []
    for share in CANDIDATE_SHARES:
        projected = space.joint_projection.project(skinned, blocks.lengths, blocks.angles, share)
        gains.append(1.0 - float((_rms_errors(elements, projected, expected) / errors_without).max()))
    share = CANDIDATE_SHARES[int(np.argmax(np.array(gains) >= SUFFICIENT_GAIN * max(gains) - 1e-12))]
    return replace(encoded, space=space.with_weights(projection=replace(space.projection, share=share)))


def _interpolated_vectors(encoded: EncodedSequence, space: MixedSpace, weights: FrameWeights) -> Float:
    """Return vectors ``(n, D)`` interpolated by weights of the frames."""
    shapes = np.zeros((len(weights.frame_ids), space.shape_dim))
    for shape, *row in zip(shapes, weights.frame_ids, weights.weights, strict=True):
        for frame, weight in zip(*row, strict=True):  # one frame is in memory at a time
            shape += weight * encoded.shapes[frame : frame + 1][0]
    signals = encoded.operators[0], encoded.poses, encoded.placement
    body_poses, part_poses = space.pose_interpolation(*signals).interpolate(weights)
    blocks = space.split(np.pad(shapes, ((0, 0), (0, space.placement_dim + space.correction_dim))))
    poses = space.articulation.add_relations(part_poses)
    return space.join(MixedBlocks(*blocks[:3], *poses, *body_poses, blocks.corrections))


def _lengths_and_angles(elements: tuple[Int32, Int32], points: FloatArray) -> tuple[Float, Float]:
    """Return lengths of edges and dihedral angles of hinges of points ``(V, 3)`` in diagonals."""
    return edge_lengths(points, elements[0]), dihedral_angles(points, elements[1])


def _rms_errors(elements: tuple[Int32, Int32], points: Iterable[Float], expected: list[tuple[Float, Float]]) -> Float:
    """Return root mean square errors ``(2,)`` of relative lengths and of angles in frames ``(n, V, 3)``."""
    squares = np.zeros(2)
    for frame, (expected_lengths, expected_angles) in zip(points, expected, strict=True):
        lengths, angles = _lengths_and_angles(elements, frame)
        strain = lengths / np.maximum(expected_lengths, 1e-12) - 1.0
        errors = strain, wrap_angles(angles - expected_angles)
        squares += [float(np.square(each).mean()) if len(each) else 0.0 for each in errors]
    return np.sqrt(squares / len(expected))


FIT_STAGES = 2 + SPACE_STAGES  # progress stages without a search: reading frames, making the space, encoding
_SHELL_ACCURACY_RATIO = 10.0  # ratio of the tolerance of frames to the accuracy of fits to lengths and angles


class FitOptions(SpaceOptions, total=False):
    """Optional keyword settings of `fit`."""

    knots: int | ArrayLike | None
    between: BetweenName
    cuts: CutChoice


@public
def fit(
    sequence: FileOr[Frames | HasFrames],
    exact: bool = False,
    tolerance: float | None = None,
    rank: int | None = None,
    placement: PlacementName = MixedSettings.placement,
    parts: int | ArrayLike | None = None,
    joint_width: int = MixedSettings.joint_width,
    space: SpaceName = "mixed",
    *,
    progress: Progress = log_progress,
    workers: Executor | None = None,
    **settings: Unpack[FitOptions],
) -> Model:
    """Fit a model to a mesh sequence: time, pose and shape signals in a shape space.

    The sequence may be larger than memory: pass the result of `mixseq.open_sequence`. Its points are read once and
    stored with their vectors in a temporary file. Memory holds a few frames at a time, the signals, and square
    matrices. Their size is the number of frames or of shape coordinates, whichever is smaller. The model is
    bit-identical to the model of a `MeshSequence`.

    Without `exact`, `tolerance`, `rank` or `knots` the model is visually lossless: no vertex of any frame is off by
    more than 0.0005 of the diagonal, half a pixel where the mesh fills a picture of 1000 pixels.

    Without `rank` and `knots`, the anchored placement also relaxes the mesh between two frames, or between the distant
    frames of a set of poses. It is relaxed towards the interpolated lengths and angles, so that faces do not tear.

    Parameters
    ----------
    sequence : MeshSequence or SequenceReader
        The animation.
    exact : bool
        Reproduce the frames to about 1e-11 of the diagonal, because key shapes are rounded. The model is decoded at all
        frames to verify that no vertex is off by more than 1e-8 of the diagonal.
    tolerance : float, optional
        Largest distance of a vertex from the original, as a fraction of the bounding box's diagonal in the first
        frame (in the largest frame if the first is a point), verified at all frames. The tolerance determines the
        numbers of modes and knots.
    rank : int, optional
        Number of shape modes; placements of parts stay exact.
    placement : {"anchored", "free"}
        Placement of parts by their poses (default), or by lengths, angles and six numbers for every body, as in the
        paper.
    parts : int or (F,) int, optional
        Number of parts, or the part of every triangle; by default those of a model, or segmented by motion.
    joint_width : int
        Largest width of joints, in strips of triangles on each side of a boundary.
    space : {"mixed", "vertex", "gradient", "lri", "edge"}
        The shape space: S_m, vertex positions, deformation gradients, LRI coordinates, or edge lengths and dihedral
        angles. Only S_m uses `placement`, `parts`, `joint_width` and `segmentation`.
    progress : callable, optional
        Called for every stage.
    workers : Executor, optional
        Executor for blocks of frames, see `mixseq.runtime.parallel`; by default one thread per core.

    Other Parameters
    ----------------
    segmentation : {"motion", "silhouettes", "spanning-tree"}, optional
        Segmentation method, or its settings, such as `mixseq.segmentation.MotionSettings`.
    projection, volume, shell : optional
        Settings of the edge space, see `mixseq.spaces.EdgeSettings`.
    knots : int or (n,) array_like, optional
        Inner knots of all curves: their number, evenly spread, or their times in seconds. By default, a knot at
        (almost) every frame, or the fewest knots that `tolerance` allows.
    between : {"auto", "smooth", "linear", "hold", "vertices"}
        Motion between frames. By default, holds, repeated poses (on twos) and linear motion between keys are found in
        the frames and kept. "smooth" goes smoothly through repeated poses and keys, and does not keep the frames
        between them; "linear" goes straight from frame to frame; "hold" keeps every frame until the next; "vertices"
        is "auto" in the vertex space.
    cuts : {"auto", "none"} or sequence of int
        Cuts, where the motion jumps half-way between two frames: found (default), none, or the first frames after them.
        With `knots` there are none.

    Returns
    -------
    Model

    Raises
    ------
    SettingsError
        If a setting is out of range, contradicts another setting, or is unused by the space. Also if double precision
        cannot resolve the tolerance, because the sequence is far from the origin relative to its size.
    ReconstructionError
        If the most accurate model exceeds the tolerance for another reason, such as triangles that lose their area in
        the free placement.
    SegmentationError
        If `parts` does not fit the mesh.
    FormatError, InvalidSequenceError
        If a sequence being read is damaged or invalid, or its size exceeds the range of doubles.
    OutputError
        If the disk has no space for the temporary file.

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
    sequence = cast("Frames", sequence)
    check_motion(sequence)
    knots = settings.pop("knots", None)
    between, cuts = settings.pop("between", "auto"), settings.pop("cuts", "auto")
    _check_options(exact, tolerance, rank, knots, between)
    if between == "vertices":
        if space not in ("mixed", "vertex"):
            raise SettingsError(f"between='vertices' is the vertex space; leave it out, or space={space!r}")
        space, between = "vertex", "auto"
    if parts is None and space == "mixed":
        parts = own_parts(sequence)
    if knots is not None and (between, cuts) != ("auto", "auto"):
        raise SettingsError("a model with given knots is smooth everywhere; leave out between and cuts, or knots")
    options = space_settings(space, placement=placement, parts=parts, joint_width=joint_width, **settings)
    max_error = VISUALLY_LOSSLESS_TOLERANCE if tolerance is None else float(tolerance)
    is_reduced = rank is not None or knots is not None
    match options:
        case MixedSettings() if is_reduced or sequence.header.frame_count == 2:
            options = replace(options, purpose="reduced" if is_reduced else "blends")
        case EdgeSettings(projection="dso", shell=None):
            options = replace(options, shell=ShellSettings(accuracy=max_error / _SHELL_ACCURACY_RATIO))
    search_stages = 1 if exact else 0 if is_reduced else MAX_TRIAL_MODELS
    stages = StagedProgress(progress, FIT_STAGES + search_stages, sequence.header.frame_count)
    executor = workers or thread_executor()
    with one_blas_thread():
        frames = whole = load_frames(sequence, stages.at(0))
        found, keys = SequenceEvents(), frames.header.keys if knots is None else None
        topology = Topology(frames.header.faces, frames.header.vertex_count)
        if knots is None:
            found = find_events(frames.points, frames.header.times, topology)
            found = found.with_keys(keys) if keys else found
            found = found.with_cuts(cuts, frames.header)
        groups, group_of_vertex = [found.whole], None
        if space in ("mixed", "vertex") and found.components:
            groups, group_of_vertex = found.group_components(topology.component_of_vertex)
        del topology  # its tables are large
        if between == "smooth":
            frames, groups = distinct_poses(frames, groups)
        is_held = between == "auto" and bool(keys and keys.is_held)
        timings = [Timing(events, "hold" if is_held else between) for events in groups]
        shape_space = make_space(frames, space, options, executor, stages.at(1, SPACE_STAGES))
        stage = stages.at(1 + SPACE_STAGES)
        encoded = encode_sequence(frames, shape_space, executor, stage, timings, group_of_vertex)
        encoded = select_share(encoded, frames.points)
        return_freed_memory()
        if exact:
            max_error, model = EXACT_TOLERANCE, build_model(encoded, Detail(step=EXACT_ROUNDING_STEP))
            del encoded  # as large as the model
            verify_tolerance(model, frames, max_error, executor, stages.at(FIT_STAGES))
        elif is_reduced:
            model = build_model(encoded, Detail(rank=rank, knots=knots))
            max_error = largest_error(model, frames, workers=executor)
        else:
            search = stages.at(FIT_STAGES, MAX_TRIAL_MODELS)
            bound = max_error - _rounding_share(frames, max_error)
            model = fit_within_tolerance(encoded, frames, bound, search, executor)
        header = frames.trace(max_error, promised=not is_reduced)
        if header.provenance:
            events_text = found.describe(whole.header, between)
            header = replace(header, provenance=replace(header.provenance, events=events_text))
        if frames is not whole:
            header = replace(header, times=whole.header.times, provenance=as_edited(header.provenance))
        return replace(model, header=header)


def as_motion(source: Decodable | Frames, progress: Progress = log_progress) -> Decodable:
    """Return a motion at any time: a model as it is, a rig as its file says, and other frames fitted exactly."""
    if isinstance(source, Decodable):
        return source
    if is_rig(source):
        return RigMotion(source.header, source)
    return fit(source, exact=True, progress=progress)


def _rounding_share(frames: FrameStore, tolerance: float) -> float:
    """Return the part of a tolerance, in diagonals, that is left to files in single precision."""
    unit, local = frames.diagonal or 1.0, frames.about(choose_origin(frames.points[:1][0]))
    coordinates = [largest_coordinate(each.points) for each in (frames, local)]
    return rounding_margin(tolerance * unit, *coordinates) / unit


def _check_options(
    exact: bool, tolerance: float | None, rank: int | None, knots: int | ArrayLike | None, between: BetweenName
) -> None:
    if exact and not (tolerance is None and rank is None and knots is None):
        raise SettingsError("exact models keep everything; leave out tolerance, rank and knots, or exact")
    if tolerance is not None and not (rank is None and knots is None):
        raise SettingsError("tolerance chooses rank and knots; give either tolerance, or rank and knots")
    if tolerance is not None and not (np.isfinite(tolerance) and tolerance > 0):
        raise SettingsError(f"tolerance is {tolerance}; a positive number is expected (or exact=True)")
    if rank is not None and not (isinstance(rank, int | np.integer) and rank >= 0):
        raise SettingsError(f"rank is {rank}; a whole number of shape modes, zero or more, is expected")
    if between not in BETWEENS:
        raise SettingsError(f"between is {between!r}; {', '.join(BETWEENS)} are possible")
