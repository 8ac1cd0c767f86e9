"""The data of meshes in a page: their poses and extents, compressed streams, stored colours, and binary data as text.

A page is UTF-16 with a byte order mark, which overrides a server's encoding. Two bytes, the lower one first, are one
code unit. Units that the text of a script element cannot hold (NUL, carriage return, ``<``, surrogates) and U+0001 are
written as U+0001 and a unit with the highest bit flipped. This adds 3 % to typical bytes; base64 in UTF-8 adds 33 %, 7
bits a character 14 %. ``page/loader.js`` decodes it.

Vertices are numbered for the smallest size, and texture coordinates and other undrawn data are left out. The page
computes strain and curvature; parts and errors are stored as palette entries. Of rows :math:`q_{tj}` of bytes, a row
per frame, the page has :math:`s_{tj} = d_{tj} - d_{t,j-1}` with :math:`d_{tj} = q_{tj} - q_{t-1,j}` and zeros before
the first row and column, modulo 256, deflated (RFC 1950), which browsers decode.
"""

from __future__ import annotations

import codecs
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.compression.bitstream.compressed_sequence import CompressedSequence
from mixseq.compression.encoder.compress import compress
from mixseq.compression.numbering import cheapest_numbering
from mixseq.errors import InvalidSequenceError
from mixseq.mesh.surface import Surface
from mixseq.pictures.colours import MEASURES, Colouring, SceneColours
from mixseq.pictures.scene import SceneItem, View, resolve_view, to_y_up
from mixseq.runtime.low_memory import LargeArray, new_large_array
from mixseq.runtime.parallel import Executor
from mixseq.runtime.progress import Progress, no_progress
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import LazyFrames, check_block, iterate_blocks
from mixseq.types import Float, FloatArray, Index
from mixseq.viewer.session import signals_of
from mixseq_io.coded.packing import pack

ENCODING = "utf-16-le"
"""Encoding of pages."""

BYTE_ORDER_MARK = codecs.BOM_UTF16_LE
"""First character of pages."""

ESCAPE = 1
"""The unit before those with a flipped highest bit."""

_UNFIT = np.array([0, ord("\r"), ord("<"), ESCAPE])
_HALVES = 0xD800, 0xDFFF


def as_text(data: bytes) -> bytes:
    """Return bytes as UTF-16 text of a script element; an odd number is padded by a zero."""
    units = np.frombuffer(data + bytes(len(data) % 2), "<u2")
    unfit = np.isin(units, _UNFIT) | ((units >= _HALVES[0]) & (units <= _HALVES[1]))
    text = np.repeat(units, 1 + unfit)
    seconds = np.cumsum(1 + unfit)[unfit] - 1
    text[seconds - 1] = ESCAPE
    text[seconds] ^= 0x8000
    return text.tobytes()


def deflated_rows(rows: Iterable[NDArray[np.uint8]]) -> bytes:
    """Return rows ``(V,)`` of bytes, joined and deflated."""
    deflate, parts = zlib.compressobj(9), []
    before = np.zeros(1, np.uint8)
    for row in rows:
        steps = row - before
        parts.append(deflate.compress(np.diff(steps, prepend=np.uint8(0)).tobytes()))
        before = row
    return b"".join([*parts, deflate.flush()])


TOGETHER = 2.0
"""Ratio of joint to smaller box up to which meshes have one scale: metres beside centimetres would be a dot."""


@dataclass(frozen=True, eq=False)
class PageItem:
    """A mesh in a page, with the poses of its own frames."""

    mesh: SceneItem  # the moving mesh
    colourings: Mapping[str, Colouring]  # available colourings, the initial one first
    # The signals of a model, for its charts (mixseq.viewer.session.signals_of).
    signals: Mapping[str, Any] | None = None
    coded: CompressedSequence | None = None  # the compressed mesh, if there is one


def page_items(
    colours: SceneColours, coded: Sequence[CompressedSequence | None] | None = None
) -> list[PageItem]:
    """Return the meshes of a scene with all their colourings, and the charts of models."""
    items = colours.scene.items
    return [
        PageItem(
            item, colours.each(index), None if item.model is None else signals_of(item.model), compressed
        )
        for index, (item, compressed) in enumerate(zip(items, coded or [None] * len(items), strict=True))
    ]


