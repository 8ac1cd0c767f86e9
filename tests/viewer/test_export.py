"""What a page holds is what was given, within what it says, and nothing else is in it."""

from __future__ import annotations

import re
import tracemalloc
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from html import unescape
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from mixseq.compression.bitstream.compressed_sequence import decode
from mixseq.compression.compressed_model import CompressedModel
from mixseq.compression.encoder.compress import compress
from mixseq.compression.numbering import cheapest_numbering
from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.mesh.surface import CornerValues, Surface
from mixseq.pictures.charts import chart_data
from mixseq.pictures.colours import Colouring, SceneColours, available_colourings
from mixseq.pictures.scene import Scene, SceneItem, View, shared_limits, three_quarter_view, to_y_up
from mixseq.runtime import low_memory
from mixseq.runtime.parallel import Executor
from mixseq.sequence.sequence import FrameStore, MeshSequence, bounding_diagonal
from mixseq.signals.model import Model
from mixseq.types import Float, FloatArray
from mixseq.viewer.export import ExportSettings, export_page
from mixseq.viewer.export_data import PAGE_ENCODING, PageItem, deflate_rows, encode_text, measure_extent, page_items
from tests.meshes import SEQUENCES, bar
from tests.viewer.pages import Opened, bytes_of, rows_of

pytestmark = pytest.mark.slow


@dataclass(frozen=True, eq=False)
class Given(SceneItem):
    """A mesh with poses and times that a test gives.

    Attributes
    ----------
    given : callable
        Takes times, yields blocks of points.
    times : (n,) float
        Times of its own frames.
    """

    given: Callable[[Float], Iterable[FloatArray]]
    times: Float

    @property
    def elapsed(self) -> Float:
        return self.times

    def poses(self, elapsed: Float, workers: Executor | None = None) -> Iterator[FloatArray]:
        yield from self.given(elapsed)


def given_poses(item: PageItem, blocks: Iterable[FloatArray]) -> PageItem:
    """The same, with other poses."""
    mesh = item.mesh
    return replace(item, mesh=Given(mesh.name, mesh.motion, lambda elapsed: blocks, mesh.elapsed))


def exported(sequence: MeshSequence, name: str = "bar") -> PageItem:
    elapsed = sequence.times - sequence.times[0]
    poses = zip(elapsed.tolist(), sequence.points, strict=True)
    colours = available_colourings(sequence.header, sequence.points[0], poses=poses)
    return PageItem(SceneItem(name, sequence), colours)


def exported_model(model: Model, name: str = "model") -> PageItem:
    colours = available_colourings(model.header, model(model.start))
    return PageItem(SceneItem(name, model), colours, chart_data(model))


def vertices_of(item: PageItem) -> NDArray[np.int64]:
    """The old number of every vertex of the page."""
    return cheapest_numbering(item.mesh.header, "free").vertices


# Packing --------------------------------------------------------------------------------------------------


@settings(max_examples=60)
@given(st.binary(max_size=300))
def test_bytes_are_text_of_a_script(data: bytes) -> None:
    text = encode_text(data).decode(PAGE_ENCODING)
    assert bytes_of(text, len(data)) == data
    assert not set(text) & set("\0\r<")


def test_all_units_come_back() -> None:
    """Those that do not fit are two."""
    data = np.arange(1 << 16, dtype="<u2").tobytes()
    text = encode_text(data)
    assert bytes_of(text.decode(PAGE_ENCODING), len(data)) == data
    assert len(text) - len(data) == 2 * (2048 + 4)


@settings(max_examples=40)
@given(hnp.arrays(np.uint8, st.tuples(st.integers(1, 9), st.integers(1, 12))))
def test_rows_of_colours_come_back(rows: NDArray[np.uint8]) -> None:
    """Also where differences wrap."""
    assert np.array_equal(rows_of(deflate_rows(rows), rows.shape[1]), rows)


