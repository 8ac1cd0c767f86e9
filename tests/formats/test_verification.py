"""Whether `verify` tells a promise that is kept from one that is not."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mixseq
from mixseq.compression.bitstream.compressed_sequence import CompressedSequence
from mixseq.errors import FormatError, InvalidSequenceError, SettingsError
from mixseq.sequence.sequence import MeshSequence
from mixseq_io.model_files import compressed_sizes, read_compressed

pytestmark = pytest.mark.slow

BOUND = 1e-3


@pytest.fixture(scope="module")
def coded(bent_bar: MeshSequence) -> CompressedSequence:
    coded: CompressedSequence = mixseq.compress(bent_bar, max_error=BOUND)
    return coded


@pytest.fixture
def path(tmp_path: Path, coded: CompressedSequence) -> Path:
    file = tmp_path / "small.h5"
    mixseq.save(file, coded)
    return file


def test_without_an_original_all_frames_are_decoded(path: Path) -> None:
    told: list[int] = []
    found = mixseq.verify(path, progress=lambda done, total, what: told.append(done))
    assert (found.frames, found.vertices, found.bound, found.promised) == (4, 77, BOUND, True)
    assert (found.max_error, found.kg_percent, found.worst_frame, found.worst_vertex) == 4 * (None,)
    assert found.holds
    assert told[-1] == 4


def test_with_an_original_every_vertex_is_compared(path: Path, bent_bar: MeshSequence) -> None:
    found = mixseq.verify(path, bent_bar)
    expected = mixseq.compare(bent_bar, mixseq.load(path).sample())
    assert found.holds
    assert found.max_error == pytest.approx(expected.max_error)
    assert found.kg_percent == pytest.approx(expected.kg_percent)
    assert found.worst_frame == expected.worst_frame
    assert 0 < expected.max_error <= BOUND


def test_the_worst_vertex_is_found(path: Path, bent_bar: MeshSequence) -> None:
    points = np.array(bent_bar.points)
    points[2, 17] += [0, 0.3, 0.4]
    found = mixseq.verify(path, bent_bar.with_points(points))
    assert (found.worst_frame, found.worst_vertex, found.holds) == (2, 17, False)
    assert found.max_error == pytest.approx(0.5 / bent_bar.diagonal, abs=BOUND)
    assert found.as_dict()["holds"] is False


def test_a_bound_is_met_to_the_last_digit(path: Path, bent_bar: MeshSequence, coded: CompressedSequence) -> None:
    error = mixseq.verify(path, bent_bar).max_error
    assert error is not None
    for bound, promised, holds in (
        (error, True, True),
        (np.nextafter(error, 0), True, False),
        (np.nextafter(error, 0), False, True),  # measured when it was written, maybe in another order
        (error * (1 - 1e-6), False, False),
    ):
        parameters = replace(coded.parameters, max_error=float(bound), promised=promised)
        mixseq.save(path, replace(coded, parameters=parameters))
        assert mixseq.verify(path, bent_bar).holds is holds


def test_vertices_with_other_numbers_are_found(bent_bar: MeshSequence, tmp_path: Path) -> None:
    """The worst vertex has the number that it has in the original."""
    file = tmp_path / "free.h5"
    mixseq.save(file, mixseq.compress(bent_bar, max_error=BOUND, order="free"))
    found = mixseq.verify(file, bent_bar)
    assert found.holds
    assert found.max_error == pytest.approx(mixseq.compare(bent_bar, mixseq.load(file).sample()).max_error)
    points = np.array(bent_bar.points)
    points[2, 17] += [0, 0.3, 0.4]
    found = mixseq.verify(file, bent_bar.with_points(points))
    assert (found.worst_frame, found.worst_vertex, found.holds) == (2, 17, False)


@pytest.mark.parametrize("exponent", [-1030, -600, -100, 0, 100, 600, 1020])
def test_nothing_is_said_to_hold_that_does_not_at_any_scale(
    exponent: int, path: Path, bent_bar: MeshSequence, coded: CompressedSequence
) -> None:
    original = bent_bar.with_points(np.ldexp(bent_bar.points, exponent))
    lengths: dict[str, Any] = {
        name: float(np.ldexp(getattr(coded.parameters, name), exponent)) for name in ("step", "diagonal", "correction")
    }
    mixseq.save(path, replace(coded, parameters=replace(coded.parameters, **lengths)))
    try:
        found = mixseq.verify(path, original)
    except FormatError as error:  # beyond the range of numbers, or what decodes to infinite points
        assert abs(exponent) > 300
        assert "1e-100 to 1e+100 is expected" in str(error) or "finite" in str(error)
        return
    decoded = mixseq.load(path).sample().points.astype(np.longdouble)
    apart = np.ldexp(decoded - original.points, -exponent)
    largest = np.sqrt(np.square(apart).sum(axis=2)).max() / bent_bar.diagonal
    assert found.max_error == pytest.approx(float(largest), rel=1e-12)
    assert found.holds is bool(largest <= BOUND)
    assert found.holds is (abs(exponent) <= 100)


def test_originals_stream(path: Path, bent_bar: MeshSequence) -> None:
    file = path.with_name("bar.npz")
    mixseq.write(file, bent_bar)
    with mixseq.open_sequence(file) as reader:
        assert mixseq.verify(path, reader) == mixseq.verify(path, bent_bar)


def test_still_meshes_have_no_kg_error_to_speak_of(path: Path, bent_bar: MeshSequence) -> None:
    point = bent_bar.with_points(np.zeros_like(bent_bar.points))
    found = mixseq.verify(path, point)
    assert not found.holds
    assert found.as_dict()["kg_percent"] is None


def test_a_first_frame_that_is_one_point_has_the_diagonal_one(bent_bar: MeshSequence, tmp_path: Path) -> None:
    points = bent_bar.points.copy()
    points[0] = 1.0
    burst = MeshSequence.from_header(bent_bar.header, points)
    mixseq.save(tmp_path / "burst.h5", mixseq.compress(burst, max_error=1e-3))
    found = mixseq.verify(tmp_path / "burst.h5", burst)
    assert found.holds
    assert 0 < (found.max_error or 0) <= 1e-3


def test_what_is_no_original_is_refused(path: Path, bent_bar: MeshSequence) -> None:
    with pytest.raises(TypeError, match=r"verify: original is of type int; .*mixseq\.read reads one"):
        mixseq.verify(path, 3)  # type: ignore[arg-type]
    later = MeshSequence.from_header(bent_bar.header.with_times(bent_bar.times + 1), bent_bar.points)
    with pytest.raises(InvalidSequenceError, match=r"frame 10 \(index 0\) is at 1 s in the reference, at 0 s"):
        mixseq.verify(path, later)


def test_damage_is_refused(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[-len(read_compressed(path).chunks[-1].residuals) - 5] ^= 1
    path.write_bytes(data)
    with pytest.raises(
        FormatError, match=r"small\.h5: the (coefficients|residuals|in-betweens) of frames .* are damaged"
    ):
        mixseq.verify(path)


def test_truncated_files_are_refused(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-300])
    with pytest.raises(FormatError, match=r"small\.h5 cannot be read as HDF5"):
        mixseq.verify(path)


@pytest.mark.realdata
def test_the_bound_of_a_real_animation_holds(data: Path, tmp_path: Path) -> None:
    original = mixseq.read(data / "npz" / "fox_run.npz")
    file = tmp_path / "small.h5"
    mixseq.save(file, mixseq.compress(original, max_error=BOUND))
    assert mixseq.verify(file, original).holds
    assert compressed_sizes(file)["container"] < 1400


# Models of models ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def chain(bent_bar: MeshSequence, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files of a sequence, of its model with one mode, of that compressed twice, and of an edit."""
    folder = tmp_path_factory.mktemp("chain")
    mixseq.write(folder / "bar.npz", bent_bar)
    with mixseq.open_sequence(folder / "bar.npz") as reader:
        mixseq.save(folder / "rank.h5", mixseq.fit(reader, space="vertex", rank=1))
    for source, target in (("rank.h5", "small.h5"), ("small.h5", "twice.glb")):
        with mixseq.open_sequence(folder / source) as reader:
            mixseq.save(folder / target, mixseq.compress(reader, max_error=BOUND, order="free"), still="plain")
    mixseq.save(folder / "edit.h5", mixseq.operations.cut(mixseq.load(folder / "small.h5"), 0.1, 0.3))
    (folder / "cut.toml").write_text('[[edit]]\noperation = "cut"\nstart = 0.1\nend = 0.3\n')
    return folder


