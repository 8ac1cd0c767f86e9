"""The page plays in a browser, from a file and without a network: what is seen changes when it should."""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mixseq.mesh.surface import CornerValues, Surface
from mixseq.pictures.charts import chart_data
from mixseq.pictures.colours import MEASURES, available_colourings
from mixseq.pictures.scene import SceneItem
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.spaces.temporal import insert_midpoints
from mixseq.viewer.export import ExportSettings, export_page
from mixseq.viewer.export_data import PageItem
from tests.compression.encoder.test_inbetweens import bending_tube, turning_bars
from tests.meshes import SEQUENCES, bar, coarse_walk
from tests.viewer.conftest import SCREENSHOTS, Keep, NewPage, Watched
from tests.viewer.pages import Opened

pytestmark = pytest.mark.slow

if TYPE_CHECKING:
    from playwright.sync_api import Page

Pixels = NDArray[np.uint8]
SMALL = 400, 480
WIDE = 1100, 460
"""Room for the signals beside the meshes."""


def exported(name: str, motion: MeshSequence | Model, original: MeshSequence | None = None) -> PageItem:
    start = float(motion.times[0])
    elapsed = motion.times - start
    poses = motion.points if isinstance(motion, MeshSequence) else [motion(start + t) for t in elapsed]

    def before(seconds: float) -> NDArray[Any]:
        assert original is not None
        return np.asarray(original.points[int(np.abs(original.times - original.times[0] - seconds).argmin())])

    colours = available_colourings(
        motion.header,
        poses[0],
        motion.decomposition if isinstance(motion, Model) else None,
        before if original is not None else None,
        zip(elapsed.tolist(), poses, strict=True),
    )
    signals = chart_data(motion) if isinstance(motion, Model) else None
    return PageItem(SceneItem(name, motion), colours, signals)


class Player:
    """A page that plays, and a hand."""

    def __init__(self, page: Page, path: Path) -> None:
        self.page = page
        self.path = path
        self.asked: list[str] = []
        page.on("request", lambda request: self.asked.append(request.url))
        page.goto(path.as_uri())
        page.wait_for_selector("html[data-state=ready]", state="attached")
        self.restore()

    def restore(self) -> None:
        """Stop it at its first frame, with everything as it was at first."""
        for key in ("Shift", "Control"):
            self.page.keyboard.up(key)
        if self.page.viewport_size != dict(zip(("width", "height"), SMALL, strict=True)):
            self.resize(*SMALL)
        self.page.emulate_media(color_scheme="light")
        self.page.evaluate(RESTORE)

    def resize(self, width: int, height: int) -> None:
        self.page.set_viewport_size({"width": width, "height": height})

    def run(self, script: str) -> Any:
        """Run a script, wait until all is drawn, and return what it returned."""
        return self.page.evaluate(f"async () => {{ const made = {script}; await mixseqPlayer.settled(); return made }}")

    def seek(self, time: float) -> None:
        self.run(f"mixseqPlayer.seek({time})")

    def state(self) -> dict[str, Any]:
        return dict(self.page.evaluate("async () => (await mixseqPlayer.settled(), mixseqPlayer.state())"))

    def picture(self, wanted: str = "#stage") -> Pixels:
        image = pytest.importorskip("PIL.Image")
        x, y, width, height = self.run(
            f"(({{x, y, width, height}}) => [x, y, width, height])"
            f"(document.querySelector('{wanted}').getBoundingClientRect())"
        )
        seen = self.page.screenshot(clip={"x": x, "y": y, "width": width, "height": height})
        return np.asarray(image.open(io.BytesIO(seen)).convert("RGB"))

    def at(self, wanted: str, across: float = 0.5, down: float = 0.5) -> tuple[float, float]:
        """Where a place of an element is on the page."""
        box = self.page.locator(wanted).bounding_box()
        assert box
        return box["x"] + across * box["width"], box["y"] + down * box["height"]

    def drag(self, right: int, down: int) -> None:
        x, y = self.at("#view", 0.5, 0.4)
        self.page.mouse.move(x, y)
        self.page.mouse.down()
        self.page.mouse.move(x + right, y + down, steps=2)
        self.page.mouse.up()