@dataclass(frozen=True, eq=False)
class Extent:
    """The extent of a mesh over all poses, Y up."""

    low: Float  # (3,) minimum corner of its bounding box
    high: Float  # (3,) maximum corner of its bounding box
    # (views, 5) left, right, bottom and top on the screen of each view, whose middle is the origin of space, and the
    # bottom of what is at height zero below the mesh.
    seen: Float

    @property
    def centre(self) -> Float:
        """Middle of the bounding box."""
        return np.asarray((self.low + self.high) / 2)

    @property
    def side(self) -> float:
        """Longest side of the bounding box."""
        return float((self.high - self.low).max())

    def joined(self, other: Extent | None) -> Extent:
        """Return the extent of both."""
        if other is None:
            return self
        low, high = np.minimum(self.low, other.low), np.maximum(self.high, other.high)
        nearer, farther = np.minimum(self.seen, other.seen), np.maximum(self.seen, other.seen)
        return Extent(low, high, np.where([True, False, True, False, True], nearer, farther))

    def rectangles(self, views: Sequence[View]) -> Float:
        """Return left, right, bottom and top ``(views, 4)`` of the mesh and of its shadow on the ground."""
        floors = [
            view.rotation[1, 1] * self.low[1] + seen[4] for view, seen in zip(views, self.seen, strict=True)
        ]
        left, right, bottom, top, _ = self.seen.T
        return np.stack([left, right, np.minimum(bottom, floors), top], axis=1)


@dataclass(frozen=True, eq=False)
class Gathered:
    """The poses of a mesh."""

    poses: LargeArray  # (n, V, 3) as they were given
    still: Extent  # extent in space, in both views
    following: Extent  # extent relative to the mean of the vertices, on the ground, in both views
    views: tuple[View, View]  # (View, View) their own view, and that of the first mesh of the page
    # Whether they are seen as the first mesh is: they have its triangles, and about its place and size.
    like_first: bool


def gather(
    item: SceneItem,
    elapsed: Float,
    first: tuple[SequenceHeader, Gathered] | None,
    progress: Progress = no_progress,
    workers: Executor | None = None,
    camera: tuple[float, float] | None = None,
) -> Gathered:
    """Read the poses at times `elapsed` ``(n,)`` once; `first` are those of the page's first mesh, None for itself."""
    header = item.header
    same = first is None or np.array_equal(header.faces, first[0].faces)
    views: tuple[View, View] | None = None
    table: LargeArray | None = None
    still: Extent | None = None
    following: Extent | None = None
    done = 0
    for block in item.poses(elapsed, workers):
        check_block(header, block, done)
        if done + len(block) > len(elapsed):
            raise InvalidSequenceError(f"{item.name} has more poses than the {len(elapsed)} times asked for")
        if table is None or views is None:
            table = new_large_array((len(elapsed), header.vertex_count, 3), block.dtype)
            if first and same:
                own = first[1].views[0]
            else:
                end = next(item.poses(elapsed[-1:]))[-1]
                own = resolve_view(np.stack([block[0], end]), header.up_axis, camera)
            views = own, first[1].views[0] if first else own
        table[done : done + len(block)] = block
        done += len(block)
        world = to_y_up(block, header.up_axis)
        still = extent_of(world, views).joined(still)
        path = world.mean(axis=1, keepdims=True, dtype=np.float64) * [1, 0, 1]
        following = extent_of(world - path, views).joined(following)
        progress(done, len(elapsed), "decoding frames")
    if table is None or still is None or following is None or views is None or done < len(elapsed):
        raise InvalidSequenceError(f"{item.name} has {done} poses but {len(elapsed)} times were asked for")
    like_first = same and (first is None or _together(still, first[1].still))
    return Gathered(table, still, following, views, like_first)


def extent_of(world: FloatArray, views: Sequence[View]) -> Extent:
    """Return the extent of poses ``(B, V, 3)``, Y up, in some views."""
    seen = []
    for view in views:
        right, up, _ = view.rotation
        # sums in a fixed order: a page has the same bytes on every machine
        x, y, z = world[..., 0], world[..., 1], world[..., 2]
        across, flat = x * right[0] + z * right[2], x * up[0] + z * up[2]
        above = flat + y * up[1]
        seen.append([across.min(), across.max(), above.min(), above.max(), flat.min()])
    return Extent(world.min(axis=(0, 1)), world.max(axis=(0, 1)), np.array(seen))


def _together(one: Extent, other: Extent) -> bool:
    """Whether both are large enough in a common picture."""
    return one.joined(other).side <= TOGETHER * min(one.side, other.side)


STOP = 15
"""Step between stored colours of a palette of 256; the page interpolates between them."""

DIGITS = 5
"""Digits of places relative to the side of a mesh's box, the resolution of a screen."""


@dataclass(frozen=True)
class PageItemReport:
    """Report on a mesh in a page."""

    name: str  # what stands above it
    frames: int  # its poses
    # No vertex is farther from where it was, in diagonals of the bounding box of the first pose.
    max_error: float
    error: float  # the same in units of the mesh
    positions: int  # size of its mesh and motion in bytes, before conversion to text
    colours: int  # size of its colours in bytes, before conversion to text


