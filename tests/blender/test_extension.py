"""The archive that Blender installs: what its manifest says, and what is in it."""

from __future__ import annotations

import csv
import re
import subprocess
import sys
import tomllib
import zipfile
from base64 import urlsafe_b64encode
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

import mixseq
from mixseq.blender import extension
from mixseq.blender.extension import ADDON_FOLDER, PLATFORMS, RELEASES, Release, archive_name, manifest, this_platform
from mixseq.cli import blender, main
from mixseq.errors import OutputError, SettingsError

LIBRARY = "h5py-3.16.0-cp311-cp311-manylinux_2_28_x86_64.whl"


@pytest.fixture
def downloaded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have pip download one wheel."""

    def download_wheels(folder: Path, release: Release, platform: str) -> list[Path]:
        (folder / LIBRARY).write_bytes(b"a wheel")
        return [folder / LIBRARY]

    monkeypatch.setattr(extension, "download_wheels", download_wheels)


@pytest.fixture
def archive(downloaded: None, tmp_path: Path) -> zipfile.ZipFile:
    path = tmp_path / "mixseq.zip"
    extension.write_extension(path, "linux-x64", RELEASES["4.2"])
    return zipfile.ZipFile(path)


def read_manifest(release: Release) -> dict[str, Any]:
    return tomllib.loads(manifest("linux-x64", release, [LIBRARY]))


@pytest.mark.parametrize("release", RELEASES.values(), ids=RELEASES)
def test_the_manifest_has_the_fields_blender_requires(release: Release) -> None:
    found = read_manifest(release)
    assert found["schema_version"] == "1.0.0"
    assert found["type"] == "add-on"
    assert re.fullmatch(r"[a-z][a-z0-9_]*", found["id"])
    assert re.fullmatch(r"\d+\.\d+\.\d+", found["version"])
    assert found["version"] == mixseq.__version__
    assert len(found["tagline"]) <= 64
    assert found["tagline"][-1].isalnum()
    assert "Blender" not in found["name"]  # terms of extensions.blender.org
    assert {"name", "maintainer"} <= found.keys()
    assert found["license"] == ["SPDX:MIT"]
    assert found["wheels"] == [f"./wheels/{LIBRARY}"]
    assert all(0 < len(reason) <= 64 and reason[-1].isalnum() for reason in found["permissions"].values())


def test_releases_follow_each_other() -> None:
    first, last = RELEASES.values()
    assert read_manifest(first)["blender_version_max"] == read_manifest(last)["blender_version_min"]
    assert "blender_version_max" not in read_manifest(last)


def test_the_archive_holds_all_that_its_manifest_names(archive: zipfile.ZipFile) -> None:
    inside = set(archive.namelist())
    found = tomllib.loads(archive.read("blender_manifest.toml").decode())
    named = {wheel.removeprefix("./") for wheel in found["wheels"]}
    assert inside == {"blender_manifest.toml", "LICENSE", *(each.name for each in ADDON_FOLDER.glob("*.py")), *named}
    assert archive.read("LICENSE").startswith(b"MIT License")
    assert archive.read(f"wheels/{LIBRARY}") == b"a wheel"


def test_the_same_archive_is_made_twice(downloaded: None, tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ("one.zip", "two.zip")]
    for path in paths:
        extension.write_extension(path, "linux-x64", RELEASES["4.2"])
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_the_wheel_matches_its_record(tmp_path: Path) -> None:
    with zipfile.ZipFile(extension.build_wheel(tmp_path)) as wheel:
        records = csv.reader(wheel.read(f"mixseq-{mixseq.__version__}.dist-info/RECORD").decode().splitlines())
        rows = {name: digest for name, digest, _ in records}
        assert rows.keys() == set(wheel.namelist())
        for name, digest in rows.items():
            if digest:
                plain = urlsafe_b64encode(sha256(wheel.read(name)).digest()).decode().rstrip("=")
                assert digest == f"sha256={plain}"
    assert {"mixseq/__init__.py", "mixseq_io/model_files.py"} <= rows.keys()
    assert {name.rpartition("/")[2] for name in rows if "dist-info" in name} >= {"METADATA", "WHEEL", "LICENSE"}


def test_the_wheel_decodes_models_with_only_its_libraries(tmp_path: Path) -> None:
    """Any other import would have to be bundled as well."""
    path = extension.build_wheel(tmp_path)
    code = """
import sys, mixseq
for path in sys.argv[1:]:
    mixseq.load(path)(0)
print(*sorted({name.partition('.')[0] for name in sys.modules}))
"""
    golden = Path(__file__).parents[1] / "formats/golden"
    words = [sys.executable, "-c", code, *(str(golden / name) for name in ("model-v1.h5", "compressed-v1-uvs.h5"))]
    environment = {"PYTHONPATH": str(path), "NUMBA_DISABLE_JIT": "1"}  # nothing compiled can be kept in an archive
    done = subprocess.run(words, env=environment, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    others = {"click", "rich", "trimesh", "pxr", "matplotlib", "dask", "alembic3d", "viser"}
    assert not others & set(done.stdout.split())


def test_libraries_are_among_what_mixseq_requires() -> None:
    assert [re.split(r"[^\w.-]", line)[0] for line in extension.requirements()] == list(extension.LIBRARIES)


def test_errors_of_pip_are_reported(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path))
    with pytest.raises(OutputError, match=r"pip cannot download the libraries .*PIP_FIND_LINKS"):
        extension.download_wheels(tmp_path, RELEASES["4.2"], "windows-x64")


def test_platforms_are_named_as_blender_names_them(monkeypatch: pytest.MonkeyPatch) -> None:
    for system, machine, name in (("linux", "x86_64", "linux-x64"), ("darwin", "arm64", "macos-arm64")):
        monkeypatch.setattr(sys, "platform", system)
        monkeypatch.setattr("platform.machine", lambda machine=machine: machine)
        assert this_platform() == name
    monkeypatch.setattr("platform.machine", lambda: "riscv64")
    with pytest.raises(SettingsError, match=r"no extension for macos-riscv64; choose a platform from linux-x64"):
        this_platform()


def test_the_command_offers_what_there_is() -> None:
    assert tuple(PLATFORMS) == blender.PLATFORMS
    assert tuple(RELEASES) == blender.RELEASES


def test_the_command_writes_an_archive_for_each_platform(downloaded: None, tmp_path: Path) -> None:
    words = ["blender", "--out", str(tmp_path / "new"), "--platform", "linux-x64", "--platform", "windows-x64"]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0, done.output
    names = {archive_name(each, RELEASES["4.2"]) for each in ("linux-x64", "windows-x64")}
    assert {each.name for each in (tmp_path / "new").iterdir()} == names
