"""Build the Blender extension: an archive with a manifest, the add-on's modules and wheels.

https://docs.blender.org/manual/en/latest/advanced/extensions/getting_started.html

The wheels contain the installed mixseq and the libraries that decode models. NumPy is omitted because Blender includes
NumPy, and two versions cannot be loaded together.
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
"""Libraries besides NumPy that read and decode models, without libraries of other file formats, such as usd-core."""

_WHEEL_METADATA = "Wheel-Version: 1.0\nGenerator: mixseq\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
_ZIP_TIMESTAMP = (1980, 1, 1, 0, 0, 0)
"""Modification time of all archived files, so that equal contents give equal archives."""


def build_wheel(folder: Path) -> Path:
    """Build a wheel of the installed mixseq in a folder, and return the path of the wheel."""
    name = f"mixseq-{mixseq.__version__}"
    path = folder / f"{name}-py3-none-any.whl"
    records = []
    with ZipFile(path, "w", ZIP_DEFLATED) as archive:
        for member, content in [*_package_files(), *_dist_info_files(f"{name}.dist-info")]:
            add_member(archive, member, content)
            digest = urlsafe_b64encode(sha256(content).digest()).rstrip(b"=").decode()
            records.append(f"{member},sha256={digest},{len(content)}\n")
        record = f"{name}.dist-info/RECORD"
        add_member(archive, record, "".join([*records, f"{record},,\n"]).encode())
    return path


def add_member(archive: ZipFile, name: str, content: bytes, compression: int = ZIP_DEFLATED) -> None:
    """Add a file to an archive, with a fixed modification time."""
    archive.writestr(ZipInfo(name, _ZIP_TIMESTAMP), content, compression)


def _package_files() -> Iterator[tuple[str, bytes]]:
    """Yield names and contents of the files of the packages mixseq and mixseq_io."""
    import mixseq_io

    for package in (mixseq, mixseq_io):
        folder = Path(package.__path__[0])
        for path in sorted(folder.rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                yield f"{package.__name__}/{path.relative_to(folder).as_posix()}", path.read_bytes()


def _dist_info_files(folder: str) -> Iterator[tuple[str, bytes]]:
    """Yield names and contents of the wheel's metadata and of the licence."""
    yield f"{folder}/WHEEL", _WHEEL_METADATA.encode()
    for file in _distribution().files or ():
        if file.name in ("METADATA", "LICENSE"):
            name = file.as_posix().partition(".dist-info/")[2]
            yield f"{folder}/{name}", Path(file.locate()).read_bytes()


def _distribution() -> metadata.Distribution:
    try:
        return metadata.distribution("mixseq")
    except metadata.PackageNotFoundError:
        raise OutputError(
            "mixseq is not installed, it runs from a source folder; run pip install -e . in that folder"
        ) from None


def requirements() -> list[str]:
    """Return mixseq's version requirements for `LIBRARIES`, in pip's format."""
    lines = {re.split(r"[^\w.-]", line)[0]: line for line in _distribution().requires or () if "extra ==" not in line}
    return [lines[name] for name in LIBRARIES]


def download_wheels(folder: Path, release: Release, platform: str) -> list[Path]:
    """Download with pip the wheels of `LIBRARIES` for a release and platform of Blender; return their paths."""
    options = ["--quiet", "--only-binary=:all:", "--dest", str(folder), "--python-version", release.python]
    options += [option for tag in PLATFORMS[platform] for option in ("--platform", tag)]
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "download", *options]
    process = subprocess.run([*command, release.numpy, *requirements()], capture_output=True, text=True)
    if process.returncode:
        lines = [line for line in process.stderr.splitlines() if line.strip()]
        reason = next((line for line in lines if line.startswith("ERROR")), lines[-1] if lines else "")
        raise OutputError(
            f"pip cannot download the libraries of the extension: {reason}; without a network, set PIP_FIND_LINKS to "
            "a folder with their wheels, and PIP_NO_INDEX=1"
        )
    return sorted(path for path in folder.glob("*.whl") if not path.name.startswith("numpy-"))


ADDON_FOLDER = Path(__file__).parent / "addon"

PLATFORMS = {
    "linux-x64": ("manylinux_2_28_x86_64", "manylinux_2_27_x86_64", "manylinux_2_17_x86_64", "manylinux2014_x86_64"),
    "macos-arm64": ("macosx_14_0_arm64",),
    "windows-x64": ("win_amd64",),
}
"""Platforms for which all libraries have wheels: Blender's name of the platform, and platform tags of the wheels."""


@dataclass(frozen=True)
class Release:
    """A range of Blender versions with the same Python and NumPy."""

    min_version: str
    max_version: str | None  # exclusive
    python: str
    numpy: str


RELEASES = {
    "4.2": Release("4.2.0", "5.1.0", "3.11", "numpy==1.26.4"),
    "5.1": Release("5.1.0", None, "3.13", "numpy>=2.3,<2.4"),
}


def this_platform() -> str:
    """Return Blender's name for the platform of this machine."""
    system = {"linux": "linux", "darwin": "macos", "win32": "windows"}.get(sys.platform, sys.platform)
    machine = {"x86_64": "x64", "amd64": "x64", "aarch64": "arm64"}.get(platform.machine().lower(), platform.machine())
    name = f"{system}-{machine}"
    if name not in PLATFORMS:
        raise SettingsError(f"there is no extension for {name}; choose a platform from {', '.join(PLATFORMS)}")
    return name


def archive_name(platform: str, release: Release) -> str:
    """Return the file name of an archive, such as ``mixseq-0.1.0-blender4.2-linux_x64.zip``."""
    version = release.min_version.removesuffix(".0")
    return f"mixseq-{mixseq.__version__}-blender{version}-{platform.replace('-', '_')}.zip"


def write_extension(path: Path, platform: str, release: Release) -> None:
    """Write the extension for a platform and a range of Blender versions."""
    with atomic_file(path) as temporary, TemporaryDirectory() as scratch:
        folder = Path(scratch)
        libraries = download_wheels(folder, release, platform)
        wheels = [build_wheel(folder), *libraries]
        with ZipFile(temporary, "w") as archive:
            text = manifest(platform, release, [wheel.name for wheel in wheels])
            add_member(archive, "blender_manifest.toml", text.encode())
            licence = next(content for name, content in _dist_info_files("") if name.endswith("LICENSE"))
            add_member(archive, "LICENSE", licence)
            for module in sorted(ADDON_FOLDER.glob("*.py")):
                add_member(archive, module.name, module.read_bytes())
            for wheel in wheels:  # wheels are already compressed
                add_member(archive, f"wheels/{wheel.name}", wheel.read_bytes(), ZIP_STORED)


def manifest(platform: str, release: Release, wheels: Sequence[str]) -> str:
    """Return the extension's manifest in TOML; `wheels` are file names in the folder ``wheels``."""
    max_version = f'blender_version_max = "{release.max_version}"\n' if release.max_version else ""
    return f"""\
schema_version = "1.0.0"
id = "mixseq"
version = "{mixseq.__version__}"
name = "mixseq Models"
tagline = "Deforming meshes, live at any frame and sub-frame"
maintainer = "The mixseq authors"
type = "add-on"
tags = ["Animation", "Import-Export", "Mesh"]
blender_version_min = "{release.min_version}"
{max_version}license = ["SPDX:MIT"]
copyright = ["2026 The mixseq authors"]
platforms = ["{platform}"]
wheels = {json.dumps([f"./wheels/{wheel}" for wheel in wheels], indent=2)}
[permissions]
files = "Read models, write Alembic files"
"""
