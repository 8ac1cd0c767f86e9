"""Implement the command ``mixseq blender``."""

from __future__ import annotations

from pathlib import Path

import click

from mixseq.cli import options
from mixseq.cli.files import Claim
from mixseq.cli.group import announce
from mixseq.cli.options import option, setting

PLATFORMS = ("linux-x64", "macos-arm64", "windows-x64")
RELEASES = ("4.2", "5.1")


@options.command(
    "blender",
    "mixseq blender --out extensions",
    "mixseq blender --set blender=5.1 --set platform=windows-x64",
    out=option(
        "--out",
        "Folder for the extension, made if missing.  [default: this one]",
        type=options.FILE_PATH,
        default=Path(),
        show_default=False,
    ),
    platforms=setting(
        "--platform",
        "Where Blender runs; may be given several times.  [default: as here]",
        type=click.Choice(PLATFORMS),
        multiple=True,
    ),
    release=setting(
        "--blender",
        "Oldest version: 4.2 is for those to 5.0, which have Python 3.11.",
        type=click.Choice(RELEASES),
        default=RELEASES[0],
    ),
)
def command(out: Path, platforms: tuple[str, ...], release: str, claim: Claim) -> None:
    """Write an extension with which Blender shows models, live.

    The archive holds an add-on, mixseq, and the libraries that decode models, which pip downloads. Install it
    in Blender with Edit > Preferences > Get Extensions > Install from Disk.
    """
    from mixseq.blender.extension import RELEASES, archive_name, this_platform, write_extension

    out.mkdir(parents=True, exist_ok=True)
    targets = {out / archive_name(name, RELEASES[release]): name for name in platforms or (this_platform(),)}
    claim(*targets)
    for path, name in targets.items():
        write_extension(path, name, RELEASES[release])
        announce(path)
