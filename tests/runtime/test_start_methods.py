"""What is public gives the same bits in a process of its own, however that was started."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from functools import partial
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq import operations
from tests.meshes import bar, coarse_walk

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning"),
]

PATIENCE = 240.0  # seconds
FILES = ("walk.usdc", "walk.abc", "walk.glb", "walk.h5")
WALK = coarse_walk(frames=4)
BAR = bar(sides=5, rings=8, frames=4)


def _read(name: str, folder: Path) -> object:
    return mixseq.read(folder / name).points


def _written(name: str, folder: Path) -> object:
    mixseq.write(folder / name, WALK)
    return mixseq.read(folder / name).points


def _saved(folder: Path) -> object:
    mixseq.save(folder / "new.h5", mixseq.load(folder / "model.h5"))
    return (folder / "new.h5").read_bytes()


def _compressed(folder: Path) -> object:
    mixseq.save(folder / "new_compressed.h5", mixseq.compress(BAR, max_error=1e-3))
    return (folder / "new_compressed.h5").read_bytes()


def _transferred(_: Path) -> object:
    same = mixseq.Correspondence.identity(WALK.vertex_count, len(WALK.faces))
    return mixseq.transfer(WALK, coarse_walk(frames=1), mapping=same).points


def _rigs(folder: Path) -> object:
    mixseq.write_rig(folder / "skin.glb", mixseq.fit_skin(BAR, bones=2))
    mixseq.write_rig(folder / "morph.glb", mixseq.fit_morph(BAR))
    return (folder / "skin.glb").read_bytes() + (folder / "morph.glb").read_bytes()


CALLS: dict[str, Callable[[Path], object]] = {
    "fit": lambda _: mixseq.fit(WALK, exact=True).sample(fps=30).points,
    "sample": lambda folder: mixseq.load(folder / "model.h5").sample(fps=48).points,
    "save": _saved,
    "compress": _compressed,
    "decompress": lambda folder: mixseq.load(folder / "compressed.h5").sample().points,
    "verify": lambda folder: mixseq.verify(folder / "compressed.h5", BAR).max_error,
    "edit": lambda folder: operations.exaggerate(mixseq.load(folder / "model.h5"), 1.5).sample().points,
    "transfer": _transferred,
    "rigs": _rigs,
    **{f"read {name}": partial(_read, name) for name in FILES},
    **{f"write {name}": partial(_written, f"new_{name}") for name in FILES},
}


def results(folder: Path) -> dict[str, str]:
    """Return a digest of what each function makes of the files in a folder."""
    return {
        what: sha256(made if isinstance(made := call(folder), bytes) else np.asarray(made).tobytes()).hexdigest()
        for what, call in CALLS.items()
    }


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("files")
    for name in FILES:
        mixseq.write(made / name, WALK)
    mixseq.save(made / "model.h5", mixseq.fit(WALK))
    mixseq.save(made / "compressed.h5", mixseq.compress(BAR, max_error=1e-3))
    return made


@pytest.fixture(scope="module")
def here(folder: Path) -> dict[str, str]:
    return results(folder)


@pytest.mark.parametrize("method", ["fork", "spawn", pytest.param("forkserver", marks=pytest.mark.exhaustive)])
def test_the_same_bits(method: str, folder: Path, here: dict[str, str]) -> None:
    if method not in multiprocessing.get_all_start_methods():
        pytest.skip(f"there is no {method} on this system")
    with multiprocessing.get_context(method).Pool(1) as pool:
        assert pool.apply_async(results, [folder]).get(PATIENCE) == here
