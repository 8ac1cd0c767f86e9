"""Implement the command ``mixseq convert``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mixseq
from mixseq.cli import options
from mixseq.cli.files import Claim, counted, each_animation, select_frames, write_sequence
from mixseq.cli.group import announce, progress_bar


@options.command(
    "convert",
    "mixseq convert walk.usdc walk.h5",
    "mixseq convert walk.usdc walk_####.obj",
    "mixseq convert shot.abc part.abc --frames 1005-1010",
    "mixseq convert fox.glb run.glb --set animation=Run",
    frames=options.frames("Only these frames, by their numbers.  [default: all]"),
)
@each_animation
def command(
    source: Path,
    target: Path,
    frames: options.FrameChoice | None,
    reading: dict[str, Any],
    writing: dict[str, Any],
    claim: Claim,
    quiet: bool,
) -> None:
    """Write a sequence in another format.

    The formats of SOURCE and TARGET follow from their extensions, see "mixseq formats". Frames are converted in
    blocks, so sequences may be larger than memory. A warning lists data that TARGET's format cannot hold.

    If both files are USD, both Alembic or both glTF, materials, cameras and everything else are kept. USD becomes a
    layer over SOURCE, which must not be moved; Alembic and glTF become copies of SOURCE with new points.
    --flatten writes only the meshes, independent of SOURCE.
    """
    claim(target)
    with progress_bar(quiet) as progress, mixseq.open_sequence(source, **reading) as reader:
        header, blocks, velocities = reader.header, reader.blocks(), reader.velocity_blocks()
        if frames is not None:
            indices = frames.indices(header)
            header = header.with_times(header.times[indices])
            blocks = select_frames(blocks, indices)
            velocities = None if velocities is None else select_frames(velocities, indices)
        counting = counted(blocks, header.frame_count, "converting", progress)
        write_sequence(target, header, counting, velocities, writing)
    announce(target)
