"""What tests of several subpackages share: real animations, and a small bending bar."""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from tests.meshes import bar

# No deadline: how long an example takes depends on what else runs.
settings.register_profile("untimed", deadline=None, max_examples=50)
settings.register_profile("few", deadline=None, max_examples=10)
settings.load_profile("untimed")

# Processes of pytest-xdist have one core each; more threads of BLAS only wait for each other. They inherit this.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


LONG = ("test_docs", "test_live", "test_marking_viewer", "test_notebooks", "test_other_machines", "test_packages")
"""Files whose tests take up to half a minute each: they come first, so that no process is left with them at the end."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put long tests first, and leave out exhaustive ones if MIXSEQ_EXHAUSTIVE is not set."""
    items.sort(key=lambda item: item.path.stem not in LONG)
    if not os.environ.get("MIXSEQ_EXHAUSTIVE"):
        for item in items:
            if item.get_closest_marker("exhaustive"):
                item.add_marker(pytest.mark.skip("MIXSEQ_EXHAUSTIVE is not set"))


def pytest_collection_finish() -> None:
    """Let the garbage collector pass over the tests themselves: they are a million objects that stay."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real animations."""
    named = os.environ.get("MIXSEQ_DATA")
    if not named:
        pytest.skip("MIXSEQ_DATA is not set")
    folder = Path(named)
    if not folder.is_dir():
        pytest.skip(f"MIXSEQ_DATA is {named}, which is no folder")
    return folder


@pytest.fixture(scope="session")
def bent_bar() -> MeshSequence:
    """Two bones, 77 vertices, 4 frames from 0 to 0.3 s."""
    return bar(sides=5, rings=15, frames=4)


@pytest.fixture(scope="session")
def bar_model(bent_bar: MeshSequence) -> Model:
    """The bar in the mixed shape space."""
    return fit(bent_bar, exact=True)


@pytest.fixture
def gem() -> MeshSequence:
    """A stretching octahedron, long in x, that lasts 8 / 24 s."""
    points = np.array([[2, 0, 0], [-2, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1.0]])
    faces = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
    stretch = 1 + 0.2 * np.sin(np.linspace(0, 2, 9))[:, None, None]
    return MeshSequence.from_arrays(points * stretch, faces, name="gem")


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Heed signals, here and in processes that we start, even if we run in the background of a shell or under nohup."""
    before = {
        signal.SIGINT: signal.signal(signal.SIGINT, signal.default_int_handler),
        signal.SIGTERM: signal.signal(signal.SIGTERM, signal.SIG_DFL),
        signal.SIGHUP: signal.signal(signal.SIGHUP, signal.SIG_DFL),
    }
    yield
    for number, handler in before.items():
        signal.signal(number, handler)
