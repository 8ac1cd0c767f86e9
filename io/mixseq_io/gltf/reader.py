"""glTF, reading: skinned, morphed and moving meshes in world space (.gltf, .glb).

Frames are at all keys of the chosen meshes, or at a given rate. Where more than translations and linear morph weights
moves, points follow arcs, and gaps between keys are filled with frames (`mixseq_io.gltf.frame_times.played_times`).
Keys are float32; frames within that rounding of the frame grid are moved onto it in float64. Split vertices are
welded (`mixseq_io.gltf.welding`). Points are computed in float64 and rounded to float32. A .glb with a mesh sequence
(`mixseq_io.gltf.sequence_extension`) is decoded as a compressed model.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, FloatArray
from mixseq.errors import FormatError, InvalidSequenceError
from mixseq.sequence import SequenceHeader
from mixseq.sequence_header import DEFAULT_FPS
from mixseq.surface import Origin
from mixseq_io.blocks import warn
from mixseq_io.choosing import common_name
from mixseq_io.gltf.animation import Channel, choose_animation, pose_at, read_channels, told_by
from mixseq_io.gltf.compression import plain
from mixseq_io.gltf.document import Document, load_document
from mixseq_io.gltf.frame_times import key_times, played_rate, played_times, rate_of, sampled_times
from mixseq_io.gltf.joints import bound, nodes_on
from mixseq_io.gltf.node_meshes import chosen_nodes, moving_nodes, scene_mesh_of, skinning_of
from mixseq_io.gltf.node_tree import Pose, Scene, read_scene
from mixseq_io.gltf.primitives import primitives_of
from mixseq_io.gltf.welding import Weld, weld
from mixseq_io.gltf.world_points import Shape, bearers, read_shape
from mixseq_io.key_times import on_grid
from mixseq_io.labels.markings import Markings
from mixseq_io.reader import SequenceReader, naming
from mixseq_io.scene_meshes import join


def open_gltf(
    path: Path, prim: str | None = None, animation: str | int | None = None, fps: float | None = None
) -> SequenceReader:
    """Open a glTF file."""
    # Non-finite points are reported with their vertex when they are read.
    with naming(path), np.errstate(all="ignore"):
        document = plain(load_document(path))
        scene = read_scene(document)
        nodes = chosen_nodes(document, scene, prim)
        chosen = choose_animation(document, animation)
        channels = read_channels(document, chosen, _influencing(document, scene, nodes))
        if prim is None:
            nodes = moving_nodes(document, scene, nodes, channels)
            influencing = _influencing(document, scene, nodes)
            channels = [channel for channel in channels if channel.node in influencing]
        shapes = _shapes(document, scene, nodes, channels)
        times, rate = _frames(path, channels, fps, told_by(chosen, "fps", 0.0))
        start = told_by(chosen, "start") or 0.0
        return _GltfReader(document, shapes, channels, times, rate, start)


def open_gltf_bind_pose(path: Path, skeleton: str | None) -> SequenceReader:
    """Open the meshes of a skeleton in their bind pose; see `mixseq_io.read_bind_pose`."""
    with naming(path), np.errstate(all="ignore"):
        document = plain(load_document(path))
        scene = read_scene(document)
        shapes = _shapes(document, scene, nodes_on(document, scene, skeleton), ())
        shapes = [bound(document, shape, skeleton) for shape in shapes]
        return _GltfReader(document, shapes, (), np.zeros(1), DEFAULT_FPS, 0.0)


def _frames(
    path: Path, channels: Sequence[Channel], fps: float | None, told: float | None
) -> tuple[NDArray[np.float64], float]:
    """Return frame times ``(T,)`` in s and frames per second: as requested, else from the file, else from the keys."""
    keys = key_times(channel.times for channel in channels)
    if fps is not None:
        times = sampled_times(path, keys, fps)
        return times if times.size else np.zeros(1), fps
    rate = told or rate_of(keys)
    if any(channel.moves and not channel.moves_straight for channel in channels):
        played = told or played_rate(keys)
        times = played_times(keys, played)
        if times.size > keys.size:
            return times, played
    return keys if keys.size else np.zeros(1), rate


def _influencing(document: Document, scene: Scene, nodes: Sequence[int]) -> set[int]:
    """Return the nodes that influence the meshes of some nodes."""
    found, count = set(nodes), 0
    for node in nodes:
        moving = bearers(document, scene.nodes[node], node)
        count += 16 * len(moving)  # their matrices
        document.check_effort(count, "skeletons of all meshes together")
        found |= scene.with_above(moving)
    return found


def _shapes(
    document: Document, scene: Scene, nodes: Sequence[int], channels: Collection[Channel]
) -> list[Shape]:
    welds: dict[int, Weld | None] = {}
    shapes, numbers = [], 0
    for node in nodes:
        mesh = scene.nodes[node].integer("mesh")
        if mesh not in welds:
            welds[mesh] = _welded(document, mesh)
        found = welds[mesh]
        if found is not None:
            numbers += 3 * found.count + found.faces.size
            document.check_effort(numbers, "meshes of all nodes together")
            shapes.append(read_shape(document, scene, node, found))
    if not shapes:
        raise FormatError(f"{document.path} has no triangles to read; points and lines alone are not a mesh")
    for channel in channels:
        for shape in shapes:
            if (channel.node, channel.name) == (shape.node, "weights") and len(channel.values.T) != len(
                shape.weights
            ):
                raise scene.nodes[shape.node].error(
                    f"has {len(shape.weights)} morph targets, but {len(channel.values.T)} weights are animated"
                )
    return shapes


def _welded(document: Document, mesh: int) -> Weld | None:
    """Return a mesh's welded vertices, None without triangles; warn of skipped primitives."""
    primitives, others = primitives_of(document, mesh)
    place = f"{document.path}: meshes[{mesh}]"
    if others:
        warn(
            f"{place}: primitives {', '.join(map(str, others[:20]))} are points, lines or empty; they are left out"
        )
    for what, name in (("texture coordinates", "TEXCOORD"), ("colours", "COLOR")):
        if any(each.sets(name) > 1 for each in primitives):
            warn(f"{place} has several sets of {what}; {name}_0 is read")
    return weld(document, mesh) if primitives else None