def page_mesh(
    shown: PageItem,
    elapsed: Float,
    gathered: Gathered,
    tops: Mapping[str, float],
    max_error: float,
    progress: Progress = no_progress,
) -> tuple[dict[str, Any], list[bytes], PageItemReport]:
    """Compress poses at `elapsed` ``(n,)`` within `max_error` diagonals; `tops` are ends of colour scales.

    Returns the description for the page, ready for JSON, and its data: the streams, and colours that are stored.
    """
    header = shown.mesh.header
    if shown.coded is None:
        centre = gathered.poses[:1][0].mean(axis=0, dtype=np.float64)
        coded, vertices = _compressed(header, elapsed, gathered, centre, max_error, progress)
    else:
        centre, vertices = np.zeros(3), np.arange(header.vertex_count)
        bare = replace(shown.coded.header, surface=Surface(), name="")
        without_uvs = replace(shown.coded.parameters, uv_steps=None, uv_error=None)
        coded = replace(shown.coded, header=bare, parameters=without_uvs)
    container = pack(coded)
    colourings: list[dict[str, Any]] = []
    stored: list[bytes] = []
    for name, colouring in shown.colourings.items():
        description, data = _colours(colouring, tops.get(name, 1.0), elapsed, gathered, vertices)
        colourings.append(description if data is None else {**description, "data": 1 + len(stored)})
        stored += [] if data is None else [data]
    parameters, own = coded.parameters, _own_times(coded.header, elapsed)
    error = parameters.max_error * parameters.diagonal
    description = {
        "name": shown.mesh.name,
        "coding": container.text.decode("ascii"),
        "times": None if own else np.round(elapsed, 9).tolist(),
        "start": float(header.times[0]),
        "fps": header.fps,
        "centre": to_y_up(centre, header.up_axis).tolist(),
        "likeFirst": gathered.like_first,
        "azimuth": gathered.views[0].azimuth,
        "elevation": gathered.views[0].elevation,
        "still": _extent(gathered.still, gathered),
        "following": _extent(gathered.following, gathered),
        "error": float(f"{error:.3g}"),
        "colourings": colourings,
        "signals": shown.signals,
    }
    sizes = len(container.streams), sum(map(len, stored))
    report = PageItemReport(shown.mesh.name, len(elapsed), parameters.max_error, error, *sizes)
    return description, [container.streams, *stored], report


def _compressed(
    header: SequenceHeader,
    elapsed: Float,
    gathered: Gathered,
    centre: Float,
    max_error: float,
    progress: Progress,
) -> tuple[CompressedSequence, Index]:
    """Return compressed poses, and the original index of every vertex."""
    regular, rate = _regular(elapsed, header.fps)
    plain = replace(header.with_times(regular, rate), surface=Surface(), name="")
    numbering = cheapest_numbering(plain, "free")
    # Around the origin, as the page computes in single precision.
    centred = LazyFrames(
        plain,
        lambda size: (
            gathered.poses[start : start + size].astype(np.float64) - centre
            for start in range(0, plain.frame_count, size)
        ),
    )
    frames = numbering.renumber_frames(centred)
    return compress(frames, max_error=max_error, progress=progress, uvs=False), numbering.vertices


def _regular(elapsed: Float, fps: float) -> tuple[Float, float]:
    """Return times at a constant rate, which take no bytes, if they have one; else unchanged."""
    if len(elapsed) > 1:
        rate = (len(elapsed) - 1) / float(elapsed[-1])
        times = np.arange(len(elapsed)) / rate
        if np.allclose(times, elapsed, rtol=0, atol=1e-6 / rate):
            return times, rate
    return elapsed, fps


def _own_times(header: SequenceHeader, elapsed: Float) -> bool:
    """Whether the poses of a page are the frames of the compressed sequence."""
    own = header.times - header.times[0]
    return len(own) == len(elapsed) and np.allclose(own, elapsed, rtol=0, atol=1e-6 / header.fps)


def _extent(extent: Extent, gathered: Gathered) -> dict[str, Any]:
    digits = DIGITS - int(np.ceil(np.log10(extent.side or 1.0)))
    low, high, seen = (
        np.round(each, digits).tolist()
        for each in (extent.low, extent.high, extent.rectangles(gathered.views))
    )
    return {"low": low, "high": high, "seen": seen}


# Colours --------------------------------------------------------------------------------------------------


def _colours(
    colouring: Colouring, top: float, elapsed: Float, gathered: Gathered, vertices: Index
) -> tuple[dict[str, Any], bytes | None]:
    """Return the description of a colouring for a page, and its stored data."""
    if not colouring.constant:
        palette = colouring.palette[::STOP]
        scaled = {"name": colouring.name, "palette": palette.tolist(), "top": top, "unit": colouring.unit}
        if colouring.name in MEASURES:
            return scaled, None
        ending = colouring.scaled(top)
        poses = (pose for block in iterate_blocks(gathered.poses) for pose in block)
        times = elapsed.tolist()
        entries = (ending.indices(pose, time) for pose, time in zip(poses, times, strict=True))
        return scaled, deflated_rows(each[vertices] for each in entries)
    used, places = np.unique(colouring.indices(gathered.poses[:1][0], 0.0), return_inverse=True)
    fixed = {"name": colouring.name, "palette": colouring.palette[used].tolist()}
    if len(used) == 1:
        return fixed, None
    return fixed, deflated_rows([places.astype(np.uint8)[vertices]])
