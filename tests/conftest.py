"""What tests of several subpackages share: real animations, and a small bending bar."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

from mixseq.sequence import MeshSequence
from mixseq.signals import Model, fit
from tests.meshes import bar

settings.register_profile("untimed", deadline=None)  # how long an example takes depends on what else runs
settings.load_profile("untimed")


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