# Where things are -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("view", [View(), View(60, 14), View(-100, 40)])
def test_extents_hold_all_poses_and_shadows(view: View) -> None:
    world = to_y_up(bar().points, "Z")
    parts = [measure_extent(world[:2], [view]), measure_extent(world[2:], [view])]
    whole = parts[1].union(parts[0])
    assert np.allclose(whole.rectangles([view])[0], shared_limits(world, "Y", view, margin=0))
    assert np.array_equal(whole.low, world.min(axis=(0, 1)))
    assert whole.side == np.ptp(world, axis=(0, 1)).max()


# Pages ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SEQUENCES)
def test_pages_hold_what_was_given(tmp_path: Path, name: str) -> None:
    sequence = SEQUENCES[name]()
    given = exported(sequence)
    (report,) = export_page(tmp_path / "a.html", [given])
    item, vertices = Opened(tmp_path / "a.html").items[0], vertices_of(given)
    faces = vertices[item.model.header.faces]
    assert sorted(map(sorted, faces.tolist())) == sorted(map(sorted, sequence.faces.tolist()))
    assert np.allclose(item.times, sequence.times - sequence.times[0], atol=1e-9)
    off = np.linalg.norm(item.points - to_y_up(sequence.points, sequence.up_axis)[:, vertices], axis=2).max()
    assert off <= report.error * (1 + 1e-6)
    assert report.error == pytest.approx(1e-3 * bounding_diagonal(sequence.points[0]))
    assert set(given.colourings) == {each["name"] for each in item.description["colourings"]}
    assert not item.colours, "the page measures strain and curvature"


def test_the_error_can_be_chosen(tmp_path: Path) -> None:
    sequence = SEQUENCES["folding sheet"]()
    sizes = []
    for error in (1e-2, 1e-5):
        report = export_page(tmp_path / "a.html", [exported(sequence)], ExportSettings(max_error=error))
        assert report[0].max_error == error
        sizes.append((tmp_path / "a.html").stat().st_size)
    assert sizes[0] < sizes[1]


def test_models_that_are_compressed_are_taken_as_they_are(tmp_path: Path) -> None:
    sequence = bar(frames=9)
    coded = compress(sequence, max_error=2e-3)
    item = replace(exported(sequence), mesh=SceneItem("bar", CompressedModel.from_sequence(coded)), compressed=coded)
    report = export_page(tmp_path / "a.html", [item], ExportSettings(max_error=1e-5))[0]
    page = Opened(tmp_path / "a.html").items[0]
    assert report.max_error == 2e-3
    for time in (0.0, 0.13, 0.8):
        assert np.array_equal(page.model(time), decode(coded)(time))


def test_compressed_models_are_shown_at_any_rate(tmp_path: Path) -> None:
    coded = compress(bar(frames=9), max_error=1e-3)
    item = replace(
        exported(bar(frames=9)), mesh=SceneItem("bar", CompressedModel.from_sequence(coded)), compressed=coded
    )
    for options, times in (({"fps": 25.0}, np.arange(21) / 25), ({"every": 4}, [0, 0.4, 0.8])):
        export_page(tmp_path / "a.html", [item], ExportSettings(**options))
        page = Opened(tmp_path / "a.html").items[0]
        assert page.times == pytest.approx(times)
        assert page.model.times == pytest.approx(np.arange(9) / 10)


def test_parts_and_errors_are_stored(tmp_path: Path, bent_bar: MeshSequence, bar_model: Model) -> None:
    off = bent_bar.points + np.linspace(0, 0.1, len(bent_bar.points[0]))[None, :, None]

    def original(elapsed: float) -> FloatArray:
        return np.asarray(off[round(10 * elapsed)])

    colours = available_colourings(bar_model.header, bar_model(0.0), bar_model.decomposition, original)
    given = PageItem(SceneItem("bar", bar_model), {**colours, "error": colours["error"].with_top(0.2)})
    export_page(tmp_path / "a.html", [given])
    item, vertices = Opened(tmp_path / "a.html").items[0], vertices_of(given)
    described = {each["name"]: each for each in item.description["colourings"]}
    palette = np.array(described["parts"]["palette"])
    entries = colours["parts"].entries(bent_bar.points[0], 0.0)[vertices]
    assert np.array_equal(palette[item.colours["parts"][0]], colours["parts"].palette[entries])
    for row, time in zip(item.colours["error"], item.times, strict=True):
        expected = given.colourings["error"].entries(bar_model(time), time)
        assert np.array_equal(row, expected[vertices])


