"""Run the live viewer in a browser (extra ``viewer``): `viewer` and `marking` run a viser server behind a `guard`.

`stage` draws the 3D scene of the page; `controls` are the panels beside the scene.
"""

from __future__ import annotations

from mixseq.errors import MissingExtraError


def check_viser() -> None:
    """Raise MissingExtraError if viser is not installed."""
    try:
        import viser  # noqa: F401
    except ImportError:
        raise MissingExtraError("the viewer needs viser; get it with: pip install 'mixseq[viewer]'") from None
