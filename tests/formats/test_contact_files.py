"""Files of contacts: groups of vertices by name."""

from __future__ import annotations

from pathlib import Path

import pytest

from mixseq.errors import FormatError
from mixseq_io.text.markers import read_contacts


@pytest.mark.parametrize(
    "text",
    [
        '{"left foot": [3, 4], "right foot": [7]}',
        '\ufeff{"contacts": {"left foot": [3, 4], "right foot": [7]}, "by": "me"}',
    ],
)
def test_groups_are_read(tmp_path: Path, text: str) -> None:
    file = tmp_path / "feet.json"
    file.write_text(text, encoding="utf-8")
    assert read_contacts(file) == {"left foot": [3, 4], "right foot": [7]}


WRONG = {
    "empty": ("", "feet.json cannot be read as JSON"),
    "broken": ('{"left": [1', "cannot be read as JSON"),
    "deep": ("[" * 100000, "cannot be read as JSON"),
    "digits": (f'{{"left": [{"9" * 5000}]}}', "cannot be read as JSON"),
    "list": ("[1, 2]", "has no contacts; an object such as"),
    "nothing": ("{}", "has no contacts"),
    "number": ('{"left": 3}', "contact 'left' is not a list of vertices"),
    "no vertices": ('{"left": []}', "contact 'left' is not a list"),
    "minus": ('{"left": [1], "right": [2, -1]}', "contact 'right' has -1; vertices are numbered from 0"),
    "half": ('{"left": [1.5]}', "contact 'left' has"),
    "true": ('{"left": [true]}', "contact 'left' has"),
}


@pytest.mark.parametrize("name", WRONG)
def test_errors_name_file_and_contact(tmp_path: Path, name: str) -> None:
    text, message = WRONG[name]
    file = tmp_path / "feet.json"
    file.write_text(text)
    with pytest.raises(FormatError, match=message):
        read_contacts(file)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"none\.json does not exist"):
        read_contacts(tmp_path / "none.json")
    (tmp_path / "binary.json").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(FormatError, match="cannot be read as contacts"):
        read_contacts(tmp_path / "binary.json")
