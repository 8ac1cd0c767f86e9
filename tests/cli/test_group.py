"""What commands say when something is wrong: one line, exit code 2, and every file as it was."""

from __future__ import annotations

import ctypes
import os
import re
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NoReturn

import click
import pytest
from click.testing import Result

import mixseq
from mixseq.cli import group
from mixseq.cli.group import MIN_ADDRESS_SPACE, exit_code, is_short_of_memory, limit_threads
from mixseq.errors import MissingExtraError, MixseqError, SettingsError
from tests.cli.conftest import Contents, Run

FAILURES: list[tuple[str, str]] = [
    # No such file.
    ("info none.npz", "none.npz.* does not exist"),
    ("info none.h5", "none.h5 does not exist"),
    ("info none.usdc", "none.usdc.* does not exist"),
    ("info none", "none does not exist"),
    ("convert none.usdc old.npz", "none.usdc.* does not exist"),
    ("encode none.npz old.h5", "none.npz.* does not exist"),
    ("decode none.h5 old.npz", "none.h5 does not exist"),
    ("compare none.npz bar.npz", "none.npz.* does not exist"),
    ("compare bar.npz none.npz", "none.npz.* does not exist"),
    # Something else than its name says.
    ("info notes.txt", "'.txt' is not known"),
    ("info notes.npz", "notes.npz"),
    ("info empty.h5", "empty.h5"),
    ("info folder.h5", "folder.h5"),
    ("convert notes.npz old.usdc", "notes.npz"),
    ("encode notes.txt old.h5", "notes.txt"),
    ("decode bar.npz old.npz", "bar.npz"),
    ("decode bar_sequence.h5 old.npz", "bar_sequence.h5"),
    ("decode notes.txt old.npz", "notes.txt"),
    ("compare bar.npz notes.npz", "notes.npz"),
    # Half a file.
    ("info cut_bar.npz", "cut_bar.npz"),
    ("info cut_bar.usdc", "cut_bar.usdc"),
    ("info cut_bar_sequence.h5", "cut_bar_sequence.h5"),
    ("info cut_model.h5", "cut_model.h5"),
    ("convert cut_bar.npz old.usdc", "cut_bar.npz"),
    ("convert cut_bar.usdc old.npz", "cut_bar.usdc"),
    ("convert cut_bar_sequence.h5 old.npz", "cut_bar_sequence.h5"),
    ("encode cut_bar.npz old.h5", "cut_bar.npz"),
    ("decode cut_model.h5 old.npz", "cut_model.h5"),
    ("compare bar.npz cut_bar.usdc", "cut_bar.usdc"),
    # No place to write to.
    ("convert bar.npz nowhere/new.usdc", "nowhere does not exist; make it first"),
    ("convert bar.npz nowhere/new_####.obj", "nowhere does not exist; make it first"),
    ("encode bar.npz nowhere/new.h5", "nowhere does not exist; make it first"),
    ("decode model.h5 nowhere/new.usdc", "nowhere does not exist; make it first"),
    ("convert bar.npz folder.usdc", "folder.usdc is a folder"),
    ("convert bar.npz folder.h5", "folder.h5 is a folder"),
    ("encode bar.npz folder.h5", "folder.h5 is a folder"),
    ("decode model.h5 folder.usdc", "folder.usdc is a folder"),
    ("demo --frames 2 --out notes.txt", "notes.txt"),
    ("demo --frames 2 --out notes.txt/fox", "notes.txt"),
    ("convert bar.npz new.fbx", "'.fbx' is not known; write one of"),
    ("encode bar.npz old.usdc", "models are HDF5 files; end the name in .h5 or .hdf5"),
    ("decode model.h5 new.fbx", "'.fbx' is not known; write one of"),
    ("convert bar.npz one.obj", "one.obj"),
    # Options.
    ("bogus", "No such command 'bogus'.*see mixseq --help"),
    ("encdoe", "No such command 'encdoe'; did you mean encode\\? .*see mixseq --help"),
    ("converts bar.npz new.usdc", "did you mean convert\\?"),
    ("--bogus", "No such option.*--bogus.*see mixseq --help"),
    ("encode bar.npz", "Missing argument 'TARGET'.*see mixseq encode --help"),
    ("info", "Missing argument 'FILE'"),
    ("info bar.npz bar.usdc", "unexpected extra argument"),
    ("encode bar.npz old.h5 --tolerance 0", "--tolerance.*0.* is not a length above 0"),
    ("encode bar.npz old.h5 --parts 0", "--parts.*0 is not in the range"),
    ("encode bar.npz old.h5 --parts many", "--parts.*'many' is not a valid integer"),
    ("encode bar.npz old.h5 --parts 1000", "parts is 1000; a whole number from 1 to 150"),
    ("encode bar.npz old.h5 --joint-width 0", "--joint-width.*0 is not in the range"),
    ("encode bar.npz old.h5 --placement loose", "--placement.*'loose' is not one of"),
    ("encode bar.usdc old.h5 --prim /none", "/none"),
    ("encode bar.npz old.h5 --prim /bar", "npz has no option 'prim'"),
    ("convert bar.usdc old.npz --input-fps 10", "USD has no option 'fps'"),
    ("convert bar.usdc old.npz --allow-gaps", "USD has no option 'allow_gaps'"),
    ("compare bar.npz bar.npz --prim /bar", "neither bar.npz nor bar.npz is read with an option 'prim'"),
    ("demo --frames 1", "--frames.*1 is not in the range"),
    ("decode model.h5 old.npz --fps 0", "--fps.*0.* is not in the range"),
    ("decode model.h5 old.npz --fps fast", "--fps.*'fast' is not a frame rate such as 25, 23.976 or 24000/1001"),
    ("decode model.h5 old.npz --fps nan", "fps is nan"),
    ("decode model.h5 old.npz --fps nan --start 0", "fps is nan"),
    ("decode model.h5 old.npz --times 0;1", "--times.*'0;1' is not a list of seconds such as 0,0.5,1.25"),
    ("decode model.h5 old.npz --times 0,", "--times.*'0,' is not a list of seconds"),
    ("decode model.h5 old.npz --end 3", r"motions are not extrapolated; frame 3 is at 0\.3 s"),
    ("decode model.h5 old.npz --frames 4", "there is no frame 4; frames are 0 to 3"),
    ("decode model.h5 old.npz --frames 1 --times 0", "leave out --times"),
    ("decode model.h5 old.npz --frames 1-2 --end 0", "leave out --end"),
    ("decode model.h5 old.npz --frames a", "'a' is not a range of frames"),
    ("convert bar.npz old.npz --frames 2-9", "there is no frame 9; frames are 0 to 3"),
    ("decode model.h5 old.npz --times 0 --start 0", "leave out --start and --end"),
    ("decode model.h5 old.npz --times 0 --end 0", "leave out --start and --end"),
    # Times.
    ("decode model.h5 old.npz --times 9", "time 9 s is outside the sequence, 0 to 0.3 s"),
    ("decode model.h5 old.npz --times -0.1,0", "time -0.1 s is outside the sequence"),
    ("decode model.h5 old.npz --times nan", "time nan s is outside the sequence"),
    ("decode model.h5 old.npz --times 0.2,0.1", "times must increase"),
    ("decode model.h5 old.npz --times 0.1,0.1", "times must increase"),
    ("decode model.h5 old.npz --start -1 --fps 10", "time -1 s is outside the sequence"),
    ("decode model.h5 old.npz --end 2 --fps 10", "time 2 s is outside the sequence"),
    ("decode model.h5 old.npz --end 1e300 --fps 1000", r"time 1e\+300 s is outside the sequence"),
    ("decode model.h5 old.npz --start 0.2 --end 0.1", "no time between the start, 0.2 s, and the end, 0.1 s"),
    ("decode model.h5 old.npz --start nan", "no time between"),
    ("decode model.h5 old.npz --end inf --fps 10", "no time between"),
    ("decode model.h5 old.npz --start 0.12 --end 0.18", "no frame from 0.12 to 0.18 s; give --fps"),
    # Meshes that do not match.
    ("compare bar.npz other.npz", "the reference has 77 vertices, the other sequence 4"),
]


