"""Modules that know nothing of sequences: checksums, zlib, splines and the operator in time are those of Python."""

from __future__ import annotations

import json
import zlib
from base64 import b64encode
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mixseq.compression.bitstream.arithmetic import checksum_of
from mixseq.signals.curve import Curve
from mixseq.spaces.temporal import TemporalOperator, insert_midpoints, spline_weights
from tests.web.conftest import Node


def told(node: Node, folder: Path, script: str, given: Any) -> Any:
    """What a script prints as JSON that finds what is given in `given`."""
    path = folder / "given.json"
    path.write_text(json.dumps(given), encoding="utf-8")
    head = 'import { readFileSync } from "node:fs";\nconst given = JSON.parse(readFileSync(process.argv[2]));\n'
    return json.loads(node(f"{head}{script}", path))


def test_checksums(node: Node, tmp_path: Path) -> None:
    script = """
    import { crc32 } from "decoder/arithmetic.js";
    import { checksumOf } from "decoder/arithmetic.js";
    const whole = crc32(Uint8Array.from(given.bytes)), half = given.bytes.length >> 1;
    const first = crc32(Uint8Array.from(given.bytes.slice(0, half)));
    console.log(JSON.stringify([
      whole, crc32(Uint8Array.from(given.bytes.slice(half)), first), checksumOf(Float64Array.from(given.numbers)),
      checksumOf(Int32Array.from([-1, 7]), checksumOf([2 ** 40])),
    ]));
    """
    data = np.random.default_rng(0).integers(0, 256, 1001).astype(np.uint8)
    numbers = np.array([0, 1, -1, 2**31, -(2**31), 2**32, -(2**32) - 1, 2**52 + 3, -(2**52) + 1])
    found = told(node, tmp_path, script, {"bytes": data.tolist(), "numbers": numbers.tolist()})
    whole = zlib.crc32(data.tobytes())
    chained = checksum_of(np.array([-1, 7]), checksum_of(np.array([2**40])))
    assert found == [whole, whole, checksum_of(numbers), chained]


def test_zlib_is_undone(node: Node, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    texts = [
        b"a",
        b"to be or not to be, to be",
        bytes(70_000),
        rng.bytes(70_000),
        rng.integers(0, 4, 9000).astype(np.uint8).tobytes(),
        np.arange(4000, dtype="<i8").tobytes(),
    ]
    cases = [(text, zlib.compress(text, level)) for text in texts for level in (0, 1, 6, 9)]
    fixed = zlib.compressobj(strategy=zlib.Z_FIXED)
    cases.append((texts[1], fixed.compress(texts[1]) + fixed.flush()))
    script = """
    import { crc32 } from "decoder/arithmetic.js";
    import { decompressed } from "decoder/stream_index.js";
    const outcome = ([text, size]) => decompressed(Uint8Array.from(Buffer.from(text, "base64")), size, "the bytes")
      .then(crc32).catch(({ name }) => name);
    console.log(JSON.stringify(await Promise.all(given.map(outcome))));
    """
    given = [(b64encode(packed).decode(), len(text)) for text, packed in cases]
    assert told(node, tmp_path, script, given) == [zlib.crc32(text) for text, _ in cases]
    _, packed = cases[6]
    broken = [packed[:-1], packed[:9], packed[:-1] + b"!", b"\x78\x9c\x07" + packed[3:]]
    wrong = [(b64encode(each).decode(), len(texts[1])) for each in broken]
    wrong.append((b64encode(packed).decode(), len(texts[1]) - 1))
    assert told(node, tmp_path, script, wrong) == ["MixseqError"] * len(wrong)


@pytest.mark.parametrize("count", [2, 3, 4, 5, 20])
def test_splines(node: Node, tmp_path: Path, count: int) -> None:
    rng = np.random.default_rng(count)
    knots = np.cumsum(rng.uniform(0.2, 2.0, count))
    times = np.concatenate([knots, rng.uniform(knots[0], knots[-1], 10)])
    script = """
    import { splineWeights } from "decoder/curve.js";
    const { times, smooth } = given, knots = Float64Array.from(given.knots);
    console.log(JSON.stringify(times.map((time) => [...splineWeights(knots, time, smooth)])));
    """
    for ends, smooth in (("natural", False), ("not-a-knot", True)):
        given = {"knots": knots.tolist(), "times": times.tolist(), "smooth": smooth}
        expected = spline_weights(knots, times, "not-a-knot" if ends == "not-a-knot" else "natural")
        np.testing.assert_allclose(told(node, tmp_path, script, given), expected, atol=1e-11)


@pytest.mark.parametrize("count", [1, 2, 7, 130])
@pytest.mark.parametrize("length", [np.inf, 1.0, 5.6])
def test_curves_between_frames(node: Node, tmp_path: Path, count: int, length: float) -> None:
    """Weights of frames at middles, and the spline through these and the frames, of which a window is enough."""
    rng = np.random.default_rng(count)
    frames, cubic = np.cumsum(rng.uniform(0.02, 0.1, count)), (0.3, 0.8)
    rows = np.cumsum(rng.normal(size=(count, 2)), axis=0)
    times = np.concatenate([insert_midpoints(frames), rng.uniform(frames[0], frames[-1], 20)])
    operator = TemporalOperator(frames, length, cubic)
    knots = insert_midpoints(frames)
    expected = Curve(knots, operator.weights_at(knots).interpolate(rows))(times)
    script = """
    import { Curve } from "decoder/curve.js";
    const { frames, times, rows, between } = given;
    const curve = new Curve(Float64Array.from(frames), between, 2, (frame) => Float64Array.from(rows[frame]));
    console.log(JSON.stringify(times.map((time) => [...curve.at(time)])));
    """
    between = {"length": None if np.isinf(length) else length, "cubic": cubic}
    given = {"frames": frames.tolist(), "times": times.tolist(), "rows": rows.tolist(), "between": between}
    np.testing.assert_allclose(told(node, tmp_path, script, given), expected, atol=1e-8)
