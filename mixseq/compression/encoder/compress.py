"""Compress a sequence to an error or a size, and measure the error by decoding the result.

Guaranteed errors are verified on the decoded frames. `mixseq.compression.encoder.search` finds the step.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from mixseq.choices import OrderName
from mixseq.compression.bitstream.compressed_sequence import (
    MAX_CHUNK_FRAMES,
    CodingParameters,
    CompressedSequence,
    Playback,
    decode,
)
from mixseq.compression.bitstream.spatial_basis import MAX_PARTS, FaceLabels, encode_face_labels
from mixseq.compression.encoder.inbetweens import add_inbetweens
from mixseq.compression.encoder.search import MAX_ROUNDS, Search
from mixseq.compression.encoder.trial import DEFAULT_CHUNK_FRAMES, MIN_CHUNK_FRAMES, residual_unit
from mixseq.compression.encoder.uvs import UV_ERROR, with_quantised_uvs
from mixseq.compression.numbering import cheapest_numbering
from mixseq.errors import MixseqWarning, ReconstructionError, SettingsError
from mixseq.mesh.measures import choose_origin
from mixseq.mesh.topology import Topology
from mixseq.runtime.low_memory import return_freed_memory
from mixseq.runtime.parallel import one_blas_thread
from mixseq.runtime.progress import Progress, StagedProgress, log_progress
from mixseq.runtime.public import FileOr, public
from mixseq.sequence.events import CutChoice, describe_cuts, find_events
from mixseq.sequence.sequence import (
    Frames,
    FrameStore,
    check_motion,
    iterate_blocks,
    largest_coordinate,
    load_frames,
    own_parts,
    rounding_error,
    rounding_margin,
)
from mixseq.signals.model import Model
from mixseq.spaces.making import MixedSettings, segment_faces


@public
def compress(
    sequence: FileOr[Frames | Model],
    max_error: float | None = None,
    kg: float | None = None,
    size: int | None = None,
    progress: Progress = log_progress,
    *,
    uv_error: float = UV_ERROR,
    uvs: bool = True,
    order: OrderName = "keep",
    chunk: int = DEFAULT_CHUNK_FRAMES,
    parts: int | ArrayLike | None = None,
    inbetweens: bool = True,
    between_frames: bool = False,
    cuts: CutChoice = "auto",
) -> CompressedSequence:
    """Compress a sequence.

    The compressed bytes are the same for any number of threads (`mixseq.runtime.parallel.thread_count`).

    Parameters
    ----------
    sequence : MeshSequence, SequenceReader or Model
        The animation. Of a model, all bodies are compressed, each to the same error.
    max_error : float, optional
        Guaranteed largest distance of a vertex from the original at any frame, as a fraction of the bounding box's
        diagonal in the first frame, or in the largest frame if the first is a point.
    kg : float, optional
        KG error in percent: root mean square distance, relative to the same mean of distances from the centroids.
    size : int, optional
        Largest number of bytes of the signals. The KG error is minimised for this size.
    progress : callable, optional
        Called at every stage.
    uv_error : float
        Guaranteed largest difference of u and of v from the original texture coordinates, in units of the texture's
        size. By default a sixteenth of a texel of a texture of 4096 x 4096; 0 keeps all bits.
    uvs : bool
        Whether to keep texture coordinates.
    order : {"keep", "vertices", "free"}
        Numbering to keep: of vertices and faces, of vertices only, or of neither. Numberings that need not be kept are
        chosen for the fewest bytes, and attributes of vertices, faces and corners are reordered to match.
    chunk : int
        Approximate number of frames per chunk, 16 to 4096. A chunk is decoded as a whole, and lost as a whole if it is
        damaged. Small chunks take more bytes.
    parts : int or (F,) int, optional
        Near-rigid parts for frames between the stored ones, as in `mixseq.fit`: their number, or the part of every
        triangle. By default those of a model, or segmented by motion.
    inbetweens : bool
        Whether to fit a model, and to store what players need to show its motion between frames where a spline of the
        vertices is farther from it than the error at the frames. Takes at most 15 % more bytes, or what a `size`
        leaves, and the time of `mixseq.fit`.
    between_frames : bool
        Whether `max_error` also bounds the distance of players from the fitted model between frames, at the quarters
        of a frame, at in-betweens and at the middles between these. In-betweens take as many bytes as this needs.
    cuts : {"auto", "none"} or sequence of int
        Cuts, where the motion jumps half-way between two frames: found (default), none, or the first frames after them.

    Returns
    -------
    CompressedSequence
        Compressed sequence that `mixseq.save` writes to a file. `mixseq.load` reads a model from this file.

    Raises
    ------
    SettingsError
        If not exactly one of `max_error`, `kg` and `size` is given, or its value is out of range; if `size` is too
        small, or given for several bodies; if `max_error` is below the precision of the coordinates; if `uv_error` is
        not from 0 to 0.25; if `order` is unknown; if `chunk` is not from 16 to 4096; or if the bound cannot be kept
        between frames.
    SegmentationError
        If `parts` does not fit the mesh.
    FormatError, InvalidSequenceError
        If the sequence is damaged or invalid, or its coordinates are too small or too large for double precision.

    Examples
    --------
    >>> import mixseq
    >>> coded = mixseq.compress("arm.usdc", max_error=1e-3)
    >>> mixseq.save("small.h5", coded)
    >>> mixseq.compare("arm.usdc", "small.h5").max_error < 1e-3
    True
    """
    _check_target(max_error, kg, size)
    if isinstance(sequence, Model):
        options: dict[str, Any] = {
            **{"uv_error": uv_error, "uvs": uvs, "order": order, "chunk": chunk, "parts": parts, "cuts": cuts},
            **{"inbetweens": inbetweens, "between_frames": between_frames},
        }
        if sequence.body_names[1:] and size is not None:
            raise SettingsError("size is for one body, and the model has several; give max_error or kg")
        if sequence.body_names[1:] and not (parts is None or isinstance(parts, int | np.integer)):
            raise SettingsError("labels are for one body, and the model has several; leave out parts to keep their own")
        stages, bodies = StagedProgress(progress, len(sequence.body_names), 100), sequence.frames_of_bodies()
        first, *others = (
            replace(compress(frames, max_error, kg, size, stages.at(number), **options), relation=relation)
            for number, (frames, relation) in enumerate(zip(bodies, sequence.relations, strict=True))
        )
        return replace(first, bodies=tuple(others))
    sequence = cast("Frames", sequence)
    check_motion(sequence)
    if between_frames and not (inbetweens and max_error is not None):
        raise SettingsError(
            "between_frames keeps max_error by in-betweens; give max_error, and leave out inbetweens=False"
        )
    if not MIN_CHUNK_FRAMES <= chunk <= MAX_CHUNK_FRAMES // 2:  # a chunk may have half as many again
        raise SettingsError(f"chunk is {chunk}; {MIN_CHUNK_FRAMES} to {MAX_CHUNK_FRAMES // 2} frames are expected")
    numbering = cheapest_numbering(sequence.header, order)
    parts = own_parts(sequence) if parts is None else parts
    if not (parts is None or isinstance(parts, int | np.integer)):
        parts = numbering.renumber_labels(np.asarray(parts), sequence.header.polygons)
    sequence, order = numbering.renumber_frames(sequence), numbering.order
    header, uv_steps = with_quantised_uvs(sequence.header, uv_error, uvs)
    inbetweens &= sequence.header.frame_count > 1
    stages = StagedProgress(progress, 2 + inbetweens + MAX_ROUNDS, sequence.header.frame_count)
    with one_blas_thread():
        frames = load_frames(sequence, stages.at(0))
        del sequence, numbering  # large
        unit = frames.diagonal or 1.0
        labels = _segment(frames, parts)
        if size is not None and labels is not None:
            size -= len(labels.data)
        coded = replace(_search_streams(frames, stages, chunk, unit, max_error, kg, size), labels=labels)
        return_freed_memory()
        stages.at(1 + MAX_ROUNDS)(0, 1, "checking")
        events = find_events(frames.points, header.times, Topology(header.faces, header.vertex_count))
        whole = events.with_cuts(cuts, header).whole
        playback = decode(coded, tuple(k + 1 for k in sorted({*whole.cuts, *whole.pops})))
        parameters = _measure_errors(frames, playback, coded.parameters, max_error, kg)
        coded = replace(coded, parameters=parameters, between=playback.between, order=order)
        return_freed_memory()
        if inbetweens:
            coded = add_inbetweens(coded, playback, size, between_frames, stages.at(2 + MAX_ROUNDS))
    parameters = coded.parameters
    provenance = frames.trace(parameters.max_error, parameters.promised, coded.order).provenance
    if provenance and coded.between:
        provenance = replace(provenance, events=describe_cuts(coded.between.cuts, header))
    header = replace(header, provenance=provenance)
    if uv_steps is not None:
        parameters = replace(parameters, uv_steps=uv_steps, uv_error=float(uv_error))
    return replace(coded, header=header, parameters=parameters)


def _segment(frames: FrameStore, parts: int | ArrayLike | None) -> FaceLabels | None:
    """Return the parts of triangles; None if there are too many to be stored."""
    topology = Topology(frames.header.faces, frames.header.vertex_count)
    labels = segment_faces(frames, MixedSettings(parts=parts), topology)
    count = int(labels.max()) + 1
    if count <= MAX_PARTS:
        return encode_face_labels(labels, topology.faces)
    if parts is not None:
        warnings.warn(
            f"{frames.header.name!r}: there are {count} parts; {MAX_PARTS} can be stored, so decoders find parts again",
            MixseqWarning,
            stacklevel=4,
        )
    return None


def _check_target(max_error: float | None, kg: float | None, size: int | None) -> None:
    targets = {"max_error": max_error, "kg": kg, "size": size}
    given = [(name, value) for name, value in targets.items() if value is not None]
    if len(given) != 1:
        names = " and ".join(name for name, _ in given) or "nothing"
        raise SettingsError(f"{names} is given; give one of max_error, kg and size")
    [(name, value)] = given
    least = 1 if name == "size" else 0
    if not (np.isfinite(value) and value > 0 and value >= least):
        raise SettingsError(f"{name} is {value}; a positive number{' of bytes' * least} is expected")


def _with_margin(bound: float, sequence: FrameStore, local: FrameStore) -> float:
    """Reduce a bound by a margin for last digits, which vary between machines, and for single precision."""
    largest, largest_local = (largest_coordinate(each.points) for each in (sequence, local))
    local_least = rounding_error(largest_local)
    least = max(local_least, _ORIGIN_ROUNDING * largest)
    if bound < least:
        cure = ", or move the sequence to the origin" if bound >= local_least else ""
        raise SettingsError(
            f"max_error is {bound:.3g} in units of the sequence, beyond the digits of coordinates of up to "
            f"{largest:.3g}; give at least {least:.3g} of these units{cure}"
        )
    margin = max(rounding_margin(bound, largest, largest_local), least)
    return bound - min(1e-9 * bound + margin, bound / 2)


_ORIGIN_ROUNDING = 2.0**-50  # largest error of adding an origin in double precision, relative to the largest coordinate


def _total_deviation(sequence: FrameStore) -> float:
    """Return the root of the sum of all squared distances of vertices from the centroids of their frames."""
    squares = largest = 0.0
    for block in iterate_blocks(sequence.points):
        points = block.astype(np.float64)
        squares += float(np.square(points - points.mean(axis=1, keepdims=True)).sum())
        largest = max(largest, float(np.abs(points).max()))
    if squares <= np.prod(sequence.points.shape) * (2.0**-40 * largest) ** 2:
        raise SettingsError("all vertices are at one place, and have no KG error; give max_error")
    return float(np.sqrt(squares))


def _search_streams(
    frames: FrameStore,
    stages: StagedProgress,
    chunk: int,
    unit: float,
    max_error: float | None,
    kg: float | None,
    size: int | None,
) -> CompressedSequence:
    """Return the streams found by a search; other results, a few kB per vertex, are freed on return."""
    origin = choose_origin(frames.points[:1][0])
    local = frames.about(origin)
    search = Search(local, stages, chunk)
    if max_error is not None:
        best = search.find_for_bound(_with_margin(max_error * unit, frames, local))
    elif kg is not None:
        best = search.find_for_error(kg / 100 * _total_deviation(local))
    else:
        best = search.find_for_size(int(size or 0), _total_deviation(local))
    parameters = CodingParameters(
        factors=best.basis.kind,
        rank=sum(best.ranks),
        frame_count=len(frames.points),
        step=best.step,
        diagonal=unit,
        max_error=0.0,
        kg_percent=0.0,
        promised=max_error is not None,
        correction=0.0 if best.bound is None else residual_unit(best.bound),
        ranks=best.ranks if len(best.ranks) > 1 else (),
        origin=tuple(origin.tolist()) if origin.any() else (),
    )
    return CompressedSequence(frames.header, parameters, best.groups, best.chunks)


MIN_MOTION_LEFT = 0.5  # part of the motion below which a size is warned about: 1 - error / error of the best still mesh


def _measure_errors(
    sequence: FrameStore, playback: Playback, parameters: CodingParameters, bound: float | None, kg: float | None
) -> CodingParameters:
    """Return the parameters of a decoded sequence with its measured errors."""
    unit = parameters.diagonal
    squares = variation = largest = 0.0
    total = np.zeros((sequence.points.shape[1], 3))  # of vertices relative to the centroids of their frames
    frame_count = 0
    for block in playback.blocks(playback.times):
        points = sequence.points[frame_count : frame_count + len(block)].astype(np.float64)
        distances = np.square(points - block).sum(axis=2)
        squares, largest = squares + float(distances.sum()), max(largest, float(distances.max()))
        local = points - points.mean(axis=1, keepdims=True)
        variation, total = variation + float(np.square(local).sum()), total + local.sum(axis=0)
        frame_count += len(block)
    error = float(np.sqrt(largest)) / unit
    if bound is not None and error > bound:
        raise ReconstructionError(
            f"the error of a decoded vertex is {error:.3g} diagonals, more than {bound:g}; please report this"
        )
    rounding = sequence.points.shape[1] * frame_count * (1e-12 * unit) ** 2
    kg_percent = 100 * float(np.sqrt(squares / variation)) if variation > rounding else 0.0
    if kg is not None and kg_percent > (1 + 1e-9) * kg:
        raise ReconstructionError(
            f"the KG error of the decoded frames is {kg_percent:.6g} %, more than {kg:g}; please report this"
        )
    motion = variation - float(np.square(total).sum()) / frame_count  # squared distances from a still mesh
    if bound is None and kg is None and motion > rounding and squares > (1 - MIN_MOTION_LEFT) ** 2 * motion:
        left = 100 * max(1 - float(np.sqrt(squares / motion)), 0.0)
        warnings.warn(
            f"{sequence.header.name!r}: {left:.0f} % of the motion is left in this size; give more",
            MixseqWarning,
            stacklevel=4,
        )
    return replace(parameters, max_error=error if bound is None else bound, kg_percent=kg_percent)