def check_message(result: Result, message: str) -> None:
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    assert result.stderr.startswith("mixseq: error: ")
    assert result.stderr.endswith("\n")
    assert result.stderr.count("\n") == 1, result.stderr
    assert "Traceback" not in result.stderr
    assert re.search(message, result.stderr), result.stderr


@pytest.mark.parametrize(("line", "message"), FAILURES, ids=[line for line, _ in FAILURES])
def test_failure(run: Run, contents: Contents, line: str, message: str) -> None:
    before = contents()
    check_message(run(*line.split()), message)
    assert contents() == before


def test_an_error_while_writing(run: Run, contents: Contents, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> NoReturn:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("mixseq_io.files._flush", full)
    before = contents()
    for line in (
        "convert bar.npz old.usdc",
        "convert bar.npz old.h5",
        "decode model.h5 old.npz",
        "encode bar.npz old.h5 --parts 2",
    ):
        check_message(run(*line.split()), "cannot write .*No space left on device; free some space")
        assert contents() == before


@pytest.mark.parametrize("error", [KeyboardInterrupt, click.Abort])
@pytest.mark.parametrize(
    ("line", "where"),
    [
        ("encode bar.npz old.h5", "fit"),
        ("encode bar.npz new.h5", "save"),
        ("decode model.h5 old.npz", "write_blocks"),
        ("convert bar.npz new.npz", "write_blocks"),
    ],
)
def test_interrupt(
    run: Run, contents: Contents, monkeypatch: pytest.MonkeyPatch, line: str, where: str, error: type[BaseException]
) -> None:
    def stop(*_: object, **__: object) -> NoReturn:
        raise error

    monkeypatch.setattr(mixseq, where, stop)
    if where == "save":
        monkeypatch.setattr(mixseq, "fit", lambda *_, **__: mixseq.load("model.h5"))
    before = contents()
    result = run(*line.split())
    assert (result.exit_code, result.stdout, result.stderr.strip()) == (130, "", "mixseq: interrupted")
    assert contents() == before


def test_interrupt_in_the_middle_of_a_file(run: Run, contents: Contents, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[str] = []

    def stop(file: Path) -> NoReturn:
        calls.append(file.name)
        raise KeyboardInterrupt

    monkeypatch.setattr("mixseq_io.files._flush", stop)
    before = contents()
    assert run("encode", "bar.npz", "old.h5", "--parts", "2").exit_code == 130
    assert run("decode", "model.h5", "old.usdc").exit_code == 130
    assert run("decode", "model.h5", "new.npz").exit_code == 130
    assert len(calls) == 3
    assert contents() == before


def test_bugs_are_not_hidden(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def bug(*_: object, **__: object) -> NoReturn:
        raise ZeroDivisionError

    monkeypatch.setattr(mixseq, "open_sequence", bug)
    with pytest.raises(ZeroDivisionError):
        run("info", "bar.npz")


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (MixseqError("head:\n  one\n  two"), "mixseq: error: head: one, two"),
        (MissingExtraError("pip install it"), "mixseq: error: pip install it"),
        (OSError(13, "Permission denied", "a.npz"), "mixseq: error: a.npz: Permission denied"),
        (OSError("strange"), "mixseq: error: strange"),
        (MemoryError(), "mixseq: error: there is not enough memory"),
        (MemoryError("9 TB"), "mixseq: error: there is not enough memory (9 TB)"),
        (click.ClickException("plain"), "mixseq: error: plain"),
    ],
)
def test_messages(error: Exception, line: str, capsys: pytest.CaptureFixture[str]) -> None:
    def fail() -> NoReturn:
        raise error

    assert exit_code(fail) == 2
    assert capsys.readouterr() == ("", f"{line}\n")


def test_exit_codes_of_what_succeeds() -> None:
    assert [exit_code(lambda: None), exit_code(lambda: 0), exit_code(lambda: 3)] == [0, 0, 3]


def test_other_warnings_are_left_alone() -> None:
    import warnings

    with pytest.warns(DeprecationWarning, match="old") as caught:
        assert exit_code(lambda: warnings.warn("old", DeprecationWarning, stacklevel=2)) == 0
    assert len(caught) == 1


@pytest.mark.parametrize(("error", "code"), [(KeyboardInterrupt, 130), (lambda: SystemExit(143), 143)])
def test_an_interrupt_that_a_library_swallows_comes_again(error: Any, code: int) -> None:
    """As llvmlite and HDF5 do, which call Python from C."""

    def callback() -> None:
        raise error()

    called_from_c = ctypes.CFUNCTYPE(None)(callback)

    def work() -> None:
        called_from_c()
        for _ in range(200):
            time.sleep(0.01)

    # A process that was started in the background ignores interrupts.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert exit_code(work) == code
    except SystemExit as leaving:
        assert leaving.code == code
    finally:
        signal.signal(signal.SIGINT, before)


# Little address space: one line, before libraries crash


@pytest.fixture
def limited(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Give the process little more than the floor."""
    monkeypatch.setattr(os, "environ", dict(os.environ))
    os.environ.pop("MIXSEQ_THREADS", None)
    monkeypatch.setattr("resource.getrlimit", lambda _: (MIN_ADDRESS_SPACE + 1, MIN_ADDRESS_SPACE + 1))
    return monkeypatch


def test_one_thread_where_there_is_a_limit(limited: pytest.MonkeyPatch) -> None:
    limited.setitem(os.environ, "OPENBLAS_NUM_THREADS", "3")
    limit_threads()
    assert (os.environ["MIXSEQ_THREADS"], os.environ["OPENBLAS_NUM_THREADS"]) == ("1", "3")


def test_nothing_changes_without_one(limited: pytest.MonkeyPatch) -> None:
    limited.setattr("resource.getrlimit", lambda _: (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    limit_threads()
    assert "MIXSEQ_THREADS" not in os.environ
    assert not is_short_of_memory(RuntimeError("can't start new thread"))


def test_too_little(limited: pytest.MonkeyPatch) -> None:
    limited.setattr("resource.getrlimit", lambda _: (300 << 20, -1))
    with pytest.raises(SettingsError, match=r"limited to 300 MiB \(ulimit -v\), .* need 2000 MiB .*; raise the limit"):
        limit_threads()


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
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (group.MIN_ADDRESS_SPACE // 4,) * 2),
        capture_output=True,
        text=True,
        timeout=60,
        cwd=tmp_path,
        check=False,
    )
    assert ended.returncode == code
    assert len(ended.stderr.splitlines()) == (1 if code else 0)
