"""Rates and CPU seconds beside peers, all in one run: Draco, meshopt, PCA, py-dem-bones, SciPy's spline and pxr.

Seconds are those of a processor, on as many threads as MIXSEQ_THREADS allows. Where mixseq and a peer take turns, they
are medians. Coders take the coarsest of their settings that keeps the bound. Ratios above 1 are in favour of mixseq.

Usage: MIXSEQ_THREADS=1 scripts/bench speed [NAME ...]   (animations of $MIXSEQ_DATA/npz)
"""

from __future__ import annotations

import lzma
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from pxr import Usd, UsdGeom, Vt
from scipy.interpolate import make_interp_spline

import mixseq
from mixseq.compression.bitstream.signal_coder import Writer, code_numbers, new_number_models
from mixseq.compression.bitstream.signal_graph import mesh_graph
from mixseq.types import Float, FloatArray, IntArray
from scripts.benchmarks.common.dembones import fit_peer
from scripts.benchmarks.common.harness import MIXSEQ, Child, animation, cpu_timed, print_table, run
from scripts.benchmarks.peers.coders import Coder, Draco, Meshopt, Ours
from scripts.benchmarks.peers.pca import Pca

NAMES = ("q_man_run", "horse_gallop", "elephant_gallop")
COLUMNS = ("sequence", "V", "what", "mixseq", "peer", "its figure", "ratio")

MAX_ERROR = 1e-3
"""Bound in diagonals of the coders."""

PEERS: tuple[Coder, ...] = (Pca("trajectory"), Meshopt(), Draco())
RUNS = 5
FRAMES_PER_FRAME = 4
"""Number of sampled frames per frame of the animation."""

WRITTEN_FRAMES = 60
SKIN_ERROR = 5e-3
"""Bound in diagonals of skins."""

TALLER = 1.0, 1.2, 1.0
BATCH_SIZE = 12
BATCHES = ("--threads", 2), ("--cluster", "local:2")

STARTS = {"first frame": "model(model.times[0])", "between frames, as players": "model.playback(between)",
          "between frames, fitted": "model(between)"}  # fmt: skip
PROGRAM = """
import sys, mixseq
model = mixseq.load(sys.argv[1])
between = model.start + 0.4 * (model.times[1] - model.times[0])
"""


class Row(NamedTuple):
    """A line of the table."""

    what: str
    ours: float
    peer: str
    its: float
    is_rate: bool = False


def rows(name: str) -> Iterator[tuple[str, ...]]:
    """Measure an animation."""
    sequence = animation(name)
    with tempfile.TemporaryDirectory() as folder:
        for measure in (code, entropy, start, load, fit, skin, sample, resample, transfer, write, batch):
            for row in measure(name, sequence, Path(folder)):
                ratio = row.ours / row.its if row.is_rate else row.its / row.ours
                figures = f"{row.ours:.3g}", row.peer, f"{row.its:.3g}", f"{ratio:.2f}"
                yield name, str(sequence.vertex_count), row.what, *figures


def code(name: str, sequence: mixseq.MeshSequence, folder: Path) -> Iterator[Row]:
    """Compress and decompress within the bound."""
    _, ours = (coded(Ours(), sequence, ("max_error", MAX_ERROR)) for _ in range(2))  # loads compiled loops first
    for coder in PEERS:
        if coder.package and find_spec(coder.package) is None:
            continue
        found = (coded(coder, sequence, setting) for setting in coder.settings(sequence))
        theirs = next(figures for figures in found if figures[-1] <= MAX_ERROR)
        for what, *figures in zip(("bits a vertex and frame", "encode, s", "decode, s"), ours, theirs, strict=False):
            yield Row(what, figures[0], coder.title, figures[1])


def coded(coder: Coder, sequence: mixseq.MeshSequence, setting: Any) -> tuple[float, float, float, float]:
    """Return bits per vertex and frame, seconds to encode and to decode, and the largest error in diagonals."""
    mesh = mixseq.Topology(sequence.faces, sequence.vertex_count)
    encoding, data = cpu_timed(partial(coder.encode, sequence, setting))
    decoding, points = cpu_timed(partial(coder.decode, mesh, data))
    away = np.sqrt(np.square(points - sequence.points.astype(np.float64)).sum(axis=2).max())
    bits = 8 * coder.signals(mesh, data) / sequence.points[..., 0].size
    return bits, encoding, decoding, float(away) / sequence.diagonal


