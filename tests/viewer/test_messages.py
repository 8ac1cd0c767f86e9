"""What pages say is believed where it makes sense, and harmless where it does not."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixseq.viewer.session import LARGEST, MOST_POINTS, Drag, Drawn, Message, Retime, Seek, Sketch, message_of

numbers = st.floats(-LARGEST, LARGEST) | st.integers(-int(LARGEST), int(LARGEST))
pairs = st.tuples(numbers, numbers).map(list)
scalars = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5)
values = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=12,
)
names = ("time", "to", "done", "points", "keys", "frame", "from")
nearly = st.fixed_dictionaries(
    {"kind": st.sampled_from(["drawn", "seek", "drag", "sketch", "retime"]) | scalars},
    optional={name: values | pairs | st.lists(pairs, max_size=3) for name in names},
)
"""Objects that may, or may not, be messages."""


def arrays(message: Message) -> list[Any]:
    """Every number of a message."""
    return [np.asarray(value) for value in vars(message).values()]


@given(numbers)
def test_seek(time: float) -> None:
    said = message_of(json.dumps({"kind": "seek", "time": time}))
    assert isinstance(said, Seek)
    assert said.time == time


@pytest.mark.parametrize("time", [1.001 * LARGEST, -1e308, 10**400])
def test_nothing_is_so_far_away(time: float) -> None:
    assert message_of(json.dumps({"kind": "seek", "time": time})) is None


@given(numbers, pairs, st.booleans())
def test_drag(time: float, to: list[float], done: bool) -> None:
    said = message_of(json.dumps({"kind": "drag", "time": time, "to": to, "done": done}))
    assert isinstance(said, Drag)
    assert (said.time, said.to.tolist(), said.done) == (time, to, done)


@given(st.lists(pairs, min_size=1))
def test_sketch(points: list[list[float]]) -> None:
    said = message_of(json.dumps({"kind": "sketch", "points": points}))
    assert isinstance(said, Sketch)
    assert said.points.tolist() == points


@given(st.lists(pairs, min_size=1), st.booleans())
def test_retime(keys: list[list[float]], done: bool) -> None:
    said = message_of(json.dumps({"kind": "retime", "keys": keys, "done": done}))
    assert isinstance(said, Retime)
    assert (said.keys.tolist(), said.done) == (keys, done)


def test_drawn_and_what_else_the_page_adds() -> None:
    assert message_of('{"kind": "drawn", "frame": 3}') == Drawn()
    assert message_of('{"kind": "seek", "time": 2, "from": "ab12", "number": 7}') == Seek(2.0)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "drawn",
        "null",
        "[]",
        "7",
        '"drawn"',
        "{}",
        '{"kind": "explode"}',
        '{"kind": ["drawn"]}',
        '{"kind": "seek"}',
        '{"kind": "seek", "time": null}',
        '{"kind": "seek", "time": true}',
        '{"kind": "seek", "time": "1"}',
        '{"kind": "seek", "time": NaN}',
        '{"kind": "seek", "time": -Infinity}',
        '{"kind": "seek", "time": 1e999}',
        f'{{"kind": "seek", "time": {10**400}}}',
        f'{{"kind": "seek", "time": {"1" * 10_000}}}',
        '{"kind": "drag", "time": 1, "to": [1, 2]}',
        '{"kind": "drag", "time": 1, "to": [1, 2], "done": 1}',
        '{"kind": "drag", "time": 1, "to": [1, 2, 3], "done": true}',
        '{"kind": "drag", "time": 1, "to": [[1, 2]], "done": true}',
        '{"kind": "drag", "time": 1, "to": [1, NaN], "done": true}',
        '{"kind": "drag", "time": NaN, "to": [1, 2], "done": true}',
        '{"kind": "drag", "time": 1, "to": {"0": 1, "1": 2}, "done": true}',
        '{"kind": "sketch", "points": []}',
        '{"kind": "sketch", "points": [1, 2]}',
        '{"kind": "sketch", "points": [[1, 2], [3]]}',
        '{"kind": "sketch", "points": [[1, 2], [3, false]]}',
        '{"kind": "sketch", "points": "12"}',
        '{"kind": "retime", "keys": [[1, 2]], "done": null}',
        '{"kind": "retime", "keys": [[1, Infinity]], "done": true}',
        "[" * 100_000,
        '{"kind": ' * 50_000,
    ],
    ids=lambda text: text[:40],
)
def test_nonsense(text: str) -> None:
    assert message_of(text) is None


@pytest.mark.parametrize("value", [None, 7, ["drawn"], b"\xff"])
def test_no_text_at_all(value: Any) -> None:
    assert message_of(value) is None


@pytest.mark.parametrize(("kind", "name"), [("sketch", "points"), ("retime", "keys")])
def test_limits(kind: str, name: str) -> None:
    said = {"kind": kind, "done": True}
    assert message_of(json.dumps({**said, name: MOST_POINTS * [[1, 2]]})) is not None
    assert message_of(json.dumps({**said, name: (MOST_POINTS + 1) * [[1, 2]]})) is None


@given(st.text() | values.map(json.dumps) | nearly.map(json.dumps))
def test_whatever_is_said(text: str) -> None:
    said = message_of(text)
    assert said is None or isinstance(said, Message)
    for numbers in arrays(said) if said is not None else []:
        assert numbers.dtype.kind in "fb"
        assert np.isfinite(numbers).all()
