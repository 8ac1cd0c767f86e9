"""What the file format freezes knows nothing of the encoder, and says at every constant what it is."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

import mixseq

BITSTREAM = sorted((Path(mixseq.__file__).parent / "compression" / "bitstream").rglob("*.py"))


@pytest.mark.parametrize("file", BITSTREAM, ids=lambda file: file.stem)
def test_the_frozen_room_does_not_import_the_encoder(file: Path) -> None:
    assert "import mixseq.compression.encoder" not in (text := file.read_text(encoding="utf-8"))
    assert "from mixseq.compression.encoder" not in text


@pytest.mark.parametrize("file", BITSTREAM, ids=lambda file: file.stem)
def test_constants_are_frozen_or_free(file: Path) -> None:
    """Whoever changes a number sees whether old files break."""
    text = file.read_text(encoding="utf-8")
    body, lines = ast.parse(text).body, text.splitlines()
    assert "rozen" in (ast.get_docstring(ast.Module(body, [])) or "")
    for constant, after in zip(body, [*body[1:], None], strict=True):
        if not isinstance(constant, ast.Assign):
            continue
        names = [name.id for name in ast.walk(constant.targets[0]) if isinstance(name, ast.Name)]
        if all(name.isupper() for name in names) and "_NO_RESIDUALS" not in names:
            docstring = "\n".join(lines[after.lineno - 1 : after.end_lineno]) if isinstance(after, ast.Expr) else ""
            said = lines[constant.lineno - 1].partition("#")[2] or docstring
            assert {"frozen", "free"} & set(re.findall(r"\w+", said.lower())), names
