"""Models of one sequence in every shape space, and their files, which are made once."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import mixseq
from mixseq.shells.fitting import ShellSettings
from mixseq.signals.detail import Detail
from mixseq.signals.model import Model
from tests.formats.models.model_cases import jointed
from tests.meshes import bar


@pytest.fixture(scope="session")
def models() -> dict[str, Model]:
    """Models of seven frames with three key shapes and five knots, in all spaces."""
    sequence = bar(sides=5, rings=13, frames=7)
    shell = ShellSettings(bending=0.4, iterations=77)
    return {
        "mixed": jointed(sequence, Detail(rank=2, knots=1)),
        "free": mixseq.fit(sequence, rank=2, knots=1, parts=2, joint_width=3, placement="free"),
        "vertex": mixseq.fit(sequence, rank=2, knots=1, space="vertex"),
        "gradient": mixseq.fit(sequence, rank=2, knots=1, space="gradient"),
        "lri": mixseq.fit(sequence, rank=2, knots=1, space="lri"),
        "edge": mixseq.fit(sequence, rank=2, knots=1, space="edge"),
        "volume": mixseq.fit(sequence, rank=2, knots=1, space="edge", shell=shell, projection="dso", volume=0.5),
    }


@pytest.fixture(scope="session")
def files(models: dict[str, Model], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("models")
    for name, model in models.items():
        mixseq.save(folder / f"{name}.h5", model)
    return folder


@pytest.fixture
def model(models: dict[str, Model]) -> Model:
    return models["mixed"]


@pytest.fixture
def stored(files: Path) -> Path:
    return files / "mixed.h5"


@pytest.fixture
def copy(files: Path, tmp_path: Path) -> Path:
    """A file to be edited or spoilt."""
    return Path(shutil.copy(files / "mixed.h5", tmp_path / "bar.h5"))


@pytest.fixture
def free(files: Path, tmp_path: Path) -> Path:
    """One in the free placement."""
    return Path(shutil.copy(files / "free.h5", tmp_path / "bar.h5"))


@pytest.fixture
def vertices(files: Path, tmp_path: Path) -> Path:
    """One in the vertex space."""
    return Path(shutil.copy(files / "vertex.h5", tmp_path / "bar.h5"))
