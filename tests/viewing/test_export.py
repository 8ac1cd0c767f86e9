"""What a page holds is what was given, within what it says, and nothing else is in it."""

from __future__ import annotations

import json
import re
import tracemalloc
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from html import unescape
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from mixseq import disk_array
from mixseq.arrays import Float, FloatArray
from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.frame_store import FrameStore, frame_store
from mixseq.mapping import Executor
from mixseq.scene import SceneItem
from mixseq.scene.camera import View, shared_limits, three_quarter_view, y_up
from mixseq.scene.colouring import Colouring, colourings_of
from mixseq.sequence import MeshSequence
from mixseq.signals import Model
from mixseq.viewing.chart_data import signals_of
from mixseq.viewing.export import ExportSettings, export_page
from mixseq.viewing.gathering import PageItem, extent_of
from mixseq.viewing.packing import Packer, unpacked
from mixseq.viewing.template import CHART_SCRIPTS
from tests.meshes import SEQUENCES, bar

pytestmark = pytest.mark.slow

Rows = NDArray[np.unsignedinteger[Any]]


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
    colours = colourings_of(sequence.header, sequence.points[0], poses=poses)
    return PageItem(SceneItem(name, sequence), colours)


def exported_model(model: Model, name: str = "model") -> PageItem:
    colours = colourings_of(model.header, model(model.start))
    return PageItem(SceneItem(name, model), colours, signals_of(model))


class Opened:
    """A page taken apart."""

    def __init__(self, path: Path) -> None:
        self.text = path.read_text(encoding="utf-8")
        found = re.search(r'<script type="application/json" id="description">(.*?)</script>', self.text)
        assert found
        self.description = json.loads(found[1])
        self._streams = iter(
            re.findall(
                r'<script type="application/octet-stream" data-rows="(\d+)" data-width="(\d+)" data-bytes="(\d)">\n'
                r"([A-Za-z0-9+/=\n]*)</script>",
                self.text,
            )
        )
        self.items = [self._item(item) for item in self.description["items"]]
        assert not list(self._streams)

    def _next(self) -> Rows:
        rows, width, size, lines = next(self._streams)
        numbers = unpacked(lines.encode().split(b"\n"), int(width), f"u{size}")
        assert numbers.shape == (int(rows), int(width))
        return numbers

    def _item(self, item: dict[str, Any]) -> dict[str, Any]:
        faces = self._next().reshape(-1, 3)
        places = self._next().view(np.int16).reshape(-1, 3, item["vertices"]).transpose(0, 2, 1)
        points = np.array(item["centre"]) + item["step"] * places.astype(np.float64)
        return {
            **item,
            "faces": faces,
            "points": points,
            "colours": {colouring["name"]: self._next() for colouring in item["colourings"]},
        }


# Packing --------------------------------------------------------------------------------------------------


def packed(rows: Rows, cuts: Iterable[int] = ()) -> list[bytes]:
    packer = Packer(rows.shape[1], rows.dtype)
    for block in np.split(rows, sorted(cuts)):
        packer.add(block)
    packer.finish()
    lines = list(packer.lines())
    assert packer.size == sum(map(len, lines))
    assert packer.rows == len(rows)
    return lines


@settings(max_examples=40)
@given(st.data(), st.sampled_from(["u1", "u2", "u4"]))
def test_packed_rows_come_back(data: st.DataObject, dtype: str) -> None:
    """All numbers, also where differences wrap, however the rows are cut into blocks."""
    shape = data.draw(st.tuples(st.integers(1, 9), st.integers(1, 12)))
    rows = data.draw(hnp.arrays(np.dtype(dtype), shape))
    cuts = data.draw(st.lists(st.integers(0, shape[0]), max_size=3))
    lines = packed(rows, cuts)
    assert np.array_equal(unpacked(lines, shape[1], dtype), rows)
    assert lines == packed(rows)


def test_lines_can_be_read_by_themselves() -> None:
    rows = np.random.default_rng(3).integers(0, 1 << 16, (40, 30_000)).astype(np.uint16)
    lines = packed(rows, [7, 9])
    assert len(lines) > 2
    assert all(b"=" not in line for line in lines[:-1])
    assert np.array_equal(unpacked(lines, 30_000, "u2"), rows)