def entropy(name: str, sequence: mixseq.MeshSequence, folder: Path) -> Iterator[Row]:
    """Write the change of a coordinate from frame to frame, in whole steps of the bound, in both entropy coders."""
    graph = mesh_graph(sequence.faces, sequence.vertex_count)
    steps = np.diff(sequence.points[:, graph.order, 0], axis=0) / (MAX_ERROR * sequence.diagonal)
    numbers = np.rint(steps).astype(np.int64)
    unknown = np.zeros(graph.size, dtype=np.int64)

    def write() -> None:
        writer, models = Writer(), new_number_models()
        for age, own in enumerate(numbers):
            stream = writer.reserve(graph.size)
            code_numbers(stream, models, age, graph.neighbours, graph.counts, unknown, unknown, unknown, own)
        writer.finish()

    ours, theirs = medians(write, lambda: lzma.compress(numbers.astype(np.int16).tobytes()))
    yield Row("entropy coder, ns a number", 1e9 * ours / numbers.size, "lzma", 1e9 * theirs / numbers.size)


def start(name: str, sequence: mixseq.MeshSequence, folder: Path) -> Iterator[Row]:
    """Load a compressed file in a new process, with its reader; loops have been compiled before."""
    path = folder / "coded.h5"
    mixseq.save(path, mixseq.compress(sequence, max_error=MAX_ERROR))
    programs = "import numpy, numba", *(PROGRAM + frame for frame in STARTS.values())
    imports, *seconds = np.median(
        [[run(sys.executable, "-c", each, path).cpu for each in programs] for _ in range(RUNS + 1)][1:], axis=0
    )
    for what, ours in zip(STARTS, seconds, strict=True):
        yield Row(f"new process: {what}, s", ours, "import of numba alone", imports)


def load(name: str, sequence: mixseq.MeshSequence, folder: Path) -> Iterator[Row]:
    """Load a compressed file in this process, and all its frames, beside the points as they are."""
    coded, plain = str(folder / "coded.h5"), str(folder / "plain.npz")
    mixseq.write(plain, sequence)
    ours, theirs = medians(lambda: mixseq.load(coded).sample(), lambda: mixseq.read(plain))
    yield Row("load and all frames, s", ours, "points in .npz", theirs)


def fit(name: str, sequence: mixseq.MeshSequence, folder: Path) -> Iterator[Row]:
    """Fit a default model, and as many bones as it has parts."""
    mixseq.fit(sequence)
    seconds, model = cpu_timed(partial(mixseq.fit, sequence))
    if peer := fit_peer(name, len(model.decomposition.parts)):
        yield Row("fit, s", seconds, "py-dem-bones", float(np.median(peer.seconds)))
        error = mixseq.compare(sequence, model.sample()).kg_percent
        yield Row("KG error of the fit, %", error, "py-dem-bones", peer.kg_percent)


def skin(name: str, sequence: mixseq.MeshSequence, folder: Path) -> Iterator[Row]:
    """Find the fewest bones for an error, beside as many bones that are known."""
    seconds, found = cpu_timed(partial(mixseq.fit_skin, sequence, max_error=SKIN_ERROR))
    if peer := fit_peer(name, found.bone_count):
        theirs = float(np.median(peer.seconds))
        yield Row("fewest bones of a skin for an error, s", seconds, "py-dem-bones, with as many", theirs)


def sample(name: str, sequence: mixseq.MeshSequence, folder: Path) -> Iterator[Row]:
    """Sample a default model, and the cubic spline of the vertices."""
    model, spline = mixseq.fit(sequence), spline_of(sequence)
    times = np.linspace(model.start, model.end, FRAMES_PER_FRAME * (len(sequence) - 1) + 1)
    ours, theirs = medians(lambda: [block[0] for block in model.blocks(times)], lambda: [spline(t) for t in times])
    yield Row("sampling, frames/s", len(times) / ours, "SciPy's cubic spline", len(times) / theirs, is_rate=True)
    yield Row("rms error at left-out frames, diagonals", *left_out_errors(sequence))


def resample(name: str, sequence: mixseq.MeshSequence, folder: Path) -> Iterator[Row]:
    """Resample a file at another rate, beside reading and writing it."""
    source, target = folder / "source.usdc", folder / "target.usdc"
    mixseq.write(source, sequence)
    jobs = ("resample", "--fps", "60"), ("convert",)
    ours, theirs = median_runs(*((*MIXSEQ, job, source, target, *more) for job, *more in jobs))
    yield Row("resample a .usdc, s", ours.cpu, "convert alone", theirs.cpu)


def transfer(name: str, sequence: mixseq.MeshSequence, folder: Path) -> Iterator[Row]:
    """Transfer to a taller body with the same triangles, by both methods."""
    tall = sequence[:1].with_points(sequence.points[:1] * TALLER)
    methods: tuple[Literal["mixed", "gradients"], ...] = "mixed", "gradients"
    ours, theirs = medians(*(partial(mixseq.transfer, sequence, tall, method=method) for method in methods))
    yield Row("transfer, ms a frame", 1e3 * ours / len(sequence), "by gradients", 1e3 * theirs / len(sequence))