RESTORE = """async () => {
  const element = (id) => document.getElementById(id);
  const first = { loop: true, smooth: true, wires: false, follow: false, ground: true, fold: false };
  for (const [id, on] of Object.entries(first)) {
    if (!element(id).hidden && element(id).getAttribute("aria-pressed") !== String(on)) element(id).click();
  }
  for (const [id, value] of [["speed", "1"], ["layout", "side"], ["colour", "clay"]]) {
    if (element(id).value !== value) Object.assign(element(id), { value }).onchange({ target: element(id) });
  }
  element("help").close();
  element("reset").click();
  document.activeElement.blur();
  mixseqPlayer.play(false);
  mixseqPlayer.seek(0);
  await mixseqPlayer.settled();
}"""


def changed(before: Pixels, after: Pixels) -> float:
    """Share of the pixels that are another colour."""
    assert before.shape == after.shape
    return float((np.abs(before.astype(int) - after).max(axis=2) > 12).mean())


@pytest.fixture(scope="module")
def bar_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page with a bar of 9 frames, 0.9 s."""
    target = tmp_path_factory.mktemp("one") / "bar.html"
    export_page(target, [exported("a <b>bar</b> & more", bar(frames=9))])
    return target


@pytest.fixture(scope="module")
def bars_page(tmp_path_factory: pytest.TempPathFactory, bent_bar: MeshSequence, bar_model: Model) -> Path:
    """A page with a bar and its model, which begins at 0 s and ends at 0.3 s."""
    target = tmp_path_factory.mktemp("two") / "bars.html"
    export_page(target, [exported("original", bent_bar), exported("model", bar_model, bent_bar)])
    return target


@pytest.fixture(scope="module")
def opened_bar(watched: Watched, bar_page: Path) -> Player:
    return Player(watched.open(*SMALL), bar_page)


@pytest.fixture(scope="module")
def opened_bars(watched: Watched, bars_page: Path) -> Player:
    return Player(watched.open(*SMALL), bars_page)


@pytest.fixture
def one(opened_bar: Player, watched: Watched) -> Iterator[Player]:
    """The page with one bar, stopped at its first frame."""
    yield opened_bar
    opened_bar.restore()
    watched.check()


@pytest.fixture
def two(opened_bars: Player, watched: Watched) -> Iterator[Player]:
    """The page with a bar and its model, stopped at the first frame."""
    yield opened_bars
    opened_bars.restore()
    watched.check()


# What is in it --------------------------------------------------------------------------------------------


def test_only_the_file_is_asked_for(two: Player) -> None:
    two.resize(*WIDE)
    two.seek(0.1)
    assert [address for address in two.asked if not address.startswith("blob:")] == [two.path.as_uri()]


POSES = """(async () => {
  const found = [];
  const { items, source } = mixseqPlayer, { times, faces } = items[0];
  for (let pose = 0; pose < times.length; pose++) {
    const measured = [];
    for (const measure of ["strain", "curvature"]) {
      const { top } = items[0].colourings.find(({ name }) => name === measure);
      measured.push([...(await source.ask("pose", { mesh: 0, pose, time: times[pose], measure, top })).colours]);
    }
    const { places, normals } = await source.ask("pose", { mesh: 0, pose, time: times[pose] });
    found.push({ places: [...places], normals: [...normals], measured });
  }
  return { faces: [...faces], found };
})()"""
"""All poses, as they are decoded."""


@pytest.mark.parametrize("without", ["", "delete window.Worker", "window.Worker = class { constructor() { throw 0 } }"])
def test_the_browser_finds_what_python_does(new_page: NewPage, bar_page: Path, without: str) -> None:
    """Places, and what colours measure of them; in a worker and, where there is none, in the page."""
    page = new_page(*SMALL)
    page.add_init_script(without)
    made = Player(page, bar_page).run(f"await {POSES}")
    item = Opened(bar_page).items[0]
    faces = item.model.header.faces
    assert made["faces"] == faces.ravel().tolist()
    measures = [
        (MEASURES[name](item.points[0], faces), unit, top)
        for name, unit, top in zip(
            ("strain", "curvature"),
            (100, 1),
            [each["top"] for each in item.description["colourings"] if "top" in each],
            strict=True,
        )
    ]
    for pose, points in zip(made["found"], item.points, strict=True):
        places = np.reshape(pose["places"], (-1, 3)) + item.description["centre"]
        np.testing.assert_allclose(places, points, atol=2e-6)
        triangles = points[faces]
        crosses = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        expected = np.zeros_like(points)
        np.add.at(expected, faces.ravel(), np.repeat(crosses, 3, axis=0))
        np.testing.assert_allclose(np.reshape(pose["normals"], (-1, 3)), expected, atol=2e-5)
        for colours, (measure, unit, top) in zip(pose["measured"], measures, strict=True):
            shares = np.clip(unit * measure(points) / top, 0, 1)
            np.testing.assert_allclose(colours, 255 * shares, atol=0.6)


CURVE = """(async () => {
  const { items: [item], source } = mixseqPlayer, found = [];
  for (let k = 0; k <= 4 * (item.times.length - 1); k++) {
    const before = item.times[k >> 2], after = item.times[Math.ceil(k / 4)];
    const time = before + ((k % 4) / 4) * (after - before);
    found.push([...(await source.ask("pose", { mesh: 0, pose: k, time })).places]);
  }
  return { found, text: document.getElementById("facts").textContent };
})()"""
"""Places at the frames and at the quarters between them, and what the page says."""


@pytest.mark.parametrize("make", [bending_tube, SEQUENCES["rigid component"]], ids=["of the mesh", "of its parts"])
def test_the_browser_shows_in_betweens(new_page: NewPage, tmp_path: Path, make: Callable[[], MeshSequence]) -> None:
    report = export_page(tmp_path / "tube.html", [exported("tube", make())])[0]
    made = Player(new_page(*SMALL), tmp_path / "tube.html").run(f"await {CURVE}")
    item = Opened(tmp_path / "tube.html").items[0]
    assert len(item.model.inbetweens) > 0
    expected = item.model.sample(insert_midpoints(insert_midpoints(item.model.times))).points
    np.testing.assert_allclose(np.reshape(made["found"], expected.shape), expected, atol=2e-6)
    assert report.between is not None
    assert f"{item.description['between']} units from the model between frames" in made["text"]
    diagonal = report.error / report.max_error
    assert item.description["between"] == pytest.approx(report.between * diagonal, rel=0.01)


def test_a_cut_is_a_cut_between_frames(new_page: NewPage, tmp_path: Path) -> None:
    """The bar jumps between its frames 4 and 5: half-way, and in no place between both."""
    bending = bar(frames=9)
    shot = bending.with_points(bending.points + 0.3 * bending.diagonal * (np.arange(9) > 4)[:, None, None])
    export_page(tmp_path / "shot.html", [exported("shot", shot)])
    page = Player(new_page(*SMALL), tmp_path / "shot.html")
    pictures = []
    for frame in (4.26, 4.49, 4.5, 4.74):
        page.seek(frame * shot.times[1])
        pictures.append(page.picture("#view"))
    first, before, after, last = pictures
    assert changed(before, after) > 0.08
    assert changed(first, before) == 0, "poses are interpolated up to a quarter before the cut"
    assert changed(after, last) < 0.05


def test_in_betweens_of_parts_keep_labels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mixseq.compression.encoder.search.BASIS_KINDS", ("shapes",))
    report = export_page(tmp_path / "bars.html", [exported("bars", turning_bars())])[0]
    model = Opened(tmp_path / "bars.html").items[0].model
    assert model.parts_basis is not None
    assert report.between is not None
    assert report.between < 2 * report.max_error


def test_in_betweens_are_left_out(tmp_path: Path) -> None:
    report = export_page(tmp_path / "tube.html", [exported("tube", bending_tube())], ExportSettings(inbetweens=False))
    assert report[0].between is None
    assert not Opened(tmp_path / "tube.html").items[0].model.inbetweens


def test_names_are_shown_as_they_are(one: Player) -> None:
    page = one.page
    assert page.locator(".name").all_inner_texts() == ["a <b>bar</b> & more"]
    assert page.title() == "a <b>bar</b> & more"
    page.click("#about")
    assert "vertex error at most" in page.locator("#facts").inner_text()
    page.keyboard.press("Escape")
    assert not page.locator("#help").is_visible()


# Time -----------------------------------------------------------------------------------------------------

WATCH = """async (until) => {
  const seen = [];
  for (let frame = 0; frame < 600; frame++) {
    const { time, playing } = mixseqPlayer.state();
    seen.push(time);
    if (!playing || (until === "again" && time < seen[seen.length - 2])) break;
    await new Promise(requestAnimationFrame);
  }
  return seen;
}"""
"""Times of what is drawn until it stops, or starts again."""


def test_it_plays_and_starts_again_or_ends_at_the_end(one: Player) -> None:
    page = one.page
    page.click("#play")
    seen = page.evaluate(WATCH, "again")
    assert max(seen) > 0.5, "most of the 0.9 s were seen"
    assert seen[-1] < seen[-2], "and then the beginning again"
    page.keyboard.press("Space")
    assert not one.state()["playing"]
    page.click("#loop")
    page.select_option("#speed", "2")
    page.keyboard.press("End")
    page.keyboard.press("ArrowLeft")
    page.click("#play")
    seen = page.evaluate(WATCH, "end")
    assert min(seen) > 0.6
    assert (one.state()["playing"], one.state()["frame"]) == (False, 8)


def test_keys_step_by_frames(one: Player) -> None:
    for key, frame in (("ArrowRight", 1), ("ArrowRight", 2), ("ArrowLeft", 1), ("End", 8), ("ArrowRight", 0)):
        one.page.keyboard.press(key)
        assert one.state()["frame"] == frame, key
    assert one.page.locator("#now").inner_text().startswith("0 / 8 · 0.000 s")


def test_scrubbing_moves_the_mesh(one: Player) -> None:
    before = one.picture()
    one.page.mouse.click(*one.at("#time", 0.75))
    assert one.state()["time"] == pytest.approx(0.6, abs=0.1)
    assert changed(before, one.picture()) > 0.01
    one.page.keyboard.press("ArrowRight")  # the slider still has the focus
    time = one.state()["time"]  # after which all is drawn
    assert one.run("+document.getElementById('time').value") == pytest.approx(time, abs=1e-3)


def test_between_frames_it_moves_smoothly_unless_told_otherwise(one: Player) -> None:
    pictures = []
    for time in (0.06, 0.1):
        one.seek(time)
        pictures.append(one.picture())
    assert changed(*pictures) > 0.001
    one.page.click("#smooth")
    one.seek(0.06)
    assert changed(one.picture(), pictures[1]) == 0


def test_a_single_pose_has_no_clock(new_page: NewPage, tmp_path: Path) -> None:
    export_page(tmp_path / "a.html", [exported("bar", bar(frames=1))])
    player = Player(new_page(*SMALL), tmp_path / "a.html")
    assert not player.page.locator("#transport").is_visible()
    player.page.keyboard.press("Space")
    assert not player.state()["playing"]


# Looks ----------------------------------------------------------------------------------------------------


def test_colours_can_be_chosen(two: Player) -> None:
    page = two.page
    two.seek(0.3)
    clay = two.picture()
    assert not page.locator("#legend").is_visible()
    colours = ["Clay", "Strain", "Curvature", "Parts", "Error"]
    assert page.locator("#colour option").all_inner_texts() == colours
    for name, words in (("parts", "red where parts meet"), ("strain", "Strain (%)"), ("error", "Error (diagonals)")):
        page.select_option("#colour", name)
        assert changed(clay, two.picture()) > 0.01
        assert words in page.locator("#legend").inner_text()


def test_own_colours_are_drawn(new_page: NewPage, tmp_path: Path) -> None:
    """A bar that is green: what is drawn of it is, once that is chosen."""
    sequence = bar(frames=1)
    green = np.tile([0.0, 1, 0, 1], (sequence.vertex_count, 1))
    surface = Surface(colours=CornerValues(green, sequence.polygons.indices))
    export_page(tmp_path / "green.html", [exported("green", replace(sequence, surface=surface))])
    player = Player(new_page(), tmp_path / "green.html")
    assert not greens(player.picture()).any()
    player.page.select_option("#colour", "own")
    assert player.page.locator("#legend").inner_text() == "Vertex colours"
    assert greens(player.picture()).mean() > 0.01


def greens(picture: Pixels) -> NDArray[np.bool_]:
    """Which pixels are green, as light falls on it."""
    red, green, blue = picture.astype(int).transpose(2, 0, 1)
    return np.asarray((green > 80) & (red < green / 3) & (blue < green / 3))


def test_dragging_turns_and_a_double_click_undoes_it(one: Player) -> None:
    before = one.picture()
    one.drag(80, 20)
    state = one.state()
    assert (state["yaw"], state["pitch"]) == pytest.approx((-32, 8))
    assert changed(before, one.picture()) > 0.01
    one.page.dblclick("#view")
    assert changed(before, one.picture()) == 0


def test_shift_and_the_wheel_move_and_zoom(one: Player) -> None:
    one.page.keyboard.down("Shift")
    one.drag(30, 40)
    one.page.keyboard.up("Shift")
    assert one.state()["pan"] == pytest.approx([30, 40])
    one.page.mouse.wheel(0, -300)
    one.page.wait_for_function("mixseqPlayer.state().zoom > 1.3")
    one.page.keyboard.press("0")
    state = one.state()
    assert (state["zoom"], state["pan"]) == (1, [0, 0])


def test_overlaid_meshes_stand_in_one_place(two: Player) -> None:
    before = two.picture()
    assert two.page.locator(".name").count() == 2
    two.page.select_option("#layout", "over")
    assert two.page.locator(".name").all_inner_texts() == ["originalmodel"]
    assert changed(before, two.picture()) > 0.01


def test_edges_and_the_ground_can_be_switched(one: Player) -> None:
    pictures = [one.picture()]
    for name in ("#wires", "#ground"):
        one.page.click(name)
        pictures.append(one.picture())
        assert changed(pictures[-2], pictures[-1]) > 0.005


def test_a_body_that_travels_is_followed(new_page: NewPage, tmp_path: Path) -> None:
    """It is where it was, however far it goes, and the ground moves."""
    still = bar(frames=1)
    steps = np.arange(5)[:, None, None] * [3.3, 0, 2.1]
    moving = MeshSequence.from_arrays(np.repeat(still.points, 5, axis=0) + steps, still.faces, fps=10)
    export_page(tmp_path / "a.html", [exported("bar", moving)], ExportSettings(following=True))
    player = Player(new_page(*SMALL), tmp_path / "a.html")
    assert player.page.get_attribute("#follow", "aria-pressed") == "false", "the fixture turned it off"
    player.page.click("#ground")
    for follow, moves in ((False, True), (True, False)):
        if follow:
            player.page.click("#follow")
        pictures = []
        for time in (0.0, 0.4):
            player.seek(time)
            pictures.append(player.picture())
        assert (changed(*pictures) > 1e-3) == moves
    player.page.click("#ground")
    player.seek(0.4)
    with_ground = player.picture()
    player.seek(0.3)
    assert changed(with_ground, player.picture()) > 1e-3


def test_the_signals_follow_and_lead(two: Player) -> None:
    page = two.page
    two.resize(*WIDE)
    page.click("#fold")
    assert page.locator("#side").is_visible()
    before = two.picture("#charts")
    two.seek(0.2)
    assert changed(before, two.picture("#charts")) > 0.0005
    page.mouse.click(*two.run("document.getElementById('charts').mixseqCharts.timePixel(0.1)"))
    assert two.state()["time"] == pytest.approx(0.1, abs=0.01)
    width = "document.getElementById('stage').clientWidth"
    narrow = two.run(width)
    page.click("#fold")
    assert two.run(width) > narrow + 300


@pytest.mark.parametrize("name", ["one", "two"])
def test_it_is_dark_where_that_is_preferred(request: pytest.FixtureRequest, name: str) -> None:
    """With charts and without."""
    player: Player = request.getfixturevalue(name)
    assert player.picture()[200, 3].min() > 240
    player.page.emulate_media(color_scheme="dark")
    assert player.picture()[200, 3].max() < 50


# Where it cannot play -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("without", "words"),
    [
        ("delete window.DecompressionStream", "no DecompressionStream"),
        ("HTMLCanvasElement.prototype.getContext = () => null", "WebGL 2 is missing"),
    ],
)
def test_browsers_that_cannot_are_told(new_page: NewPage, bar_page: Path, without: str, words: str) -> None:
    page = new_page(*SMALL)
    page.add_init_script(without)
    page.goto(bar_page.as_uri())
    page.wait_for_selector("html[data-state=failed]", state="attached")
    assert words in page.get_by_role("alert").inner_text()


def test_damaged_pages_are_told(new_page: NewPage, bar_page: Path, tmp_path: Path) -> None:
    text = bar_page.read_text(encoding="utf-16")
    place = text.rindex('data-size="') + 400
    damaged = text[:place] + ("A" if text[place] != "A" else "B") + text[place + 1 :]
    (tmp_path / "a.html").write_text(damaged, encoding="utf-16")
    page = new_page(*SMALL)
    page.goto((tmp_path / "a.html").as_uri())
    page.wait_for_selector("html[data-state=failed]", state="attached")
    assert "The page is damaged" in page.get_by_role("alert").inner_text()


# What it looks like ---------------------------------------------------------------------------------------

BOXES = """[...document.querySelectorAll("#bar button, #bar select, #bar input, #bar output")]
  .filter((each) => each.offsetParent).map((each) => each.getBoundingClientRect())
  .map(({ left, top, right, bottom }) => [left, top, right, bottom])"""
"""Left, top, right and bottom ``(n, 4)`` of the controls that can be seen."""


def test_controls_have_room(two: Player) -> None:
    for width in (360, 390, 600, 768, 1024, 1280, 1920):
        two.resize(width, 560)
        controls = np.array(two.run(BOXES))
        assert len(controls) > 12
        assert two.run("document.documentElement.scrollWidth") == width
        assert controls[:, 0].min() >= 0
        assert controls[:, 2].max() <= width
        beside = (controls[:, None, :2] >= controls[None, :, 2:] - 0.5).any(axis=2)
        over = ~(beside | beside.T | np.eye(len(controls), dtype=bool))
        assert not over.any(), f"controls {np.argwhere(over).tolist()} overlap in a window {width} wide"
        assert two.run("document.getElementById('stage').clientHeight") > 150


def test_all_controls_have_names(two: Player) -> None:
    names = two.run(
        "[...document.querySelectorAll('#bar button, #bar select, #bar input')].map((each) => "
        "each.ariaLabel || each.innerText || [...each.labels].map((label) => label.innerText).join())"
    )
    assert len(names) > 12
    assert all(name.strip() for name in names)


@pytest.fixture(scope="module")
def fox(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The fox, and a model of it that keeps two modes."""
    walk = coarse_walk(frames=12)
    items = [exported("original", walk), exported("two modes", fit(walk, rank=2), walk)]
    path = tmp_path_factory.mktemp("pictures") / "fox.html"
    export_page(path, items, ExportSettings(title="Fox"))
    return path


@pytest.mark.skipif(SCREENSHOTS not in os.environ, reason=f"pictures to be looked at: set {SCREENSHOTS}")
@pytest.mark.parametrize(
    ("width", "height", "colour"), [(1280, 800, "parts"), (1920, 1080, "error"), (390, 844, "clay")]
)
def test_pictures(new_page: NewPage, keep: Keep, fox: Path, width: int, height: int, colour: str) -> None:
    page = new_page(width, height)
    player = Player(page, fox)
    player.resize(width, height)
    if width > WIDE[0]:
        page.click("#fold")
    page.emulate_media(color_scheme="dark" if colour == "parts" else "light")
    page.select_option("#colour", colour)
    player.seek(0.25)
    keep(page, f"page-{width}x{height}-{colour}")
