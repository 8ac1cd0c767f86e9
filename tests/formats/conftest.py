"""Shared cases: sequences that are awkward in one way each, and the formats that must hold them."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mixseq.errors import MixseqWarning
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import CornerValues, FaceSet, MeshObject, Surface
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import FloatArray
from mixseq_io import FORMATS, write
from mixseq_io.registry import Format
from tests.formats.gltf_maker import load

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


def dressed() -> MeshSequence:
    """Two objects with everything that can be on them."""
    corners = PENTAGON_QUAD_TRIANGLE.indices.size
    polygons = Polygons(
        np.append(PENTAGON_QUAD_TRIANGLE.counts, 4), np.append(PENTAGON_QUAD_TRIANGLE.indices, [8, 9, 10, 11])
    )
    surface = Surface(
        uvs=CornerValues(np.random.default_rng(3).random((9, 2)), np.arange(corners + 4) % 9),
        colours=CornerValues(np.random.default_rng(4).random((7, 4)), np.arange(corners + 4) % 7),
        hard_edges=np.append(np.arange(corners), [12, 13, 14, 15]),
        face_sets=(FaceSet("skin", np.array([0, 2]), "skin"), FaceSet("cloth", np.array([3]), "cloth")),
        objects=(MeshObject("body", "", 8, 3), MeshObject("coat", "", 4, 1)),
    )
    return replace(MeshSequence.from_arrays(wave(vertices=12), polygons), surface=surface)


def painted() -> MeshSequence:
    """Return a mesh with opaque colours of bytes at its vertices."""
    plain = MeshSequence.from_arrays(wave(), PENTAGON_QUAD_TRIANGLE)
    channels = np.random.default_rng(5).integers(0, 256, (8, 4))
    channels[:, 3] = 255
    colours = CornerValues((channels / 255).astype(np.float32), plain.polygons.indices)
    return replace(plain, surface=Surface(colours=colours))


CASES: dict[str, Callable[[], MeshSequence]] = {
    "triangles": lambda: MeshSequence.from_arrays(wave(), fan()),
    "polygons": lambda: MeshSequence.from_arrays(wave(), PENTAGON_QUAD_TRIANGLE),
    "quads": lambda: MeshSequence.from_arrays(wave(), Polygons(np.array([4, 4]), np.array([0, 1, 2, 3, 4, 5, 6, 7]))),
    "tiny": lambda: MeshSequence.from_arrays(wave(vertices=3, scale=1e-9), [[0, 1, 2]], metres_per_unit=0.001),
    "unused vertices": lambda: MeshSequence.from_arrays(wave(vertices=9), [[0, 4, 8]]),
    "one frame": lambda: MeshSequence.from_arrays(wave(1), fan()),
    "dressed": dressed,
    "painted": painted,
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
    """A format under test: the file name it is asked for, and what of a sequence it gives back.

    Parameters
    ----------
    file_name : str
        The name; its extension chooses the format, whose table tells the rest.
    options : dict
        Options for writing.
    keeps_rate : bool
        Whether frames per second come back.
    keeps_name : bool
        Whether the name comes back.
    time_error : float
        How exact times are, as a fraction.
    keeps_unused : bool
        Whether vertices that no polygon uses come back.
    """

    file_name: str
    options: dict[str, Any] = field(default_factory=dict)
    keeps_rate: bool = True
    keeps_name: bool = True
    time_error: float = 1e-14
    keeps_unused: bool = True

    @property
    def format(self) -> Format:
        """The format of the file."""
        extension = Path(self.file_name).suffix
        return next(each for each in FORMATS if extension in each.extensions)

    @property
    def rounds(self) -> bool:
        """Whether points become float32."""
        return self.format.capabilities.points == "float32"


TARGETS = (
    Target("walk.usdc", {"flatten": True}),
    Target("walk.usda", {"flatten": True}),
    Target("walk.usd", {"flatten": True, "clips": 3}),
    Target("walk.usdz", {"flatten": True}),
    Target("walk.npz"),
    Target("walk.npz", {"compress": True}),
    Target("walk.h5"),
    Target("walk.abc", {"flatten": True}),
    Target("walk.glb", {"flatten": True}, time_error=1e-6),
    Target("walk.gltf", {"flatten": True}, time_error=1e-6),
    Target("walk.pc2", keeps_rate=False),
    Target("walk.mdd", keeps_rate=False, time_error=1e-6),
    Target("walk_####.obj", keeps_rate=False),
    Target("walk.%03d.obj", {"start": 998}, keeps_rate=False),
    Target("walk_####.ply", keeps_rate=False, keeps_name=False),
    Target("walk_####.stl", keeps_rate=False, keeps_name=False, keeps_unused=False),
    Target("walk_####.off", keeps_rate=False, keeps_name=False),
)


@pytest.fixture(params=TARGETS, ids=lambda target: target.file_name + "+".join(target.options))
def target(request: pytest.FixtureRequest) -> Target:
    """Every format in turn."""
    chosen: Target = request.param
    return chosen


@pytest.fixture
def plain() -> MeshSequence:
    """A sequence that every format holds."""
    return CASES["triangles"]()


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
        str(file.relative_to(tmp_path)): file.read_bytes() for file in sorted(tmp_path.rglob("*")) if file.is_file()
    }


@pytest.fixture
def data() -> Path:
    """The folder of real animations."""
    folder = os.environ.get("MIXSEQ_DATA")
    if not folder:
        pytest.skip("MIXSEQ_DATA is not set")
    return Path(folder)


@pytest.fixture
def made(tmp_path: Path) -> Callable[..., MeshSequence]:
    """Write a glTF file of a `gltf_maker.Maker` and read it."""
    return lambda maker, **options: load(maker.glb(tmp_path / "made.glb"), **options)
