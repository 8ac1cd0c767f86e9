"""Contrast of text and its ground on pages, visible focus, and reduced motion."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from mixseq.viewer.page import read_script

SITE = Path(__file__).parents[2] / "scripts" / "site" / "assets" / "site.css"

PAIRS = {
    "page.css": [("ink", "page"), ("ink", "raised"), ("quiet", "page"), ("quiet", "raised"), ("accent", "page")],
    "chart_pane.js": [("ink", "background"), ("quiet", "background"), ("background", "now")],
}
"""Text and what it is on, of each style sheet."""


def schemes(name: str) -> list[dict[str, str]]:
    """The colours of a style sheet by name, light and dark."""
    text = read_script(name)
    blocks = re.findall(r":root \{([^}]*)\}|parts\.(?:LIGHT|DARK) = \{([^}]*)\}", text)
    found = [dict(re.findall(r"(\w+): \"?(#[0-9a-f]{6})", css or script)) for css, script in blocks]
    assert len(found) == 2
    return found


def luminance(colour: str) -> float:
    """Relative luminance (WCAG 2.2)."""
    shares = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    r, g, b = (share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4 for share in shares)
    return 0.2126 * r + 0.7152 * g + 0.0722 * b


def contrast(one: str, other: str) -> float:
    dark, light = sorted(map(luminance, (one, other)))
    return (light + 0.05) / (dark + 0.05)


def test_contrast_in_closed_form() -> None:
    assert contrast("#000000", "#ffffff") == pytest.approx(21)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.01)


@pytest.mark.parametrize("name", PAIRS)
def test_text_can_be_read(name: str) -> None:
    for scheme in schemes(name):
        for text, ground in PAIRS[name]:
            assert contrast(scheme[text], scheme[ground]) >= 4.5, (text, ground, scheme)


def test_text_of_the_live_page_can_be_read() -> None:
    style = read_script("live_window.js")
    found = [
        re.findall(r"(?<![-\w])(?:color|background): (#[0-9a-f]{3,6})", block)
        for block in re.findall(r"\{([^}]*)\}", style)
    ]
    pairs = [tuple(pair) for pair in found if len(pair) == 2]
    assert len(pairs) >= 3  # of the shortcuts, and of the time line, light and dark
    for pair in pairs:
        assert (
            contrast(
                *(colour if len(colour) == 7 else "#" + "".join(2 * digit for digit in colour[1:]) for colour in pair)
            )
            >= 4.5
        )
    light, dark = schemes("chart_pane.js")  # numbers of frames stand on the time line
    grounds = re.findall(r"#mixseq-timeline[^}]*background: (#[0-9a-f]{6})", style)
    for scheme, ground in zip((light, dark), grounds, strict=True):
        assert contrast(scheme["quiet"], ground) >= 4.5


def test_focus_is_visible_and_motion_may_be_reduced() -> None:
    styles = [read_script("page.css"), read_script("live_window.js"), SITE.read_text(encoding="utf-8")]
    assert all(":focus-visible" in style for style in styles)
    assert "outline: none" not in "".join(styles)
    for style in styles:
        moves = re.search(r"transition|animation", style)
        assert not moves or "prefers-reduced-motion" in style
    assert "prefers-reduced-motion" in read_script("player.js")  # does not play at once then
