"""Mutate compressed models by their structure, with right checksums, and compare Python's decoder with JavaScript's."""

from __future__ import annotations

import json
import subprocess
import zlib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random
from typing import Any
from zlib import crc32

import numpy as np

import mixseq
from mixseq.compression.compressed_model import CompressedModel
from mixseq.errors import MixseqError
from mixseq_io.coded.streams import INDEX_HEAD, MAGIC, pack_leb128, unpack_leb128
from scripts.benchmarks.common.node import node_executable
from scripts.fuzzing.damage import JSON_VALUES, join_glb, split_glb

VALUES: tuple[Any, ...] = (*JSON_VALUES, 3, 10**400, 1e-320, 1e-99, False, "1", "Z", "\ud800", [0.5] * 2, "__proto__")
NAMES = (
    "ranks", "origin", "uv_steps", "between", "order", "source", "label_count", "inbetween_levels", "inbetween_parts",
    "__proto__", "revision",
)  # fmt: skip
"""Keys that not all texts have."""

SCRIPT = Path(__file__).with_suffix(".mjs")
"""Decodes a file in JavaScript."""

FRAMES, TOLERANCE = 400, 1e-4
"""Frames that are compared; largest difference, of JavaScript's single precision, in largest coordinates."""

PLAYER_ONLY = ("source:", "provenance", "memory", "GiB", "labels", "surface", "face", "order", "texture", "hard")
"""What only one of the decoders looks at, or what their limits of memory say."""


@dataclass
class Coding:
    """The text of a compressed model, numbers of groups and of frames of every chunk, streams, and their lengths."""

    facts: dict[str, Any]
    groups: int
    counts: list[int]
    streams: list[bytes]
    lengths: dict[int, int]  # wrong ones by stream

    @classmethod
    def from_bytes(cls, text: bytes, data: bytes) -> Coding:
        """Read the bytes of a sound file."""
        _, lengths_size, checksums_size, _ = INDEX_HEAD.unpack_from(data)
        groups, chunks, *rest = unpack_leb128(data[INDEX_HEAD.size : INDEX_HEAD.size + lengths_size])
        start, streams = INDEX_HEAD.size + lengths_size + checksums_size, []
        for length in rest[chunks:]:
            streams.append(data[start : start + length])
            start += length
        return cls(json.loads(text), groups, rest[:chunks], streams, {})

    def to_bytes(self) -> tuple[bytes, bytes]:
        """Return text and streams, all checksums right."""
        text = json.dumps(self.facts).encode()
        sizes = [self.lengths.get(number, len(stream)) for number, stream in enumerate(self.streams)]
        lengths = pack_leb128([self.groups, len(self.counts), *self.counts, *sizes])
        crcs = np.array([crc32(text), *(crc32(each) for each in self.streams if each)], dtype="<u4").tobytes()
        head = INDEX_HEAD.pack(MAGIC, len(lengths), len(crcs), crc32(lengths + crcs))
        return text, b"".join([head, lengths, crcs, *self.streams])


def damage_coding(rng: Random, sound: bytes) -> tuple[str, bytes]:
    """Change facts, streams, counts and lengths of a compressed model; all checksums are right afterwards."""
    document, buffer = split_glb(sound)
    views = document["bufferViews"]
    extension = next(each["extensions"]["MIXSEQ_mesh_sequence"] for each in document["meshes"])
    own = [views[extension[key]] for key in ("coding", "streams")]
    coding = Coding.from_bytes(*(buffer[each["byteOffset"] :][: each["byteLength"]] for each in own))
    mutations = (_mutate_fact, _mutate_fact, _mutate_stream, _mutate_stream, _mutate_index)
    labels = [rng.choice(mutations)(rng, coding) for _ in range(rng.choice([1, 1, 1, 2, 3]))]
    for view, part in zip(own, coding.to_bytes(), strict=True):
        view.update(byteOffset=len(buffer), byteLength=len(part))
        buffer += part + bytes(-len(part) % 4)
    document["buffers"][0]["byteLength"] = len(buffer)
    return ", ".join(labels), join_glb(document, buffer)