def _world(scene: Scene, shapes: Sequence[Shape], pose: Pose) -> Mapping[int, Float]:
    """Return the world matrices of all bearers of meshes, computed together for their common ancestors."""
    return scene.world((node for shape in shapes for node in shape.bearers), pose)


class _GltfReader(SequenceReader):
    def __init__(
        self,
        document: Document,
        shapes: Sequence[Shape],
        channels: Sequence[Channel],
        times: NDArray[np.float64],
        rate: float,
        start: float,
    ) -> None:
        scene = shapes[0].scene
        world = _world(scene, shapes, pose_at(channels, times[:1]))
        mirrored = [bool(shape.handedness(world)[0] < 0) for shape in shapes]
        ends = np.cumsum([0, *(shape.weld.count for shape in shapes)]).tolist()
        scene_meshes = [
            scene_mesh_of(document, shape, first, flip)
            for shape, first, flip in zip(shapes, ends, mirrored, strict=False)
        ]
        path = document.path
        polygons, surface = join(scene_meshes, Origin("glTF", str(path.resolve())))
        header = SequenceHeader(
            polygons=polygons,
            vertex_count=ends[-1],
            times=on_grid(times + start, rate),
            fps=rate,
            name=common_name([scene.objects[shape.node] for shape in shapes]) or path.stem,
            surface=surface,
        )
        super().__init__(path, header)
        self._shapes, self._mirrored, self._channels = shapes, mirrored, channels
        self._times = times  # as the keys have them

    def markings(self) -> Markings:
        """Return the sets of polygons and the joints of the meshes."""
        return replace(super().markings(), skinning=skinning_of(self._shapes))

    def _read_blocks(self, size: int) -> Iterator[FloatArray]:
        for start in range(0, self.header.frame_count, size):
            times = self._times[start : start + size]
            with np.errstate(all="ignore"):
                pose = pose_at(self._channels, times)
                world = _world(self._shapes[0].scene, self._shapes, pose)
                self._check_handedness(world, start)
                points = [shape.points(pose, world, len(times)).astype(np.float32) for shape in self._shapes]
            yield np.concatenate(points, axis=1)

    def _check_handedness(self, world: Mapping[int, Float], first: int) -> None:
        for shape, mirrored in zip(self._shapes, self._mirrored, strict=True):
            turned = shape.handedness(world) * (-1 if mirrored else 1) < 0
            if turned.any() and shape.skin is None:
                raise InvalidSequenceError(
                    f"{self.path}: {self.header.frame_name(first + int(np.argmax(turned)))}: "
                    f"{shape.scene.paths[shape.node]!r} is mirrored relative to the first frame, which turns "
                    "its faces inside out; give the animated scale one sign"
                )