def test_what_moves_with_its_neighbours_takes_little() -> None:
    """A rigid shift by the same step in every frame is one number per coordinate."""
    rows = np.random.default_rng(1).integers(0, 1 << 16, 3000).astype(np.uint16)
    moving = rows + (np.arange(50, dtype=np.uint16) * 37)[:, None]
    assert len(b"".join(packed(moving))) < 1.2 * len(b"".join(packed(rows[None])))


# Where things are -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("view", [View(), View(60, 14), View(-100, 40)])
def test_extents_hold_all_poses_and_shadows(view: View) -> None:
    world = y_up(bar().points, "Z")
    parts = [extent_of(world[:2], [view]), extent_of(world[2:], [view])]
    whole = parts[1].joined(parts[0])
    assert np.allclose(whole.rectangles([view])[0], shared_limits(world, "Y", view, margin=0))
    assert np.array_equal(whole.low, world.min(axis=(0, 1)))
    assert whole.side == np.ptp(world, axis=(0, 1)).max()


# Pages ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SEQUENCES)
def test_pages_hold_what_was_given(tmp_path: Path, name: str) -> None:
    sequence = SEQUENCES[name]()
    given = exported(sequence)
    report = export_page(tmp_path / "a.html", [given])
    item = Opened(tmp_path / "a.html").items[0]
    assert np.array_equal(item["faces"], sequence.faces)
    assert np.allclose(item["times"], sequence.times - sequence.times[0], atol=1e-9)
    off = np.abs(item["points"] - y_up(sequence.points, sequence.up_axis)).max()
    side = np.ptp(sequence.points.astype(np.float64), axis=(0, 1)).max()
    assert off <= report.items[0].error * (1 + 1e-9)
    assert report.items[0].error <= side / 131068 * (1 + 1e-9)
    for colour, colouring in given.colourings.items():
        kept = item["colours"][colour]
        assert len(kept) == (1 if colouring.constant else sequence.frame_count)
        for row, (pose, time) in zip(
            kept, zip(sequence.points, given.mesh.elapsed, strict=True), strict=False
        ):
            assert np.array_equal(row, colouring.indices(pose, float(time)))


def test_the_up_axis_becomes_y(tmp_path: Path) -> None:
    points = bar().points
    sequence = MeshSequence.from_arrays(points, bar().faces, up_axis="Z")
    export_page(tmp_path / "a.html", [exported(sequence)])
    item = Opened(tmp_path / "a.html").items[0]
    assert np.abs(item["points"][..., 1] - points[..., 2]).max() < 1e-3
    assert item["azimuth"] == three_quarter_view(points, "Z").azimuth


def test_a_page_begins_where_the_camera_was_asked_for(tmp_path: Path) -> None:
    still = MeshSequence.from_arrays(bar().points[:1], bar().faces)
    export_page(tmp_path / "a.html", [exported(still)], ExportSettings(camera=(-15.0, 40.0)))
    item = Opened(tmp_path / "a.html").items[0]
    assert (item["azimuth"], item["elevation"]) == (-15, 40)


def test_models_are_decoded_at_any_rate(tmp_path: Path, bar_model: Model) -> None:
    report = export_page(tmp_path / "a.html", [exported_model(bar_model)], ExportSettings(fps=30))
    item = Opened(tmp_path / "a.html").items[0]
    assert np.allclose(item["times"], np.arange(10) / 30)
    expected = np.stack([bar_model(bar_model.start + time) for time in item["times"]])
    assert np.abs(item["points"] - expected).max() <= report.items[0].error * 1.001
    assert item["signals"]["end"] == pytest.approx(0.3)


def test_every_nth_frame(tmp_path: Path) -> None:
    sequence = bar(frames=7)
    export_page(tmp_path / "a.html", [exported(sequence)], ExportSettings(every=3))
    page = Opened(tmp_path / "a.html")
    assert page.items[0]["times"] == [0, 0.3, 0.6]
    assert np.abs(page.items[0]["points"] - sequence.points[::3]).max() < 1e-3
    assert page.description["period"] == pytest.approx(0.7)


def test_sequences_at_another_rate_show_the_nearest_frames(tmp_path: Path) -> None:
    sequence = bar(frames=5)
    export_page(tmp_path / "a.html", [exported(sequence)], ExportSettings(fps=4))
    item = Opened(tmp_path / "a.html").items[0]
    assert item["times"] == [0, 0.25]
    assert np.abs(item["points"] - sequence.points[[0, 2]]).max() < 1e-3


