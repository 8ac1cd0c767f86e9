"""The page plays in a browser, from a file and without a network: what is seen changes when it should."""

from __future__ import annotations

import io
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mixseq.creature import walk_cycle
from mixseq.plots.camera import y_up
from mixseq.sequence import MeshSequence
from mixseq.signals import Model, fit
from mixseq.stored import stored
from mixseq.viewing.colouring import colourings_of
from mixseq.viewing.export import ExportSettings, export_page, poses_of
from mixseq.viewing.exporting import Exported, integers
from mixseq.viewing.signals import signals_of
from tests.meshes import bar
from tests.viewing.conftest import NewPage

if TYPE_CHECKING:
    from playwright.sync_api import Page

Pixels = NDArray[np.uint8]
SMALL = 480, 560


def exported(name: str, motion: MeshSequence | Model, original: MeshSequence | None = None) -> Exported:
    start = float(motion.times[0])
    elapsed = motion.times - start
    poses = motion.points if isinstance(motion, MeshSequence) else [motion(start + t) for t in elapsed]

    def before(seconds: float) -> NDArray[Any]:
        assert original is not None
        return np.asarray(original.points[int(np.abs(original.times - original.times[0] - seconds).argmin())])

    colours = colourings_of(
        motion.header,
        poses[0],
        motion.decomposition if isinstance(motion, Model) else None,
        before if original is not None else None,
        zip(elapsed.tolist(), poses, strict=True),
    )
    signals = signals_of(motion) if isinstance(motion, Model) else None
    of = motion if isinstance(motion, Model) else stored(motion)
    return Exported(name, motion.header, poses_of(of), elapsed, colours, signals)


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page with a bar of 9 frames, 0.9 s."""
    target = tmp_path_factory.mktemp("one") / "bar.html"
    export_page(target, [exported("a <b>bar</b> & more", bar(frames=9))])
    return target


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory, bent_bar: MeshSequence, bar_model: Model) -> Path:
    """A page with a bar and its model, which begins at 0 s and ends at 0.3 s."""
    target = tmp_path_factory.mktemp("two") / "bars.html"
    export_page(target, [exported("original", bent_bar), exported("model", bar_model, bent_bar)])
    return target


@pytest.fixture(scope="module")
def fox(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The fox, and a model of it that keeps two modes."""
    target = tmp_path_factory.mktemp("fox") / "fox.html"
    walk = walk_cycle(frames=12)
    model = fit(walk, rank=2)
    export_page(
        target, [exported("original", walk), exported("two modes", model, walk)], ExportSettings(title="Fox")
    )
    return target


def opened(new_page: NewPage, path: Path, width: int = SMALL[0], height: int = SMALL[1]) -> Page:
    """Open a page, wait until it is unpacked, and stop it at its first frame."""
    page = new_page(width, height)
    page.goto(path.as_uri())
    page.wait_for_selector("html[data-state=ready]", state="attached")
    page.evaluate("mixseqPlayer.play(false); mixseqPlayer.seek(0)")
    return page


def state(page: Page) -> dict[str, Any]:
    page.evaluate("mixseqPlayer.settled()")
    return dict(page.evaluate("mixseqPlayer.state()"))


def picture(page: Page, wanted: str = "#stage") -> Pixels:
    image = pytest.importorskip("PIL.Image")
    page.evaluate("mixseqPlayer.settled()")
    return np.asarray(image.open(io.BytesIO(page.locator(wanted).screenshot())).convert("RGB"))


def changed(before: Pixels, after: Pixels) -> float:
    """Share of the pixels that are another colour."""
    assert before.shape == after.shape
    return float((np.abs(before.astype(int) - after).max(axis=2) > 12).mean())


def drag(page: Page, by: tuple[int, int], start: tuple[float, float] = (0.5, 0.4)) -> None:
    box = page.locator("#view").bounding_box()
    assert box
    x, y = box["x"] + start[0] * box["width"], box["y"] + start[1] * box["height"]
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + by[0], y + by[1], steps=4)
    page.mouse.up()


