"""Other motion of a glTF file that a sequence is laid over: cameras, lights and other meshes keep theirs.

It keeps its own times, and gets keys at the frames of the sequence, so that the animation lasts as long. The file
must have a single animation, since with several the matching one is unknown.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from mixseq.sequence import SequenceHeader
from mixseq_io.gltf.animation import Channel, read_channels, told_by
from mixseq_io.gltf.buffers import Json, Layout
from mixseq_io.gltf.document import Document
from mixseq_io.gltf.node_tree import Scene
from mixseq_io.originals import warn_of_other_times

_SEEN = ("mesh", "camera", "extensions")


@dataclass(frozen=True, eq=False)
class OtherMotion:
    """Channels of a file that go on beside the sequence."""

    things: Sequence[str] = ()
    channels: Sequence[Channel] = ()
    start: float = 0.0

    @property
    def nodes(self) -> set[int]:
        """Animated nodes."""
        return {channel.node for channel in self.channels}

    def instead(self, stand_ins: Mapping[int, int | None]) -> OtherMotion:
        """Replace animated nodes by others, without their morph weights; None drops their channels."""
        channels = []
        for channel in self.channels:
            node = stand_ins.get(channel.node, channel.node)
            if node is not None and not (channel.node in stand_ins and channel.name == "weights"):
                channels.append(replace(channel, node=node))
        return replace(self, channels=channels)

    def animate(self, layout: Layout, animation: Json, header: SequenceHeader) -> None:
        """Add the channels to the sequence's animation, whose first sampler has a key at every frame."""
        keys = animation["samplers"][0]["input"]
        for channel in self.channels:
            values = channel.at(header.times - self.start)
            if channel.name == "rotation":
                values /= np.linalg.norm(values, axis=1, keepdims=True)
            if channel.name == "weights":
                values = values.reshape(-1)
            sampler = {
                "input": keys,
                "output": layout.add_array(values.astype(np.float32)),
                "interpolation": "STEP" if channel.interpolation == "STEP" else "LINEAR",
            }
            target = {"node": channel.node, "path": channel.name}
            animation["channels"].append({"sampler": len(animation["samplers"]), "target": target})
            animation["samplers"].append(sampler)

    def warn_of_times(self, path: Path, header: SequenceHeader, sources: ArrayLike | None) -> None:
        """Warn of other motion if the sequence shows other times, or the motion outlasts it by more than a frame."""
        ends = [channel.times[[0, -1]] + self.start for channel in self.channels if channel.moves]
        if ends:
            span = float(np.min(ends)), float(np.max(ends))
            warn_of_other_times(path, header, dict.fromkeys(self.things, span), sources)


NOTHING = OtherMotion()


def other_motion(document: Document, scene: Scene, taken: Collection[int]) -> OtherMotion:
    """Return the other motion of a file with one animation, given the nodes `taken` by the sequence."""
    animations = document.items("animations")
    if len(animations) != 1:
        return NOTHING
    moved = moved_by_animations(document.json, document.json["animations"], scene) - {*taken}
    bearers = [bearer for node in moved for bearer in _bearers(document.json, node)]
    channels = read_channels(document, animations[0], scene.with_above(bearers))
    return OtherMotion(
        [scene.paths[node] for node in sorted(moved)], channels, told_by(animations[0], "start") or 0.0
    )


def moved_by_animations(document: Json, animations: Sequence[Json], scene: Scene) -> set[int]:
    """Return the nodes with visible contents that animations move: meshes, cameras, lights."""
    targets = {channel["target"].get("node") for each in animations for channel in each["channels"]}
    return {
        node
        for node in scene.paths
        if any(key in document["nodes"][node] for key in _SEEN)
        and any(not targets.isdisjoint(scene.above(bearer)) for bearer in _bearers(document, node))
    }


def _bearers(document: Json, node: int) -> list[int]:
    """Return a node and its skin's joints."""
    entry = document["nodes"][node]
    return [node, *(document["skins"][entry["skin"]]["joints"] if "skin" in entry else ())]