def test_several_meshes_have_one_clock_and_one_scale(tmp_path: Path, bar_model: Model) -> None:
    other = SEQUENCES["folding sheet"]()
    items = [exported_model(bar_model), exported(bar(frames=9), "long"), exported(other, "sheet")]
    report = export_page(tmp_path / "a.html", items, ExportSettings(overlaid=True))
    page = Opened(tmp_path / "a.html")
    assert page.description["period"] == pytest.approx(0.9)
    assert page.description["overlaid"]
    assert page.description["title"] == "model, long, sheet"
    tops = {c["top"] for item in page.items for c in item["colourings"] if c["name"] == "strain"}
    assert tops == {max(item.colourings["strain"].top for item in items)}
    assert [item["likeFirst"] for item in page.items] == [True, False, False]
    assert [item.frames for item in report.items] == [4, 9, 5]
    assert report.size == (tmp_path / "a.html").stat().st_size


def test_meshes_with_the_triangles_of_the_first_are_seen_as_it_is(tmp_path: Path, bar_model: Model) -> None:
    turned = bar_model.header
    quarter = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    points = np.stack([bar_model(time) @ quarter for time in bar_model.times])
    sequence = MeshSequence.from_header(turned, points)
    export_page(tmp_path / "a.html", [exported_model(bar_model), exported(sequence)])
    first, second = Opened(tmp_path / "a.html").items
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
    first, second = Opened(tmp_path / "a.html").items
    assert (first["likeFirst"], second["likeFirst"]) == (True, like)


def test_equal_input_makes_equal_bytes(tmp_path: Path, bar_model: Model) -> None:
    for name in ("a", "b"):
        export_page(tmp_path / f"{name}.html", [exported(bar()), exported_model(bar_model)])
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()


@pytest.mark.parametrize(
    "name",
    ["</script><script>alert(1)</script>", "<!-- x -->", "\"'&amp;\\", "Füchsin 狐 \u2028", "<!-- data -->"],
)
def test_names_stay_names(tmp_path: Path, name: str) -> None:
    export_page(tmp_path / "a.html", [exported(bar(), name)])
    page = Opened(tmp_path / "a.html")
    assert page.items[0]["name"] == name
    title = re.search(r"<title>(.*?)</title>", page.text, re.DOTALL)
    assert title
    assert unescape(title[1]) == name
    assert page.text.count("<script") == page.text.count("</script>")


def test_pages_ask_for_nothing_else(tmp_path: Path) -> None:
    export_page(tmp_path / "a.html", [exported(bar())])
    text = Opened(tmp_path / "a.html").text
    assert not re.findall(r"""(?:src|href)\s*=\s*["']|url\(|https?://|@import""", text)
    assert "default-src 'none'" in text


def test_the_page_has_all_scripts_of_the_charts_in_their_order() -> None:
    from mixseq.viewing.template import script

    named = re.findall(r'<script src="([\w.]+)">', script("player.html"))
    assert tuple(named[: len(CHART_SCRIPTS)]) == CHART_SCRIPTS


def test_progress_is_told(tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    export_page(
        tmp_path / "a.html", [exported(bar())], progress=lambda done, total, what: told.append((done, total))
    )
    assert told[-1] == (10, 10)
    assert all(before[0] <= after[0] for before, after in pairwise(told))


def test_memory_does_not_grow_with_the_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disk_array, "IN_MEMORY", 1 << 16)
    sequence = bar(sides=40, rings=50, frames=2)
    rest = sequence.points[0]

    def peak(count: int) -> int:
        def poses(elapsed: FloatArray) -> Iterator[FloatArray]:
            for time in elapsed:
                yield (rest * (1 + 0.1 * np.sin(9 * time + rest)))[None]

        header = sequence.header.with_times(np.arange(count) / 24, 24)
        mesh = Given("bar", FrameStore(header, sequence.points), poses, header.times)
        item = PageItem(mesh, colourings_of(header, rest))
        tracemalloc.start()
        export_page(tmp_path / "a.html", [item])
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most

    assert peak(160) < 1.3 * peak(40)


# Refusals -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"fps": 0.0}, "fps is 0.0; a positive number"),
        ({"fps": float("nan")}, "fps is nan"),
        ({"every": 0}, "every 0 frames"),
        ({"largest": -1.0}, "largest size is -1.0"),
    ],
)
def test_settings_out_of_range_are_refused(wrong: dict[str, Any], words: str) -> None:
    with pytest.raises(SettingsError, match=words):
        ExportSettings(**wrong)


