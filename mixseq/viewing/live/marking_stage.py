"""Markers in the scene: a ball and a number at both ends of a pair, dark balls for proposals."""

from __future__ import annotations

import colorsys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.correspondence.triangle_mesh import TriangleMesh
from mixseq.scene.arrangement import HEIGHT
from mixseq.topology import Topology
from mixseq.viewing.marking import Marking, Pair

RADIUS = 0.004
"""Radius of a ball, relative to the distance of the camera from its target."""

FARTHEST = 2.5 * HEIGHT
"""Distance beyond which balls shrink on the screen."""

STEP = 1.15
"""Factor of the radius at which balls are drawn again."""

CHOSEN = 1.6
"""Relative size of the ball of a chosen or begun pair."""

ABOVE = 3.0
"""Distance of a number from the surface, in radii, for visibility."""

SPARE, AWAY = 64, 1e4
"""Smallest number of balls, and the depth of unused ones below the ground."""

PROPOSED = (40, 40, 40)
"""Colour of proposals."""

GOLDEN = 0.618034
"""Step of the hue between consecutive numbers, so that neighbours differ."""


def colour(number: int) -> tuple[int, int, int]:
    """Return the colour of a pair by its number, from 0."""
    red, green, blue = colorsys.hsv_to_rgb((0.02 + GOLDEN * number) % 1.0, 0.85, 0.9)
    return round(255 * red), round(255 * green), round(255 * blue)


@dataclass(frozen=True)
class Ball:
    """A ball on one of the meshes."""

    vertex: int  # vertex of the mesh
    text: str  # label, may be empty
    colour: tuple[int, int, int]  # its colour
    scale: float  # radius relative to the usual one


def balls(marking: Marking, proposals: Sequence[Pair], suspects: frozenset[int], side: int) -> Iterator[Ball]:
    """Yield the balls of a side: pairs with their numbers, with ``!`` for suspects."""
    for number, pair in enumerate(marking.pairs):
        text = f"{number + 1}{'!' if number in suspects else ''}"
        scale = CHOSEN if number == marking.chosen else 1.0
        yield Ball(pair.vertices[side], text, colour(number), scale)
    if marking.begun is not None and marking.begun[0] == side:
        number = len(marking.pairs)
        yield Ball(marking.begun[1], f"{number + 1} ...", colour(number), CHOSEN)
    for place, pair in enumerate(proposals):
        yield Ball(pair.vertices[side], "" if place else "?", PROPOSED, 0.7 if place else 1.2)


class MarkingStage:
    """Balls and numbers in the scene of a server."""

    def __init__(
        self, server: Any, topologies: tuple[Topology, Topology], clicked: Callable[[int, int], None]
    ) -> None:
        self._server = server
        self._clicked = clicked
        self._topologies = topologies
        self._radius = RADIUS * FARTHEST
        self._placed: dict[int, tuple[Float, Float]] = {}
        self._labels: dict[str, Any] = {}
        self._nodes: dict[int, Any] = {}
        self._frames = [server.scene.add_frame(f"/markers/{side}", show_axes=False) for side in range(2)]
        self._ball = _icosphere()

    def place(self, side: int, points: Float) -> None:
        """Set the vertices ``(V, 3)`` of a mesh, relative to its place."""
        self._placed[side] = points, TriangleMesh(points, self._topologies[side]).vertex_normals

    def stand(self, offsets: Float) -> None:
        """Set the places ``(2, 3)`` of the meshes."""
        for frame, offset in zip(self._frames, offsets, strict=True):
            frame.position = offset

    def standing(self, side: int, vertices: Index) -> Float:
        """Return the places ``(n, 3)`` of vertices in the scene."""
        return np.asarray(self._placed[side][0][vertices] + self._frames[side].position)

    def seen_from(self, distance: float) -> bool:
        """Set the distance of the camera; returns whether balls must be drawn again."""
        radius = RADIUS * min(distance, FARTHEST)
        if 1 / STEP < radius / self._radius < STEP:
            return False
        self._radius = radius
        return True

    def draw(self, side: int, drawn: Sequence[Ball]) -> None:
        """Draw exactly the given balls of a side."""
        points, normals = self._placed[side]
        vertices = np.array([ball.vertex for ball in drawn], np.int64)
        with self._server.atomic():
            self._show(side, drawn, points[vertices])
            self._write(side, drawn, points[vertices] + ABOVE * self._radius * normals[vertices])

    def _show(self, side: int, drawn: Sequence[Ball], places: Float) -> None:
        """Move the balls of a side; spare ones are kept far away, as new ones blink."""
        count = max(SPARE, 1 << len(drawn).bit_length())
        positions = np.tile(np.array([0.0, -AWAY, 0.0], np.float32), (count, 1))
        scales = np.full(count, self._radius, np.float32)
        colours = np.zeros((count, 3), np.uint8)
        for row, ball in enumerate(drawn):
            positions[row], scales[row], colours[row] = places[row], self._radius * ball.scale, ball.colour
        node = self._nodes.get(side)
        if node is not None and len(node.batched_positions) == count:
            node.batched_positions, node.batched_scales, node.batched_colors = positions, scales, colours
            return
        node = self._nodes[side] = self._server.scene.add_batched_meshes_simple(
            f"/markers/{side}/balls",
            *self._ball,
            batched_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
            batched_positions=positions,
            batched_scales=scales,
            batched_colors=colours,
            lod="off",
            cast_shadow=False,
            receive_shadow=False,
        )

        @node.on_click  # type: ignore[untyped-decorator]
        def _(event: Any) -> None:
            if event.instance_index is not None:
                self._clicked(side, event.instance_index)

    def _write(self, side: int, drawn: Sequence[Ball], places: Float) -> None:
        texts = {
            f"/markers/{side}/{row}": (ball.text, place)
            for row, (ball, place) in enumerate(zip(drawn, places, strict=True))
            if ball.text
        }
        for name in [each for each in self._labels if each.startswith(f"/markers/{side}/")]:
            if name not in texts:
                self._labels.pop(name).remove()
        for name, (text, place) in texts.items():
            label = self._labels.get(name)
            if label is None:
                self._labels[name] = self._server.scene.add_label(
                    name,
                    text,
                    position=place,
                    anchor="center-center",
                    font_screen_scale=1.1,
                    depth_test=True,
                )
                continue
            label.position = place
            if label.text != text:
                label.text = text


def _icosphere() -> tuple[Float, Index]:
    """Return points and triangles of a ball of radius 1."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    return np.asarray(ball.vertices, np.float64), np.asarray(ball.faces, np.int64)
