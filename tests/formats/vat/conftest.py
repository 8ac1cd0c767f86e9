"""The fox as vertex animation textures."""

from __future__ import annotations

from pathlib import Path

import pytest

from mixseq.sequence.sequence import MeshSequence
from mixseq_io.vat.writer import VatReport, write_vat
from tests.meshes import coarse_walk

KINDS = {"plain": None, "low rank": 1e-3}


@pytest.fixture(scope="session")
def fox() -> MeshSequence:
    return coarse_walk(8)


@pytest.fixture(scope="session", params=KINDS)
def written(
    fox: MeshSequence, request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, VatReport]:
    folder = tmp_path_factory.mktemp("textures") / "fox.vat"
    return folder, write_vat(folder, fox, KINDS[request.param])
