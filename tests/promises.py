"""Whether a promise is kept: a sequence is fitted or compressed, saved, loaded and decoded, and measured on its own.

Errors are measured in extended precision (where the machine has it), by none of mixseq's code.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

import mixseq
from mixseq.errors import MixseqError, SettingsError
from mixseq.mesh.measures import choose_origin
from mixseq.sequence.sequence import MeshSequence, rounding_margin
from mixseq.signals.detail import EXACT_TOLERANCE
from mixseq.types import FloatArray, Index
from mixseq_io.model_files import read_compressed
from mixseq_io.rig_files import write_measured_rig
from tests.formats.vat.shader import looked_up, told, vertices_of

Way = str
WAYS: tuple[Way, ...] = ("fit", "compress", "exact")

Kind = Literal["kept", "refused", "broken", "verify wrong", "traceback"]
"""Refused is a typed error."""


@dataclass(frozen=True)
class Outcome:
    """What became of a promise: the measured error in diagonals, and what an error or `verify` said."""

    way: Way
    bound: float
    kind: Kind
    error: float | None
    words: str


def attempts(points: FloatArray, faces: Index, bounds: tuple[float, ...]) -> Iterator[Outcome]:
    """Try all ways with all bounds; exact models once."""
    for way in WAYS:
        for bound in (EXACT_TOLERANCE,) if way == "exact" else bounds:
            yield Outcome(way, bound, *_attempt(points, faces, way, bound))


def _attempt(points: FloatArray, faces: Index, way: Way, bound: float) -> tuple[Kind, float | None, str]:
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("error")  # numbers that overflow are no way to keep a promise
        warnings.filterwarnings("ignore", "there are no in-betweens")
        file = Path(folder, "model.h5")
        try:
            sequence = MeshSequence.from_arrays(points, faces)
            if way == "compress":
                mixseq.save(file, mixseq.compress(sequence, max_error=bound))
            else:
                exact = way == "exact"
                mixseq.save(file, mixseq.fit(sequence, exact=exact, tolerance=None if exact else bound))
            error = distance(points, mixseq.load(file).sample().points)
            wrong = "" if way != "compress" else "; ".join(_lies(file, sequence, bound))
        except MixseqError as refusal:
            return "refused", None, str(refusal)
        except Exception as other:  # a traceback is what is looked for
            return "traceback", None, f"{type(other).__name__}: {other}"
    if not error <= bound:
        return "broken", error, ""
    return ("verify wrong" if wrong else "kept"), error, wrong


DELIVERIES: tuple[Way, ...] = (
    *("python", "javascript", "player", "a.npz", "a.usdc", "a.abc", "a.glb", "a.pc2"),
    *("textures", "morph", "skin"),
)
"""What users get of a bound: `player` is JavaScript in single precision about its origin."""

_PLAY = """
import { readFileSync, writeFileSync } from "node:fs";
import { readGlb } from "player/glb.js";
import { open } from "decoder/sequence.js";
const file = readFileSync(process.argv[2]), start = file.byteOffset;
const { text, streams } = readGlb(file.buffer.slice(start, start + file.length));
const sequence = await open(text, streams), double = process.argv[4] === "javascript";
const frames = Array.from(sequence.times, (_, k) => {
  const out = new (double ? Float64Array : Float32Array)(3 * sequence.vertexCount);
  return Float64Array.from(sequence.frame(k, out), (value, at) => sequence.origin[at % 3] + value);
});
writeFileSync(process.argv[3], Buffer.concat(frames.map((frame) => new Uint8Array(frame.buffer))));
"""


def deliveries(
    points: FloatArray,
    faces: Index,
    bound: float,
    run_node: Callable[..., str] | None,
    ways: Iterable[Way] = DELIVERIES,
) -> Iterator[Outcome]:
    """Ask for a bound, and measure what arrives in each way; without Node.js, JavaScript is left out."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for way in ways:
            if run_node is None and way in ("javascript", "player"):
                continue
            try:
                error = distance(points, _delivered(points, faces, bound, way, Path(folder), run_node))
                kind: Kind = "kept" if error <= bound else "broken"
                yield Outcome(way, bound, kind, error, "")
            except MixseqError as refusal:
                yield Outcome(way, bound, "refused", None, str(refusal))
            except Exception as other:  # a traceback is what is looked for
                yield Outcome(way, bound, "traceback", None, f"{type(other).__name__}: {other}")


