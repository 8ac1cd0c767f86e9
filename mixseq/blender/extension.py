"""The extension that Blender installs: an archive with a manifest, modules and wheels.

https://docs.blender.org/manual/en/latest/advanced/extensions/getting_started.html

The wheels are mixseq's own, of the installed package, and those of the libraries that decode models. NumPy is left to
Blender, which has it and would not run with two.
"""

from __future__ import annotations

import json
import platform
import re
import subprocess
import sys
from base64 import urlsafe_b64encode
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from hashlib import sha256
from importlib import metadata
from pathlib import Path
from tempfile import TemporaryDirectory
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile, ZipInfo

import mixseq
from mixseq.errors import OutputError, SettingsError
from mixseq_io.files import atomic_file

LIBRARIES = ("h5py", "numba", "scipy", "threadpoolctl")
"""Imports of reading and decoding a model, besides NumPy; without those for other files, as usd-core."""

_PACKAGES = ("mixseq", "mixseq_io")
_WHEEL = "Wheel-Version: 1.0\nGenerator: mixseq\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
_DATE = (1980, 1, 1, 0, 0, 0)
"""Date of all files in archives, so that equal files make equal archives."""


def own_wheel(folder: Path) -> Path:
    """Write the installed mixseq as a wheel in a folder, and return its path."""
    name = f"mixseq-{mixseq.__version__}"
    path = folder / f"{name}-py3-none-any.whl"
    records = []
    with ZipFile(path, "w", ZIP_DEFLATED) as archive:
        for inside, content in [*_modules(), *_information(f"{name}.dist-info")]:
            add(archive, inside, content)
            digest = urlsafe_b64encode(sha256(content).digest()).rstrip(b"=").decode()
            records.append(f"{inside},sha256={digest},{len(content)}\n")
        record = f"{name}.dist-info/RECORD"
        add(archive, record, "".join([*records, f"{record},,\n"]).encode())
    return path


def add(archive: ZipFile, inside: str, content: bytes, compression: int = ZIP_DEFLATED) -> None:
    """Add a file to an archive, with a fixed date."""
    archive.writestr(ZipInfo(inside, _DATE), content, compression)


def _modules() -> Iterator[tuple[str, bytes]]:
    from mixseq_io import __path__ as readers

    for package, folder in zip(_PACKAGES, (mixseq.__path__[0], readers[0]), strict=True):
        for path in sorted(Path(folder).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                yield f"{package}/{path.relative_to(folder).as_posix()}", path.read_bytes()


def _information(folder: str) -> Iterator[tuple[str, bytes]]:
    """Yield the metadata and the licence of the installed mixseq, for a wheel."""
    yield f"{folder}/WHEEL", _WHEEL.encode()
    for file in _distribution().files or ():
        if file.name in ("METADATA", "LICENSE"):
            inside = file.as_posix().partition(".dist-info/")[2]
            yield f"{folder}/{inside}", Path(file.locate()).read_bytes()


def _distribution() -> metadata.Distribution:
    try:
        return metadata.distribution("mixseq")
    except metadata.PackageNotFoundError:
        raise OutputError(
            "mixseq runs from a folder and is not installed; run pip install -e . in it"
        ) from None


def requirements() -> list[str]:
    """Return the requirements of `LIBRARIES` in mixseq, in pip's format."""
    needed = {
        re.split(r"[^\w.-]", line)[0]: line
        for line in _distribution().requires or ()
        if "extra ==" not in line
    }
    return [needed[name] for name in LIBRARIES]


def download(folder: Path, python: str, numpy: str, tags: Sequence[str]) -> list[Path]:
    """Download the wheels of `LIBRARIES` with pip, and return their paths."""
    words = ["download", "--quiet", "--only-binary=:all:", "--dest", str(folder), "--python-version", python]
    words += [word for tag in tags for word in ("--platform", tag)]
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", *words, numpy, *requirements()]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if line.strip()]
        said = next((line for line in lines if line.startswith("ERROR")), lines[-1] if lines else "")
        raise OutputError(
            f"pip cannot download the libraries that the extension needs: {said}; without a network, name a folder "
            "that has their wheels in PIP_FIND_LINKS, and set PIP_NO_INDEX=1"
        )
    return sorted(path for path in folder.glob("*.whl") if not path.name.startswith("numpy-"))


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
    with atomic_file(path) as temporary, TemporaryDirectory() as scratch:
        folder = Path(scratch)
        found = download(folder, release.python, release.numpy, PLATFORMS[platform])
        wheels = [own_wheel(folder), *found]
        with ZipFile(temporary, "w") as archive:
            text = manifest(platform, release, [each.name for each in wheels])
            add(archive, "blender_manifest.toml", text.encode())
            licence = next(content for inside, content in _information("") if inside.endswith("LICENSE"))
            add(archive, "LICENSE", licence)
            for module in sorted(ADDON.glob("*.py")):
                add(archive, module.name, module.read_bytes())
            for wheel in wheels:  # they are compressed themselves
                add(archive, f"wheels/{wheel.name}", wheel.read_bytes(), ZIP_STORED)


def manifest(platform: str, release: Release, wheels: Sequence[str]) -> str:
    """Return the manifest of the extension in TOML; `wheels` are names of files in the folder ``wheels``."""
    end = f'blender_version_max = "{release.end}"\n' if release.end else ""
    return f"""\
schema_version = "1.0.0"
id = "mixseq"
version = "{mixseq.__version__}"
name = "mixseq Models"
tagline = "Deforming meshes, live at any frame and sub-frame"
maintainer = "The mixseq authors"
type = "add-on"
tags = ["Animation", "Import-Export", "Mesh"]
blender_version_min = "{release.first}"
{end}license = ["SPDX:MIT"]
copyright = ["2026 The mixseq authors"]
platforms = ["{platform}"]
wheels = {json.dumps([f"./wheels/{wheel}" for wheel in wheels], indent=2)}
[permissions]
files = "Read models, write Alembic files"
"""
