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


@pytest.fixture(scope="session")
def written_kinds(fox: MeshSequence, tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, VatReport]]:
    folders = {kind: tmp_path_factory.mktemp("textures") / "fox.vat" for kind in KINDS}
    return {kind: (folder, write_vat(folder, fox, KINDS[kind])) for kind, folder in folders.items()}


# Parameters of a session would start the browser of each module once for every kind.
@pytest.fixture(params=KINDS)
def written(written_kinds: dict[str, tuple[Path, VatReport]], request: pytest.FixtureRequest) -> tuple[Path, VatReport]:
    return written_kinds[request.param]
