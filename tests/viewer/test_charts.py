"""Charts in a browser: what is drawn is where it says, and what a hand does is told in diagonals and seconds."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from mixseq.operations.sketch import drag
from mixseq.pictures.charts import chart_data
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.viewer.page import CHART_SCRIPTS, chart_scripts
from tests.meshes import bar
from tests.viewer.conftest import Keep, NewPage, Watched

pytestmark = pytest.mark.slow

if TYPE_CHECKING:
    from playwright.sync_api import Page

PAGE = """<!doctype html><meta charset="utf-8">
<style>html, body, #root { margin: 0; height: 100% }</style><div id="root"></div>
<script>CHARTS</script>
<script>
  const say = (kind) => (message) => log.push([kind, message]);
  var log, charts;
  function make(options) {
    charts?.remove();
    log = [];
    charts = mixseqCharts(
      document.getElementById("root"),
      { onDrag: say("drag"), onSketch: say("sketch"), onRetime: say("retime"), onSeek: say("seek") },
      options,
    );
  }
</script>""".replace("CHARTS", chart_scripts())

SETTLED = """async () => {
  const frame = () => new Promise(requestAnimationFrame);
  do await frame(); while (!root.mixseqCharts.settled());
  await frame();
}"""
"""Waits until all is drawn."""

WIDTH, HEIGHT = 380, 760

Place = tuple[float, float]


class Charts:
    """Charts on a page, and a hand."""

    def __init__(self, page: Page, signals: dict[str, Any] | None, **options: bool) -> None:
        self.page = page
        page.evaluate("(options) => make(options)", options)
        if signals is not None:
            self.show(signals)

    def show(self, signals: dict[str, Any]) -> None:
        self.page.evaluate("(signals) => charts.show(signals)", signals)
        self.settle()

    def settle(self) -> None:
        self.page.evaluate(SETTLED)

    def ask(self, what: str) -> Any:
        return self.page.evaluate(f"() => root.mixseqCharts.{what}")

    def pixel(self, point: Any) -> Place:
        x, y = self.page.evaluate("(point) => root.mixseqCharts.toPixels(point)", list(point))
        return x, y

    def told(self, kind: str | None = None) -> list[Any]:
        """What was told since last time: messages of one kind, or all as pairs."""
        told = self.page.evaluate("() => log.splice(0)")
        return told if kind is None else [message for each, message in told if each == kind]

    def grab(self, place: Place) -> None:
        self.page.mouse.move(*place)
        self.page.mouse.down()

    def move(self, place: Place, steps: int = 5) -> None:
        self.page.mouse.move(*place, steps=steps)
        self.settle()

    def drop(self) -> None:
        self.page.mouse.up()
        self.settle()

    def drag(self, start: Place, end: Place) -> None:
        self.grab(start)
        self.move(end)
        self.drop()


@pytest.fixture(scope="module")
def model() -> Model:
    """A bar whose tip goes almost around once, and up and down, in 12 frames from 0 to 11 / 24 s."""
    rest = bar(sides=4, rings=6, frames=1)
    turn = np.linspace(0, 1.8 * np.pi, 12)
    tip = np.stack([np.cos(turn), np.sin(turn), 0.3 * np.sin(2 * turn)], axis=1)
    moves = tip[:, None] * rest.points[0, :, 2:]
    return fit(MeshSequence.from_arrays(rest.points + moves, rest.faces, fps=24), exact=True, space="vertex")


@pytest.fixture(scope="module")
def signals(model: Model) -> dict[str, Any]:
    return chart_data(model)


@pytest.fixture(scope="module")
def opened_page(watched: Watched) -> Page:
    page = watched.open(WIDTH, HEIGHT)
    page.set_content(PAGE)
    return page


@pytest.fixture
def small(opened_page: Page, watched: Watched) -> Iterator[Page]:
    """A page of the size that charts have beside a mesh, with nothing in it yet and no key or button down."""
    opened_page.mouse.move(0, 0)
    yield opened_page
    opened_page.mouse.up()
    for key in ("Shift", "Alt"):
        opened_page.keyboard.up(key)
    watched.check()


@pytest.fixture
def charts(small: Page, signals: dict[str, Any]) -> Iterator[Charts]:
    charts = Charts(small, signals, editable=True)
    yield charts
    assert small.evaluate("() => Object.keys(window).filter((name) => /^mixseq/.test(name)).sort()") == [
        "mixseqChartParts",
        "mixseqCharts",
        "mixseqFrame",
    ]


def apart(a: Any, b: Any) -> float:
    return float(np.abs(np.subtract(a, b)).max())


def test_charts_have_texts(charts: Charts) -> None:
    curve, lines, keys = charts.page.locator("canvas").evaluate_all("(all) => all.map((each) => each.ariaLabel)")
    assert re.match(r"Time curve: 12 frames from 0 to 0.458 s on a path of \S+ by \S+ diagonals, whose ends are", curve)
    assert re.match(r"Coefficients: coordinate 1 from -\S+ to \S+, coordinate 2 from .* diagonals$", lines)
    assert keys.startswith("Retiming: output 0 s shows 0 s, output 0.115 s shows 0.115 s, ")


def test_every_script_is_there() -> None:
    assert len(set(CHART_SCRIPTS)) == len(CHART_SCRIPTS)
    assert "https:" not in chart_scripts() and "</script" not in chart_scripts()


def test_the_layout_has_one_scale(charts: Charts, signals: dict[str, Any]) -> None:
    scale = charts.ask("scale()")
    shown = np.array(charts.ask("pathPixels()"))
    path = np.array(signals["path"])
    np.testing.assert_allclose(shown - shown[0], (path - path[0]) * [scale, -scale], atol=1e-6)
    assert shown.min() > 0 and shown[:, 0].max() < WIDTH and shown[:, 1].max() < HEIGHT / 2
    assert np.ptp(shown, axis=0).max() > 0.7 * WIDTH


def test_the_point_is_where_the_model_is(charts: Charts, model: Model) -> None:
    time = 0.3
    charts.page.evaluate("(time) => charts.at(time)", time)
    charts.settle()
    assert apart(charts.ask("pointPixel()"), charts.pixel(model.embedding([time])[0])) < 1


def test_dragging_a_handle(charts: Charts, signals: dict[str, Any]) -> None:
    handle = signals["handles"][5]
    start = charts.ask("handlePixels()")[5]
    assert apart(start, charts.pixel(handle["at"])) < 1e-6
    end = (start[0] + 40, start[1] - 30)
    charts.drag(start, end)
    *before, last = charts.told("drag")
    assert before and not any(each["done"] for each in before) and last["done"]
    assert {each["time"] for each in [*before, last]} == {handle["time"]}
    assert apart(charts.pixel(last["to"]), end) < 1
    expected = np.add(handle["at"], np.array([40, 30]) / charts.ask("scale()"))
    assert apart(last["to"], expected) < 1 / charts.ask("scale()")


def test_a_handle_that_is_held_off_its_centre_does_not_jump(charts: Charts) -> None:
    start = charts.ask("handlePixels()")[5]
    charts.drag((start[0] + 4, start[1] + 3), (start[0] + 24, start[1] + 3))
    assert apart(charts.pixel(charts.told("drag")[-1]["to"]), (start[0] + 20, start[1])) < 1e-6


def test_a_click_on_a_handle_goes_there(charts: Charts, signals: dict[str, Any]) -> None:
    charts.drag(charts.ask("handlePixels()")[5], charts.ask("handlePixels()")[5])
    assert charts.told() == [["seek", signals["handles"][5]["time"]]]


def test_showing_does_not_fight_the_hand(charts: Charts, signals: dict[str, Any], model: Model) -> None:
    """While a handle is dragged and the answer comes late, it stays in the hand, and the picture does not move."""
    time, start = signals["handles"][5]["time"], charts.ask("handlePixels()")[5]
    end = (start[0] + 30, start[1] - 60)
    scale = charts.ask("scale()")
    charts.grab(start)
    charts.move(end)
    half = drag(model, time, np.add(signals["handles"][5]["at"], np.array([15, 30]) / scale).tolist())
    charts.show(chart_data(half, model.plane))
    assert apart(charts.ask("handlePixels()")[5], end) < 1 and charts.ask("scale()") == scale
    charts.drop()
    (last,) = [each for each in charts.told("drag") if each["done"]]
    assert apart(charts.pixel(last["to"]), end) < 1
    assert apart(charts.ask("handlePixels()")[5], end) < 1  # until it is answered
    charts.show(chart_data(drag(model, time, last["to"]), model.plane))
    assert apart(charts.ask("handlePixels()")[5], charts.pixel(last["to"])) < 1
    charts.show({**signals, "handles": []})
    assert charts.ask("handlePixels()") == []


def test_what_a_drag_will_make_is_shown_at_once(charts: Charts, signals: dict[str, Any], model: Model) -> None:
    time, start = signals["handles"][5]["time"], charts.ask("handlePixels()")[5]
    charts.grab(start)
    charts.move((start[0] + 30, start[1] - 60))
    to = charts.told("drag")[-1]["to"]
    made = drag(model, time, to).embedding(signals["times"], model.plane)
    changed = np.abs(made - signals["path"]).max(axis=1) > 1e-3
    shown = np.array(charts.ask("bentPixels()"))
    made_there = np.array([charts.pixel(point) for point in made[changed]])
    nearest = np.linalg.norm(made_there[:, None] - shown, axis=-1).min(axis=1)
    assert changed.sum() > 10 and nearest.max() < 1
    charts.drop()


@pytest.mark.parametrize("pen", ["shift", "pen"])
def test_sketching(charts: Charts, pen: str) -> None:
    corners = [(60.0, 80.0), (200.0, 100.0), (180.0, 240.0)]
    if pen == "shift":
        charts.page.keyboard.down("Shift")
    else:
        charts.page.evaluate("() => charts.pen(true)")
    charts.grab(corners[0])
    for corner in corners[1:]:
        charts.move(corner, steps=20)
    charts.drop()
    ((kind, points),) = charts.told()
    assert kind == "sketch" and len(points) > 20
    drawn = np.array([charts.pixel(point) for point in points])
    assert apart(drawn[0], corners[0]) < 1 and apart(drawn[-1], corners[-1]) < 2.5
    assert np.linalg.norm(drawn - corners[1], axis=1).min() < 2.5


def test_a_stroke_that_is_a_dot_is_none(charts: Charts) -> None:
    charts.page.keyboard.down("Shift")
    charts.drag((100.0, 100.0), (102.0, 101.0))
    assert charts.told() == []


def test_without_editing_only_seeking(small: Page, signals: dict[str, Any]) -> None:
    charts = Charts(small, signals, editable=False)
    place = charts.pixel(signals["handles"][5]["at"])
    charts.page.keyboard.down("Shift")
    charts.drag(place, (place[0] + 40, place[1]))
    charts.page.evaluate("() => charts.pen(true)")
    charts.drag(place, (place[0] + 40, place[1]))
    assert {kind for kind, _ in charts.told()} == {"seek"}
    assert charts.ask("handlePixels()") == charts.ask("keyPixels()") == []
    assert small.get_by_text("Retiming").count() == 0


def test_seeking_over_coefficients(charts: Charts, signals: dict[str, Any]) -> None:
    start, end = (charts.page.evaluate("(t) => root.mixseqCharts.timePixel(t)", time) for time in (0.1, 0.4))
    charts.drag(start, end)
    times = charts.told("seek")
    assert times[0] == pytest.approx(0.1, abs=0.002) and times[-1] == pytest.approx(0.4, abs=0.002)
    charts.drag(start, (WIDTH - 1.0, start[1]))
    assert charts.told("seek")[-1] == signals["end"]


def test_late_news_does_not_fight_the_hand_either(charts: Charts) -> None:
    start, end = (charts.page.evaluate("(t) => root.mixseqCharts.timePixel(t)", time) for time in (0.1, 0.4))
    charts.grab(start)
    charts.move(end)
    held = charts.ask("pointPixel()")
    charts.page.evaluate("() => charts.at(0.2)")
    assert charts.ask("pointPixel()") == held
    charts.drop()
    charts.page.evaluate("() => charts.at(0.2)")
    assert charts.ask("pointPixel()") != held


def test_seeking_on_the_curve(charts: Charts, model: Model, signals: dict[str, Any]) -> None:
    before, after = signals["handles"][7:9]
    time = (before["time"] + after["time"]) / 2
    x, y = charts.pixel(model.embedding([time])[0])
    charts.drag((x, y), (x, y))
    assert charts.told("seek")[0] == pytest.approx(time, abs=0.002)
    assert apart(charts.ask("pointPixel()"), (x, y)) < 1.5


def test_dragging_a_key(charts: Charts, signals: dict[str, Any]) -> None:
    keys, (x, y) = signals["keys"], charts.ask("keyPixels()")[2]
    charts.drag((x, y), (x + 20, y - 25))
    *before, last = charts.told("retime")
    assert before and not any(each["done"] for each in before) and last["done"]
    made = last["keys"]
    assert made[:2] == keys[:2] and made[3:] == keys[3:]
    assert made[2][0] > keys[2][0] and made[2][1] > keys[2][1]
    assert apart(charts.ask("keyPixels()")[2], (x + 20, y - 25)) < 1


def test_keys_keep_their_order(charts: Charts, signals: dict[str, Any]) -> None:
    places = charts.ask("keyPixels()")
    charts.drag(places[2], (places[4][0] + 10, -50.0))
    keys = charts.told("retime")[-1]["keys"]
    assert keys[1][0] < keys[2][0] < keys[3][0] == signals["keys"][3][0]
    assert keys[2][1] == signals["end"]  # there is no source beyond


@pytest.mark.parametrize("towards", [-30, 30])
def test_the_last_key_makes_it_shorter_or_longer(charts: Charts, signals: dict[str, Any], towards: int) -> None:
    x, y = charts.ask("keyPixels()")[-1]
    charts.drag((x, y), (x + towards, y))
    output, source = charts.told("retime")[-1]["keys"][-1]
    assert source == signals["end"] and (output > signals["end"]) == (towards > 0)


def test_adding_and_removing_keys(charts: Charts, signals: dict[str, Any]) -> None:
    first, second, *_, last = charts.ask("keyPixels()")
    middle = ((first[0] + second[0]) / 2, (first[1] + second[1]) / 2)
    charts.page.mouse.dblclick(*middle)
    charts.settle()
    (added,) = charts.told("retime")
    assert added["done"] and len(added["keys"]) == 6
    assert apart(charts.ask("keyPixels()")[1], middle) < 1
    charts.page.keyboard.down("Alt")
    charts.page.mouse.click(*middle)
    charts.page.mouse.click(*first)  # an end stays
    charts.page.keyboard.up("Alt")
    charts.page.mouse.dblclick(*last)
    (removed,) = charts.told("retime")
    assert removed == {"keys": signals["keys"], "done": True}
    charts.page.mouse.dblclick(*charts.ask("keyPixels()")[2])
    assert len(charts.told("retime")[-1]["keys"]) == 4


@pytest.mark.parametrize(
    "keys",
    [
        [[0, 1], [2, 5]],
        [[0, 0], [1, 2], [3, 2.5]],
        [[0, 0], [0.2, 2], [1, 2], [2, 1.5], [3, 4]],
        [[0, 0], [1, 3], [1.2, 2.9], [2.5, 0], [3, 0.2]],
    ],
)
def test_the_curve_through_keys_is_that_of_the_retiming(small: Page, keys: list[list[float]]) -> None:
    Charts(small, None)
    wanted = PchipInterpolator(*np.transpose(keys)) if len(keys) > 2 else None
    times = np.linspace(keys[0][0], keys[-1][0], 50)
    drawn = small.evaluate("([keys, times]) => times.map(mixseqChartParts.monotone(keys))", [keys, times.tolist()])
    if wanted is None:
        np.testing.assert_allclose(drawn, np.stack([1 + 2 * times, np.full(50, 2.0)], axis=1), atol=1e-12)
    else:
        np.testing.assert_allclose(drawn, np.stack([wanted(times), wanted(times, 1)], axis=1), atol=1e-12)


@pytest.mark.parametrize(
    ("low", "high", "most", "labels"),
    [
        (0, 1, 6, ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]),
        (-0.3, 0.31, 3, ["\u22120.2", "0.0", "0.2"]),
        (97, 1203, 4, ["500", "1000"]),
        (0, 2e-4, 3, ["0.0000", "0.0001", "0.0002"]),
    ],
)
def test_ticks_are_round(small: Page, low: float, high: float, most: int, labels: list[str]) -> None:
    Charts(small, None)
    written = small.evaluate(
        "(asked) => { const { values, write } = mixseqChartParts.ticks(...asked); return values.map(write) }",
        [low, high, most],
    )
    assert written == labels


def test_models_that_hardly_are(charts: Charts, signals: dict[str, Any]) -> None:
    """One frame; no modes; nothing to drag: no errors, and back again."""
    single = {
        **dict.fromkeys(("start", "end", "reach"), 0.0),
        **{"times": [0.0], "frameTimes": [0.0], "path": [[0, 0]], "frames": [[0, 0]]},
        **{"handles": [], "coefficients": [], "keys": []},
    }
    charts.show(single)
    charts.drag((100, 100), (WIDTH / 2, HEIGHT / 4))
    charts.page.mouse.dblclick(WIDTH / 2, HEIGHT - 60)
    charts.show(signals)
    assert len(charts.ask("handlePixels()")) == len(signals["handles"])


def test_touch(charts: Charts) -> None:
    """Fingers drag too, and need not be as exact as a mouse."""
    x, y = charts.ask("handlePixels()")[5]
    touch = charts.page.context.new_cdp_session(charts.page)
    for kind, place in (("Start", (x + 9, y + 9)), ("Move", (x + 30, y)), ("Move", (x + 49, y + 9)), ("End", None)):
        points = [{"x": place[0], "y": place[1]}] if place else []
        touch.send("Input.dispatchTouchEvent", {"type": f"touch{kind}", "touchPoints": points})
    charts.settle()
    last = charts.told("drag")[-1]
    assert last["done"] and apart(charts.pixel(last["to"]), (x + 40, y)) < 1


COLOURS = """(frames) => {
  const canvas = document.querySelector("canvas");
  const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  const seen = new Set(), name = (rgb) => rgb.join();
  for (let k = 0; k < data.length; k += 4) if (data[k + 3] === 255) seen.add(name(data.subarray(k, k + 3)));
  const dots = [...Array(frames).keys()].map((k) => mixseqChartParts.viridis(k / (frames - 1)).match(/[0-9]+/g));
  const now = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16));
  return {
    dots: dots.filter((each) => seen.has(name(each))).length,
    light: seen.has(name(now(mixseqChartParts.LIGHT.now))),
    dark: seen.has(name(now(mixseqChartParts.DARK.now))),
  };
}"""


@pytest.mark.parametrize(
    ("width", "height", "scale", "dark"),
    [(380, 760, 2, False), (1000, 640, 1, True)],
    ids=["narrow, light", "wide, dark"],
)
def test_pictures(
    new_page: NewPage, signals: dict[str, Any], keep: Keep, width: int, height: int, scale: int, dark: bool
) -> None:
    page = new_page(width, height, scale)
    page.set_content(PAGE)
    charts = Charts(page, signals, editable=True, dark=dark)
    page.evaluate("() => charts.at(0.2)")
    charts.settle()
    canvases = page.evaluate(
        "() => [...document.querySelectorAll('canvas')].map((c) => [c.width, c.clientWidth, c.height, c.clientHeight])"
    )
    assert len(canvases) == 3
    for pixels_across, across, pixels_down, down in canvases:  # sharp, and of a size that can be used
        assert abs(pixels_across - scale * across) <= 1 and abs(pixels_down - scale * down) <= 1
        assert across > 300 and down > 90
    count = len(signals["frames"])
    seen = page.evaluate(COLOURS, count)
    assert seen["dots"] >= count / 2  # some are under handles
    assert seen["dark" if dark else "light"] and not seen["light" if dark else "dark"]  # the present
    keep(page, f"charts-{'dark' if dark else 'light'}-{width}x{height}@{scale}")


def test_charts_follow_the_size(charts: Charts) -> None:
    before = charts.ask("handlePixels()")
    charts.page.set_viewport_size({"width": 700, "height": 400})
    charts.settle()
    wide = charts.ask("handlePixels()")
    assert np.max(wide, axis=0)[0] < 350 and np.max(wide, axis=0)[1] < 400
    assert np.ptp(wide, axis=0).max() != pytest.approx(np.ptp(before, axis=0).max(), rel=0.01)
    charts.drag(wide[5], (wide[5][0] + 20, wide[5][1]))
    assert charts.told("drag")[-1]["done"]
    charts.page.set_viewport_size({"width": WIDTH, "height": HEIGHT})
    charts.settle()
    assert np.ptp(charts.ask("pathPixels()"), axis=0).max() > 0.7 * WIDTH
