"""What every format owes: the same sequence back, whole or in blocks, and honest errors."""

from __future__ import annotations

import errno
import os
import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.errors import FormatError, InvalidSequenceError, OutputError, SettingsError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import MeshObject, Surface
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import FloatArray
from mixseq_io import open_sequence, read, write, write_blocks
from tests.formats.conftest import CASES, TARGETS, lossy
from tests.formats.kept import assert_close, assert_kept

pytestmark = pytest.mark.slow

Store = Callable[[Any, MeshSequence], Path]
Files = Callable[[], dict[str, bytes]]


MAIN_TARGETS = list({target.format.name: target for target in reversed(TARGETS)}.values())
"""One target of each format; the others contain the same in text, in a package, in clips, or compressed."""

VARIANT_CASES = ("dressed", "float64", "hundred frames", "unicode name")


@pytest.mark.parametrize(
    ("target", "case"),
    [(each, case) for each in TARGETS for case in (CASES if each in MAIN_TARGETS else VARIANT_CASES)],
    ids=lambda each: each if isinstance(each, str) else each.file_name + "+".join(each.options),
)
def test_what_is_written_is_read(target: Any, case: str, store: Store) -> None:
    sequence = CASES[case]()
    assert_kept(target, sequence, read(store(target, sequence)))


def random_sequence(seed: int) -> MeshSequence:
    """Return a mesh of any polygons, float32 or float64, of any size and place, in any number of frames."""
    rng = np.random.default_rng(seed)
    vertices, frames = int(rng.integers(3, 20)), int(rng.integers(1, 9))
    counts = rng.integers(3, min(vertices, 6) + 1, int(rng.integers(1, 8)))
    corners = np.concatenate([rng.permutation(vertices)[:count] for count in counts])
    size = 10.0 ** rng.integers(-6, 7)
    place = size * 10.0 ** rng.integers(-3, 3) * rng.normal(size=3)  # not so far that vertices fall together
    points = (size * rng.normal(size=(frames, vertices, 3)) + place).astype(np.float32 if seed % 2 else np.float64)
    times = np.cumsum(rng.integers(1, 5, frames)) / 24
    return MeshSequence.from_arrays(points, Polygons(counts, corners), times=times)


