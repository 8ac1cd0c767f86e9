"""Properties of nodes at keys, as an animation of linear samplers.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html#animations
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixseq.sequence import SequenceHeader
from mixseq_io.gltf.buffers import Json, Layout, append
from mixseq_io.gltf.morphs import float_times

_KINDS = {"translation": "VEC3", "rotation": "VEC4", "weights": "SCALAR"}


@dataclass(frozen=True, eq=False)
class Track:
    """What a property of some nodes is at every frame.

    Parameters
    ----------
    nodes : sequence of int
        The nodes.
    path : {"translation", "rotation", "weights"}
        The property.
    values : (T, k) float32
        Its values.
    """

    nodes: Sequence[int]
    path: str
    values: NDArray[np.float32]

    @property
    def moves(self) -> bool:
        """Whether the property ever changes."""
        return bool((self.values != self.values[0]).any())


def animate(layout: Layout, header: SequenceHeader, tracks: Sequence[Track]) -> None:
    """Add the animation of a sequence, with keys at its frames, to a document.

    Tracks that stand still are left out: nodes have the values of the first frame anyway. If all do, there is no
    animation. Linear samplers turn rotations at a constant rate by the shorter way (spherical linear interpolation).

    Raises
    ------
    InvalidSequenceError
        If frames follow each other too closely for float32.
    """
    moving = [track for track in tracks if track.moves]
    if not moving:
        return
    keys = float_times(header)
    times = layout.add_array(keys)
    layout.bounded(times, ([float(keys[0])], [float(keys[-1])]))
    # One view for all of them, since there may be hundreds.
    values = [np.ascontiguousarray(track.values) for track in moving]
    view, offset = layout.add(values, sum(each.nbytes for each in values)), 0
    samplers: list[Json] = []
    channels: list[Json] = []
    for number, (track, each) in enumerate(zip(moving, values, strict=True)):
        kind = _KINDS[track.path]
        count = each.size if kind == "SCALAR" else len(each)
        output = layout.accessor(view, count, kind, offset)
        samplers.append({"input": times, "output": output, "interpolation": "LINEAR"})
        channels += [
            {"sampler": number, "target": {"node": node, "path": track.path}} for node in track.nodes
        ]
        offset += each.nbytes
    animation = {
        "name": header.name or "animation",
        "samplers": samplers,
        "channels": channels,
        "extras": {"fps": header.fps},
    }
    append(layout.document, "animations", animation)