def _delivered(
    points: FloatArray, faces: Index, bound: float, way: Way, folder: Path, run_node: Callable[..., str] | None
) -> FloatArray:
    """Return the frames that arrive in a way; raise MixseqError if the bound is refused."""
    sequence = MeshSequence.from_arrays(points, faces)
    if way == "textures":
        mixseq.write_vat(folder / "a.vat", sequence, max_error=bound)
        frames = np.stack([looked_up(folder / "a.vat", "points", frame) for frame in range(len(points))])
        return _at_vertices(points, frames + np.array(told(folder / "a.vat")["origin"]), vertices_of(folder / "a.vat"))
    if way in ("morph", "skin"):
        rig = (
            mixseq.fit_morph(sequence, max_error=bound)
            if way == "morph"
            else mixseq.fit_skin(sequence, bones=3, correctives=bound, max_targets=len(points))
        )
        if distance(points, np.concatenate(list(rig.blocks()))) > bound:
            raise SettingsError("the rig does not reach the bound, which a warning says")
        write_measured_rig(folder / "rig.glb", rig, sequence, bound)
        return mixseq.read(folder / "rig.glb").points
    file = folder / f"{bound}.h5"
    if not file.exists():
        coded = mixseq.compress(sequence, max_error=bound, inbetweens=False)
        mixseq.save(file, coded)
        mixseq.save(file.with_suffix(".glb"), coded, still="none")
    if way in ("javascript", "player"):
        assert run_node is not None, "JavaScript is left out without Node.js"
        near = points - choose_origin(points[0])
        coordinates = [float(np.abs(each).max()) for each in (points, near)]
        if way == "player" and not rounding_margin(bound * sequence.diagonal, *coordinates):
            raise SettingsError("single precision does not hold the bound")
        run_node(_PLAY, file.with_suffix(".glb"), folder / "frames", way)
        return np.fromfile(folder / "frames").reshape(points.shape)
    decoded = mixseq.load(file).sample()
    if way == "python":
        return decoded.points
    mixseq.write(folder / way, decoded)
    return mixseq.read(folder / way).points


def _at_vertices(points: FloatArray, frames: FloatArray, vertices: Index) -> FloatArray:
    """Return frames ``(T, V, 3)`` of those at vertices ``(n,)``, which may repeat; others stay as they are."""
    result = points.astype(np.float64)
    apart = np.square(frames - result[:, vertices]).sum(axis=2).max(axis=0)
    order = np.argsort(apart)  # the farthest of repeated ones is kept
    result[:, vertices[order]] = frames[:, order]
    return result


def distance(points: FloatArray, others: FloatArray) -> float:
    """Return the largest distance of a vertex, in diagonals: of the first frame, or the largest if it is a point."""
    x, y = points.astype(np.longdouble), others.astype(np.longdouble)
    diagonals = np.sqrt(np.square(x.max(axis=1) - x.min(axis=1)).sum(axis=1))
    return float(np.sqrt(np.square(x - y).sum(axis=2).max()) / (diagonals[0] or diagonals.max() or 1))


def _lies(file: Path, sequence: MeshSequence, bound: float) -> Iterator[str]:
    """Yield what `verify` says wrongly: of the file, and of others that hold less than they promise."""
    coded = read_compressed(file)

    def wrong(case: str, original: MeshSequence) -> Iterator[str]:
        promised = read_compressed(file).parameters.max_error
        error = distance(original.points, mixseq.load(file).sample().points)
        found = mixseq.verify(file, original)
        if found.holds != (error <= promised):
            yield f"{case}: verify says {found.max_error} for {promised:g}, and it is {error:g}"

    yield from wrong("the file", sequence)
    finer = replace(coded.parameters, max_error=bound / 1e3)
    coarser = replace(coded.parameters, step=1.5 * coded.parameters.step)
    for case, parameters in (("another bound", finer), ("another step", coarser)):
        mixseq.save(file, replace(coded, parameters=parameters))
        yield from wrong(case, sequence)
    mixseq.save(file, coded)
    moved = sequence.points.astype(np.float64)
    moved[-1, -1, 1] += 3 * bound * (sequence.diagonal or 1.0)
    yield from wrong("a vertex elsewhere", sequence.with_points(moved))
    data = bytearray(file.read_bytes())
    data[-len(data) // 3] ^= 4
    file.write_bytes(data)
    with suppress(MixseqError):  # as it should
        yield from wrong("damage", sequence)