def batch(name: str, sequence: mixseq.MeshSequence, folder: Path) -> Iterator[Row]:
    """Encode copies in a batch: seconds of a clock on one process, on two, and on two of a cluster."""
    shots = folder / "shots"
    shots.mkdir()
    for number in range(BATCH_SIZE):
        mixseq.write(shots / f"{number}.npz", sequence)
    words = *MIXSEQ, "batch", "encode", shots, "--force", "--out"
    one, two, cluster = median_runs(
        *((*words, folder / f"out{n}", *more) for n, more in enumerate((("--threads", 1), *BATCHES)))
    )
    yield Row(f"batch of {BATCH_SIZE} on 2 processes, s of a clock", two.seconds, "one process", one.seconds)
    yield Row("batch on --cluster local:2, s of a clock", cluster.seconds, "2 processes", two.seconds)


def write(name: str, sequence: mixseq.MeshSequence, folder: Path) -> Iterator[Row]:
    """Write .usdc, from points in float32 and, rounded, in float64."""
    points = np.resize(sequence.points, (WRITTEN_FRAMES, *sequence.points.shape[1:])).astype(np.float32)
    single = mixseq.MeshSequence.from_header(sequence.header.with_times(np.arange(WRITTEN_FRAMES) / 24), points)
    double = single.with_points(points.astype(np.float64) + 1e-9 * sequence.diagonal)
    file = str(folder / "a.usdc")
    for each, precision in ((single, "float32"), (double, "float64")):
        writers = partial(mixseq.write, file, each), partial(write_plainly, file, each.points, sequence.faces)
        rates = (points.nbytes / 1e6 / seconds for seconds in medians(*writers))
        yield Row(f".usdc of {precision}, MB/s", next(rates), "pxr alone", next(rates), is_rate=True)


def medians(*functions: Callable[[], object]) -> list[float]:
    """Return the median CPU seconds of functions that take turns, after a run of each that is not counted."""
    seconds = [[cpu_timed(function)[0] for function in functions] for _ in range(RUNS + 1)]
    return [float(median) for median in np.median(seconds[1:], axis=0)]


def median_runs(*commands: Sequence[object]) -> list[Child]:
    """Return the run of median CPU seconds of programs that take turns, after a run of each that is not counted."""
    runs = [[run(*command) for command in commands] for _ in range(RUNS + 1)][1:]
    return [sorted(each, key=lambda child: child.cpu)[RUNS // 2] for each in zip(*runs, strict=True)]


def spline_of(sequence: mixseq.MeshSequence) -> Callable[[Float], Float]:
    spline: Callable[[Float], Float] = make_interp_spline(sequence.times, sequence.points.astype(np.float64))
    return spline


def left_out_errors(sequence: mixseq.MeshSequence) -> tuple[float, str, float]:
    """Return the errors of a default model and of the spline of every second frame, at the frames between."""
    kept = np.arange(0, len(sequence), 2)
    header = sequence.header.with_times(sequence.times[kept])
    keys = mixseq.MeshSequence.from_header(header, sequence.points[kept])
    between = np.arange(1, kept[-1], 2)
    times, expected = sequence.times[between], sequence.points[between]
    found = (mixseq.fit(keys)(times), spline_of(keys)(times))
    model, spline = (float(np.sqrt(np.square(x - expected).sum(axis=2).mean())) / sequence.diagonal for x in found)
    return model, "SciPy's cubic spline", spline


def write_plainly(file: str, points: FloatArray, faces: IntArray) -> None:
    """Write points, rounded, and faces with pxr alone, with the extents that it computes."""
    stage = Usd.Stage.CreateInMemory()
    mesh = UsdGeom.Mesh.Define(stage, "/mesh")
    mesh.CreateFaceVertexCountsAttr(Vt.IntArrayFromBuffer(np.full(len(faces), 3, dtype=np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArrayFromBuffer(faces.astype(np.int32).reshape(-1)))
    values, extents = mesh.CreatePointsAttr(), mesh.CreateExtentAttr()
    for frame_code, frame in enumerate(points):
        array = Vt.Vec3fArrayFromBuffer(frame.astype(np.float32, copy=False))
        values.Set(array, frame_code)
        extents.Set(UsdGeom.PointBased.ComputeExtent(array), frame_code)
    stage.GetRootLayer().Export(file)


if __name__ == "__main__":
    sys.exit(print_table(COLUMNS, rows, NAMES))
