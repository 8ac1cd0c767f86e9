r"""Verify a model by comparison with its original, or with the same edit of it, and verify its stated error bound.

:math:`A, B` are points of original and decoded frames. d is the unit of errors of the original
(`mixseq.sequence.sequence.reference_diagonal`), or 1 if all frames are points. The bound is
:math:`|A_{tv} - B_{tv}| \le \epsilon\, d`, a sum for models that were made of models (`mixseq.sequence.provenance`).
`mixseq.metrics` defines the KG error. Frames are decoded in small blocks; `mixseq.mesh.measures` avoids overflow at any
scale.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any, cast

import numpy as np

from mixseq.compression.numbering import Renumbering
from mixseq.errors import FormatError, SettingsError
from mixseq.mesh.measures import Diagonal
from mixseq.mesh.polygons import match_polygons
from mixseq.metrics import match_reference, paired_blocks
from mixseq.runtime.progress import Progress, log_progress
from mixseq.runtime.public import FileOr, public
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.provenance import Provenance, frames_checksum
from mixseq.sequence.sequence import Frames, LazyFrames, check_frames, reference_diagonal
from mixseq.signals.decoding import FRAMES_PER_BLOCK
from mixseq.signals.model import Model
from mixseq.types import FloatArray, PathLike
from mixseq_io.coded.streams import decode_model
from mixseq_io.model_files import is_compressed, load, read_compressed

_MEASURED_BOUND_TOLERANCE = 1e-9
"""Relative tolerance for a bound that was measured after compression instead of requested."""


@dataclass(frozen=True)
class Verification:
    """Result of `verify`; errors are None without an original.

    Attributes
    ----------
    frames, vertices : int
        Number of decoded frames and vertices.
    bound : float or None
        Bound stated by the file: largest distance of a vertex from the original, in diagonals. If the file comes from
        another model of the original, the sum of both bounds. None for models that were edited.
    promised : bool
        Whether the bound (the first one of a sum) was requested beforehand instead of measured afterwards.
    source : str
        Name of the original to which the bound refers.
    diagonal : float
        Diagonal of the original's first frame (of the largest if that is a point) in metres, the unit of errors.
    provenance : str
        All steps from the original to the file, such as "1e-4 from r10.h5, which is 6e-4 from walk.usdc".
    max_error : float or None
        Largest distance of a vertex from the original, in diagonals.
    kg_percent : float or None
        Karni-Gotsman error in percent.
    worst_frame, worst_vertex : int or None
        Frame and vertex of the largest distance, numbered as in the original.
    uv_bound : float or None
        Requested bound of texture coordinates; None if there are none or if they are stored exactly.
    uv_error : float or None
        Largest difference of u or v at any corner; None if the original has no coordinates.
    bodies : dict of Verification
        Results of the further bodies by name; compared with those of a model with these names.
    """

    frames: int
    vertices: int
    bound: float | None
    promised: bool
    source: str
    diagonal: float
    provenance: str
    max_error: float | None = None
    kg_percent: float | None = None
    worst_frame: int | None = None
    worst_vertex: int | None = None
    uv_bound: float | None = None
    uv_error: float | None = None
    bodies: dict[str, Verification] = field(default_factory=dict)

    @property
    def holds(self) -> bool:
        """Whether all vertices and texture coordinates are within their bounds; true without an original or a bound."""
        if not all(body.holds for body in self.bodies.values()):
            return False
        tolerance = 1.0 if self.promised else 1.0 + _MEASURED_BOUND_TOLERANCE
        if self.uv_bound is not None and self.uv_error is not None and self.uv_error > self.uv_bound:
            return False
        return self.max_error is None or self.bound is None or self.max_error <= self.bound * tolerance

    def as_dict(self) -> dict[str, Any]:
        """Return the result as values for JSON, with None in place of infinity."""
        bodies = {name: body.as_dict() for name, body in self.bodies.items()}
        values = {**asdict(self), "holds": self.holds, "bodies": bodies}
        return {name: None if value == float("inf") else value for name, value in values.items()}


@public
def verify(
    path: PathLike,
    original: FileOr[Frames | Model] | None = None,
    progress: Progress = log_progress,
    *,
    script: PathLike | None = None,
) -> Verification:
    """Verify checksums and error bound of a model, and that its frames decode to finite points.

    Parameters
    ----------
    path : path-like
        HDF5 or GLB file with a result of `mixseq.compress`, or a model.
    original : MeshSequence, SequenceReader or Model, optional
        The sequence before compression or fitting, or the one before that; all vertices of all frames are compared,
        even if vertices were renumbered. Of models, bodies of equal names are compared.
    progress : callable, optional
        Function that is called after every frame.
    script : path-like, optional
        Edit script by which the model was edited. It is applied to the exact model of the original.

    Raises
    ------
    FormatError
        If the file is damaged or is not a model, or if a decoded frame is not finite.
    InvalidSequenceError
        If the original is not a sequence, or if its mesh or frames differ from those of the model.
    SettingsError
        If the model was edited and there is no script.

    Examples
    --------
    >>> import mixseq
    >>> mixseq.save("small.h5", mixseq.compress("arm.usdc", max_error=1e-3))
    >>> mixseq.verify("small.h5", "arm.usdc").max_error <= 1e-3
    True
    """
    file = Path(path)
    sequence = read_compressed(file) if is_compressed(file) else None
    models = load(file) if sequence is None else decode_model(file, sequence)
    uv_bounds = {} if sequence is None else {body.header.name: body.parameters.uv_error for body in sequence.all_bodies}
    first = models.header.name
    originals: dict[str, Frames] = {}
    if isinstance(original, Model):
        originals = {frames.header.name: frames for frames in original.frames_of_bodies()}
        originals[first] = originals.get(first, next(iter(originals.values())))
    elif original is not None:
        check_frames(original)
        originals[first] = cast("Frames", original)
    if script is not None and originals:
        originals = {first: _edit(originals[first], Path(script))}
    results = {
        name: _verify_body(file, models.body(name), originals.get(name), uv_bounds.get(name), script is None, progress)
        for name in models.body_names
    }
    return replace(results.pop(first), bodies=results)


def _verify_body(
    file: Path, model: Model, original: Frames | None, uv_bound: float | None, has_bound: bool, progress: Progress
) -> Verification:
    """Return the verification of the body in front; `has_bound` is whether the original is that of the file."""
    header, provenance = model.header, model.header.provenance or Provenance(file.name)
    if provenance.source is None:
        provenance = replace(provenance, source=Provenance(""))
    bounds = provenance.bounds
    verification = Verification(
        header.frame_count,
        header.vertex_count,
        **_describe(*bounds[0], header),
        provenance=str(provenance),
        uv_bound=uv_bound,
    )
    frames = LazyFrames(header, lambda size: _finite_blocks(file, model, size, progress))
    if original is None:
        for _ in frames.blocks(FRAMES_PER_BLOCK):
            pass
        return verification
    unbounded = SettingsError(
        f"{file} is {provenance or 'a model of an unknown original'}, which has no bound; give the edit script, "
        "which is applied to the original for comparison (--script), or measure without a bound by mixseq compare"
    )
    if has_bound and bounds[0][1] is None:
        raise unbounded
    paired, renumbering = match_reference(original, header)
    uv_error = None if uv_bound is None else _uv_error(original.header, header)
    errors = _measure_errors(paired, frames, renumbering)
    checksum = errors.pop("checksum")
    if has_bound:
        step, bound = _find_step(bounds, checksum, original.header)
        if bound is None:
            raise unbounded
        verification = replace(verification, **_describe(step, bound, header))
    return replace(verification, **errors, uv_error=uv_error)


Bounds = list[tuple[Provenance, float | None]]


def _find_step(bounds: Bounds, checksum: int, header: SequenceHeader) -> tuple[Provenance, float | None]:
    """Return the step whose source has the frames or else the name of an original, or else the first step."""
    same = [bound for bound in bounds if bound[0].source and bound[0].source.checksum == checksum]
    named = [bound for bound in bounds if bound[0].source and bound[0].source.name == header.file_name]
    return [*same, *named, bounds[-1]][0]


def _describe(step: Provenance, bound: float | None, header: SequenceHeader) -> dict[str, Any]:
    """Return the fields of `Verification` for the source of a step."""
    name = step.source.name if step.source else ""
    diagonal = step.diagonal * header.metres_per_unit
    return {"source": name, "bound": bound, "promised": step.promised, "diagonal": diagonal}


def _edit(original: Frames, script: Path) -> LazyFrames:
    """Return the frames of the exact model of a sequence after the edits of a script."""
    from mixseq.operations.script import Readers, read_script
    from mixseq.signals.fitting import fit
    from mixseq_io.registry import read

    model = fit(original, exact=True)
    for edit in read_script(script, Readers(model=load, mesh=read)):
        model = edit(model)
    return LazyFrames(model.header, lambda size: model.blocks(model.times, size))


def _finite_blocks(path: Path, model: Model, size: int, progress: Progress) -> Iterator[FloatArray]:
    """Decode all frames of a model in blocks ``(B, V, 3)``; raise `FormatError` if a frame is not finite."""
    first_frame = 0
    for block in model.blocks(model.times, size, progress=progress):
        finite = np.isfinite(block).all(axis=(1, 2))
        if not finite.all():
            name = model.header.frame_name(first_frame + int(finite.argmin()))
            raise FormatError(f"{path}: {name} is not finite; it is damaged")
        yield block
        first_frame += len(block)


def _measure_errors(original: Frames, frames: Frames, renumbering: Renumbering) -> dict[str, Any]:
    """Compare all vertices of all frames; return the errors, the worst frame and vertex, and a checksum."""
    squared_sum = variation = worst = 0.0
    first_frame, worst_frame, worst_vertex, checksum = 0, 0, 0, 0
    unit = Diagonal(0.0, 0)
    for x, y in paired_blocks(original, frames, FRAMES_PER_BLOCK):
        checksum = frames_checksum([x], checksum)
        if first_frame == 0:
            unit = reference_diagonal(chain([x], original.blocks()))
        with np.errstate(over="ignore"):  # an overflow gives an infinite distance
            squared = np.square(unit.rescale(x - y)).sum(axis=2)
            squared_sum += float(squared.sum())
            variation += float(np.square(unit.rescale(x - x.mean(axis=1, keepdims=True))).sum())
        if squared.max() > worst:
            worst = float(squared.max())
            frame, vertex = np.unravel_index(squared.argmax(), squared.shape)
            worst_frame, worst_vertex = first_frame + int(frame), int(vertex)
        first_frame += len(x)
    return {
        "checksum": checksum,
        "max_error": _ratio(np.sqrt(worst), unit.fraction or 1.0),
        "kg_percent": 100 * _ratio(np.sqrt(squared_sum), np.sqrt(variation)),
        "worst_frame": worst_frame,
        "worst_vertex": int(renumbering.vertices[worst_vertex]),
    }


def _uv_error(original: SequenceHeader, header: SequenceHeader) -> float | None:
    """Return the largest difference of texture coordinates at corners, or None if a comparison is impossible."""
    original_uvs, uvs = original.surface.uvs, header.surface.uvs
    match = match_polygons(original.polygons, header.polygons)
    if original_uvs is None or uvs is None or match is None:
        return None
    differences = original_uvs.at_corners.astype(np.float64) - uvs.at_corners[match.corners]
    return float(np.abs(differences).max())


def _ratio(value: float, unit: float) -> float:
    if value == 0:
        return 0.0
    return float(value / unit) if 0 < unit < np.inf else float("inf")