def test_own_colours_are_stored(tmp_path: Path, bent_bar: MeshSequence) -> None:
    """Those that differ are in the page's palette, which has no others, and are where vertices are."""
    values = np.ones((bent_bar.vertex_count, 4), np.float32)
    values[:, :3] = np.arange(bent_bar.vertex_count)[:, None] % [2, 3, 5] == 0
    surface = Surface(colours=CornerValues(values, bent_bar.polygons.indices))
    given = page_items(
        SceneColours(Scene((SceneItem("bar", replace(bent_bar, surface=surface)).with_random_access(),)))
    )
    export_page(tmp_path / "a.html", given)
    item = Opened(tmp_path / "a.html").items[0]
    described = {each["name"]: each for each in item.description["colourings"]}
    assert list(described) == ["clay", "own", "strain", "curvature"]
    palette = np.array(described["own"]["palette"])
    assert len(palette) == 8
    np.testing.assert_array_equal(palette[item.colours["own"][0]], 255 * values[vertices_of(given[0]), :3])


def test_the_up_axis_becomes_y(tmp_path: Path) -> None:
    points = bar().points
    sequence = MeshSequence.from_arrays(points, bar().faces, up_axis="Z")
    given = exported(sequence)
    export_page(tmp_path / "a.html", [given])
    item = Opened(tmp_path / "a.html").items[0]
    assert np.abs(item.points[..., 1] - points[:, vertices_of(given), 2]).max() < 1e-2
    assert item.description["azimuth"] == three_quarter_view(points, "Z").azimuth


def test_a_page_begins_where_the_camera_was_asked_for(tmp_path: Path) -> None:
    still = MeshSequence.from_arrays(bar().points[:1], bar().faces)
    export_page(tmp_path / "a.html", [exported(still)], ExportSettings(camera=(-15.0, 40.0), following=True))
    page = Opened(tmp_path / "a.html")
    item = page.items[0].description
    assert (item["azimuth"], item["elevation"]) == (-15, 40)
    assert page.description["following"]


def test_a_body_that_is_followed_stays_in_its_box(tmp_path: Path) -> None:
    """However far it goes; heights are not followed."""
    sequence = bar(frames=5)
    steps = np.arange(5)[:, None, None] * [10.0, 0.5, -7.0]
    still = sequence.points[:1].repeat(5, axis=0)
    export_page(tmp_path / "a.html", [exported(sequence.with_points(still + steps))])
    item = Opened(tmp_path / "a.html").items[0].description
    size = np.ptp(still[0], axis=0)
    for name, travelled in (("still", [40.0, 2.0, 28.0]), ("following", [0.0, 2.0, 0.0])):
        low, high = np.array(item[name]["low"]), np.array(item[name]["high"])
        assert high - low == pytest.approx(size + travelled, abs=1e-3)
    middle = still[0].mean(axis=0)
    low = still[0].min(axis=0) - middle * [1, 0, 1]
    assert item["following"]["low"] == pytest.approx(low, abs=1e-3)


def test_models_are_decoded_at_any_rate(tmp_path: Path, bar_model: Model) -> None:
    given = exported_model(bar_model)
    report = export_page(tmp_path / "a.html", [given], ExportSettings(fps=30))
    item = Opened(tmp_path / "a.html").items[0]
    assert np.allclose(item.times, np.arange(10) / 30)
    expected = np.stack([bar_model(bar_model.start + time) for time in item.times])[:, vertices_of(given)]
    assert np.linalg.norm(item.points - expected, axis=2).max() <= report[0].error * 1.001
    assert item.description["signals"]["end"] == pytest.approx(0.3)


