"""The wheels of an extension: mixseq's own, of what is installed here, and those of the libraries that decode models.

NumPy is left to Blender, which has it and would not run with two.
"""

from __future__ import annotations

import re
import subprocess
import sys
from base64 import urlsafe_b64encode
from collections.abc import Iterator, Sequence
from hashlib import sha256
from importlib import metadata
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

import mixseq
from mixseq.errors import OutputError

LIBRARIES = ("h5py", "numba", "scipy", "threadpoolctl")
"""What reading a model and decoding it imports, besides NumPy; without those for other files, as usd-core."""

_PACKAGES = ("mixseq", "mixseq_io")
_WHEEL = "Wheel-Version: 1.0\nGenerator: mixseq\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
_DATE = (1980, 1, 1, 0, 0, 0)
"""Of everything in archives, so that the same files make the same archive."""


def own_wheel(folder: Path) -> Path:
    """Write mixseq as it is installed here into a wheel, in a folder, and return its path."""
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
    """Add a file to an archive, without the time of day."""
    archive.writestr(ZipInfo(inside, _DATE), content, compression)


def licence() -> bytes:
    """Return the text of mixseq's licence."""
    return next(content for inside, content in _information("") if inside.endswith("LICENSE"))


def _modules() -> Iterator[tuple[str, bytes]]:
    from mixseq_io import __path__ as readers

    for package, folder in zip(_PACKAGES, (mixseq.__path__[0], readers[0]), strict=True):
        for path in sorted(Path(folder).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                yield f"{package}/{path.relative_to(folder).as_posix()}", path.read_bytes()


def _information(folder: str) -> Iterator[tuple[str, bytes]]:
    """Yield what a wheel tells of itself: the metadata and the licence that mixseq was installed with."""
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
    """Return which versions of `LIBRARIES` mixseq needs, as pip is told."""
    needed = {
        re.split(r"[^\w.-]", line)[0]: line
        for line in _distribution().requires or ()
        if "extra ==" not in line
    }
    return [needed[name] for name in LIBRARIES]


def download(folder: Path, python: str, numpy: str, tags: Sequence[str]) -> list[Path]:
    """Have pip download the wheels of `LIBRARIES`, and return their paths."""
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