# What is in it --------------------------------------------------------------------------------------------


def test_only_the_file_is_asked_for(new_page: NewPage, two: Path) -> None:
    page = new_page(*SMALL)
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(two.as_uri())
    page.wait_for_selector("html[data-state=ready]", state="attached")
    page.wait_for_timeout(300)
    assert asked == [two.as_uri()]


def test_the_browser_finds_the_numbers_that_were_packed(new_page: NewPage, one: Path) -> None:
    page, sequence = opened(new_page, one), bar(frames=9)
    item = page.evaluate(
        "(({centre, step, faces, positions, colourings}) => ({centre, step, faces: [...faces],"
        " positions: [...positions], colours: colourings.map((c) => [c.name, [...c.indices]])}))(mixseqPlayer.items[0])"
    )
    assert item["faces"] == sequence.faces.ravel().tolist()
    expected = integers(y_up(sequence.points, "Y"), np.array(item["centre"]), item["step"]).view(np.int16)
    assert item["positions"] == expected.ravel().tolist()
    given = exported("bar", sequence)
    for name, indices in item["colours"]:
        colouring, poses = given.colourings[name], zip(sequence.points, given.elapsed.tolist(), strict=True)
        entries = [colouring.indices(pose, time) for pose, time in poses]
        assert indices == np.concatenate(entries[:1] if colouring.constant else entries).tolist()


def test_names_are_shown_as_they_are(new_page: NewPage, one: Path) -> None:
    page = opened(new_page, one)
    assert page.locator(".name").all_inner_texts() == ["a <b>bar</b> & more"]
    assert page.title() == "a <b>bar</b> & more"
    page.click("#about")
    assert "±" in page.locator("#facts").inner_text()
    page.keyboard.press("Escape")
    assert not page.locator("#help").is_visible()


# Time -----------------------------------------------------------------------------------------------------


def test_it_plays_and_starts_again(new_page: NewPage, one: Path) -> None:
    page = opened(new_page, one)
    page.click("#play")
    seen = []
    for _ in range(200):
        seen.append(page.evaluate("mixseqPlayer.state().time"))
        if any(after < before for before, after in pairwise(seen)):
            break
        page.wait_for_timeout(20)
    assert max(seen) > 0.5, "most of the 0.9 s were seen"
    assert seen[-1] < seen[-2], "and then the beginning again"
    page.keyboard.press("Space")
    assert not state(page)["playing"]


def test_without_the_loop_it_ends_at_the_end(new_page: NewPage, one: Path) -> None:
    page = opened(new_page, one)
    page.click("#loop")
    page.select_option("#speed", "2")
    page.click("#play")
    for _ in range(200):
        if not state(page)["playing"]:
            break
        page.wait_for_timeout(20)
    assert state(page)["frame"] == 8


def test_keys_step_by_frames(new_page: NewPage, one: Path) -> None:
    page = opened(new_page, one)
    for key, frame in (("ArrowRight", 1), ("ArrowRight", 2), ("ArrowLeft", 1), ("End", 8), ("ArrowRight", 0)):
        page.keyboard.press(key)
        assert state(page)["frame"] == frame, key
    assert page.locator("#now").inner_text().startswith("1 / 9")


def test_scrubbing_moves_the_mesh(new_page: NewPage, one: Path) -> None:
    page = opened(new_page, one)
    before = picture(page)
    box = page.locator("#time").bounding_box()
    assert box
    page.mouse.click(box["x"] + 0.75 * box["width"], box["y"] + box["height"] / 2)
    assert state(page)["time"] == pytest.approx(0.6, abs=0.1)
    assert changed(before, picture(page)) > 0.01


