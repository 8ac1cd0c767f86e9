"""Names from files are shown, and never obeyed, by whatever a command prints."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from io import StringIO
from pathlib import Path

import pytest

import mixseq
from mixseq.cli import files, group
from mixseq.cli.group import print_table, printable, progress_bar
from mixseq.sequence.sequence import MeshSequence
from tests.cli.conftest import Run

NAME = "\x1b]0;owned\x07\x1b[2J\x9b31m\x7f\u202egpj.exe\u2028[/red]\ud800"
SHOWN = r"\x1b]0;owned\x07\x1b[2J\x9b31m\x7f\u202egpj.exe\u2028[/red]\ud800"
OBEYED = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2028\ud800]")


class Terminal(StringIO):
    def isatty(self) -> bool:
        return True


def test_what_is_escaped() -> None:
    assert printable(NAME) == SHOWN
    usual = "Ängström 日本　 नमस्ते 👩‍🚀 \\x1b"
    assert printable(usual) == usual


def test_tables(capsys: pytest.CaptureFixture[str]) -> None:
    print_table([(NAME, "\n")], ("name", "value"))
    assert capsys.readouterr().out.splitlines()[1] == f"{SHOWN}  \\n"


def test_tables_fit_100_columns(capsys: pytest.CaptureFixture[str]) -> None:
    path = 110 * "p"
    print_table([("one", 30 * "word " + "end"), ("two", path)], None)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines[:-1])) <= 100
    assert lines[0].startswith("one  word")
    assert lines[1].startswith("     word")
    assert lines[1].endswith("end")
    assert lines[-1] == f"two  {path}"
    print_table([(40 * "f", 12 * "word ", 9 * "size "), ("g", "1", "2")], ("file", "words", "sizes"))
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 100
    start = lines[0].index("sizes")
    assert all(line[start - 2 : start].isspace() for line in lines if len(line) > start)  # columns stay apart


def test_tables_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setattr("sys.stdout", terminal := Terminal())
    print_table([(NAME, "1")], ("name", "count"))
    shown = re.sub("\x1b\\[[0-9;]*m", "", terminal.getvalue())  # bold
    assert SHOWN in shown
    assert not OBEYED.search(shown)


def test_progress_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr("sys.stderr", terminal := Terminal())
    with progress_bar(quiet=False) as progress:
        progress(1, 2, NAME)
    assert SHOWN in terminal.getvalue()
    assert "\x1b]0;" not in terminal.getvalue()


def test_names_in_files(run: Run, bent_bar: MeshSequence) -> None:
    name = NAME.removesuffix("\ud800")
    mixseq.write("named.npz", replace(bent_bar, name=name))
    table = run("info", "named.npz").stdout
    assert SHOWN.removesuffix(r"\ud800") in table
    assert not OBEYED.search(table)
    assert json.loads(run("info", "named.npz", "--json").stdout)["name"] == name


@pytest.mark.parametrize(
    "arguments",
    [
        ("info", "\x1b[2J.npz"),
        ("convert", "bar.npz", "\x1b[2J.wrong"),
        ("encode", "bar.npz", "new.h5", "--tolerance", "\x1b[2J"),
        ("\x1b[2J",),
        ("convert", "bar.npz", "\x1b[2J.npz", "--no-overwrite"),
    ],
)
def test_errors(run: Run, folder: Path, arguments: tuple[str, ...]) -> None:
    if "--no-overwrite" in arguments:
        (folder / "\x1b[2J.npz").touch()
    result = run(*arguments)
    assert result.exit_code == 2
    assert r"\x1b[2J" in result.stderr
    assert not OBEYED.search(result.stderr)


def test_warnings_files_and_questions(run: Run, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = run("convert", "bar.npz", "\x1b[2J_#.obj")
    assert (result.exit_code, "warning: \\x1b[2J_#.obj: OBJ files" in result.stderr) == (0, True)
    monkeypatch.setattr(files, "on_terminal", lambda: True)
    asked = run("convert", "bar.npz", "\x1b[2J_#.obj")
    for text in (result.stdout, result.stderr, asked.stderr):
        assert r"\x1b[2J" in text
        assert not OBEYED.search(text)


def test_nothing_is_printed_elsewhere() -> None:
    """All of a command's lines go through `say`, but for help and tables of our own."""
    modules = sorted(Path(group.__file__).parent.rglob("*.py"))
    printing = {path.name for path in modules if re.search(r"\bclick\.s?echo\(.|\bprint\(", path.read_text())}
    assert printing == {"__init__.py", "formats.py", "group.py", "view.py"}
