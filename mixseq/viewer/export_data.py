"""Encode the meshes of a page: poses and extents, compressed streams, stored colours, and binary data as text.

A page is UTF-16 with a byte order mark, which overrides a server's encoding. Every two bytes, in little-endian order,
form one code unit. The text of a script element cannot hold NUL, carriage return, ``<`` and surrogates. These units
and U+0001 are escaped as U+0001 followed by the unit with its highest bit flipped. Escaping adds 3 % to typical data;
base64 in UTF-8 adds 33 %. ``page/loader.js`` decodes the text.

Vertices are renumbered for the smallest size. Data that is not drawn, such as texture coordinates, is omitted. The page
computes strain and curvature; colours of parts and errors are stored as palette entries. The entries form one row of
bytes :math:`q_{tj}` per frame, stored as :math:`s_{tj} = d_{tj} - d_{t,j-1}` with :math:`d_{tj} = q_{tj} - q_{t-1,j}`
modulo 256, with zeros before the first row and column. The result is deflated (RFC 1950).
"""

from __future__ import annotations

import codecs
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.compression.bitstream.compressed_sequence import CompressedSequence
from mixseq.compression.encoder.compress import compress
from mixseq.compression.numbering import cheapest_numbering
from mixseq.errors import InvalidSequenceError
from mixseq.mesh.measures import NO_ORIGIN
from mixseq.mesh.surface import Surface
from mixseq.pictures.charts import chart_data
from mixseq.pictures.colours import MEASURES, Colouring, SceneColours
from mixseq.pictures.scene import SceneItem, View, resolve_view, to_y_up
from mixseq.runtime.low_memory import LargeArray, new_large_array
from mixseq.runtime.parallel import Executor
from mixseq.runtime.progress import Progress, log_progress
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import LazyFrames, check_block, iterate_blocks
from mixseq.types import Float, FloatArray, Index, IntArray
from mixseq_io.coded.packing import pack

PAGE_ENCODING = "utf-16-le"
BYTE_ORDER_MARK = codecs.BOM_UTF16_LE
ESCAPE_UNIT = 1
_FORBIDDEN_UNITS = np.array([0, ord("\r"), ord("<"), ESCAPE_UNIT])
_MIN_SURROGATE, _MAX_SURROGATE = 0xD800, 0xDFFF


def encode_text(data: bytes) -> bytes:
    """Encode bytes as UTF-16 text of a script element; an odd number of bytes is padded with a zero byte."""
    units = np.frombuffer(data + bytes(len(data) % 2), "<u2")
    is_surrogate = (units >= _MIN_SURROGATE) & (units <= _MAX_SURROGATE)
    is_escaped = np.isin(units, _FORBIDDEN_UNITS) | is_surrogate
    text = np.repeat(units, 1 + is_escaped)
    escaped_ids = np.cumsum(1 + is_escaped)[is_escaped] - 1
    text[escaped_ids - 1] = ESCAPE_UNIT
    text[escaped_ids] ^= 0x8000
    return text.tobytes()


def deflate_rows(rows: Iterable[NDArray[np.uint8]]) -> bytes:
    """Predict the bytes of rows ``(V,)`` from the previous row and column, and deflate the prediction errors."""
    deflate, chunks = zlib.compressobj(9), []
    previous = np.zeros(1, np.uint8)
    for row in rows:
        changes = row - previous
        chunks.append(deflate.compress(np.diff(changes, prepend=np.uint8(0)).tobytes()))
        previous = row
    return b"".join([*chunks, deflate.flush()])


@dataclass(frozen=True, eq=False)
class PageItem:
    """A mesh of a page, with one pose per frame of this mesh."""

    mesh: SceneItem  # the moving mesh
    colourings: Mapping[str, Colouring]  # available colourings, the initial one first
    signals: Mapping[str, Any] | None = None  # chart data of a model (mixseq.pictures.charts)
    compressed: CompressedSequence | None = None  # the opened file of the mesh, if compressed


