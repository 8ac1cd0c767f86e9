"""The container of compressed models: what goes in comes out, damage is found, and what is whole comes out anyway.

The streams are any bytes here: the container does not look into them.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from zlib import crc32

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

import mixseq
from mixseq.coding.bitstream.compressed_sequence import Chunk, CodingParameters, CompressedSequence
from mixseq.coding.bitstream.entropy import pack_leb128, unpack_leb128
from mixseq.errors import FormatError, MixseqWarning, OutputError
from mixseq.polygons import Polygons
from mixseq.sequence import MeshSequence, SequenceHeader
from mixseq.spaces.basis import BasisSpace
from mixseq.surface import CornerValues, FaceSet, MeshObject, Origin, Surface
from mixseq_io.hdf5.compressed_reader import (
    COMPRESSED_VERSION,
    Stream,
    StreamIndex,
    is_compressed,
    read_compressed,
    read_container,
    read_index,
)
from mixseq_io.hdf5.compressed_writer import compressed_sizes
from mixseq_io.hdf5.lossless import pack_surface, pack_times, unpack_surface, unpack_times
from mixseq_io.hdf5.salvage import salvage_compressed
from tests.meshes import bar

GOLDEN = Path(__file__).parent / "golden"

PARAMETERS = CodingParameters(
    factors="trajectories",
    rank=3,
    frame_count=14,
    step=0.1 + 0.2,
    diagonal=4.1234567890123456,
    max_error=1e-3,
    kg_percent=1 / 3,
    promised=True,
)


def any_bytes(size: int) -> bytes:
    return np.random.default_rng(size).integers(0, 256, size, dtype=np.uint8).tobytes()


@pytest.fixture
def coded() -> CompressedSequence:
    """Three groups of basis vectors; chunks of 4, 4, 4 and 2 frames, the third of which has no residuals."""
    header = replace(bar(5, 15, 14).header, name="Füchsin", up_axis="Z", metres_per_unit=0.01)
    sizes = [(4, 301, 50), (4, 302, 60), (4, 303, 0), (2, 304, 40)]
    chunks = tuple(
        Chunk(4 * number, count, any_bytes(coefficients), any_bytes(residuals))
        for number, (count, coefficients, residuals) in enumerate(sizes)
    )
    return CompressedSequence(header, PARAMETERS, tuple(any_bytes(size) for size in (500, 600, 700)), chunks)


@pytest.fixture
def path(tmp_path: Path, coded: CompressedSequence) -> Path:
    file = tmp_path / "small.h5"
    mixseq.save(file, coded)
    return file


def assert_same(got: CompressedSequence, expected: CompressedSequence) -> None:
    assert (got.parameters, got.basis, got.chunks) == (expected.parameters, expected.basis, expected.chunks)
    a, b = got.header, expected.header
    assert a.polygons.same_as(b.polygons)
    assert a.times.tolist() == b.times.tolist()
    for name in ("vertex_count", "fps", "up_axis", "metres_per_unit", "name"):
        assert getattr(a, name) == getattr(b, name)


def index_of(path: Path) -> StreamIndex:
    return read_index(path, read_container(path))


def place_of(path: Path) -> int:
    """Where the dataset begins in the file."""
    with h5py.File(path) as file:
        return int(file["streams"].id.get_offset())


def flip(path: Path, at: int) -> None:
    data = bytearray(path.read_bytes())
    data[at] ^= 0x10
    path.write_bytes(data)


def damage(path: Path, *streams: Stream) -> None:
    """Flip a bit in the middle of every stream."""
    first = place_of(path)
    for stream in streams:
        assert stream.size
        flip(path, first + stream.start + stream.size // 2)


# There and back -------------------------------------------------------------------------------------------


def test_everything_comes_back(path: Path, coded: CompressedSequence) -> None:
    assert is_compressed(path)
    got = read_compressed(path)
    assert_same(got, coded)
    assert got.header.surface.origin is None


def test_saving_twice_makes_the_same_file(path: Path, coded: CompressedSequence, tmp_path: Path) -> None:
    mixseq.save(tmp_path / "again.hdf5", coded)
    assert (tmp_path / "again.hdf5").read_bytes() == path.read_bytes()


def test_the_file_says_what_it_is(path: Path) -> None:
    with h5py.File(path) as file:
        assert file.attrs["format"] == b"mixseq-model"
        assert file.attrs["version"] == COMPRESSED_VERSION
        assert list(file) == ["streams"]
        facts = json.loads(file.attrs["coding"])
    assert facts["coding"] == {name: value for name, value in asdict(PARAMETERS).items() if name != "ranks"}
    assert (facts["name"], facts["frame_count"], facts["polygon_count"]) == ("Füchsin", 14, 150)


def test_sizes_add_up_and_hdf5_takes_few_bytes(path: Path, coded: CompressedSequence) -> None:
    sizes = compressed_sizes(path)
    assert sizes["total"] == path.stat().st_size
    assert sizes["total"] == sizes["connectivity"] + sizes["container"] + sizes["signals"]
    streams = sum(map(len, coded.basis)) + sum(
        len(each.coefficients + each.residuals) for each in coded.chunks
    )
    assert sizes["signals"] == streams + sizes["index"]
    assert sizes["surface"] == 0
    assert 0 < sizes["connectivity"] < 600
    assert sizes["index"] < 150
    assert sizes["container"] < 1100


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


def test_only_h5(tmp_path: Path, coded: CompressedSequence) -> None:
    with pytest.raises(OutputError, match=r"end the name in \.h5"):
        mixseq.save(tmp_path / "small.usdc", coded)


def test_models_in_the_basis_space_are_kept(tmp_path: Path) -> None:
    sequence = bar(5, 9, 4)
    fields = np.concatenate([np.ones((1, 47)), sequence.points[0].T, sequence.points[3].T[:2]])
    space = BasisSpace(fields, sequence.diagonal)
    vectors = space.encode(sequence.points)
    flat = mixseq.fit(sequence, space="vertex", exact=True)
    model = replace(flat, space=space, shapes=vectors[: len(flat.shapes)])
    mixseq.save(tmp_path / "basis.h5", model)
    got = mixseq.load(tmp_path / "basis.h5")
    assert isinstance(got.space, BasisSpace)
    np.testing.assert_array_equal(got.space.basis, space.basis)
    np.testing.assert_array_equal(got.shapes, model.shapes)
    np.testing.assert_array_equal(got.sample().points, model.sample().points)
    with h5py.File(tmp_path / "basis.h5", "r+") as file:
        assert file.attrs["version"] == 4
        file["space/fields"][1] = 0.0
    with pytest.raises(FormatError, match=r"basis\.h5: space/fields is zero everywhere in row 1"):
        mixseq.load(tmp_path / "basis.h5")


def test_residual_layers_that_are_not_stored_are_told(tmp_path: Path, bent_bar: MeshSequence) -> None:
    model = mixseq.fit(bent_bar, space="vertex", exact=True)

    class Lift:
        def at(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.ones((len(times), bent_bar.vertex_count, 3))

        rates = at

    lifted = replace(model, residual_layer=Lift())
    with pytest.warns(MixseqWarning, match=r"lifted\.h5: the residual layer .* is not stored with signals"):
        mixseq.save(tmp_path / "lifted.h5", lifted)
    got = mixseq.load(tmp_path / "lifted.h5").sample().points
    np.testing.assert_allclose(got, bent_bar.points, atol=1e-12)


# Times ----------------------------------------------------------------------------------------------------


def test_regular_times_take_nothing() -> None:
    assert pack_times(2.5 + np.arange(1000) / 23.976, 23.976) == b""


def test_nearly_regular_times_take_little() -> None:
    times = np.arange(1000, dtype=np.float64) * (1 / 24)  # not the same bits as n / 24
    assert 0 < len(pack_times(times, 24)) < 600


@given(st.lists(st.floats(-1e9, 1e9), min_size=1, max_size=20, unique=True), st.floats(1e-3, 1e5))
def test_times_keep_every_bit(values: list[float], fps: float) -> None:
    times = np.sort(np.array(values))
    packed = pack_times(times, fps)
    got = unpack_times(packed, float(times[0]), len(times), fps)
    assert got.tobytes() == times.tobytes()


@pytest.mark.parametrize("count", [3, 5])
def test_another_number_of_times_is_refused(count: int) -> None:
    packed = pack_times(np.array([0.0, 0.3, 0.31, 0.5]), 24)
    with pytest.raises(FormatError, match=f"{8 * count} are expected"):
        unpack_times(packed, 0.0, count, 24)
    with pytest.raises(FormatError):
        unpack_times(packed[:-9] + b"123456789", 0.0, 4, 24)


@given(st.lists(st.integers(0, 2**70)))
def test_whole_numbers(numbers: list[int]) -> None:
    assert list(unpack_leb128(pack_leb128(numbers))) == numbers


# Surface --------------------------------------------------------------------------------------------------


def full() -> Surface:
    return Surface(
        uvs=CornerValues(np.random.default_rng(1).random((5, 2)), np.arange(7) % 5),
        hard_edges=np.arange(7)[::-1],
        face_sets=(FaceSet("Hände", np.array([0, 1]), "/Looks/Haut 皮"), FaceSet("empty", np.zeros(0, int))),
        objects=(MeshObject("a", "/w/a", 4, 1), MeshObject("ä", "/w/ä", 3, 1)),
        subdivision="loop",
        origin=Origin("glTF", "/tmp/走る.glb"),
    )


def test_surfaces_come_back(tmp_path: Path, coded: CompressedSequence) -> None:
    polygons = Polygons(np.array([4, 3]), np.array([0, 1, 2, 3, 4, 5, 6]))
    header = SequenceHeader(polygons=polygons, vertex_count=7, times=coded.header.times, surface=full())
    file = tmp_path / "surface.h5"
    mixseq.save(file, replace(coded, header=header))
    got, expected = read_compressed(file).header.surface, full()
    assert got.uvs is not None and expected.uvs is not None
    np.testing.assert_array_equal(got.uvs.values, expected.uvs.values)
    np.testing.assert_array_equal(got.uvs.indices, expected.uvs.indices)
    assert got.hard_edges is not None
    assert got.hard_edges.tolist() == [6, 5, 4, 3, 2, 1, 0]
    assert [(each.name, each.polygons.tolist(), each.material) for each in got.face_sets] == [
        ("Hände", [0, 1], "/Looks/Haut 皮"),
        ("empty", [], ""),
    ]
    assert (got.objects, got.subdivision, got.origin) == (expected.objects, "loop", expected.origin)
    assert 0 < compressed_sizes(file)["surface"] < 600
    assert read_compressed(file).header.polygons.same_as(polygons)


def test_no_surface_takes_nothing(tmp_path: Path) -> None:
    assert pack_surface(Surface()) == b""
    bare = unpack_surface(b"", tmp_path)
    assert (bare.uvs, bare.hard_edges, bare.face_sets, bare.objects) == (None, None, (), ())


def test_texture_coordinates_of_a_grid_take_little(tmp_path: Path) -> None:
    count = 2500
    u, v = np.meshgrid(np.linspace(0, 1, 50), np.linspace(0, 1, 50))
    uvs = CornerValues(np.stack([u.reshape(-1), v.reshape(-1)], axis=1), np.arange(count))
    packed = pack_surface(Surface(uvs=uvs))
    assert len(packed) < 3 * count
    got = unpack_surface(packed, tmp_path).uvs
    assert got is not None
    np.testing.assert_array_equal(got.at_corners, uvs.at_corners)


@pytest.mark.parametrize("size", [1, 20, 100])
def test_damaged_surfaces_are_refused(size: int, tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="the surface is damaged"):
        unpack_surface(pack_surface(full())[:size], tmp_path)
    with pytest.raises(FormatError, match="the surface is damaged"):
        unpack_surface(any_bytes(size), tmp_path)


# Damage ---------------------------------------------------------------------------------------------------

STREAMS: list[tuple[Callable[[StreamIndex], Stream], str]] = [
    (lambda index: index.ground["connectivity"], "the connectivity's bytes are damaged"),
    (lambda index: index.basis[0], "the basis vectors of group 0 are damaged"),
    (lambda index: index.basis[2], "the basis vectors of group 2 are damaged"),
    (lambda index: index.chunks[0].coefficients, "the coefficients of frames 0 to 3 are damaged"),
    (lambda index: index.chunks[3].coefficients, "the coefficients of frames 12 to 13 are damaged"),
    (lambda index: index.chunks[1].residuals, "the residuals of frames 4 to 7 are damaged"),
]


@pytest.mark.parametrize(("stream", "message"), STREAMS, ids=[message for _, message in STREAMS])
def test_damage_is_named(path: Path, stream: Callable[[StreamIndex], Stream], message: str) -> None:
    damage(path, stream(index_of(path)))
    with pytest.raises(FormatError, match=rf"small\.h5: {message}; restore the file, or read the rest"):
        mixseq.load(path)


def test_damaged_times_are_named(tmp_path: Path, coded: CompressedSequence) -> None:
    file = tmp_path / "times.h5"
    mixseq.save(file, replace(coded, header=coded.header.with_times(np.arange(14) ** 2)))
    damage(file, index_of(file).ground["times"])
    with pytest.raises(FormatError, match=r"times\.h5: the times are damaged"):
        mixseq.load(file)
    with pytest.raises(FormatError, match="nothing can be salvaged"):
        mixseq.load(file, salvage=True)


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


def test_truncated_files_say_what_is_missing(path: Path) -> None:
    whole, first, index = path.read_bytes(), place_of(path), index_of(path)
    path.write_bytes(whole[: first + index.chunks[2].coefficients.start + 5])
    with pytest.raises(
        FormatError, match=r"small\.h5: the coefficients of frames 8 to 11 are damaged; restore"
    ):
        mixseq.load(path)
    path.write_bytes(whole[:100])
    with pytest.raises(FormatError, match=r"small\.h5 cannot be read as HDF5; it is damaged, truncated"):
        mixseq.load(path)


def test_damage_of_hdf5_alone_is_told(path: Path) -> None:
    flip(path, 30)  # in the superblock
    with pytest.raises(FormatError, match="HDF5's own structure is damaged, but no signal is"):
        mixseq.load(path)


def test_a_damaged_index_is_the_end(path: Path) -> None:
    flip(path, place_of(path) + 20)
    for salvage in (False, True):
        with pytest.raises(FormatError, match="its index is damaged, so nothing can be read"):
            mixseq.load(path, salvage=salvage)


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
        (lambda facts: facts["coding"].update(magic=1), "does not know the parameter 'magic'; upgrade it"),
        (lambda facts: facts["coding"].pop("step"), "parameters are missing .*step"),
        (lambda facts: facts.pop("coding"), "no parameters"),
        (lambda facts: facts["coding"].update(factors="x"), "factors is 'x'; trajectories or shapes"),
        (lambda facts: facts["coding"].update(rank=0), "rank is 0; a whole number above zero"),
        (lambda facts: facts["coding"].update(rank=2.5), "rank is 2.5; a whole number above zero"),
        (lambda facts: facts["coding"].update(step=0), "step is 0; a positive number"),
        (lambda facts: facts["coding"].update(diagonal="long"), "diagonal is 'long'; a positive number"),
        (lambda facts: facts["coding"].update(correction=float("nan")), "correction is nan; a non-negative"),
        (lambda facts: facts["coding"].update(promised=1), "promised is 1; true or false"),
        (lambda facts: facts["coding"].update(frame_count=15), "numbers of frames contradict each other"),
        (lambda facts: facts.update(vertex_count=1 << 31), "a mesh cannot have .* 2147483648 vertices"),
        (lambda facts: facts.update(corner_count=float("inf")), "infinity.*; it is damaged"),
        (lambda facts: facts.pop("fps"), "fps.*; it is damaged"),
        (lambda facts: facts.update(fps=0.0), "not finite; it is damaged"),
        (lambda facts: facts.update(fps=-1), "times must increase; it is damaged"),
        (lambda facts: facts.update(frame_count=99), "chunks do not add up to 99 frames; it is damaged"),
        (lambda facts: facts.update(vertex_count="many"), "many.*; it is damaged"),
        (lambda facts: facts.update(up_axis="W"), "up axis is 'W'.*; it is damaged"),
    ],
)
def test_contradictions_are_refused(
    path: Path, change: Callable[[dict[str, object]], object], message: str
) -> None:
    changed(path, change)
    with pytest.raises(FormatError, match=rf"small\.h5: .*{message}"):
        read_compressed(path)


def test_newer_versions_are_refused(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        file.attrs["version"] = COMPRESSED_VERSION + 1
    for salvage in (False, True):
        with pytest.raises(FormatError, match=r"has version 5, this mixseq reads up to 4.*upgrade with pip"):
            mixseq.load(path, salvage=salvage)


def test_other_files_are_no_compressed_models(tmp_path: Path, bar_model: mixseq.Model) -> None:
    model = tmp_path / "model.h5"
    mixseq.save(model, bar_model)
    assert not is_compressed(model)
    for ask in (read_compressed, compressed_sizes, mixseq.verify):
        with pytest.raises(
            FormatError, match=r"model\.h5 is no compressed model; make one with mixseq encode"
        ):
            ask(model)
    with pytest.raises(FormatError, match=r"none\.h5 does not exist"):
        read_compressed(tmp_path / "none.h5")


# Salvage --------------------------------------------------------------------------------------------------


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
            assert re.search(rf"small\.h5: .*{expected}", message)
    assert rest is not None
    return rest


def test_of_whole_files_nothing_is_left_out(path: Path, coded: CompressedSequence) -> None:
    assert_same(salvaged(path), coded)


def test_damage_of_hdf5_alone_costs_nothing(path: Path, coded: CompressedSequence) -> None:
    whole = path.read_bytes()
    flip(path, 30)
    assert_same(salvaged(path), coded)
    path.write_bytes(whole + b"more")
    assert_same(salvaged(path), coded)


def test_damaged_tracks_cost_their_frames(path: Path, coded: CompressedSequence) -> None:
    damage(path, index_of(path).chunks[1].coefficients)
    rest = salvaged(path, "frames 4 to 7 are damaged and left out")
    assert rest.header.times.tolist() == np.delete(coded.header.times, range(4, 8)).tolist()
    first, _, third, fourth = coded.chunks
    assert rest.chunks == (first, replace(third, first=4), replace(fourth, first=8))
    assert (rest.parameters, rest.basis) == (coded.parameters, coded.basis)


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


# Golden file ----------------------------------------------------------------------------------------------


def golden_sequence() -> MeshSequence:
    """What the golden file is made of: 200 frames of a bar, of which every vertex trembles a little by itself."""
    walk = bar(5, 7, 200)
    tremble = np.sin(np.outer(np.arange(200), 1 + np.arange(3 * 37)) ** 1.1).reshape(200, 37, 3)
    times = walk.times + 0.01 * np.sin(np.arange(200))
    surface = Surface(
        hard_edges=np.arange(len(walk.polygons.indices)), face_sets=(FaceSet("end", np.arange(5)),)
    )
    header = replace(walk.header, times=times, surface=surface, name="golden")
    return MeshSequence.from_header(header, walk.points + 0.01 * tremble)


def test_the_golden_file_still_decodes_to_the_same_points() -> None:
    path = GOLDEN / "model-v4-coded.h5"
    with np.load(path.with_suffix(".npz")) as expected:
        points, times = expected["points"], expected["times"]
        between, between_times = expected["between"], expected["between_times"]
    model = mixseq.load(path)
    np.testing.assert_array_equal(model.times, times)
    np.testing.assert_allclose(model.sample().points, points, atol=1e-9)
    # Tracks were splines through the frames, and are predicted by the operator that predicts frames best now. Vertices
    # tremble by 0.01 from frame to frame, which nobody can predict.
    np.testing.assert_allclose(model.sample(between_times).points, between, atol=0.02)
    coded = read_compressed(path)
    assert len(coded.basis) > 1
    assert len(coded.chunks) > 1
    assert any(chunk.residuals for chunk in coded.chunks)
    assert coded.header.polygons.same_as(golden_sequence().polygons)
    assert coded.header.surface.face_sets[0].name == "end"
    assert coded.header.surface.hard_edges is not None
    assert mixseq.verify(path, golden_sequence()).holds