@pytest.mark.parametrize("target", MAIN_TARGETS, ids=lambda target: target.file_name)
@settings(max_examples=6, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_random_meshes(target: Any, seed: int) -> None:
    sequence = random_sequence(seed)
    with tempfile.TemporaryDirectory() as folder:
        with lossy():
            write(Path(folder, target.file_name), sequence, **target.options)
        assert_kept(target, sequence, read(Path(folder, target.file_name)))


def test_read_only_files_in_read_only_folders(target: Any, plain: MeshSequence, store: Store, tmp_path: Path) -> None:
    path = store(target, plain)
    everything = [tmp_path, *tmp_path.rglob("*")]
    for each in everything:
        each.chmod(0o555 if each.is_dir() else 0o444)
    try:
        assert_kept(target, plain, read(path))
    finally:
        for each in everything:
            each.chmod(0o755)


def test_objects_that_stand_still_stay(target: Any, store: Store) -> None:
    """What is written with all its frames is read with all its objects, though one of them does not move."""
    dressed = CASES["dressed"]()
    points = dressed.points.copy()
    points[:, 8:] = points[0, 8:]
    assert_kept(target, dressed.with_points(points), read(store(target, dressed.with_points(points))))


@pytest.mark.parametrize("seed", range(2))
def test_objects_of_any_tree_keep_their_order(target: Any, store: Store, seed: int) -> None:
    """Squares anywhere in a random tree of groups, in the order of the tree or any other, are read in their order."""
    rng = np.random.default_rng(seed)
    groups = ["/root"]
    for number in range(6):
        groups.append(f"{groups[rng.integers(len(groups))]}/group{number}")
    parents = [groups[each] for each in rng.integers(len(groups), size=9)]
    objects = [MeshObject(f"mesh{k}", f"{parent}/mesh{k}", 4, 1) for k, parent in enumerate(parents)]
    if seed % 2:  # as readers give them
        objects.sort(key=lambda each: each.path.split("/"))
    points = rng.permuted(np.tile(np.arange(108.0), (2, 1)), axis=1).reshape(2, 36, 3)
    header = MeshSequence.from_arrays(points, Polygons(np.full(9, 4), np.arange(36))).header
    header = replace(header, surface=Surface(objects=tuple(objects)), name="root")
    written = MeshSequence.from_header(header, points.astype(np.float32))
    got = read(store(target, written))
    np.testing.assert_array_equal(got.points, written.points)
    if target.format.capabilities.objects is True:
        assert [each.name for each in got.objects] == [each.name for each in written.objects]


LOSSES = {
    "uvs": "texture",
    "colours": "colours",
    "hard_edges": "hard edges",
    "face_sets": "face set",
    "objects": "object",
    "units": " up",
    "velocities": "velocit",
}


def test_what_a_format_cannot_hold_is_told(target: Any, tmp_path: Path) -> None:
    dressed = CASES["dressed"]()
    everything = replace(dressed, up_axis="Z", metres_per_unit=0.01, velocities=dressed.points)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        write(tmp_path / target.file_name, everything, **target.options)
    told = [str(warning.message) for warning in caught]
    for what, word in LOSSES.items():
        assert any(word in each for each in told) == (getattr(target.format.capabilities, what) is not True), what


def test_blocks_give_the_whole(target: Any, store: Store, tmp_path: Path) -> None:
    whole = MeshSequence.from_arrays(
        np.arange(7 * 4 * 3, dtype=np.float32).reshape(7, 4, 3) % 11, [[0, 1, 2], [0, 2, 3]]
    )
    path = store(target, whole)
    with open_sequence(path) as reader:
        for size in (1, 3, 7, 100):
            blocks = list(reader.blocks(size))
            assert max(map(len, blocks)) <= size
            np.testing.assert_array_equal(np.concatenate(blocks), whole.points)
        first, second = reader.blocks(2), reader.blocks(3)  # two at once do not disturb each other
        next(first), next(second)
        np.testing.assert_array_equal(next(first), whole.points[2:4])
        np.testing.assert_array_equal(next(second), whole.points[3:6])


def test_writing_in_blocks_gives_the_same_file(target: Any, plain: MeshSequence, store: Store, files: Files) -> None:
    path = store(target, plain)
    whole = read(path)
    write_blocks(path, plain.header, iter([plain.points[:1], plain.points[1:4], plain.points[4:]]), **target.options)
    assert_kept(target, whole, read(path))


def test_unicode_file_names(target: Any, plain: MeshSequence, tmp_path: Path) -> None:
    path = tmp_path / "Läufe 走る [1]" / target.file_name.replace("walk", "größer 走")
    path.parent.mkdir()
    write(path, plain, **target.options)
    assert_kept(target, plain, read(path))


def test_a_sequence_can_be_written_onto_the_file_it_streams_from(
    target: Any, plain: MeshSequence, store: Store
) -> None:
    path = store(target, plain)
    with open_sequence(path) as reader:
        write_blocks(path, reader.header, (2 * block for block in reader.blocks(1)), **target.options)
    assert_close(target, read(path).points, 2 * plain.points)


def test_a_replaced_file_is_read_anew_while_the_old_one_is_open(target: Any, plain: MeshSequence, store: Store) -> None:
    path = store(target, plain)
    with open_sequence(path):
        store(target, plain.with_points(plain.points + 1))
        assert_close(target, read(path).points, plain.points + 1)


class Interruption:
    """Blocks that stop in the middle."""

    def __init__(self, sequence: MeshSequence, error: BaseException) -> None:
        self.sequence, self.error = sequence, error

    def __iter__(self) -> Iterator[FloatArray]:
        yield self.sequence.points[:2]
        raise self.error


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (KeyboardInterrupt(), KeyboardInterrupt),
        (ValueError("from the caller"), ValueError),
        (OSError(errno.ENOSPC, "No space left on device"), OutputError),
    ],
    ids=["interrupt", "error", "disk full"],
)
def test_after_an_interruption_nothing_has_changed(
    target: Any, plain: MeshSequence, store: Store, files: Files, error: BaseException, expected: type[BaseException]
) -> None:
    path = store(target, plain)
    before = files()
    with pytest.raises(expected):
        write_blocks(path, plain.header, Interruption(plain, error), **target.options)
    assert files() == before


@pytest.mark.parametrize(("step", "code"), [("fsync", errno.ENOSPC), ("replace", errno.EIO)])
def test_a_refusal_of_the_disk_at_the_end_is_explained(
    target: Any, plain: MeshSequence, store: Store, files: Files, monkeypatch: pytest.MonkeyPatch, step: str, code: int
) -> None:
    path = store(target, plain)
    before = files()

    def refuse(*arguments: object) -> None:
        raise OSError(code, os.strerror(code))

    if step == "fsync":
        monkeypatch.setattr(os, "fsync", refuse)
    else:
        monkeypatch.setattr(Path, "replace", refuse)
    with pytest.raises(OutputError, match=f"(?s){path.name.split('.')[0]}.*{os.strerror(code)}; "):
        write(path, plain, **target.options)
    monkeypatch.undo()
    assert files() == before


def test_missing_folder(target: Any, plain: MeshSequence, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"nowhere.* does not exist; make it first"):
        write(tmp_path / "nowhere" / target.file_name, plain, **target.options)


def test_a_folder_in_the_way(target: Any, plain: MeshSequence, tmp_path: Path, files: Files) -> None:
    (tmp_path / target.file_name).mkdir()
    with pytest.raises(OutputError, match="is a folder"):
        write(tmp_path / target.file_name, plain, **target.options)
    assert files() == {}