def test_bounds_are_of_the_file_that_is_given(chain: Path) -> None:
    """Also if it has another name."""
    shutil.copy(chain / "rank.h5", chain / "other.h5")
    names = {"small.h5": ("small.h5", BOUND), "other.h5": ("rank.h5", 2 * BOUND)}
    for file, (name, bound) in names.items():
        with mixseq.open_sequence(chain / file) as reader:
            found = mixseq.verify(chain / "twice.glb", reader)
        assert (found.source, found.holds) == (name, True)
        assert found.bound == pytest.approx(bound, rel=0.01)
    original = mixseq.read(chain / "bar.npz")
    rank, found = mixseq.verify(chain / "other.h5", original), mixseq.verify(chain / "twice.glb", original)
    assert rank.bound == rank.max_error
    assert rank.bound is not None
    assert rank.bound > 3 * BOUND  # else there were nothing to add up
    assert found.bound == pytest.approx(rank.bound + 2 * BOUND, rel=0.01)
    assert (found.source, found.holds) == ("bar.npz", True)
    assert found.max_error is not None
    assert found.max_error > 2 * BOUND
    text = r"1e-3 from small\.h5, which is 1e-3 from rank\.h5, which is \S+ from bar\.npz"
    assert re.fullmatch(text, found.provenance)


def test_what_is_made_of_a_sample_in_memory_says_so(chain: Path) -> None:
    sample = mixseq.load(chain / "rank.h5").sample()
    provenance = mixseq.compress(sample, max_error=BOUND).header.provenance
    assert provenance is not None
    assert re.fullmatch(r"1e-3 from rank\.h5, which is \S+ from bar\.npz", str(provenance))
    doubled = mixseq.compress(sample.with_points(2 * sample.points), max_error=BOUND).header.provenance
    assert doubled is not None
    assert [bound for _, bound in doubled.bounds] == [pytest.approx(BOUND), None]


def test_edits_are_compared_with_the_same_edit(chain: Path) -> None:
    original = mixseq.read(chain / "bar.npz")
    alone = mixseq.verify(chain / "edit.h5")
    assert (alone.bound, alone.holds) == (None, True)
    assert alone.provenance.startswith("an edit of what is 1e-3 from rank.h5, which is ")
    with pytest.raises(SettingsError, match=r"edit\.h5 is an edit of what is .*; give the edit script"):
        mixseq.verify(chain / "edit.h5", original)
    small = mixseq.verify(chain / "small.h5", original)
    found = mixseq.verify(chain / "edit.h5", original, script=chain / "cut.toml")
    assert found.bound is None
    assert found.max_error is not None
    assert small.max_error is not None
    assert 0 < found.max_error < 2 * small.max_error