def test_between_frames_it_moves_smoothly_unless_told_otherwise(new_page: NewPage, one: Path) -> None:
    page = opened(new_page, one)
    pictures = {}
    for name, time in (("first", 0.0), ("between", 0.06), ("next", 0.1)):
        page.evaluate("(time) => mixseqPlayer.seek(time)", time)
        pictures[name] = picture(page)
    assert changed(pictures["between"], pictures["next"]) > 0.001
    page.click("#smooth")
    page.mouse.move(1, 1)
    page.evaluate("mixseqPlayer.seek(0.06)")
    assert changed(picture(page), pictures["next"]) == 0


def test_a_single_pose_has_no_clock(new_page: NewPage, tmp_path: Path) -> None:
    export_page(tmp_path / "a.html", [exported("bar", bar(frames=1))])
    page = opened(new_page, tmp_path / "a.html")
    assert not page.locator("#transport").is_visible()
    page.keyboard.press("Space")
    assert not state(page)["playing"]


# Looks ----------------------------------------------------------------------------------------------------


def test_colours_can_be_chosen(new_page: NewPage, two: Path) -> None:
    page = opened(new_page, two)
    page.evaluate("mixseqPlayer.seek(0.3)")
    clay = picture(page)
    assert not page.locator("#legend").is_visible()
    assert page.locator("#colour option").all_inner_texts() == [
        "Clay",
        "Strain",
        "Curvature",
        "Parts",
        "Error",
    ]
    for name, words in (
        ("parts", "red are joints"),
        ("strain", "Strain (%)"),
        ("error", "Error (diagonals)"),
    ):
        page.select_option("#colour", name)
        assert changed(clay, picture(page)) > 0.01
        assert words in page.locator("#legend").inner_text()


def test_dragging_turns_and_a_double_click_undoes_it(new_page: NewPage, one: Path) -> None:
    page = opened(new_page, one)
    before = picture(page)
    drag(page, (80, 20))
    assert state(page)["yaw"] == pytest.approx(-32)
    assert state(page)["pitch"] == pytest.approx(8)
    assert changed(before, picture(page)) > 0.01
    page.dblclick("#view")
    assert changed(before, picture(page)) == 0


def test_shift_and_the_wheel_move_and_zoom(new_page: NewPage, one: Path) -> None:
    page = opened(new_page, one)
    page.keyboard.down("Shift")
    drag(page, (30, 40))
    page.keyboard.up("Shift")
    assert state(page)["pan"] == pytest.approx([30, 40])
    page.mouse.wheel(0, -300)
    page.wait_for_timeout(100)
    assert state(page)["zoom"] > 1.3
    page.keyboard.press("0")
    assert (state(page)["zoom"], state(page)["pan"]) == (1, [0, 0])


def test_overlaid_meshes_stand_in_one_place(new_page: NewPage, two: Path) -> None:
    page = opened(new_page, two)
    before = picture(page)
    assert page.locator(".name").count() == 2
    page.select_option("#layout", "over")
    assert page.locator(".name").all_inner_texts() == ["originalmodel"]
    assert changed(before, picture(page)) > 0.01


def test_edges_and_the_ground_can_be_switched(new_page: NewPage, one: Path) -> None:
    page = opened(new_page, one)
    pictures = [picture(page)]
    for name in ("#wires", "#ground"):
        page.click(name)
        pictures.append(picture(page))
        assert changed(pictures[-2], pictures[-1]) > 0.005


def test_the_signals_follow_and_lead(new_page: NewPage, two: Path) -> None:
    page = opened(new_page, two, 1280, 800)
    assert page.locator("#side").is_visible()
    before = picture(page, "#charts")
    page.evaluate("mixseqPlayer.seek(0.2)")
    assert changed(before, picture(page, "#charts")) > 0.0005
    x, y = page.evaluate("document.getElementById('charts').mixseqCharts.timePixel(0.1)")[:2]
    page.mouse.click(x, y)
    assert state(page)["time"] == pytest.approx(0.1, abs=0.01)
    wide = page.locator("#stage").bounding_box()
    page.click("#fold")
    wider = page.locator("#stage").bounding_box()
    assert wide
    assert wider
    assert wider["width"] > wide["width"] + 300