BLOCKS: dict[str, tuple[Callable[..., Any], str]] = {
    "too few": (lambda points: [points[:3]], "3 frames of points for 5 times"),
    "nan": (lambda points: [points[:2], np.where(points[2:] > 0, np.nan, points[2:])], "frame 2: vertex"),
    "too many": (lambda points: [points, points], "more frames of points than 5 times"),
    "none": (lambda points: [], "no points for the header's 5 times"),
    "vertices": (lambda points: [points[:, :-1]], "frame 0 has 7 vertices, the mesh has 8"),
    "dtype": (lambda points: [points[:2], points[2:].astype(np.float64)], "frame 2: points turn from float32"),
}
"""Blocks that do not fit; one function checks them for all formats, which clean up on their own."""


@pytest.mark.parametrize(
    ("target", "what"),
    [*((target, what) for target in TARGETS for what in ("too few", "nan")), *((TARGETS[4], w) for w in BLOCKS)],
    ids=lambda each: each if isinstance(each, str) else each.file_name,
)
def test_blocks_that_do_not_fit_the_header(
    target: Any, plain: MeshSequence, tmp_path: Path, files: Files, what: str
) -> None:
    change, message = BLOCKS[what]
    with pytest.raises(InvalidSequenceError, match=message):
        write_blocks(tmp_path / target.file_name, plain.header, change(plain.points), **target.options)
    assert files() == {}


def test_truncated_files(
    target: Any, plain: MeshSequence, store: Store, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = store(target, plain)
    file = path
    if target.format.numbered:
        file = sorted(file for file in tmp_path.rglob("*") if file.is_file())[2]
    content = file.read_bytes()
    last = len(content.rstrip()) - 1
    ends = {0, 1, 4, 16, 100, last, *range(200, last, len(content) // 12)}
    for end in sorted(ends):
        file.write_bytes(content[:end])
        if target.file_name == "walk.usdz" and end > content.index(b"PK\x01\x02"):
            continue  # only the directory of the package is cut, which USD does not need
        with pytest.raises(FormatError, match="walk"):
            read(path)
    assert capfd.readouterr() == ("", "")


def test_flipped_bits_give_an_error_or_a_sound_sequence(
    target: Any, plain: MeshSequence, store: Store, tmp_path: Path
) -> None:
    path = store(target, plain)
    file = sorted(tmp_path.rglob("*.*"))[0] if target.format.numbered else path
    content = file.read_bytes()
    rng = np.random.default_rng(7)
    checksummed = target.file_name.endswith((".npz", ".h5", ".hdf5"))
    places = rng.integers(0, len(content), 24)
    for place in places:
        damaged = bytearray(content)
        damaged[place] ^= 1 << int(rng.integers(8))
        file.write_bytes(damaged)
        try:
            with lossy():
                got = read(path)
        except (FormatError, InvalidSequenceError):
            continue
        if checksummed:
            np.testing.assert_array_equal(got.points, plain.points)
            assert got.polygons.same_as(plain.polygons)


@pytest.mark.parametrize("extension", ["usd", "usda", "usdc", "usdz", "npz", "h5", "obj"])
def test_garbage(tmp_path: Path, extension: str, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / f"noise.{extension}"
    path.write_bytes(np.random.default_rng(0).bytes(3000))
    with pytest.raises(FormatError, match="noise"):
        read(path)
    assert capfd.readouterr() == ("", "")  # nothing of the libraries' own reports


@pytest.mark.parametrize("extension", ["usd", "usda", "usdc", "usdz", "npz", "h5", "obj"])
def test_empty_and_missing_files(tmp_path: Path, extension: str) -> None:
    with pytest.raises(FileNotFoundError, match="does not exist"):
        read(tmp_path / f"missing.{extension}")
    (tmp_path / f"empty.{extension}").touch()
    with pytest.raises(FormatError, match="empty"):
        read(tmp_path / f"empty.{extension}")


def test_unknown_options(target: Any, plain: MeshSequence, store: Store, tmp_path: Path) -> None:
    path = store(target, plain)
    with pytest.raises(SettingsError, match="has no option 'colour'; it is read with"):
        read(path, colour="red")
    with pytest.raises(SettingsError, match="has no option 'colour'; it is written with"):
        write(path, plain, colour="red")


def test_reader_misuse(target: Any, plain: MeshSequence, store: Store) -> None:
    with open_sequence(store(target, plain)) as reader:
        with pytest.raises(SettingsError, match="block size is 0"):
            reader.blocks(0)
        blocks = reader.blocks(1)
        next(blocks)
    with pytest.raises(FormatError, match="is closed"):
        next(blocks)
    with pytest.raises(FormatError, match="is closed"):
        next(reader.blocks())
