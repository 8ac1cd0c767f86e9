"""Compiled functions, and the folder that they are kept in: damaged, full or read-only."""

from __future__ import annotations

import errno
import importlib
import logging
import os
import pickle
import platform
import signal
import subprocess
import sys
import tempfile
import time
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

import numba
import numpy as np
import pytest
from numba.core.serialize import _numba_unpickle

from mixseq.errors import MixseqWarning
from mixseq.runtime import jit
from mixseq.runtime.interrupts import signals_as_exceptions

SOURCE = """
from mixseq.runtime.jit import compiled

@compiled
def double(number):
    return 2 * number
"""


@pytest.fixture(autouse=True)
def nothing_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jit, "_warned", set())


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "kept"))
    (tmp_path / "doubling.py").write_text(SOURCE)
    return tmp_path


def double(kept: Path) -> Any:
    """Return the function as a new process imports it."""
    spec = spec_from_file_location("doubling", kept / "doubling.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.double


def loaded(function: Any) -> int:
    return sum(function.stats.cache_hits.values())


@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
@pytest.mark.parametrize("size", [0, 7, -9])
def test_what_was_cut_short_is_compiled_again(kept: Path, suffix: str, size: int) -> None:
    assert double(kept)(3) == 6
    (file,) = (kept / "kept").rglob(f"*{suffix}")
    file.write_bytes(file.read_bytes()[: size or 0])
    again = double(kept)
    with pytest.warns(MixseqWarning, match=r"functions in .*kept.* is damaged; they are compiled again"):
        assert again(3) == 6
    assert loaded(again) == 0
    third = double(kept)
    assert third(3) == 6
    assert loaded(third) == 1


def test_an_index_of_something_else(kept: Path) -> None:
    assert double(kept)(3) == 6
    (index,) = (kept / "kept").rglob("*.nbi")
    with index.open("rb") as file:
        version = pickle.load(file)
    index.write_bytes(pickle.dumps(version) + pickle.dumps(7))
    with pytest.warns(MixseqWarning, match="is damaged"):
        assert double(kept)(3) == 6


def test_a_full_disk(kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> NoReturn:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    function = double(kept)
    monkeypatch.setattr("numba.core.caching.IndexDataCacheFile._save_data", full)
    with pytest.warns(
        MixseqWarning, match=r"cannot be saved in .*kept.* \(No space left on device\), .*NUMBA_CACHE_DIR"
    ):
        assert function(3) == 6
    assert function(3.5) == 7.0  # told once


def test_a_folder_that_became_read_only(kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> NoReturn:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    assert double(kept)(3) == 6
    (index,) = (kept / "kept").rglob("*.nbi")
    index.write_bytes(b"")
    function = double(kept)
    monkeypatch.setattr(Path, "unlink", refuse)
    with pytest.warns(MixseqWarning) as told:
        assert function(3) == 6
    assert ["is damaged" in str(told[0].message), "Permission denied" in str(told[1].message)] == [True, True]


def test_an_index_that_cannot_be_read(kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> NoReturn:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    function = double(kept)
    monkeypatch.setattr("numba.core.caching.IndexDataCacheFile._load_index", refuse)
    with pytest.warns(MixseqWarning, match="Permission denied"):
        assert function(3) == 6


def test_no_folder_at_all(kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> NoReturn:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(tempfile, "TemporaryFile", refuse)
    assert double(kept)(3) == 6


def test_a_change_of_a_called_function_is_compiled_and_its_old_index_is_not_read(
    kept: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (kept / "doubling.py").write_text(f"from called import add\n{SOURCE.replace('2 * number', 'add(number, number)')}")
    monkeypatch.syspath_prepend(kept)
    for sign, result in (("+", 6), ("-", 0), ("+", 6)):
        text = (
            f"from mixseq.runtime.jit import force_inlined\n\n@force_inlined\ndef add(a, b):\n    return a {sign} b\n"
        )
        (kept / "called.py").write_text(text)
        monkeypatch.delitem(sys.modules, "called", raising=False)
        jit._file_hash.cache_clear()
        importlib.invalidate_caches()
        with monkeypatch.context() as patched:
            patched.setattr(sys, "dont_write_bytecode", True)
            assert double(kept)(3) == result


@pytest.mark.skipif(platform.machine() != "x86_64", reason="a wheel brings functions for x86-64 only")
def test_what_a_wheel_brings_is_loaded_where_the_processor_can_run_it(
    kept: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    settings = {"NUMBA_CPU_NAME": jit.PORTABLE_CPU, "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": str(kept / "built")}
    code = "import sys\nsys.path.append('.')\nimport doubling\nprint(doubling.double(3))"
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=kept, env=os.environ | settings, capture_output=True, check=True
    )
    assert run.stdout.strip() == b"6"
    monkeypatch.syspath_prepend(kept)  # what is kept names its module
    monkeypatch.delitem(sys.modules, "doubling", raising=False)
    brought = kept / "__pycache__"
    brought.mkdir(exist_ok=True)
    for file in (kept / "built").rglob("*.nb?"):
        file.rename(brought / file.name)
    caplog.set_level(logging.DEBUG, logger="mixseq")
    function = double(kept)
    assert function(3) == 6
    assert loaded(function) == 1
    assert not caplog.messages
    assert not list((kept / "kept").rglob("*.nbi"))  # nothing had to be kept
    monkeypatch.setattr(jit, "_PORTABLE_CPU_FEATURES", {"+avx2", "+of another processor"})
    function = double(kept)
    assert function(3) == 6
    assert loaded(function) == 0
    assert ["compiling" in message and "double" in message for message in caplog.messages] == [True]


CALLING = """
import numpy as np
from mixseq.runtime.jit import compiled

@compiled
def add(number, other):
    return number + other

@compiled
def place(numbers):
    return add(np.argmax(numbers), 1) + add(len(numbers), 2)
"""


def test_what_numba_knows_of_numpy_is_not_imported_to_load_what_it_made(kept: Path) -> None:
    (kept / "doubling.py").write_text(CALLING.replace("def place", "def double"))
    numbers = np.array([0.0, 3.0, 2.0])
    assert double(kept)(numbers) == 7
    again = double(kept)
    assert again(numbers) == 7
    assert loaded(again) == 1
    (data,) = (kept / "kept").rglob("*double*.nbc")
    assert b"numba.np.arraymath" not in data.read_bytes()
    with pytest.raises(ValueError, match="argmax of an empty sequence"):
        again(numbers[:0])


def test_functions_that_were_loaded_are_linked_into_new_ones(kept: Path) -> None:
    assert double(kept)(3) == 6
    function = double(kept)
    assert function(3) == 6
    assert loaded(function) == 1
    assert numba.njit(lambda number: function(number) + 1)(3) == 7


def test_numbers_that_stand_in_the_code_are_compiled_for_once(kept: Path) -> None:
    (kept / "doubling.py").write_text(CALLING.replace("def place", "def double"))
    function = double(kept)
    assert function(np.arange(3.0)) == 8
    assert len(function.py_func.__globals__["add"].overloads) == 1


@pytest.mark.usefixtures("interruptible")
def test_a_signal_waits_until_a_result_is_made(kept: Path) -> None:
    """What makes an array of Python's of it calls Python, and crashes if that is interrupted."""
    function = double(kept)
    function(np.arange(3.0))
    sent: list[bool] = []
    done: list[float] = []

    def interrupt(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and frame.f_code is _numba_unpickle.__code__ and not sent:
            sent.append(True)
            signal.raise_signal(signal.SIGINT)

    def work() -> None:
        before = sys.getprofile()
        sys.setprofile(interrupt)
        try:
            done.extend(function(np.arange(3.0)))
        finally:
            sys.setprofile(before)
        for _ in range(1000):
            time.sleep(0.01)  # until the signal comes again
        done.append(7.0)

    with pytest.raises(KeyboardInterrupt), signals_as_exceptions():
        work()
    assert sent == [True]
    assert done == [0.0, 2.0, 4.0]


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("step", ["rebuild", "reduce"])
def test_a_signal_waits_until_a_function_is_loaded_or_kept(
    kept: Path, step: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What llvmlite was interrupted in freeing, it frees twice."""
    if step == "rebuild":
        double(kept)(3)
    usual = getattr(jit._CompactCacheImpl, step)
    done: list[Any] = []

    def interrupted(*arguments: Any) -> Any:
        signal.raise_signal(signal.SIGINT)
        return usual(*arguments)

    def work() -> None:
        done.append(double(kept)(3))
        for _ in range(1000):
            time.sleep(0.01)  # until the signal comes again
        done.append("not reached")

    monkeypatch.setattr(jit._CompactCacheImpl, step, interrupted)
    with pytest.raises(KeyboardInterrupt), signals_as_exceptions():
        work()
    assert done == [6]
