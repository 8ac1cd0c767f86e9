"""Text files are UTF-8, with or without a byte order mark."""

from __future__ import annotations

from pathlib import Path

import pytest

from mixseq.errors import FormatError
from mixseq.runtime.text_files import read_text

TEXT = "größe = 1\r\n"


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
def test_byte_order_mark_is_no_text(encoding: str, tmp_path: Path) -> None:
    file = tmp_path / "a.toml"
    file.write_bytes(TEXT.encode(encoding))
    assert read_text(file, "a TOML file") == TEXT


@pytest.mark.parametrize(
    ("encoding", "problem"),
    [
        ("utf-16", "its text is UTF-16; save it as UTF-8"),
        ("latin-1", "byte 2 is not UTF-8"),
    ],
)
def test_other_encodings_are_refused(encoding: str, problem: str, tmp_path: Path) -> None:
    file = tmp_path / "a.toml"
    file.write_bytes(TEXT.encode(encoding))
    with pytest.raises(FormatError, match=f"a.toml cannot be read as a TOML file: {problem}"):
        read_text(file, "a TOML file")