def page_items(colours: SceneColours, compressed: Sequence[CompressedSequence | None] | None = None) -> list[PageItem]:
    """Return the meshes of a scene with all their colourings, and the chart data of models."""
    items = colours.scene.items
    return [
        PageItem(item, colours.of_mesh(index), None if item.model is None else chart_data(item.model), sequence)
        for index, (item, sequence) in enumerate(zip(items, compressed or [None] * len(items), strict=True))
    ]


@dataclass(frozen=True, eq=False)
class Extent:
    """Bounds of a mesh over all poses, with Y as the up axis."""

    low: Float  # (3,) minimum corner of the bounding box
    high: Float  # (3,) maximum corner of the bounding box
    # (views, 5) left, right, bottom and top on the screen of each view; the origin of space is at the screen's centre.
    # The last value is the screen bottom of the mesh after projection to height zero.
    screen: Float

    @property
    def centre(self) -> Float:
        """Centre ``(3,)`` of the bounding box."""
        return np.asarray((self.low + self.high) / 2)

    @property
    def side(self) -> float:
        """Longest side of the bounding box."""
        return float((self.high - self.low).max())

    def union(self, other: Extent) -> Extent:
        """Return the smallest extent that contains both extents."""
        low, high = np.minimum(self.low, other.low), np.maximum(self.high, other.high)
        minima, maxima = np.minimum(self.screen, other.screen), np.maximum(self.screen, other.screen)
        return Extent(low, high, np.where([True, False, True, False, True], minima, maxima))

    def rectangles(self, views: Sequence[View]) -> Float:
        """Return screen rectangles ``(views, 4)`` around the mesh and its shadow on the ground."""
        floors = [view.rotation[1, 1] * self.low[1] + row[4] for view, row in zip(views, self.screen, strict=True)]
        left, right, bottom, top, _ = self.screen.T
        return np.stack([left, right, np.minimum(bottom, floors), top], axis=1)


@dataclass(frozen=True, eq=False)
class PagePoses:
    """Poses of a mesh of a page."""

    poses: LargeArray  # (n, V, 3) points, in the precision of the item
    still: Extent  # extent of the mesh at its positions in space, in both views
    following: Extent  # extent without the horizontal motion of the mean vertex, in both views
    views: tuple[View, View]  # view of this mesh, and view of the first mesh of the page
    like_first: bool  # whether triangles are those of the first mesh, and size and position similar


def collect_poses(
    item: SceneItem,
    elapsed: Float,
    first: tuple[SequenceHeader, PagePoses] | None,
    progress: Progress = log_progress,
    workers: Executor | None = None,
    camera: tuple[float, float] | None = None,
) -> PagePoses:
    """Read the poses at elapsed times ``(n,)``; `first` is the page's first mesh, or None if `item` is the first."""
    header = item.header
    blocks = item.poses(elapsed, workers)
    opening = next(blocks, None)
    if opening is None:
        raise InvalidSequenceError(f"{item.name} has 0 poses, but {len(elapsed)} times")
    has_same_faces = first is None or np.array_equal(header.faces, first[0].faces)
    if first and has_same_faces:
        own = first[1].views[0]
    else:
        end = next(item.poses(elapsed[-1:]))[-1]
        own = resolve_view(np.stack([opening[0], end]), header.up_axis, camera)
    views = own, first[1].views[0] if first else own
    poses = new_large_array((len(elapsed), header.vertex_count, 3), opening.dtype)
    extents: list[tuple[Extent, Extent]] = []
    count = 0
    for block in chain([opening], blocks):
        check_block(header, block, count)
        if count + len(block) > len(elapsed):
            raise InvalidSequenceError(f"{item.name} has more poses than its {len(elapsed)} times")
        poses[count : count + len(block)] = block
        count += len(block)
        world = to_y_up(block, header.up_axis)
        path = world.mean(axis=1, keepdims=True, dtype=np.float64) * [1, 0, 1]
        extents.append((measure_extent(world, views), measure_extent(world - path, views)))
        progress(count, len(elapsed), "decoding frames")
    if count < len(elapsed):
        raise InvalidSequenceError(f"{item.name} has {count} poses, but {len(elapsed)} times")
    still, following = (reduce(Extent.union, of_blocks) for of_blocks in zip(*extents, strict=True))
    like_first = has_same_faces and (first is None or _share_scale(still, first[1].still))
    return PagePoses(poses, still, following, views, like_first)


