"""Markers set in a browser, as a person does it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

import mixseq
from mixseq.retargeting.markers import Markers
from mixseq.types import Float
from mixseq_io.text.markers import write_markers
from tests.retargeting.foxes import seen_from_left, short, tall
from tests.viewer.conftest import Keep, Watched, own_port
from tests.viewer.pages import QUICK, eventually

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytest.importorskip("viser", reason="the extra viewer is not installed")

from mixseq.viewer.live import ViewSettings
from mixseq.viewer.live.marking import MarkedMeshes, MarkingViewer, run_marking_viewer
from mixseq.viewer.marking import MarkingSession

pytestmark = pytest.mark.slow

FOXES = short, tall
"""Made when they are first called."""

PLACE = """([side, vertex]) => {
  let mesh = null;
  const { nodeRefFromName, camera, canvas } = window.__viserMutable;
  nodeRefFromName[`/mesh/${side}/surface`].traverse((each) => { if (each.isMesh && !mesh) mesh = each });
  const point = mesh.geometry.attributes.position;
  const place = mesh.position.clone().fromBufferAttribute(point, vertex);
  mesh.localToWorld(place).project(camera);
  const { x, y, width, height } = canvas.getBoundingClientRect();
  return [x + (1 + place.x) / 2 * width, y + (1 - place.y) / 2 * height];
}"""
"""Where a vertex is on the page."""


READY = (
    """() => window.__viserMutable?.nodeRefFromName?.["/mesh/1/surface"] && document.getElementById("mixseq-hint")"""
)
"""Whether the page shows the meshes and its controls."""

UNNAMED = """() => [...document.querySelectorAll("button, canvas, input:not([type=hidden])")].filter((each) =>
  each.offsetWidth && !each.getAttribute("aria-label") && !each.textContent.trim() && !each.labels?.length
).map((each) => each.outerHTML)"""
"""Controls on the page that screen readers have no name for."""


class Hand:
    """A page with the viewer, and a hand."""

    def __init__(self, page: Page, running: MarkingViewer) -> None:
        self.page, self.session = page, running.session
        page.goto(running.address + QUICK)
        page.wait_for_function(READY)
        eventually(lambda: page.get_by_text("Software WebGL").count())
        page.locator(".mantine-Notification-closeButton").first.click()
        self.wait_until_still()  # panels dock, and the camera steps back
        eventually(lambda: len(self.session.proposals) >= 8 and self.session._mirrors is not None, seconds=240.0)

    def wait_until_still(self) -> None:
        def is_still() -> bool:
            before = self.page.evaluate(PLACE, [0, 0])
            self.page.wait_for_timeout(250)
            return bool(self.page.evaluate(PLACE, [0, 0]) == before)

        eventually(is_still)

    def button(self, name: str) -> None:
        self.page.get_by_role("button", name=name, exact=True).click()

    def click(self, side: int, bone: str) -> None:
        """Click a bone from its left, and wait until that is heard."""
        self.click_vertex(side, seen_from_left(FOXES[side](), bone))

    def click_vertex(self, side: int, vertex: int) -> None:
        before = self.session.marking
        x, y = self.page.evaluate(PLACE, [side, vertex])
        self.page.mouse.move(x - 2, y)
        self.page.mouse.click(x, y)
        eventually(lambda: self.session.marking is not before)

    def see_left(self) -> None:
        """Foxes look along x, which is no format's front: their left is at its back."""
        self.button("Back")
        self.wait_until_still()

    def text(self, name: str) -> str:
        return self.page.locator(f"#mixseq-{name}").inner_text()

    def bones(self) -> list[tuple[str, str]]:
        """What is set, by the bones that it is on."""
        pairs = [pair.vertices for pair in self.session.marking.pairs]
        return [(FOXES[0]().bones[source], FOXES[1]().bones[target]) for source, target in pairs]


