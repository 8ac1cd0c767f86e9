"""Compressed sequences in HDF5: everything comes back."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from math import inf
from pathlib import Path
from typing import Any

import h5py
import pytest

import mixseq
from mixseq.compression.bitstream.compressed_sequence import Chunk, CompressedSequence, TemporalInterpolation
from mixseq.errors import FormatError, OutputError
from mixseq.signals.bodies import Relation
from mixseq_io.coded.streams import COMPRESSED_VERSION
from mixseq_io.model_files import compressed_sizes, is_compressed, read_compressed
from tests.formats.compressed.stream_cases import PARAMETERS, any_bytes, assert_same
from tests.meshes import bar


def test_everything_comes_back(path: Path, coded: CompressedSequence) -> None:
    assert is_compressed(path)
    got = read_compressed(path)
    assert_same(got, coded)
    assert got.header.surface.origin is None


def test_saving_twice_makes_the_same_file(h5: Path, coded: CompressedSequence, tmp_path: Path) -> None:
    mixseq.save(tmp_path / "again.hdf5", coded)
    assert (tmp_path / "again.hdf5").read_bytes() == h5.read_bytes()


def test_the_file_says_what_it_is(h5: Path) -> None:
    with h5py.File(h5) as file:
        assert file.attrs["format"] == b"mixseq-model"
        assert file.attrs["version"] == COMPRESSED_VERSION
        assert list(file) == ["streams"]
        facts = json.loads(file.attrs["coding"])
    without = ("ranks", "uv_steps", "uv_error", "origin", "inbetween_parts")
    assert facts["coding"] == {name: value for name, value in asdict(PARAMETERS).items() if name not in without}
    assert (facts["name"], facts["frame_count"], facts["polygon_count"]) == ("Füchsin", 14, 150)
    assert facts["between"] == {"length": 2.8, "cubic": [1 / 3, 0.1 + 0.2]}


def test_infinite_lengths_come_back(h5: Path, coded: CompressedSequence) -> None:
    endless = replace(coded, between=TemporalInterpolation(inf, (0, 1)))
    mixseq.save(h5, endless)
    with h5py.File(h5) as file:
        assert json.loads(file.attrs["coding"])["between"] == {"length": None, "cubic": [0, 1]}
    assert_same(read_compressed(h5), endless)


def test_sizes_add_up_and_hdf5_takes_few_bytes(h5: Path, coded: CompressedSequence) -> None:
    sizes = compressed_sizes(h5)
    assert sizes["total"] == h5.stat().st_size
    assert sizes["total"] == sizes["connectivity"] + sizes["container"] + sizes["signals"]
    streams = sum(map(len, coded.basis)) + sum(
        len(each.coefficients + each.residuals + each.inbetweens) for each in coded.chunks
    )
    assert sizes["signals"] == streams + sizes["index"]
    assert sizes["surface"] == 0
    assert 0 < sizes["connectivity"] < 600
    assert sizes["index"] < 150
    assert sizes["container"] < 1200


@pytest.mark.parametrize(("groups", "chunks"), [(0, 1), (1, 1), (1, 300)])
def test_any_number_of_streams(tmp_path: Path, groups: int, chunks: int) -> None:
    header = bar(5, 15, 2 * chunks).header
    some = tuple(Chunk(2 * number, 2, any_bytes(number + 200), any_bytes(7)) for number in range(chunks))
    parameters = replace(PARAMETERS, frame_count=header.frame_count)
    coded = CompressedSequence(header, parameters, tuple(any_bytes(size) for size in range(groups)), some)
    file = tmp_path / "many.h5"
    mixseq.save(file, coded)
    assert_same(read_compressed(file), coded)
    assert compressed_sizes(file)["index"] < 40 + 14 * chunks


def test_bodies_come_back(h5: Path, coded: CompressedSequence) -> None:
    header = bar(7, 9, 14).header
    relation = Relation((0.6, 0.0, 0.8, 0.0), same_parts=True)
    other = replace(coded, header=header, basis=(any_bytes(90),), relation=relation)
    mixseq.save(h5, replace(coded, bodies=(other,)))
    got = read_compressed(h5)
    assert_same(got, coded)
    [body] = got.bodies
    assert_same(body, other)
    assert body.relation == relation
    sizes = compressed_sizes(h5)
    assert sizes["total"] == sizes["connectivity"] + sizes["container"] + sizes["signals"]


@pytest.mark.parametrize("turn", [[1, 0, 0], [1, 1, 0, 0], ["a", 0, 0, 0], None])
def test_turns_of_bodies_are_checked(h5: Path, coded: CompressedSequence, turn: Any) -> None:
    mixseq.save(h5, replace(coded, relation=Relation(turn)))
    with pytest.raises(FormatError, match=r"small\.h5: relation is .*; a quaternion is expected; it is damaged"):
        read_compressed(h5)


def test_only_h5(tmp_path: Path, coded: CompressedSequence) -> None:
    with pytest.raises(OutputError, match=r"end the name in \.h5"):
        mixseq.save(tmp_path / "small.usdc", coded)
