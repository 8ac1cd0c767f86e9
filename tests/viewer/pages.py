"""Pages taken apart: what is in them, decoded by Python; and waiting for those that are alive."""

from __future__ import annotations

import json
import re
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.compression.bitstream.compressed_sequence import Playback, decode
from mixseq.pictures.scene import to_y_up
from mixseq.types import Float
from mixseq.viewer.export_data import BYTE_ORDER_MARK, ESCAPE_UNIT, PAGE_ENCODING
from mixseq_io.coded.streams import Container, read_sequence

QUICK = "&fixedDpr=0.25"
"""A quarter of the pixels each way: there is no graphics card here."""


def eventually(holds: Callable[[], Any], seconds: float = 60.0) -> Any:
    """Wait until something holds, and return it."""
    until = time.monotonic() + seconds
    while not (found := holds()):
        assert time.monotonic() < until, "it never came"
        time.sleep(0.02)
    return found


_ELEMENT = re.compile(r'<script type="text/plain" data-size="(\d+)">([^<]*)</script>')


def bytes_of(text: str, size: int) -> bytes:
    """Return the bytes that `mixseq.viewer.export_data.encode_text` wrote: two of every unit."""
    units = iter(np.frombuffer(text.encode(PAGE_ENCODING), "<u2").tolist())
    found = [next(units) ^ 0x8000 if unit == ESCAPE_UNIT else unit for unit in units]
    return np.array(found, "<u2").tobytes()[:size]


def rows_of(data: bytes, width: int) -> NDArray[np.uint8]:
    """Return the rows ``(n, width)`` that `mixseq.viewer.export_data.deflate_rows` deflated."""
    steps = np.frombuffer(zlib.decompress(data), np.uint8).reshape(-1, width)
    return np.asarray(steps.cumsum(axis=1, dtype=np.uint8).cumsum(axis=0, dtype=np.uint8))


@dataclass(frozen=True, eq=False)
class OpenedItem:
    """A mesh of a page: what is said of it, its model, and colours that are stored."""

    description: dict[str, Any]
    model: Playback
    colours: dict[str, NDArray[np.uint8]]

    @property
    def times(self) -> Float:
        """Times ``(n,)`` of its poses since the first."""
        given = self.description["times"]
        return np.asarray(self.model.times - self.model.times[0] if given is None else given)

    @property
    def points(self) -> Float:
        """Its poses ``(n, V, 3)``, Y up."""
        model = self.model
        poses = np.stack([model(model.start + elapsed) for elapsed in self.times])
        return np.asarray(to_y_up(poses, model.header.up_axis))


class Opened:
    """A page taken apart."""

    def __init__(self, path: Path) -> None:
        marked = path.read_bytes()
        assert marked.startswith(BYTE_ORDER_MARK)
        self.text = marked.decode("utf-16")
        streams = iter([bytes_of(text, int(size)) for size, text in _ELEMENT.findall(self.text)])
        parts = zlib.decompress(next(streams)).decode().split("\0")
        self.style, self.body, self.decoder, self.scripts = parts[:4]
        self.description = json.loads(parts[4])
        self.items = [_item(item, streams) for item in self.description["items"]]
        assert not list(streams)


def _item(description: dict[str, Any], streams: Any) -> OpenedItem:
    container = Container(description["coding"].encode(), next(streams))
    model = decode(read_sequence(Path(description["name"]), container))
    colours = {
        each["name"]: rows_of(next(streams), model.header.vertex_count)
        for each in description["colourings"]
        if "data" in each
    }
    return OpenedItem(description, model, colours)
