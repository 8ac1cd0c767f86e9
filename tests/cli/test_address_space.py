"""Little address space: one line, before libraries crash."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from mixseq.cli import group
from mixseq.cli.group import FLOOR, exit_code, is_short_of_memory, make_do
from mixseq.errors import SettingsError


@pytest.fixture
def limited(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Give the process little more than the floor."""
    monkeypatch.setattr(os, "environ", dict(os.environ))
    os.environ.pop("MIXSEQ_THREADS", None)
    monkeypatch.setattr("resource.getrlimit", lambda _: (FLOOR + 1, FLOOR + 1))
    return monkeypatch


def test_one_thread_where_there_is_a_limit(limited: pytest.MonkeyPatch) -> None:
    limited.setitem(os.environ, "OPENBLAS_NUM_THREADS", "3")
    make_do()
    assert (os.environ["MIXSEQ_THREADS"], os.environ["OPENBLAS_NUM_THREADS"]) == ("1", "3")


def test_nothing_changes_without_one(limited: pytest.MonkeyPatch) -> None:
    limited.setattr("resource.getrlimit", lambda _: (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    make_do()
    assert "MIXSEQ_THREADS" not in os.environ
    assert not is_short_of_memory(RuntimeError("can't start new thread"))


def test_too_little(limited: pytest.MonkeyPatch) -> None:
    limited.setattr("resource.getrlimit", lambda _: (300 << 20, -1))
    with pytest.raises(
        SettingsError, match=r"limited to 300 MiB \(ulimit -v\), .* need 2000 MiB .*; raise the limit"
    ):
        make_do()


@pytest.mark.usefixtures("limited")
@pytest.mark.parametrize(
    "error",
    [
        RuntimeError("can't start new thread"),
        ImportError("numpy.so: failed to map segment from shared object"),
        OSError("Could not find/load shared object file 'libllvmlite.so' from resource location\nand more"),
    ],
)
def test_errors_that_are_for_want_of_memory(error: Exception, capsys: pytest.CaptureFixture[str]) -> None:
    def fail() -> None:
        raise error

    assert exit_code(fail) == 2
    said = capsys.readouterr().err
    assert said == f"mixseq: error: there is not enough memory ({str(error).splitlines()[0]})\n"


@pytest.mark.usefixtures("limited")
def test_other_errors_are_bugs() -> None:
    def fail() -> None:
        raise RuntimeError("odd")

    with pytest.raises(RuntimeError, match="odd"):
        exit_code(fail)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not limit it")
@pytest.mark.parametrize(("line", "code"), [("formats", 2), ("formats --help", 0)])
def test_in_a_process(tmp_path: Path, line: str, code: int) -> None:
    ended = subprocess.run(
        [sys.executable, "-m", "mixseq", *line.split()],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (group.FLOOR // 4,) * 2),
        capture_output=True,
        text=True,
        timeout=60,
        cwd=tmp_path,
        check=False,
    )
    assert ended.returncode == code
    assert len(ended.stderr.splitlines()) == (1 if code else 0)
