"""Text files are UTF-8, with or without a byte order mark."""

from __future__ import annotations

from pathlib import Path

import pytest

from mixseq.errors import FormatError
from mixseq.runtime.text_files import read_text

TEXT = "größe = 1\nname = 2\n"


@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
def test_byte_order_mark_is_no_text(encoding: str, line_end: str, tmp_path: Path) -> None:
    file = tmp_path / "a.toml"
    file.write_bytes(TEXT.replace("\n", line_end).encode(encoding))
    assert read_text(file, "a TOML file") == TEXT


@pytest.mark.parametrize(
    ("encoding", "problem"),
    [
        *((encoding, "its text is UTF-16; save it as UTF-8") for encoding in ("utf-16", "utf-16-le", "utf-16-be")),
        *((encoding, "its text is UTF-32; save it as UTF-8") for encoding in ("utf-32", "utf-32-le", "utf-32-be")),
        ("latin-1", "byte 2 is not UTF-8"),
    ],
)
def test_other_encodings_are_refused(encoding: str, problem: str, tmp_path: Path) -> None:
    file = tmp_path / "a.toml"
    file.write_bytes(TEXT.encode(encoding))
    with pytest.raises(FormatError, match=f"a.toml cannot be read as a TOML file: {problem}"):
        read_text(file, "a TOML file")
