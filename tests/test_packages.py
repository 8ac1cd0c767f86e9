"""Releases: what is required, what is in the source distribution and the wheel, and that the wheel works on its own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import zipfile
from dataclasses import dataclass
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import mixseq
from mixseq.sequence.sequence import MeshSequence

ROOT = Path(__file__).parents[1]

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

OURS = {".ci", ".gitignore"}
"""What is for work on the project only."""

CLEAN = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "COV_"))}


def run(*command: str | Path, folder: Path, **more: str) -> str:
    done = subprocess.run(command, cwd=folder, env=CLEAN | more, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout


def required(*without: str) -> list[Requirement]:
    """What the project requires, with all extras but some."""
    extras = [each for name, some in PROJECT["optional-dependencies"].items() if name not in without for each in some]
    found = [Requirement(each) for each in [*PROJECT["dependencies"], *extras]]
    return [each for each in found if each.name != "mixseq"]


def test_the_lock_has_what_is_required() -> None:
    lines = (ROOT / "scripts/requirements.lock").read_text().splitlines()
    locked = [Requirement(line.rstrip(" \\")) for line in lines if line[:1].isalnum()]
    for wanted in required("bench"):
        versions = [
            str(each.specifier).removeprefix("==")
            for each in locked
            if canonicalize_name(each.name) == canonicalize_name(wanted.name)
        ]
        assert versions and all(map(wanted.specifier.contains, versions)), wanted


def test_the_oldest_versions_are_lower_bounds() -> None:
    printed = run(sys.executable, "-m", "scripts.oldest", folder=ROOT).splitlines()
    oldest = {name: version for name, _, version in (line.partition("==") for line in printed)}
    bounds = {each.name: str(each.specifier) for each in required("bench", "dev", "docs")}
    assert oldest.keys() == bounds.keys()
    assert all(f">={oldest[name]}" in bounds[name].split(",") for name in oldest)


@dataclass(frozen=True)
class Built:
    """The source distribution, unpacked, and a wheel built of nothing else."""

    source: Path
    wheel: Path

    @property
    def installed(self) -> set[str]:
        """Files in the wheel, without its metadata."""
        with zipfile.ZipFile(self.wheel) as archive:
            return {name for name in archive.namelist() if ".dist-info/" not in name}


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Built:
    folder = tmp_path_factory.mktemp("dist")
    build = (sys.executable, "-m", "hatchling", "build", "--directory", folder, "--target")
    run(*build, "sdist", folder=ROOT)
    with tarfile.open(next(folder.glob("*.tar.gz"))) as archive:
        archive.extraction_filter = getattr(tarfile, "data_filter", None)  # from Python 3.11.4 on
        archive.extractall(folder)
    source = folder / f"mixseq-{mixseq.__version__}"
    run(*build, "wheel", folder=source, PYTHONDONTWRITEBYTECODE="1")
    return Built(source, next(folder.glob("*.whl")))


@pytest.fixture(scope="module")
def tracked() -> set[str]:
    """Files of the project, as git knows them."""
    if not (ROOT / ".git").exists() or not shutil.which("git"):
        pytest.skip("there is no git, to tell what belongs to the project")
    names = run("git", "ls-files", "-z", folder=ROOT).rstrip("\0").split("\0")
    return {name for name in names if (ROOT / name).exists()}


@pytest.mark.slow
def test_the_source_has_every_file_of_the_project(built: Built, tracked: set[str]) -> None:
    inside = {path.relative_to(built.source).as_posix() for path in built.source.rglob("*") if path.is_file()}
    assert {name for name in tracked if name.split("/")[0] not in OURS} <= inside
    assert inside - tracked == {"PKG-INFO"}


@pytest.mark.slow
def test_the_wheel_has_both_packages_and_nothing_else(built: Built, tracked: set[str]) -> None:
    names = {name.removeprefix("io/") for name in tracked}
    assert built.installed == {name for name in names if name.startswith(("mixseq/", "mixseq_io/"))}


@pytest.mark.slow
def test_the_wheel_works_on_its_own(built: Built, tmp_path: Path, bent_bar: MeshSequence) -> None:
    """It is installed beside nothing but what it requires, as here, and used from a folder that is not ours."""
    run(sys.executable, "-m", "venv", "--without-pip", "env", folder=tmp_path)
    paths = sysconfig.get_paths(vars={"base": str(tmp_path / "env"), "platbase": str(tmp_path / "env")})
    programs, packages = Path(paths["scripts"]), Path(paths["purelib"])
    (packages / "required.pth").write_text(sysconfig.get_path("purelib"))  # this one's .pth, of ours, is not read
    pip = (sys.executable, "-m", "pip", "--python", programs / "python")
    run(*pip, "install", "--no-deps", "--no-index", "--no-compile", built.wheel, folder=tmp_path)
    shown = run(
        programs / "python",
        "-c",
        "import mixseq, mixseq_io; print(mixseq.__file__, mixseq_io.__file__, mixseq.__version__)",
        folder=tmp_path,
    )
    files = [str(packages / name / "__init__.py") for name in ("mixseq", "mixseq_io")]
    assert shown.split() == [*files, mixseq.__version__]
    mixseq.write(tmp_path / "bar.usdc", bent_bar)  # read by a process of its own, which has to find our modules
    interpreted = {"NUMBA_DISABLE_JIT": "1"}  # nothing is compiled yet, and the bar is small
    run(programs / "mixseq", "encode", "bar.usdc", "bar.h5", "--space", "vertex", folder=tmp_path, **interpreted)
    assert mixseq.load(tmp_path / "bar.h5").header.vertex_count == bent_bar.vertex_count