@pytest.fixture(scope="module")
def target(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file that markers are saved to."""
    return tmp_path_factory.mktemp("marking") / "pairs.txt"


@pytest.fixture(scope="module")
def running(target: Path) -> Iterator[MarkingViewer]:
    def save(markers: Markers) -> str:
        write_markers(target, markers)
        return "saved"

    nothing = Markers.from_pairs(np.zeros((0, 2), np.int64))
    meshes = MarkedMeshes(FOXES[0]().mesh, FOXES[1]().mesh, ("short.obj", "tall.obj"), nothing, "pairs.txt")
    with run_marking_viewer(meshes, ViewSettings(port=own_port(), material="toon5"), save) as started:
        yield started


@pytest.fixture(scope="module")
def opened(watched: Watched, running: MarkingViewer) -> Hand:
    return Hand(watched.open(), running)


@pytest.fixture
def hand(opened: Hand, watched: Watched) -> Iterator[Hand]:
    """A page without markers, which tests share, as it takes seconds to load."""
    yield opened
    while opened.session._history.index:
        opened.session.undo()
    watched.check()


def says(hand: Hand, text: str) -> bool:
    return text in hand.text("proposed")


def has_more_than(session: MarkingSession, count: int) -> bool:
    return len(session.marking.pairs) > count


def test_from_nothing_to_a_file(hand: Hand, keep: Keep, target: Path) -> None:
    page, session = hand.page, hand.session
    for certainty, count in Counter(pair.certainty for pair in session.proposals).items():
        eventually(partial(says, hand, f"{count} {certainty}"))
    keep(page, "markers_proposed")

    hand.button("Accept")
    eventually(lambda: len(session.marking.pairs) == 1)
    before = page.evaluate(PLACE, [0, 0])
    while len(session.marking.pairs) < 8:
        count = len(session.marking.pairs)
        page.keyboard.press("y")
        eventually(partial(has_more_than, session, count))
    hand.wait_until_still()
    np.testing.assert_allclose(page.evaluate(PLACE, [0, 0]), before, atol=0.5)  # the camera stays
    sides = {(one[-2:], other[-2:]) for one, other in hand.bones()}
    assert not sides & {(".l", ".r"), (".r", ".l")}

    hand.see_left()
    hand.click(0, "thigh.l")
    eventually(lambda: "9: now click the same point of tall.obj" in hand.text("hint"))
    hand.click(1, "thigh.l")
    eventually(lambda: "9 pairs" in hand.text("hint"))
    assert hand.bones()[8] == ("thigh.l", "thigh.l")
    page.keyboard.press("y")  # the right thigh is proposed first
    eventually(lambda: len(session.marking.pairs) == 10)
    assert hand.bones()[9] == ("thigh.r", "thigh.r")

    eventually(lambda: "(median)" in hand.text("map"))
    assert "No pair seems wrong" in hand.text("map")
    assert "100 % of the target covered" in hand.text("map")
    page.mouse.move(500, 750)  # a mesh under it is outlined
    keep(page, "markers_set")

    page.keyboard.press("Control+z")
    eventually(lambda: len(session.marking.pairs) == 9)
    hand.button("Redo")
    eventually(lambda: len(session.marking.pairs) == 10)

    assert ": unsaved changes" in hand.text("saved")
    hand.button("Save")
    eventually(target.exists)
    eventually(lambda: "no unsaved changes" in hand.text("saved"))
    saved = mixseq.read_markers(target)
    assert np.array_equal(saved.source, session.marking.markers.source)
    assert np.array_equal(saved.target, session.marking.markers.target)


def test_a_marker_is_chosen_moved_and_deleted(hand: Hand) -> None:
    count = len(hand.session.proposals)
    hand.button("Accept all")
    eventually(lambda: len(hand.bones()) == count)
    hand.see_left()
    number = hand.bones().index(("nose", "nose"))
    hand.click_vertex(0, hand.session.marking.pairs[number].vertices[0])  # its ball
    eventually(lambda: f"{number + 1} is selected" in hand.text("hint"))
    hand.click(0, "thigh.l")
    assert hand.bones()[number] == ("thigh.l", "nose")
    ball = hand.session.marking.pairs[number].vertices[0]

    def is_selected() -> bool:
        hand.click_vertex(0, ball)
        clicked = hand.session.marking
        if clicked.selected != number:  # a new pair: the page had not drawn the moved ball
            hand.button("Undo")
            eventually(lambda: hand.session.marking is not clicked)
        return clicked.selected == number

    eventually(is_selected)
    hand.button("Delete")
    eventually(lambda: len(hand.bones()) == count - 1)
    hand.button("Undo")
    eventually(lambda: len(hand.bones()) == count)


def test_no_mesh_hides_the_other(hand: Hand, running: MarkingViewer) -> None:
    """They stay beside each other while the camera turns, and it finds the same place of the other one."""
    mouse, stage = hand.page.mouse, running._stage
    (number,) = stage._pages
    before = stage.arrangement_of(number).view.azimuth
    mouse.move(500, 500)
    mouse.down()
    mouse.move(300, 500, steps=10)
    mouse.up()
    eventually(lambda: abs(stage.arrangement_of(number).view.azimuth - before) > 30)
    hand.wait_until_still()
    ends = [
        [hand.page.evaluate(PLACE, [side, vertex])[0] for vertex in range(0, fox.mesh.vertex_count, 40)]
        for side, fox in enumerate((short(), tall()))
    ]
    assert max(ends[0]) < min(ends[1])

    def away() -> Float:
        """How far meshes are from where the camera looks, as shares of the way between them."""
        (client,) = running._server.get_clients().values()
        middles = stage.arrangement_of(number).centres
        far = np.linalg.norm(middles - client.camera.look_at, axis=1) / np.linalg.norm(middles[1] - middles[0])
        return np.asarray(far)

    def looked_at() -> int:
        return int(away().argmin())

    first = looked_at()
    hand.button("Other mesh")
    eventually(lambda: looked_at() != first)
    assert away().min() < 0.45, "it looks past the mesh"
    hand.button("Other mesh")
    eventually(lambda: looked_at() == first)


def test_a_mesh_turns_on_its_own(hand: Hand, running: MarkingViewer) -> None:
    """The target is seen from the side of the source, until it is dragged with shift."""
    stage, page = running._stage, hand.page
    hand.see_left()
    lefts = [stage.arrangement.rotations[side] @ FOXES[side]().left for side in (0, 1)]
    assert lefts[0] @ lefts[1] > np.cos(np.radians(10.0))
    before = stage.arrangement.turns
    x, y = page.evaluate(PLACE, [1, seen_from_left(FOXES[1](), "thigh.l")])
    page.keyboard.down("Shift")
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 90, y, steps=10)
    page.mouse.up()
    page.keyboard.up("Shift")
    eventually(lambda: abs(stage.arrangement.turns[1] - before[1]) > 20)
    assert stage.arrangement.turns[0] == before[0]
    hand.wait_until_still()
    hand.click(1, "thigh.l")  # on the turned mesh
    assert hand.session.marking.started is not None
    hand.see_left()
    assert stage.arrangement.turns[1] == pytest.approx(before[1], abs=1e-6)


def test_meshes_are_stacked_on_a_phone(hand: Hand, running: MarkingViewer, watched: Watched) -> None:
    """Where that shows them larger, and nothing is outside of the picture; on another page they stay in a row."""
    phone = watched.open(390, 844)
    phone.goto(running.address + QUICK)
    phone.wait_for_function(READY)
    eventually(lambda: len(running._stage._pages) == 2)
    hand.button("Back")
    eventually(lambda: [running._stage.arrangement_of(number).is_stacked for number in (0, 1)] == [False, True])
    ends: list[Float] = []

    def are_stacked() -> bool:
        ends[:] = [
            np.array([phone.evaluate(PLACE, [side, vertex]) for vertex in range(0, fox.mesh.vertex_count, 40)])
            for side, fox in enumerate((short(), tall()))
        ]
        return bool(ends[0][:, 1].max() < ends[1][:, 1].min())

    eventually(are_stacked)
    lefts = [hand.page.evaluate(PLACE, [side, 0])[0] for side in (0, 1)]
    assert lefts[1] - lefts[0] > 200
    places = np.concatenate(ends)
    assert places.min() > 0
    assert places[:, 0].max() < 390
    for button in phone.get_by_role("button").all():
        box = button.bounding_box()
        if box is not None and button.inner_text():
            assert box["height"] >= 40, button.inner_text()
    phone.wait_for_timeout(1500)  # until they are named
    assert phone.evaluate(UNNAMED) == []
    phone.close()
