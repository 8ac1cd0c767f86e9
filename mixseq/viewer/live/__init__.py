"""Run the live viewer in a browser (extra ``viewer``): `viewer` and `marking` run a viser server behind a `guard`.

`stage` draws the 3D scene of the page; `controls` are the panels beside the scene.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mixseq.errors import MissingExtraError


@dataclass(frozen=True)
class ViewSettings:
    """Settings of the viewer."""

    host: str = "127.0.0.1"  # address to listen on; 127.0.0.1 accepts only this machine
    port: int | None = None  # port, by default the first free port from 8080 on
    folder: Path = Path()  # folder of saved motions
    threads: int = 2  # number of decoding threads
    material: str = "standard"  # "standard", or "toon5" for machines without a graphics card
    overlaid: bool = False  # whether meshes are initially overlaid, instead of side by side
    read_only: bool = False  # whether controls for editing and saving are omitted
    # Initial view: azimuth from the front of the first mesh to its left, and elevation, in degrees.
    camera: tuple[float, float] | None = None
    following: bool = False  # whether the camera initially follows moving bodies


def check_viser() -> None:
    """Raise MissingExtraError if viser is not installed."""
    try:
        import viser  # noqa: F401
    except ImportError:
        raise MissingExtraError("the viewer needs viser; get it with: pip install 'mixseq[viewer]'") from None
