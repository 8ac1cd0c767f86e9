"""Implement the command ``mixseq warm-up``."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import TYPE_CHECKING

import mixseq
from mixseq.cli import options
from mixseq.cli.group import progress_bar, say

if TYPE_CHECKING:
    from mixseq.signals.model import Model


FRAME_COUNT = 6


@options.command("warm-up", "mixseq warm-up")
def command(quiet: bool) -> None:
    """Compile inner loops in advance, so that later runs start at once.

    Inner loops are compiled at their first use and then kept on disk. This command compresses, fits and decodes a small
    walk in single and double precision, transfers it, and discards the result.
    """
    start = perf_counter()
    with progress_bar(quiet) as progress, _work() as steps:
        for done, (what, step) in enumerate(steps):
            progress(done, len(steps), what)
            step()
    if not quiet:
        say(f"ready after {perf_counter() - start:.1f} s")


@contextmanager
def _work() -> Iterator[list[tuple[str, Callable[[], object]]]]:
    """Yield the list of tasks, each with its name."""
    from dataclasses import replace

    import numpy as np

    from mixseq.creature import walk_cycle
    from mixseq.mesh.surface import CornerValues, Surface

    walk = walk_cycle(FRAME_COUNT)
    corners = walk.polygons.indices
    uvs = CornerValues(walk.points[0][:, :2], corners)
    walk = replace(walk, surface=Surface(uvs=uvs, hard_edges=corners))
    coarse = walk.with_points(walk.points.astype(np.float32))
    last = walk.points.shape[1] - 1
    reversed_mesh = mixseq.MeshSequence.from_arrays(walk.points[:1, ::-1], last - walk.faces)
    markers = [(vertex, last - vertex) for vertex in range(0, last, 100)]

    def sample(model: Model) -> None:
        model.sample(fps=30, velocities=True)

    with TemporaryDirectory(prefix="mixseq-") as folder:
        file = Path(folder) / "walk.h5"
        yield [
            ("compressing", lambda: mixseq.save(file, mixseq.compress(walk, max_error=0.01, order="free"))),
            ("decoding", lambda: sample(mixseq.load(file))),
            ("fitting, anchored", lambda: sample(mixseq.fit(coarse, placement="anchored"))),
            ("fitting, free", lambda: sample(mixseq.fit(walk, placement="free"))),
            ("transferring", lambda: mixseq.transfer(walk[:2], reversed_mesh, markers)),
        ]
