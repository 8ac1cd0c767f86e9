"""A folder with small files, in which the examples of docstrings run: a plugin of pytest, as they are everywhere."""

from __future__ import annotations

import os
from collections.abc import Generator
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

TESTS = Path(__file__).parent


@cache
def _folder() -> TemporaryDirectory[str]:
    """Make ``arm.usdc``, an animation of 77 vertices, its model ``arm.h5``, and the longer arm ``long.obj``."""
    import mixseq
    from tests.meshes import bar

    folder = TemporaryDirectory()
    arm = bar(sides=5, rings=15, frames=4)
    mixseq.write(f"{folder.name}/arm.usdc", arm)
    mixseq.save(f"{folder.name}/arm.h5", mixseq.fit(arm, exact=True))
    mixseq.write(f"{folder.name}/long.obj", arm[:1].with_points(arm.points[:1] * [1.5, 1, 1]))
    return folder


@pytest.hookimpl(wrapper=True)
def pytest_collect_file(file_path: Path) -> Generator[None, list[pytest.Collector], list[pytest.Collector]]:
    """Look for examples in the product only: looking in all tests takes as long as collecting them."""
    found = yield
    return [each for each in found if type(each) is pytest.Module] if TESTS in file_path.parents else found


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Run an example in the folder."""
    if isinstance(item, pytest.DoctestItem):
        os.chdir(_folder().name)


def pytest_runtest_teardown(item: pytest.Item) -> None:
    """Return from the folder."""
    if isinstance(item, pytest.DoctestItem):
        os.chdir(item.config.rootpath)
