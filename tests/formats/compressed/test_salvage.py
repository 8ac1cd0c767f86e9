"""Compressed sequences in HDF5: what is not damaged can be read."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import mixseq
from mixseq.coding.bitstream.compressed_sequence import CompressedSequence
from mixseq.errors import FormatError, MixseqWarning
from mixseq.surface import Surface
from mixseq_io.coded.stream_index import Stream, StreamIndex
from mixseq_io.salvage import salvage_compressed
from tests.formats.compressed.stream_cases import assert_same, damage, flip, index_of, place_of


def salvaged(path: Path, *told: str) -> CompressedSequence:
    """What is left, after exactly these warnings."""
    if not told:
        rest = salvage_compressed(path)
    else:
        with pytest.warns(MixseqWarning) as caught:
            rest = salvage_compressed(path)
        messages = [str(each.message) for each in caught]
        assert len(messages) == len(told), messages
        for message, expected in zip(messages, told, strict=True):
            assert re.search(rf"small\.(h5|glb): .*{expected}", message)
    assert rest is not None
    return rest


def test_of_whole_files_nothing_is_left_out(path: Path, coded: CompressedSequence) -> None:
    assert_same(salvaged(path), coded)


def test_damage_of_hdf5_alone_costs_nothing(h5: Path, coded: CompressedSequence) -> None:
    whole = h5.read_bytes()
    flip(h5, 30)
    assert_same(salvaged(h5), coded)
    h5.write_bytes(whole + b"more")
    assert_same(salvaged(h5), coded)


def test_damaged_tracks_cost_their_frames(path: Path, coded: CompressedSequence) -> None:
    damage(path, index_of(path).chunks[1].coefficients)
    rest = salvaged(path, "frames 4 to 7 are damaged and left out")
    assert rest.header.times.tolist() == np.delete(coded.header.times, range(4, 8)).tolist()
    first, _, third, fourth = coded.chunks
    assert rest.chunks == (first, replace(third, first=4), replace(fourth, first=8))
    assert (rest.parameters, rest.basis) == (coded.parameters, coded.basis)
    assert rest.between is None  # it was chosen for all frames


def test_frames_that_are_lost_are_named_together(path: Path) -> None:
    index = index_of(path)
    damage(path, index.chunks[0].coefficients, index.chunks[2].coefficients, index.chunks[3].coefficients)
    assert salvaged(path, "frames 0 to 3, 8 to 13 are damaged and left out").header.frame_count == 4


def test_damaged_residuals_cost_the_bound(path: Path, coded: CompressedSequence) -> None:
    damage(path, index_of(path).chunks[1].residuals)
    rest = salvaged(path, "residuals of frames 4 to 7 are damaged; the bound does not hold there")
    assert rest.chunks[1] == replace(coded.chunks[1], residuals=b"")
    assert rest.chunks[0] == coded.chunks[0]
    assert rest.parameters == replace(coded.parameters, promised=False)


def test_damaged_fields_cost_the_groups_from_there_on(path: Path, coded: CompressedSequence) -> None:
    damage(path, index_of(path).basis[1])
    rest = salvaged(path, "vectors of group 1 are damaged; decoded with 1 of 3 groups, frames are coarser")
    assert rest.basis == coded.basis[:1]
    assert [each.residuals for each in rest.chunks] == 4 * [b""]
    assert [each.coefficients for each in rest.chunks] == [each.coefficients for each in coded.chunks]
    assert not rest.parameters.promised
    assert rest.between == coded.between


def test_a_damaged_surface_costs_the_surface(tmp_path: Path, coded: CompressedSequence) -> None:
    path = tmp_path / "small.h5"
    surface = Surface(hard_edges=np.arange(len(coded.header.polygons.indices)))
    mixseq.save(path, replace(coded, header=replace(coded.header, surface=surface)))
    damage(path, index_of(path).ground["surface"])
    rest = salvaged(path, "surface is damaged and left out")
    assert rest.header.surface.hard_edges is None
    assert rest.chunks == coded.chunks


@pytest.mark.parametrize(
    ("streams", "message"),
    [
        (
            lambda index: [index.ground["connectivity"]],
            "connectivity are damaged, so nothing can be salvaged",
        ),
        (lambda index: [index.basis[0]], "vectors of group 0 are damaged, so nothing can be salvaged"),
        (
            lambda index: [each.coefficients for each in index.chunks],
            "coefficients of all frames are damaged",
        ),
    ],
)
def test_what_cannot_be_salvaged(
    path: Path, streams: Callable[[StreamIndex], list[Stream]], message: str
) -> None:
    damage(path, *streams(index_of(path)))
    with pytest.raises(FormatError, match=message):
        mixseq.load(path, salvage=True)


def frames_within(path: Path) -> NDArray[np.int64]:
    """How many bytes of the file the frames of every chunk need."""
    first = place_of(path)
    return np.array(
        [first + each.coefficients.start + each.coefficients.size for each in index_of(path).chunks]
    )


@pytest.mark.filterwarnings("ignore::mixseq.errors.MixseqWarning")
def test_truncated_files_have_the_frames_before_the_cut(path: Path, coded: CompressedSequence) -> None:
    whole, needed = path.read_bytes(), frames_within(path)
    ends = np.cumsum([each.count for each in coded.chunks])
    for size in range(0, len(whole), 101):
        path.write_bytes(whole[:size])
        complete = int((needed <= size).sum())
        try:
            rest = salvage_compressed(path)
        except FormatError as error:
            assert "damaged" in str(error)
            rest = None
        if complete:
            assert rest is not None
            assert rest.header.frame_count == ends[complete - 1]
            assert rest.basis == coded.basis
        else:
            assert rest is None


def test_salvage_does_not_matter_to_other_files(tmp_path: Path, bar_model: mixseq.Model) -> None:
    model = tmp_path / "model.h5"
    mixseq.save(model, bar_model)
    assert mixseq.load(model, salvage=True).header.frame_count == 4
    (tmp_path / "notes.h5").write_text("no mesh")
    for name, message in (("notes.h5", "is not a model"), ("none.h5", "does not exist")):
        with pytest.raises(FormatError, match=message):
            mixseq.load(tmp_path / name, salvage=True)