def test_every_nth_frame(tmp_path: Path) -> None:
    sequence = bar(frames=7)
    given = exported(sequence)
    export_page(tmp_path / "a.html", [given], ExportSettings(every=3))
    page = Opened(tmp_path / "a.html")
    assert page.items[0].times == pytest.approx([0, 0.3, 0.6])
    assert np.abs(page.items[0].points - sequence.points[::3, vertices_of(given)]).max() < 1e-2
    assert page.description["period"] == pytest.approx(0.7)


def test_sequences_at_another_rate_show_the_nearest_frames(tmp_path: Path) -> None:
    sequence = bar(frames=5)
    given = exported(sequence)
    export_page(tmp_path / "a.html", [given], ExportSettings(fps=4))
    item = Opened(tmp_path / "a.html").items[0]
    assert item.times.tolist() == [0, 0.25]
    assert np.abs(item.points - sequence.points[[0, 2]][:, vertices_of(given)]).max() < 1e-2


def test_several_meshes_have_one_clock_and_one_scale(tmp_path: Path, bar_model: Model) -> None:
    other = SEQUENCES["folding sheet"]()
    items = [exported_model(bar_model), exported(bar(frames=9), "long"), exported(other, "sheet")]
    report = export_page(tmp_path / "a.html", items, ExportSettings(overlaid=True))
    page = Opened(tmp_path / "a.html")
    assert page.description["period"] == pytest.approx(0.9)
    assert page.description["overlaid"]
    assert page.description["title"] == "model, long, sheet"
    found = [item.description for item in page.items]
    tops = {c["top"] for item in found for c in item["colourings"] if c["name"] == "strain"}
    assert tops == {max(item.colourings["strain"].top for item in items)}
    assert [item["likeFirst"] for item in found] == [True, False, False]
    assert [item.name for item in report] == [item.mesh.name for item in items]


def test_meshes_with_the_triangles_of_the_first_are_seen_as_it_is(tmp_path: Path, bar_model: Model) -> None:
    turned = bar_model.header
    quarter = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    points = np.stack([bar_model(time) @ quarter for time in bar_model.times])
    sequence = MeshSequence.from_header(turned, points)
    export_page(tmp_path / "a.html", [exported_model(bar_model), exported(sequence)])
    first, second = (item.description for item in Opened(tmp_path / "a.html").items)
    assert second["likeFirst"]
    assert second["azimuth"] == first["azimuth"]


@pytest.mark.parametrize(
    ("scale", "shift", "like"), [(1.0, 0.0, True), (1.5, 0.0, True), (100.0, 0.0, False), (1.0, 50.0, False)]
)
def test_meshes_of_another_size_or_place_have_their_own_picture(
    tmp_path: Path, scale: float, shift: float, like: bool
) -> None:
    """At one scale, the mesh in metres would be a dot beside that in centimetres."""
    sequence = bar()
    other = sequence.with_points(scale * sequence.points + shift)
    export_page(tmp_path / "a.html", [exported(sequence), exported(other)])
    first, second = (item.description for item in Opened(tmp_path / "a.html").items)
    assert (first["likeFirst"], second["likeFirst"]) == (True, like)


def test_equal_input_makes_equal_bytes(tmp_path: Path, bar_model: Model) -> None:
    for name in ("a", "b"):
        export_page(tmp_path / f"{name}.html", [exported(bar()), exported_model(bar_model)])
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()


@pytest.mark.parametrize(
    "name", ["</script><script>alert(1)</script>", "<!-- x -->", "\"'&amp;\\", "Füchsin 狐 \u2028", "<!-- data -->"]
)
def test_names_stay_names(tmp_path: Path, name: str) -> None:
    export_page(tmp_path / "a.html", [exported(bar(), name)])
    page = Opened(tmp_path / "a.html")
    assert page.items[0].description["name"] == name
    title = re.search(r"<title>(.*?)</title>", page.text, re.DOTALL)
    assert title
    assert unescape(title[1]) == name
    assert page.text.count("<script") == page.text.count("</script>")


def test_pages_ask_for_nothing_else(tmp_path: Path) -> None:
    export_page(tmp_path / "a.html", [exported(bar())])
    page = Opened(tmp_path / "a.html")
    text = "".join([re.sub(r">[^<]*</script>", "", page.text), page.style, page.body, page.decoder, page.scripts])
    assert not re.findall(r"""(?:src|href)\s*=\s*["']|url\(|https?://|@import""", text)
    assert "default-src 'none'" in text


