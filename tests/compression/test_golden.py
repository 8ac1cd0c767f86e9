"""Streams of earlier days decode to the points that they decoded to then."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from mixseq.compression.bitstream.compressed_sequence import Chunk, CodingParameters, CompressedSequence, decode
from mixseq.compression.encoder.compress import compress
from mixseq.mesh.polygons import Polygons
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import MeshSequence
from tests.meshes import bar, rotation, tetrahedron, torus, tube

GOLDEN = Path(__file__).parent / "golden"


def _bounded() -> CompressedSequence:
    return compress(bar(sides=5, rings=9, frames=6), max_error=3e-3)


def _shapes() -> CompressedSequence:
    points, faces = tube(4, 5)
    noise = np.random.default_rng(0).normal(size=(20, *points.shape))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mixseq.compression.encoder.search.BASIS_KINDS", ("shapes",))
        return compress(MeshSequence.from_arrays(points + 0.1 * noise, faces), kg=2)


def _long() -> CompressedSequence:
    points, faces = tetrahedron()
    frames = [points @ rotation((0.1 * t, 0.03 * t, 2.0)).T + [0.05 * t, 0, 0] for t in range(200)]
    return compress(MeshSequence.from_arrays(np.stack(frames), faces), kg=1, chunk=100)


def _parts() -> CompressedSequence:
    points, faces = torus(10, 8)
    turns = np.random.default_rng(1).normal(size=(3, 12, 3)).cumsum(axis=1)
    bodies = [
        np.stack([points @ rotation(tuple(turn)).T + [5.0 * number, 0, 0] for turn in body])
        for number, body in enumerate(turns)
    ]
    together = np.concatenate([faces + len(points) * number for number in range(3)])
    return compress(MeshSequence.from_arrays(np.concatenate(bodies, axis=1), together), kg=0.5)


CASES: dict[str, Callable[[], CompressedSequence]] = {
    "bounded": _bounded,
    "shapes": _shapes,
    "long": _long,
    "parts": _parts,
}


def stored(name: str) -> tuple[CompressedSequence, np.ndarray, np.ndarray]:
    """Return a golden sequence, the frames whose points are known, and these ``(n, V, 3)``."""
    with np.load(GOLDEN / f"{name}.npz") as file:
        parts = {key: file[key] for key in file.files}
    polygons = Polygons(parts["counts"], parts["indices"])
    header = SequenceHeader(polygons=polygons, vertex_count=parts["points"].shape[1], times=parts["times"])
    parameters = CodingParameters(**json.loads(str(parts["parameters"])))
    fields = tuple(parts[f"fields {n}"].tobytes() for n in range(int(parts["groups"])))
    chunks = tuple(
        Chunk(int(first), int(count), parts[f"tracks {n}"].tobytes(), parts[f"corrections {n}"].tobytes())
        for n, (first, count) in enumerate(parts["chunks"])
    )
    return CompressedSequence(header, parameters, fields, chunks), parts["frames"], parts["points"]


def store(name: str, coded: CompressedSequence) -> None:
    """Write a golden sequence."""
    frames = np.linspace(0, coded.header.frame_count - 1, 6).astype(int)
    parts: dict[str, bytes] = {f"fields {n}": stream for n, stream in enumerate(coded.basis)}
    parts |= {f"tracks {n}": chunk.coefficients for n, chunk in enumerate(coded.chunks)}
    parts |= {f"corrections {n}": chunk.residuals for n, chunk in enumerate(coded.chunks)}
    np.savez_compressed(
        GOLDEN / f"{name}.npz",
        counts=coded.header.polygons.counts,
        indices=coded.header.polygons.indices,
        times=coded.header.times,
        parameters=json.dumps(asdict(coded.parameters)),
        groups=len(coded.basis),
        chunks=[(chunk.first, chunk.count) for chunk in coded.chunks],
        frames=frames,
        points=decode(coded).sample(frames=frames.tolist()).points,
        **{name: np.frombuffer(stream, dtype=np.uint8) for name, stream in parts.items()},  # type: ignore[arg-type]
    )


@pytest.mark.parametrize("name", CASES)
def test_golden_streams_decode_to_the_same_points(name: str) -> None:
    coded, frames, points = stored(name)
    found = decode(coded).sample(frames=frames.tolist()).points
    np.testing.assert_allclose(found, points, rtol=0, atol=1e-9)


def test_golden_streams_have_all_that_streams_can_have() -> None:
    bounded, shapes, long, parts = (stored(name)[0] for name in CASES)
    assert bounded.parameters.factors == "trajectories"
    assert bounded.parameters.promised
    assert all(chunk.residuals for chunk in bounded.chunks)
    assert shapes.parameters.factors == "shapes"
    assert len(shapes.basis) > 1
    assert len(long.chunks) > 1
    assert len(parts.parameters.ranks) == 3


if __name__ == "__main__":
    for case, make in CASES.items():
        store(case, make())
