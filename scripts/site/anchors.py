"""Anchors of headings, as GitHub makes them, so that links work in both places."""

from __future__ import annotations

import re


def anchor(heading: str, separator: str = "-") -> str:
    """Return the anchor of a heading."""
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", separator)
