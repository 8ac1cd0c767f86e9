"""A file with a skinned mesh, and the mesh lifted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mixseq.sequence.sequence import MeshSequence
from tests.formats.conftest import lossy
from tests.formats.gltf_files import read, rigged, write_glb


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    return write_glb(tmp_path / "rig.glb", *rigged())


@pytest.fixture
def lifted(rig: Path) -> MeshSequence:
    """The rigged square as it is read, and lifted by one more."""
    with lossy():
        sequence = read(rig)
    return sequence.with_points(sequence.points + np.array([0, 0, 1], np.float32))