def test_it_is_dark_where_that_is_preferred(new_page: NewPage, two: Path) -> None:
    page = opened(new_page, two)
    assert picture(page)[200, 3].min() > 240
    page.emulate_media(color_scheme="dark")
    page.wait_for_timeout(100)
    assert picture(page)[200, 3].max() < 50


# Where it cannot play -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("without", "words"),
    [
        ("delete window.DecompressionStream", "no DecompressionStream"),
        ("HTMLCanvasElement.prototype.getContext = () => null", "no WebGL 2"),
    ],
)
def test_browsers_that_cannot_are_told(new_page: NewPage, one: Path, without: str, words: str) -> None:
    page = new_page(*SMALL)
    page.add_init_script(without)
    page.goto(one.as_uri())
    page.wait_for_selector("html[data-state=failed]", state="attached")
    assert words in page.get_by_role("alert").inner_text()


def test_damaged_pages_are_told(new_page: NewPage, one: Path, tmp_path: Path) -> None:
    text = one.read_text()
    place = text.index('data-bytes="2">\n') + 200
    (tmp_path / "a.html").write_text(text[:place] + ("A" if text[place] != "A" else "B") + text[place + 1 :])
    page = new_page(*SMALL)
    page.goto((tmp_path / "a.html").as_uri())
    page.wait_for_selector("html[data-state=failed]", state="attached")
    assert "The page is damaged" in page.get_by_role("alert").inner_text()


# What it looks like ---------------------------------------------------------------------------------------

CONTROLS = "#bar button:visible, #bar select:visible, #bar input:visible, #bar output:visible"


def boxes(page: Page, wanted: str) -> NDArray[np.float64]:
    """Left, top, right and bottom ``(n, 4)`` of elements."""
    found = [element.bounding_box() for element in page.locator(wanted).all()]
    return np.array([[b["x"], b["y"], b["x"] + b["width"], b["y"] + b["height"]] for b in found if b])


def test_controls_have_room(new_page: NewPage, two: Path) -> None:
    page = opened(new_page, two, 360, 740)
    page.click("#fold")
    for width in (360, 390, 600, 768, 1024, 1280, 1920):
        page.set_viewport_size({"width": width, "height": 740})
        assert page.evaluate("document.documentElement.scrollWidth") == width
        controls = boxes(page, CONTROLS)
        assert controls[:, 0].min() >= 0
        assert controls[:, 2].max() <= width
        for k, box in enumerate(controls):
            others = np.delete(controls, k, axis=0)
            beside = (others[:, :2] >= box[2:] - 0.5).any(axis=1) | (others[:, 2:] <= box[:2] + 0.5).any(
                axis=1
            )
            assert beside.all(), f"control {k} is over another one where the window is {width} wide"
        (stage,) = boxes(page, "#stage")
        assert stage[3] - stage[1] > 150


def test_all_controls_have_names(new_page: NewPage, two: Path) -> None:
    page = opened(new_page, two)
    for control in page.locator("#bar button, #bar select, #bar input").all():
        named = control.evaluate(
            "(e) => e.ariaLabel || e.innerText || [...e.labels].map((l) => l.innerText).join()"
        )
        assert named.strip()


@pytest.mark.parametrize(("width", "height"), [(1280, 800), (1920, 1080), (390, 844)])
def test_pictures(new_page: NewPage, fox: Path, screenshots: Path, width: int, height: int) -> None:
    """Kept to be looked at."""
    page = opened(new_page, fox, width, height)
    page.evaluate("mixseqPlayer.seek(0.25)")
    page.screenshot(path=screenshots / f"page-{width}x{height}-clay.png")
    page.select_option("#colour", "error")
    page.evaluate("mixseqPlayer.settled()")
    page.screenshot(path=screenshots / f"page-{width}x{height}-error.png")
    page.emulate_media(color_scheme="dark")
    page.select_option("#colour", "parts")
    page.wait_for_timeout(100)
    page.evaluate("mixseqPlayer.settled()")
    page.screenshot(path=screenshots / f"page-{width}x{height}-parts.png")
