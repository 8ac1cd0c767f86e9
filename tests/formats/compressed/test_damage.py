"""Compressed sequences in HDF5: damage is noticed and named."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from zlib import crc32

import h5py
import numpy as np
import pytest

import mixseq
from mixseq.compression.bitstream.compressed_sequence import CompressedSequence
from mixseq.errors import FormatError
from mixseq_io.coded.streams import StreamIndex
from mixseq_io.model_files import compressed_sizes, is_compressed, read_compressed
from tests.formats.compressed.stream_cases import assert_same, damage, flip, index_of, place_of

pytestmark = pytest.mark.slow

STREAMS: list[tuple[Callable[[StreamIndex], Any], str]] = [
    (lambda index: index.header["connectivity"], "the connectivity's bytes are damaged"),
    (lambda index: index.basis[0], "the basis vectors of group 0 are damaged"),
    (lambda index: index.basis[2], "the basis vectors of group 2 are damaged"),
    (lambda index: index.chunks[0].coefficients, "the coefficients of frames 0 to 3 are damaged"),
    (lambda index: index.chunks[3].coefficients, "the coefficients of frames 12 to 13 are damaged"),
    (lambda index: index.chunks[1].residuals, "the residuals of frames 4 to 7 are damaged"),
    (lambda index: index.chunks[3].inbetweens, "the in-betweens of frames 12 to 13 are damaged"),
]


@pytest.mark.parametrize(("stream", "message"), STREAMS, ids=[message for _, message in STREAMS])
def test_damage_is_named(path: Path, stream: Callable[[StreamIndex], Any], message: str) -> None:
    damage(path, stream(index_of(path)))
    with pytest.raises(FormatError, match=rf"small\.(h5|glb): {message}; restore the file"):
        mixseq.load(path)


def test_damaged_times_are_named(tmp_path: Path, coded: CompressedSequence) -> None:
    file = tmp_path / "times.h5"
    mixseq.save(file, replace(coded, header=coded.header.with_times(np.arange(14) ** 2)))
    damage(file, index_of(file).header["times"])
    with pytest.raises(FormatError, match=r"times\.h5: the times are damaged"):
        mixseq.load(file)


def test_every_flipped_bit_is_noticed_or_harmless(path: Path, coded: CompressedSequence) -> None:
    whole = path.read_bytes()
    noticed = 0
    for at in range(0, len(whole), 31):
        path.write_bytes(whole)
        flip(path, at)
        try:
            assert_same(read_compressed(path), coded)  # bytes that nobody uses: created_by, gaps
        except FormatError as error:
            noticed += 1
            assert str(path) in str(error)
    assert noticed > 0.95 * len(range(0, len(whole), 31))


def test_truncated_files_are_refused(path: Path) -> None:
    whole, first, index = path.read_bytes(), place_of(path), index_of(path)
    for size in (first + index.chunks[2].coefficients.start + 5, 100):
        path.write_bytes(whole[:size])
        with pytest.raises(
            FormatError, match=r"small\.(h5 cannot be read as HDF5|glb).*(truncated|goes beyond the end)"
        ):
            mixseq.load(path)


def test_damage_of_hdf5_alone_is_refused(h5: Path) -> None:
    flip(h5, 30)  # in the superblock
    with pytest.raises(FormatError, match=r"small\.h5 cannot be read as HDF5"):
        mixseq.load(h5)


def test_a_damaged_index_is_the_end(path: Path) -> None:
    flip(path, place_of(path) + 20)
    with pytest.raises(FormatError, match="its index is damaged, so nothing can be read"):
        mixseq.load(path)


def changed(path: Path, change: Callable[[dict[str, object]], object]) -> None:
    """Change the attribute, and its checksum with it, as somebody might on purpose."""
    with h5py.File(path, "r+") as file:
        text = bytes(file.attrs["coding"])
        facts = json.loads(text)
        change(facts)
        new = json.dumps(facts).encode()
        streams = file["streams"][:].tobytes()
        lengths, checksums = np.frombuffer(streams[4:12], "<u4").tolist()
        body = bytearray(streams[16 : 16 + lengths + checksums])
        body[lengths : lengths + 4] = np.array([crc32(new)], "<u4").tobytes()
        head = streams[:12] + np.array([crc32(bytes(body))], "<u4").tobytes()
        data = head + bytes(body) + streams[16 + lengths + checksums :]
        file["streams"][:] = np.frombuffer(data, np.uint8)
        file.attrs.create("coding", new, dtype=h5py.string_dtype("ascii", len(new)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda facts: facts["coding"].update(magic=1), "the parameter 'magic' is unknown to this mixseq; upgrade it"),
        (lambda facts: facts.update(order="spiral"), "the order 'spiral' is unknown to this mixseq; upgrade it"),
        (lambda facts: facts["coding"].pop("step"), "parameters are missing .*step"),
        (lambda facts: facts.pop("coding"), "no parameters"),
        (lambda facts: facts["coding"].update(frame_count=99) or facts.update(frame_count=99), "add up to 99 frames"),
        (lambda facts: facts["coding"].update(factors="x"), "factors is 'x'; trajectories or shapes"),
        (lambda facts: facts["coding"].update(rank=0), "rank is 0; a whole number above zero"),
        (lambda facts: facts["coding"].update(rank=2.5), "rank is 2.5; a whole number above zero"),
        (lambda facts: facts["coding"].update(step=0), "step is 0; a positive number"),
        (lambda facts: facts["coding"].update(diagonal="long"), "diagonal is 'long'; a positive number"),
        (lambda facts: facts["coding"].update(correction=float("nan")), "a number is NaN; 0, or from 1e-100 to 1e"),
        (lambda facts: facts["coding"].update(correction=-1), "correction is -1; a non-negative"),
        (lambda facts: facts["coding"].update(diagonal=1e-320), "a number is 1e-320; 0, or from"),
        (lambda facts: facts["coding"].update(step=10**400), "a number is 1000.*; 0, or from"),
        (lambda facts: facts["coding"].update(origin=""), "ranks or origin are no list of numbers"),
        (lambda facts: facts["coding"].update(ranks=""), "ranks or origin are no list of numbers"),
        (lambda facts: facts["coding"].update(rank=True), "rank is True; a whole number above zero"),
        (lambda facts: facts["coding"].update(promised=1), "promised is 1; true or false"),
        (lambda facts: facts["coding"].update(frame_count=15), "two numbers of frames differ"),
        (lambda facts: facts.update(vertex_count=1 << 31), r"\d+ bytes cannot hold \d+ numbers of its vertices"),
        (lambda facts: facts.update(corner_count=float("inf")), "Infinity.*; it is damaged"),
        (lambda facts: facts.update(vertex_count=1e9), r"\d+ bytes cannot hold \d+ numbers of its vertices"),
        (lambda facts: facts.pop("fps"), "fps.*; it is damaged"),
        (lambda facts: facts.update(fps=0.0), "not finite; it is damaged"),
        (lambda facts: facts.update(fps=-1), "times must increase; it is damaged"),
        (lambda facts: facts.update(frame_count=99), "two numbers of frames differ"),
        (lambda facts: facts.update(vertex_count="many"), "many.*; it is damaged"),
        (lambda facts: facts.update(up_axis="W"), "up axis is 'W'.*; it is damaged"),
        (lambda facts: facts.update(between=[4.0, 0.5, 0.5]), "between is .*length, cubic and cuts are expected"),
        (lambda facts: facts["between"].pop("cubic"), "between is .*length, cubic and cuts are expected"),
        (lambda facts: facts["between"].update(knots=3), "between is .*length, cubic and cuts are expected"),
        (
            lambda facts: facts["between"].update(cuts=[0, 3]),
            r"cuts is \(0, 3\); increasing numbers of frames from 1 on",
        ),
        (lambda facts: facts["between"].update(cuts="3"), "cuts is '3'; increasing numbers of frames"),
        (lambda facts: facts["between"].update(cuts=[3, 10**6]), "a cut is before frame 1000000 of 14; it is damaged"),
        (lambda facts: facts["between"].update(length=0.25), "length is 0.25; a number from 0.5 to 64"),
        (lambda facts: facts["between"].update(length=65), "length is 65; a number from 0.5 to 64"),
        (lambda facts: facts["between"].update(length=float("nan")), "a number is NaN; 0, or from"),
        (lambda facts: facts["between"].update(length=True), "length is True; a number from 0.5 to 64"),
        (lambda facts: facts["between"].update(cubic=[0.5, 1.5]), r"cubic is \(0.5, 1.5\); two numbers"),
        (lambda facts: facts["between"].update(cubic=[0.5]), r"cubic is \(0.5,\); two numbers"),
        (lambda facts: facts["between"].update(cubic=[0.5, "1"]), r"cubic is \(0.5, '1'\); two numbers"),
        (lambda facts: facts["between"].update(cubic=0.5), "cubic is 0.5; two numbers from 0 to 1"),
    ],
)
def test_contradictions_are_refused(h5: Path, change: Callable[[dict[str, object]], object], message: str) -> None:
    changed(h5, change)
    with pytest.raises(FormatError, match=rf"small\.h5: .*{message}"):
        read_compressed(h5)


def test_what_else_files_say_is_ignored(h5: Path, coded: CompressedSequence) -> None:
    changed(h5, lambda facts: facts.update(author="somebody", colours={"skin": [1, 2, 3]}))
    assert_same(read_compressed(h5), coded)


def test_files_need_not_say_what_is_between_frames(h5: Path, coded: CompressedSequence) -> None:
    changed(h5, lambda facts: facts.pop("between"))
    assert_same(read_compressed(h5), replace(coded, between=None))


@pytest.mark.parametrize("version", [0, 2, 8])
def test_other_versions_are_refused(h5: Path, version: int) -> None:
    with h5py.File(h5, "r+") as file:
        file.attrs["version"] = version
    with pytest.raises(FormatError, match=rf"of version {version}, this mixseq reads 1: upgrade with pip"):
        mixseq.load(h5)


def test_other_files_are_no_compressed_models(tmp_path: Path, bar_model: mixseq.Model) -> None:
    model = tmp_path / "model.h5"
    mixseq.save(model, bar_model)
    assert not is_compressed(model)
    for ask in (read_compressed, compressed_sizes):
        with pytest.raises(FormatError, match=r"model\.h5 is not a compressed model; make one with mixseq encode"):
            ask(model)
    with pytest.raises(FormatError, match=r"none\.h5 does not exist"):
        read_compressed(tmp_path / "none.h5")
