"""Shared cases: sequences that are awkward in one way each, and the formats that must hold them."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mixseq.errors import MixseqWarning
from mixseq.sequence import FloatArray, MeshSequence, Polygons
from mixseq_io import write

PENTAGON_QUAD_TRIANGLE = Polygons(np.array([5, 4, 3]), np.array([0, 1, 2, 3, 4, 0, 5, 6, 1, 6, 7, 2]))


def wave(frames: int = 5, vertices: int = 8, dtype: type = np.float32, scale: float = 1.0) -> FloatArray:
    """Return points (frames, vertices, 3) with no structure that a format could profit from."""
    rng = np.random.default_rng(frames * 1000 + vertices)
    return np.asarray(rng.normal(size=(frames, vertices, 3)) * scale).astype(dtype)


def fan(vertices: int = 8) -> list[list[int]]:
    return [[0, i, i + 1] for i in range(1, vertices - 1)]


def subnormal() -> FloatArray:
    points = wave()
    points[1, 2] = 1e-42, -1e-45, float(np.finfo(np.float32).tiny)
    return points


CASES: dict[str, Callable[[], MeshSequence]] = {
    "triangles": lambda: MeshSequence.from_arrays(wave(), fan()),
    "polygons": lambda: MeshSequence.from_arrays(wave(), PENTAGON_QUAD_TRIANGLE),
    "quads": lambda: MeshSequence.from_arrays(
        wave(), Polygons(np.array([4, 4]), np.array([0, 1, 2, 3, 4, 5, 6, 7]))
    ),
    "tiny": lambda: MeshSequence.from_arrays(
        wave(vertices=3, scale=1e-9), [[0, 1, 2]], metres_per_unit=0.001
    ),
    "unused vertices": lambda: MeshSequence.from_arrays(wave(vertices=9), [[0, 4, 8]]),
    "one frame": lambda: MeshSequence.from_arrays(wave(1), fan()),
    "hundred frames": lambda: MeshSequence.from_arrays(wave(100), fan(), fps=29.97),
    "uneven times": lambda: MeshSequence.from_arrays(
        wave(4), fan(), times=[-1.0, 0.1, 0.1 + 1e-6, 7 / 3], fps=30, up_axis="Z"
    ),
    "huge": lambda: MeshSequence.from_arrays(wave(scale=1e7), fan(), metres_per_unit=0.01),
    "float64": lambda: MeshSequence.from_arrays(wave(dtype=np.float64, scale=np.pi), fan()),
    "subnormal": lambda: MeshSequence.from_arrays(subnormal(), fan()),
    "unicode name": lambda: MeshSequence.from_arrays(wave(), fan(), name="Männchen 走る.001"),
}


@dataclass(frozen=True)
class Target:
    """A format under test: the file name it is asked for, and what it promises to keep."""

    file_name: str
    keeps_header: bool = True
    float32_only: bool = False
    options: dict[str, Any] = field(default_factory=dict)


TARGETS = (
    Target("walk.usdc", float32_only=True),
    Target("walk.usda", float32_only=True),
    Target("walk.usd", float32_only=True),
    Target("walk.npz"),
    Target("walk.npz", options={"compress": True}),
    Target("walk.h5"),
    Target("walk.hdf5"),
    Target("walk_####.obj", keeps_header=False),
    Target("walk.%03d.obj", keeps_header=False, options={"start": 998}),
)


@pytest.fixture(params=list(CASES))
def sequence(request: pytest.FixtureRequest) -> MeshSequence:
    """Every case in turn."""
    return CASES[request.param]()


@pytest.fixture(params=TARGETS, ids=lambda target: target.file_name + "+".join(target.options))
def target(request: pytest.FixtureRequest) -> Target:
    """Every format in turn."""
    chosen: Target = request.param
    return chosen


@pytest.fixture
def plain() -> MeshSequence:
    """A sequence that every format holds."""
    return CASES["polygons"]()


@contextmanager
def lossy() -> Iterator[None]:
    """Accept warnings that a format cannot hold something; other tests look at them."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MixseqWarning)
        yield


@pytest.fixture
def store(tmp_path: Path) -> Callable[[Target, MeshSequence], Path]:
    """Write a sequence in a format, and return what to read."""

    def write_it(target: Target, sequence: MeshSequence) -> Path:
        with lossy():
            write(tmp_path / target.file_name, sequence, **target.options)
        return tmp_path / target.file_name

    return write_it


@pytest.fixture
def files(tmp_path: Path) -> Callable[[], dict[str, bytes]]:
    """Return the names and contents of all files in the test's folder."""
    return lambda: {
        str(file.relative_to(tmp_path)): file.read_bytes()
        for file in sorted(tmp_path.rglob("*"))
        if file.is_file()
    }


@pytest.fixture
def data() -> Path:
    """The folder of real animations."""
    folder = os.environ.get("MIXSEQ_DATA")
    if not folder:
        pytest.skip("MIXSEQ_DATA is not set")
    return Path(folder)