def measure_extent(world: FloatArray, views: Sequence[View]) -> Extent:
    """Return the extent of poses ``(B, V, 3)``, with Y as the up axis, in the given views."""
    rows = []
    for view in views:
        right, up, _ = view.rotation
        # A fixed order of summation gives the same page on every machine.
        x, y, z = world[..., 0], world[..., 1], world[..., 2]
        horizontal, projected = x * right[0] + z * right[2], x * up[0] + z * up[2]
        vertical = projected + y * up[1]
        rows.append([horizontal.min(), horizontal.max(), vertical.min(), vertical.max(), projected.min()])
    return Extent(world.min(axis=(0, 1)), world.max(axis=(0, 1)), np.array(rows))


def _share_scale(one: Extent, other: Extent) -> bool:
    """Whether both meshes are visible at the same scale: the smaller one has half of their common extent."""
    return one.union(other).side <= 2 * min(one.side, other.side)


@dataclass(frozen=True)
class PageItemReport:
    """Errors of an exported mesh."""

    name: str  # name above the mesh
    max_error: float  # bound of vertex errors, in diagonals of the first pose
    error: float  # the same bound in units of the mesh
    between: float | None  # distance from the model between frames in diagonals, if it was measured
    history: str  # what the bound refers to, see `mixseq.sequence.provenance`


def encode_mesh(
    item: PageItem,
    elapsed: Float,
    page_poses: PagePoses,
    tops: Mapping[str, float],
    max_error: float,
    inbetweens: bool,
    progress: Progress = log_progress,
) -> tuple[dict[str, Any], list[bytes], PageItemReport]:
    """Compress the poses at elapsed times ``(n,)`` within `max_error` diagonals; `tops` are the ends of colour scales.

    Return the page's description of the mesh, which JSON can hold, its streams and stored colours, and a report.
    """
    header = item.mesh.header
    if item.compressed is None:
        parts = None if item.mesh.model is None else item.mesh.model.parts
        if not inbetweens:  # players have no use for parts
            parts = np.zeros(len(header.faces), dtype=np.int64)
        compressed, vertices = _compress_poses(header, elapsed, page_poses, max_error, parts, inbetweens, progress)
    else:
        vertices = np.arange(header.vertex_count)
        geometry_header = replace(item.compressed.header, surface=Surface(), name="")
        without_uvs = replace(item.compressed.parameters, uv_steps=None, uv_error=None)
        compressed = replace(item.compressed, header=geometry_header, parameters=without_uvs)
    container = pack(compressed)
    colourings: list[dict[str, Any]] = []
    stored: list[bytes] = []
    for name, colouring in item.colourings.items():
        description, data = _describe_colouring(colouring, tops.get(name, 1.0), elapsed, page_poses, vertices)
        colourings.append(description if data is None else {**description, "data": 1 + len(stored)})
        stored += [] if data is None else [data]
    parameters, has_frame_times = compressed.parameters, _has_frame_times(compressed.header, elapsed)
    error, between = parameters.max_error * parameters.diagonal, parameters.inbetween_error
    description = {
        "name": item.mesh.name,
        "coding": container.text.decode("ascii"),
        "times": None if has_frame_times else np.round(elapsed, 9).tolist(),
        "cuts": compressed.between.cuts if compressed.between else (),
        "start": float(header.times[0]),
        "fps": header.fps,
        "centre": to_y_up(np.array(parameters.origin or NO_ORIGIN), header.up_axis).tolist(),
        "likeFirst": page_poses.like_first,
        "azimuth": page_poses.views[0].azimuth,
        "elevation": page_poses.views[0].elevation,
        "still": _describe_extent(page_poses.still, page_poses),
        "following": _describe_extent(page_poses.following, page_poses),
        "error": float(f"{error:.3g}"),
        "between": None if between is None else float(f"{between * parameters.diagonal:.3g}"),
        "colourings": colourings,
        "signals": item.signals,
    }
    history = str(compressed.header.provenance or "")
    report = PageItemReport(item.mesh.name, parameters.max_error, error, between, history)
    return description, [container.streams, *stored], report