def test_nothing_to_show_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="nothing to show"):
        export_page(tmp_path / "a.html", [])


def test_pages_that_are_too_large_are_refused(tmp_path: Path) -> None:
    with pytest.raises(
        SettingsError, match=r"about 0\.\d+ MB, more than 0\.15 MB; take fewer frames \(--every 2"
    ):
        export_page(tmp_path / "a.html", [exported(bar(frames=400))], ExportSettings(largest=0.15))


def test_the_whole_page_counts(tmp_path: Path, bar_model: Model) -> None:
    items = [exported(bar(frames=9)), exported_model(bar_model)]
    size = export_page(tmp_path / "a.html", items).size
    export_page(tmp_path / "a.html", items, ExportSettings(largest=(size + 4) / 1e6))
    with pytest.raises(SettingsError, match="the page would have about"):
        export_page(tmp_path / "a.html", items, ExportSettings(largest=(size - 4) / 1e6))


def test_limits_below_an_empty_page_are_refused(tmp_path: Path) -> None:
    words = r"a page has 0\.\d+ MB even without a mesh, more than 0\.05 MB; allow more with --largest"
    with pytest.raises(SettingsError, match=words):
        export_page(tmp_path / "a.html", [exported(bar())], ExportSettings(largest=0.05))


def test_too_many_frames_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="40,001 frames, a page has at most 20,000; give a lower --fps"):
        export_page(tmp_path / "a.html", [exported(bar())], ExportSettings(fps=1e5))


@pytest.mark.parametrize("elapsed", [[], [0.0, 0.0], [-1.0, 0.0], [0.0, np.nan]])
def test_times_that_do_not_increase_are_refused(tmp_path: Path, elapsed: list[float]) -> None:
    item = exported(bar())
    mesh = Given("bar", item.mesh.motion, lambda times: [], np.array(elapsed))
    wrong = replace(item, mesh=mesh)
    with pytest.raises(SettingsError, match="times of bar are not numbers from zero on that increase"):
        export_page(tmp_path / "a.html", [wrong])


def test_meshes_without_colours_are_refused(tmp_path: Path) -> None:
    item, none = exported(bar()), dict[str, Colouring]()
    with pytest.raises(SettingsError, match="bar has no colours"):
        export_page(tmp_path / "a.html", [replace(item, colourings=none)])


@pytest.mark.parametrize(
    ("blocks", "words"),
    [
        ([bar().points, bar().points], "bar has more poses than the 5 times"),
        ([bar().points[:2]], "bar has 2 poses but 5 times"),
        ([], "bar has 0 poses but 5 times"),
        ([bar().points[:, :-1]], "the mesh has"),
        ([bar().points * np.nan], "coordinates must be finite"),
    ],
)
def test_other_poses_are_refused(tmp_path: Path, blocks: list[FloatArray], words: str) -> None:
    with pytest.raises(InvalidSequenceError, match=words):
        export_page(tmp_path / "a.html", [given_poses(exported(bar()), blocks)])


# Former names ---------------------------------------------------------------------------------------------


def test_former_names_make_the_same_page_with_a_warning(tmp_path: Path) -> None:
    from mixseq.viewing.export import Exported, poses_of

    sequence = bar()
    item = exported(sequence)
    with pytest.warns(DeprecationWarning, match=r"now SceneItem\(name, motion\)\.poses"):
        poses = poses_of(frame_store(sequence))
    with pytest.warns(DeprecationWarning, match="Exported is now PageItem"):
        former = Exported("bar", sequence.header, poses, item.mesh.elapsed, item.colourings)
    for name, given_ in (("new", item), ("former", former)):
        export_page(tmp_path / f"{name}.html", [given_])
    assert (tmp_path / "new.html").read_bytes() == (tmp_path / "former.html").read_bytes()


@pytest.mark.parametrize(
    ("module", "name", "new"),
    [
        ("mixseq.plots.video", "Shown", "SceneItem"),
        ("mixseq.viewing.colouring", "colourings_of", "colourings_of"),
        ("mixseq.viewing.colouring", "Colouring", "Colouring"),
    ],
)
def test_names_that_moved_to_the_scene(module: str, name: str, new: str) -> None:
    import mixseq.scene

    with pytest.warns(DeprecationWarning, match=rf"{module}\.{name} is now mixseq\.scene"):
        assert getattr(import_module(module), name) is getattr(mixseq.scene, new)
