"""The viewer in a browser, as a user works with it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import mixseq
from mixseq.pictures.colours import SceneColours
from mixseq.pictures.scene import Scene, SceneItem
from mixseq.signals.model import Model
from tests.meshes import coarse_walk
from tests.viewer.conftest import Keep, Watched, own_port
from tests.viewer.pages import QUICK, eventually

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytest.importorskip("viser", reason="the extra viewer is not installed")

from mixseq.viewer.live import ViewSettings
from mixseq.viewer.live.viewer import Viewer, run_viewer
from mixseq.viewer.session import Session

pytestmark = pytest.mark.slow

ARRAY = """(name) => {
  let found = [];
  window.__viserMutable?.nodeRefFromName["/mesh/0/surface"]?.traverse((each) => {
    const values = each.isMesh && !found.length && each.geometry.attributes[name];
    if (values) found = [...values.array.slice(0, 600)];
  });
  return found;
}"""
"""What the page draws of the mesh: the first numbers of one of its attributes."""


@pytest.fixture(scope="module")
def model() -> Model:
    return mixseq.fit(coarse_walk(16), rank=6)


def save(path: Path, model: Any, replace: bool) -> str:
    mixseq.save(path, model)
    return path.name


@pytest.fixture
def started(model: Model, tmp_path: Path) -> Iterator[tuple[Viewer, Callable[[], None]]]:
    """A running viewer, and what ends it."""
    scene = Scene((SceneItem("fox.h5", model),))
    settings = ViewSettings(port=own_port(), folder=tmp_path, threads=1, material="toon5")
    with ExitStack() as stack:
        yield stack.enter_context(run_viewer(SceneColours(scene), settings, save)), stack.close


MIDDLE = """() => {
  let mesh = null;
  const { nodeRefFromName, camera, canvas } = window.__viserMutable;
  nodeRefFromName["/mesh/0/surface"].traverse((each) => { if (each.isMesh && !mesh) mesh = each });
  mesh.geometry.computeBoundingSphere();
  const place = mesh.localToWorld(mesh.geometry.boundingSphere.center.clone()).project(camera);
  const { x, y, width, height } = canvas.getBoundingClientRect();
  return [x + (1 + place.x) / 2 * width, y + (1 - place.y) / 2 * height];
}"""


ON_SCREEN = """() => {
  let mesh = null;
  const { nodeRefFromName, camera, canvas } = window.__viserMutable;
  nodeRefFromName["/mesh/0/surface"].traverse((each) => { if (each.isMesh && !mesh) mesh = each });
  const { array, count } = mesh.geometry.attributes.position, { x, y, width, height } = canvas.getBoundingClientRect();
  const point = mesh.position.clone(), seen = [];
  for (let k = 0; k < count; k++) {
    mesh.localToWorld(point.fromArray(array, 3 * k)).project(camera);
    seen.push([x + (1 + point.x) / 2 * width, y + (1 - point.y) / 2 * height, point.z]);
  }
  return seen;
}"""
"""Where the vertices are on the page, and how deep."""


def foremost_part(window: Window, model: Model) -> tuple[int, tuple[float, float]]:
    """A part that hangs on another one, and the place on the page where it is nearest to the camera of all."""
    seen, parts = np.array(window.page.evaluate(ON_SCREEN)), model.decomposition
    hangs = (model.mixed.articulation.parents[parts.part_of_face] >= 0) & (parts.joint_of_face < 0)
    middles = seen[model.header.faces].mean(axis=1)
    face = np.flatnonzero(hangs)[middles[hangs, 2].argmin()]
    return int(parts.part_of_face[face]), (float(middles[face, 0]), float(middles[face, 1]))


class Window:
    """A page with the viewer, and a hand."""

    def __init__(self, page: Page, address: str) -> None:
        self.page = page
        page.goto(address + QUICK)
        page.wait_for_function("() => document.getElementById('mixseq-charts')?.mixseqCharts?.handlePixels().length")
        eventually(lambda: self.array("color"))
        # tells that there is no graphics card, and stands in the way
        eventually(lambda: page.get_by_text("Software WebGL").count())
        page.locator(".mantine-Notification-closeButton").click()

    def array(self, name: str) -> list[float]:
        values: list[float] = self.page.evaluate(ARRAY, name)
        return values

    def camera(self) -> list[float]:
        place: list[float] = self.page.evaluate("window.__viserMutable.camera.position.toArray()")
        return place

    def changes(self, name: str, action: Callable[[], object]) -> None:
        """Do something, after which the page draws other positions or colours."""
        before = self.array(name)
        action()
        eventually(lambda: self.array(name) != before)

    def drag(self, index: int, by: tuple[float, float]) -> None:
        """Drag a handle of the time curve; the mesh follows before it is let go."""
        places = self.page.evaluate("document.getElementById('mixseq-charts').mixseqCharts.handlePixels()")
        x, y = places[index]
        self.page.mouse.move(x, y)
        self.page.mouse.down()
        self.changes("position", lambda: self.page.mouse.move(x + by[0], y + by[1], steps=5))
        self.page.mouse.up()

    def middle(self) -> tuple[float, float]:
        """Where the middle of the mesh is on the page."""
        x, y = self.page.evaluate(MIDDLE)
        return x, y

    def part(self) -> str:
        """What is chosen as the part that is edited."""
        return self.page.get_by_label("Part", exact=True).input_value()

    def click(self, name: str) -> None:
        self.page.get_by_role("button", name=name, exact=True).click()

    def choose(self, now: str, option: str) -> None:
        self.page.locator(f"input[role='combobox'][value='{now}']").click()
        self.page.get_by_role("option", name=option, exact=True).click()


EDGES = """() => {
  const { left, top, right } = document.querySelector(".mixseq-sheet").getBoundingClientRect();
  const line = document.getElementById("mixseq-timeline").getBoundingClientRect();
  return [window.__viserMutable.canvas.getBoundingClientRect().bottom, line.top, line.bottom, left, top, right];
}"""
"""Where the picture ends, the edges of the time line, and the left, upper and right edge of the panel."""

MARK = """(frame) => {
  const { left, bottom, width } = document.querySelector("#mixseq-timeline canvas").getBoundingClientRect();
  return [left + 18 + frame / 15 * (width - 36), bottom - 8];
}"""
"""Where a frame of 16 is on the time line."""


FAINT = """() => {
  const light = (colour) => colour.match(/[0-9.]+/g).slice(0, 3).map((value) => value / 255)
    .map((share) => (share <= 0.04045 ? share / 12.92 : ((share + 0.055) / 1.055) ** 2.4))
    .reduce((sum, share, k) => sum + share * [0.2126, 0.7152, 0.0722][k], 0);
  const clear = (element) => /rgba[(]0, 0, 0, 0[)]/.test(getComputedStyle(element).backgroundColor);
  const isText = (element) => element.offsetWidth
    && [...element.childNodes].some((node) => node.nodeType === 3 && node.data.trim());
  return [...document.querySelectorAll("#root *, #mixseq-timeline *")].filter(isText).filter((element) => {
    let ground = element;
    while (ground && clear(ground)) ground = ground.parentElement;
    const under = ground ? getComputedStyle(ground).backgroundColor : "rgb(255, 255, 255)";
    const [a, b] = [getComputedStyle(element).color, under].map(light);
    return (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05) < 4.5;
  }).map((element) => element.textContent);
}"""
"""Texts with a contrast below 4.5."""


def pose_the_head(window: Window, session: Session, keep: Keep) -> None:
    """Pin a paw and drag the nose: cancelled, undone before it is applied, applied by a key, and undone."""
    page, before, drawn = window.page, session.model, window.array("position")
    page.get_by_label("Pose", exact=True).check()
    page.get_by_text("Drag the mesh").wait_for()
    seen = np.array(page.evaluate(ON_SCREEN))
    middles = seen[before.header.faces].mean(axis=1)
    nose, paw = (middles[middles[:, axis].argmax(), :2] for axis in (0, 1))
    summary = page.locator("#mixseq-pose")
    page.mouse.click(*paw)
    eventually(lambda: summary.inner_text() == "1 pin")

    def drag() -> None:
        camera = window.camera()
        page.mouse.move(*nose)
        page.mouse.down()
        window.changes("position", lambda: page.mouse.move(nose[0] - 10, nose[1] - 60, steps=5))
        assert window.camera() == camera, "a drag of the mesh turned the camera"
        page.mouse.up()
        eventually(lambda: summary.inner_text().startswith("1 handle"))
        eventually(lambda: window.array("position") != drawn)

    drag()
    keep(page, "view_pose")
    assert (summary.inner_text(), session.model) == ("1 handle, 1 pin", before)
    page.keyboard.press("Escape")
    eventually(lambda: window.array("position") == drawn)
    drag()
    window.click("Undo")
    eventually(lambda: window.array("position") == drawn and summary.inner_text().startswith("Drag"))
    assert session.model is before
    page.get_by_label("Exact", exact=True).check()  # otherwise a handle that is missed is warned about
    drag()
    page.keyboard.press("Enter")
    eventually(lambda: session.history.current.name == "pose")
    assert np.abs(session.model(before.times[4]) - before(before.times[4])).max() > 1e-3
    page.get_by_label("Pose", exact=True).uncheck()
    window.click("Undo")
    eventually(lambda: session.model is before and window.array("position") == drawn)


# One test, as a page takes seconds to load.
def test_a_session(
    watched: Watched, started: tuple[Viewer, Callable[[], None]], keep: Keep, model: Model, tmp_path: Path
) -> None:
    running, end = started
    window = Window(watched.open(), running.address)
    page, session, playback = window.page, running.session, running.playback
    keep(page, "view")
    assert page.evaluate(FAINT) == []

    assert window.part() == "whole body"
    window.click("Hold")
    eventually(lambda: page.get_by_text("cannot be held").count())
    assert session.model is model
    assert not session.history.index

    first = window.array("position")
    window.changes("position", lambda: window.click("Play"))
    assert playback.is_playing
    window.click("Pause")
    eventually(lambda: not playback.is_playing)

    slider, camera = page.get_by_role("slider", name="Frame", exact=True), window.camera()
    slider.press("Home")
    eventually(lambda: window.array("position") == first)
    window.changes("position", lambda: list(map(slider.press, 4 * ["ArrowRight"])))
    eventually(lambda: playback.frame == 4)
    assert window.camera() == camera, "keys for the slider turned the camera"

    page.mouse.move(*page.evaluate(MARK, 15))  # the out mark
    page.mouse.down()
    page.mouse.move(*page.evaluate(MARK, 9), steps=3)
    page.mouse.up()
    eventually(lambda: playback.section == (0, 9))
    page.keyboard.press("i")
    eventually(lambda: playback.section == (4, 9))
    page.keyboard.press("l")
    eventually(lambda: not playback.is_looping)
    page.keyboard.press("Space")
    eventually(lambda: playback.frame == 9 and not playback.is_playing)
    keep(page, "view_section")
    slider.press("Home")
    eventually(lambda: playback.frame == 0)
    list(map(slider.press, 4 * ["ArrowRight"]))
    eventually(lambda: playback.frame == 4)

    page.mouse.click(*window.middle())
    eventually(lambda: page.locator("#mixseq-picked").inner_text().startswith("vertex "))
    part, place = foremost_part(window, model)
    page.mouse.click(*place)
    eventually(lambda: window.part() == str(part))

    for now, colour in (("clay", "parts"), ("parts", "strain")):
        window.changes("color", partial(window.choose, now, colour))
        keep(page, f"view_{colour}")

    drawn = window.array("position")  # at the frame that the handle is dragged to
    window.drag(3, (30, 25))
    eventually(lambda: session.history.current.name == "drag")
    keep(page, "view_dragged")
    edited = session.model
    assert np.abs(edited.time(edited.times) - model.time(model.times)).max() > 1e-3

    # steps of the drag may still be drawn: another position is not yet that of the step back
    window.click("Undo")
    eventually(lambda: session.model is model and window.array("position") == drawn)
    window.click("Redo")
    eventually(lambda: session.model is edited and window.array("position") != drawn)

    window.click("Save")
    saved = tmp_path / "fox-edited.h5"
    eventually(saved.exists)
    eventually(lambda: page.get_by_text("Saved", exact=True).count())
    again = mixseq.load(saved)
    np.testing.assert_allclose(again.time(again.times), edited.time(edited.times), atol=1e-12)

    pose_the_head(window, session, keep)
    drawn = window.array("position")
    page.set_viewport_size({"width": 390, "height": 844})
    page.goto(running.address + QUICK)
    page.locator(".mixseq-sheet").wait_for()
    eventually(lambda: window.array("position") == drawn)
    assert session.model is edited

    def meet() -> bool:
        """Whether picture, time line and sheet meet, and the sheet has the width of the window."""
        end, begin, bottom, left, top, right = page.evaluate(EDGES)
        return max(abs(begin - end), abs(top - bottom)) <= 1 and (left, right) == (0, 390)

    eventually(meet)
    top = page.evaluate(EDGES)[1]
    assert top > 422, "the picture has more than half of the window"

    def fits() -> bool:
        seen = np.array(page.evaluate(ON_SCREEN))
        return bool((seen[:, :2].min(axis=0) > 0).all() and (seen[:, :2].max(axis=0) < [390, top]).all())

    eventually(fits)
    keep(page, "view_phone")

    box = page.get_by_role("button", name="Play").bounding_box()
    assert box is not None
    assert box["height"] >= 40
    page.locator(".mixseq-sheet").get_by_text("Curves").click()
    eventually(page.locator("#mixseq-charts").is_visible)
    page.wait_for_timeout(500)  # then the fold is kept
    page.keyboard.press("?")
    page.get_by_role("dialog").get_by_text("frame by frame").wait_for()
    page.get_by_role("button", name="Close").click()
    page.reload()
    eventually(page.locator("#mixseq-charts").is_visible)

    watched.check()  # its console is told of the connection that is lost now
    assert page.locator("#mixseq-ended").is_hidden()
    end()
    page.get_by_role("alert").get_by_text("This viewer has ended").wait_for()