def _compress_poses(
    header: SequenceHeader,
    elapsed: Float,
    page_poses: PagePoses,
    max_error: float,
    parts: IntArray | None,
    inbetweens: bool,
    progress: Progress,
) -> tuple[CompressedSequence, Index]:
    """Return the compressed poses, and the original index of each vertex."""
    times, rate = _regular_times(elapsed, header.fps)
    geometry_header = replace(header.with_times(times, rate), surface=Surface(), name="")
    numbering = cheapest_numbering(geometry_header, "free")
    frames = numbering.renumber_frames(LazyFrames(geometry_header, lambda size: iterate_blocks(page_poses.poses)))
    parts = None if parts is None else numbering.renumber_labels(parts, header.polygons)
    coded = compress(frames, max_error=max_error, progress=progress, uvs=False, parts=parts, inbetweens=inbetweens)
    # players need the labels of triangles only for in-betweens of parts
    return coded if coded.parameters.inbetween_parts else replace(coded, labels=None), numbering.vertices


def _regular_times(elapsed: Float, fps: float) -> tuple[Float, float]:
    """Return times ``(n,)``, made exactly regular if nearly so, and their rate; regular times take no bytes."""
    if len(elapsed) > 1:
        rate = (len(elapsed) - 1) / float(elapsed[-1])
        times = np.arange(len(elapsed)) / rate
        if np.allclose(times, elapsed, rtol=0, atol=1e-6 / rate):
            return times, rate
    return elapsed, fps


def _has_frame_times(header: SequenceHeader, elapsed: Float) -> bool:
    """Whether elapsed times ``(n,)`` equal the frame times of a compressed sequence."""
    frame_times = header.times - header.times[0]
    tolerance = 1e-6 / header.fps
    return len(frame_times) == len(elapsed) and np.allclose(frame_times, elapsed, rtol=0, atol=tolerance)


def _describe_extent(extent: Extent, page_poses: PagePoses) -> dict[str, Any]:
    # 5 significant digits are enough for a screen
    digits = 5 - int(np.ceil(np.log10(extent.side or 1.0)))
    low, high, screen = (
        np.round(values, digits).tolist() for values in (extent.low, extent.high, extent.rectangles(page_poses.views))
    )
    return {"low": low, "high": high, "seen": screen}


def _describe_colouring(
    colouring: Colouring, top: float, elapsed: Float, page_poses: PagePoses, vertices: Index
) -> tuple[dict[str, Any], bytes | None]:
    """Return the description of a colouring for a page, and its stored data, if any."""
    if not colouring.is_constant:
        palette = colouring.palette[::15]  # the page interpolates the others
        measured = {
            "name": colouring.name,
            "palette": palette.tolist(),
            "low": colouring.low,
            "top": top,
            "unit": colouring.unit,
        }
        if colouring.name in MEASURES:
            return measured, None
        scaled = colouring.with_top(top)
        poses = (pose for block in iterate_blocks(page_poses.poses) for pose in block)
        times = elapsed.tolist()
        entries = (scaled.entries(pose, time) for pose, time in zip(poses, times, strict=True))
        return measured, deflate_rows(row[vertices] for row in entries)
    used, entry_of_vertex = np.unique(colouring.entries(page_poses.poses[:1][0], 0.0), return_inverse=True)
    constant = {"name": colouring.name, "palette": colouring.palette[used].tolist()}
    if len(used) == 1:
        return constant, None
    return constant, deflate_rows([entry_of_vertex.astype(np.uint8)[vertices]])