def test_charts_are_in_pages_that_show_them(tmp_path: Path, bar_model: Model) -> None:
    for item, there in ((exported(bar()), False), (exported_model(bar_model), True)):
        export_page(tmp_path / "a.html", [item])
        page = Opened(tmp_path / "a.html")
        assert ("mixseqCharts=" in page.scripts) == there
        assert "retimingChart=" not in page.scripts, "nothing is edited on a page"


def test_progress_is_told(tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    export_page(tmp_path / "a.html", [exported(bar())], progress=lambda done, total, what: told.append((done, total)))
    assert told[-1][0] == told[-1][1]
    assert {total for _, total in told} == {told[-1][1]}
    assert all(before[0] <= after[0] for before, after in pairwise(told))


def test_memory_does_not_grow_with_the_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(low_memory, "MAX_BYTES_IN_MEMORY", 1 << 16)
    sequence = bar(sides=40, rings=50, frames=2)
    rest = sequence.points[0]

    def peak(count: int) -> int:
        def poses(elapsed: FloatArray) -> Iterator[FloatArray]:
            for time in elapsed:
                yield (rest * (1 + 0.1 * np.sin(9 * time + rest)))[None]

        header = sequence.header.with_times(np.arange(count) / 24, 24)
        mesh = Given("bar", FrameStore(header, sequence.points), poses, header.times)
        item = PageItem(mesh, available_colourings(header, rest))
        tracemalloc.start()
        export_page(tmp_path / "a.html", [item], ExportSettings(inbetweens=False))
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most

    peak(2)  # imports what it needs
    assert peak(120) < 1.3 * peak(30)


# Refusals -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"fps": 0.0}, "fps is 0.0; a positive number"),
        ({"fps": float("nan")}, "fps is nan"),
        ({"every": 0}, "every 0 frames"),
        ({"max_error": -1.0}, "max_error is -1.0"),
    ],
)
def test_settings_out_of_range_are_refused(wrong: dict[str, Any], words: str) -> None:
    with pytest.raises(SettingsError, match=words):
        ExportSettings(**wrong)


def test_nothing_to_show_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="no mesh to show"):
        export_page(tmp_path / "a.html", [])


def test_too_many_frames_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="40,001 frames, a page at most 20,000; give a lower --fps"):
        export_page(tmp_path / "a.html", [exported(bar())], ExportSettings(fps=1e5))


@pytest.mark.parametrize("elapsed", [[], [0.0, 0.0], [-1.0, 0.0], [0.0, np.nan]])
def test_times_that_do_not_increase_are_refused(tmp_path: Path, elapsed: list[float]) -> None:
    item = exported(bar())
    mesh = Given("bar", item.mesh.motion, lambda times: [], np.array(elapsed))
    wrong = replace(item, mesh=mesh)
    with pytest.raises(SettingsError, match="times of bar do not increase from zero"):
        export_page(tmp_path / "a.html", [wrong])


def test_meshes_without_colours_are_refused(tmp_path: Path) -> None:
    item, none = exported(bar()), dict[str, Colouring]()
    with pytest.raises(SettingsError, match="bar has no colouring"):
        export_page(tmp_path / "a.html", [replace(item, colourings=none)])


@pytest.mark.parametrize(
    ("blocks", "words"),
    [
        ([bar().points, bar().points], "bar has more poses than its 5 times"),
        ([bar().points[:2]], "bar has 2 poses, but 5 times"),
        ([], "bar has 0 poses, but 5 times"),
        ([bar().points[:, :-1]], "the mesh has"),
        ([bar().points * np.nan], "coordinates must be finite"),
    ],
)
def test_other_poses_are_refused(tmp_path: Path, blocks: list[FloatArray], words: str) -> None:
    with pytest.raises(InvalidSequenceError, match=words):
        export_page(tmp_path / "a.html", [given_poses(exported(bar()), blocks)])