def _mutate_fact(rng: Random, coding: Coding) -> str:
    holder = rng.choice([coding.facts, coding.facts["coding"]])
    key = rng.choice([*holder, *holder, *NAMES])
    value = holder.get(key)
    if type(value) in (int, float) and rng.random() < 0.5:
        value = rng.choice([value + 1, value - 1, -value, *(value * by for by in (2, 0.5, 1000, 1e-9, 1e6))])
    elif isinstance(value, list) and value and rng.random() < 0.5:
        value = [*value[:-1], rng.choice(VALUES)]
    else:
        value = rng.choice(VALUES)
    holder[key] = value
    if key == "frame_count":  # it is there twice; the only chunk follows
        coding.facts[key] = coding.facts["coding"][key] = value
        if type(value) is int and value > 0:
            coding.counts = [value]
    if not isinstance(coding.facts["coding"], dict):
        coding.facts["coding"] = {}
    return f"{key} is {value!r:.60}"


def _mutate_stream(rng: Random, coding: Coding) -> str:
    number = rng.choice([number for number, stream in enumerate(coding.streams) if stream])
    stream, packed = coding.streams[number], False
    if stream[:2] == b"\x78\xda":  # zlib
        stream, packed = zlib.decompress(stream), True
    at, size = rng.randrange(len(stream) or 1), rng.choice([1, 4, 16, 100])
    changed = rng.choice(
        [
            stream[:at] + bytes(byte ^ 1 << rng.randrange(8) for byte in stream[at : at + 1]) + stream[at + 1 :],
            stream[:at] + rng.randbytes(size) + stream[at + size :],
            stream[:at],
            stream + rng.randbytes(size),
            rng.choice(coding.streams),
            bytes(len(stream)),
            b"\xff" * len(stream),
            bytes(size),
            stream * rng.choice([2, 1000 if packed else 3]),
        ]
    )
    coding.streams[number] = zlib.compress(changed, 9) if packed else changed
    return f"stream {number} has {len(changed)} bytes of {len(stream)}"


def _mutate_index(rng: Random, coding: Coding) -> str:
    kind, number = rng.randrange(5), rng.randrange(len(coding.streams))
    if kind == 0:
        coding.lengths[number] = rng.choice([0, len(coding.streams[number]) + 1, 2**31, 2**32, 2**53, 2**64, 2**80])
    elif kind == 1:
        coding.groups = max(0, coding.groups + rng.choice([-1, 1, 2**20]))
    elif kind == 2:
        coding.counts = [max(0, count + rng.choice([-1, 1, 1000, 2**40])) for count in coding.counts]
    elif kind == 3:
        coding.counts = rng.choice([coding.counts * 2, [*coding.counts, 1], [1] * min(sum(coding.counts), 2**16), []])
    else:
        coding.streams = [*coding.streams[:number], *[b""] * rng.choice([0, 2, 1000]), *coding.streams[number + 1 :]]
    return f"index {kind}, {number}"


def decode_twice(file: Path) -> np.ndarray[Any, Any]:
    """Decode a .glb in Python and in JavaScript; raise AssertionError if they disagree."""
    refused = _decode_in_javascript(file.absolute())
    may_differ = any(word in refused for word in PLAYER_ONLY)
    try:
        model = mixseq.load(file)
        assert isinstance(model, CompressedModel)
        times = model.times[:FRAMES]
        points = model.sample(times).points - np.array(model.playback.origin or 0.0)
    except MixseqError as refusal:
        told = f"{refusal} | {refused}"
        assert refused or any(word in told for word in PLAYER_ONLY), told
        raise
    ours = np.concatenate([times, model.header.polygons.indices, points.reshape(-1)])
    if refused:
        assert may_differ, refused
        return ours
    theirs, largest = np.fromfile(f"{file}.f8"), np.abs(points).max()
    assert len(ours) == len(theirs), (len(ours), len(theirs))
    assert np.abs(ours - theirs).max() <= TOLERANCE * largest, (np.abs(ours - theirs).max(), largest)
    return ours


def _decode_in_javascript(file: Path) -> str:
    """Decode a .glb by Node.js, which goes on for the next file; return why it is refused, or ""."""
    node = _node()
    assert node.stdin is not None and node.stdout is not None
    print(file, file=node.stdin, flush=True)
    answer = node.stdout.readline()
    if not answer:
        _node.cache_clear()
        raise AssertionError(f"Node.js ended with {node.wait()}")
    return str(json.loads(answer))


@cache
def _node() -> subprocess.Popen[str]:
    command = ["prlimit", "--as=unlimited", str(node_executable()), str(SCRIPT), str(FRAMES)]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
