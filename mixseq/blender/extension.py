"""The extension that Blender installs: an archive with a manifest, modules and wheels.

https://docs.blender.org/manual/en/latest/advanced/extensions/getting_started.html
"""

from __future__ import annotations

import json
import platform
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from zipfile import ZIP_STORED, ZipFile

import mixseq
from mixseq.blender.wheels import add, download, licence, own_wheel
from mixseq.errors import SettingsError
from mixseq_io.atomic import replacing

ADDON = Path(__file__).parent / "addon"

PLATFORMS = {
    "linux-x64": (
        "manylinux_2_28_x86_64",
        "manylinux_2_27_x86_64",
        "manylinux_2_17_x86_64",
        "manylinux2014_x86_64",
    ),
    "macos-arm64": ("macosx_14_0_arm64",),
    "windows-x64": ("win_amd64",),
}
"""Platforms by Blender's names, those with wheels of all libraries, and the names in wheels."""


@dataclass(frozen=True)
class Release:
    """Properties shared by a range of Blender versions."""

    first: str
    end: str | None
    python: str
    numpy: str


RELEASES = {
    "4.2": Release("4.2.0", "5.1.0", "3.11", "numpy==1.26.4"),
    "5.1": Release("5.1.0", None, "3.13", "numpy>=2.3,<2.4"),
}


def this_platform() -> str:
    """Return Blender's name for the platform of this machine."""
    system = {"linux": "linux", "darwin": "macos", "win32": "windows"}.get(sys.platform, sys.platform)
    machine = {"x86_64": "x64", "amd64": "x64", "aarch64": "arm64"}.get(
        platform.machine().lower(), platform.machine()
    )
    name = f"{system}-{machine}"
    if name not in PLATFORMS:
        raise SettingsError(f"libraries have no wheels for {name}; platforms are {', '.join(PLATFORMS)}")
    return name


def archive_name(platform: str, release: Release) -> str:
    """Return the name of a platform's archive: ``mixseq-0.1.0-blender4.2-linux_x64.zip``."""
    short = release.first.removesuffix(".0")
    return f"mixseq-{mixseq.__version__}-blender{short}-{platform.replace('-', '_')}.zip"


def write_extension(path: Path, platform: str, release: Release) -> None:
    """Write the extension for a platform and the versions of a release."""
    with replacing(path) as temporary, TemporaryDirectory() as scratch:
        folder = Path(scratch)
        found = download(folder, release.python, release.numpy, PLATFORMS[platform])
        wheels = [own_wheel(folder), *found]
        with ZipFile(temporary, "w") as archive:
            add(
                archive,
                "blender_manifest.toml",
                manifest(platform, release, [each.name for each in wheels]).encode(),
            )
            add(archive, "LICENSE", licence())
            for module in sorted(ADDON.glob("*.py")):
                add(archive, module.name, module.read_bytes())
            for wheel in wheels:  # they are compressed themselves
                add(archive, f"wheels/{wheel.name}", wheel.read_bytes(), ZIP_STORED)


def manifest(platform: str, release: Release, wheels: Sequence[str]) -> str:
    """Return the manifest of the extension in TOML; `wheels` are names of files in the folder ``wheels``."""
    return "".join(f"{line}\n" for line in _lines(platform, release, wheels))


def _lines(platform: str, release: Release, wheels: Sequence[str]) -> Iterator[str]:
    yield 'schema_version = "1.0.0"'
    yield 'id = "mixseq"'
    yield f'version = "{mixseq.__version__}"'
    yield 'name = "mixseq Models"'
    yield 'tagline = "Deforming meshes, live at any frame and sub-frame"'
    yield 'maintainer = "The mixseq authors"'
    yield 'type = "add-on"'
    yield 'tags = ["Animation", "Import-Export", "Mesh"]'
    yield f'blender_version_min = "{release.first}"'
    if release.end:
        yield f'blender_version_max = "{release.end}"'
    yield 'license = ["SPDX:MIT"]'
    yield 'copyright = ["2026 The mixseq authors"]'
    yield f'platforms = ["{platform}"]'
    yield f"wheels = {json.dumps([f'./wheels/{wheel}' for wheel in wheels], indent=2)}"
    yield "[permissions]"
    yield 'files = "Read models, write Alembic files"'
