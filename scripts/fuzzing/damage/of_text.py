"""Damage to files of text: its numbers, words, lines and brackets."""

from __future__ import annotations

import re
from random import Random

from scripts.fuzzing.case import Case, NotMadeError

ESCAPES = "\x1b]0;gone\x07\x1b[2J\x1b[31m\r\x9b1m\u202e"
"""What a terminal would obey: another title, nothing on the screen, red, the start of the line, right to left."""

WORDS = (
    *(
        "nan",
        "inf",
        "-inf",
        "-1",
        "0",
        "1",
        "2147483648",
        "4294967295",
        "9223372036854775808",
        "9" * 25,
        "9" * 5000,
    ),
    *(
        "1e400",
        "1e-400",
        "1e308",
        "-1e308",
        "1e-310",
        "1e38",
        "1e160",
        "-0",
        "0x10",
        "1_000",
        "1.5",
        "true",
        "null",
    ),
    *("", "word", "two words", "\x00", "'", '"', "[", "]", "{", "}", "(", ")", ",", "#", "\\", "\n", "\t"),
    *("\uff11\uff12", "a" * 5000, ESCAPES, "\ufeff", "%s%n", "../../x", "1/2/3/4", "-1//-1"),
)
_NUMBER = re.compile(r"[-+]?\d[\d.eE+-]*")
_WORD = re.compile(r"[A-Za-z_:]{2,}")
_BRACKETS = ("[", "{", "(", "[[", '{"a":', "(", "- ", "a = [", "&a [*a, ")


def damage_text(case: Case) -> str:
    """Change one to three things in a file of text."""
    text = case.file.read_bytes().decode("utf-8", "surrogateescape")
    if not text:
        raise NotMadeError
    labels = []
    for _ in range(case.rng.choice([1, 1, 1, 2, 3])):
        label, text = damaged_text(text, case)
        labels.append(label)
    case.file.write_bytes(text.encode("utf-8", "surrogateescape"))
    return ", ".join(labels)


def damaged_text(text: str, case: Case) -> tuple[str, str]:
    """Change one thing in a text; return what and the text."""
    how = case.rng.choices([_number, _word, _line, _quoted, _nest], [8, 4, 4, 3, 1])[0]
    return how(text, case)


def _number(text: str, case: Case) -> tuple[str, str]:
    found = list(_NUMBER.finditer(text))
    if not found:
        return _word(text, case)
    # Counts come first.
    match = case.rng.choice(found[:20] if case.rng.random() < 0.4 else found)
    return _replaced(text, match, case.rng.choice(WORDS))


def _word(text: str, case: Case) -> tuple[str, str]:
    found = list(_WORD.finditer(text))
    if not found:
        return _line(text, case)
    match = case.rng.choice(found[:100] if case.rng.random() < 0.5 else found)
    new = case.rng.choice([*WORDS, *(each.group() for each in case.rng.sample(found, min(8, len(found))))])
    return _replaced(text, match, new)


def _quoted(text: str, case: Case) -> tuple[str, str]:
    found = list(re.finditer(r"\"[^\"\n]*\"|@[^@\n]*@|<[^<>\n]*>", text))
    if not found:
        return _number(text, case)
    match = case.rng.choice(found)
    ends = match.group()[0] + match.group()[-1]
    new = case.rng.choice([case.out(), case.out(), ESCAPES, "", "x" * 100_000])
    return _replaced(text, match, ends[0] + new + ends[1])


def _line(text: str, case: Case) -> tuple[str, str]:
    lines, rng = text.split("\n"), case.rng
    at = rng.randrange(len(lines))
    kind = rng.choice(["without", "twice", "exchanged", "chance", "often"])
    match kind:
        case "without":
            del lines[at]
        case "twice":
            lines.insert(at, lines[at])
        case "exchanged":
            other = rng.randrange(len(lines))
            lines[at], lines[other] = lines[other], lines[at]
        case "chance":
            lines[at] = _chance(rng)
        case "often":
            lines[at] = "\n".join([lines[at]] * 2000)
    return f"line {at} {kind}", "\n".join(lines)


def _nest(text: str, case: Case) -> tuple[str, str]:
    found = [match.start() for match in re.finditer(r"[\[{(=:-]", text)] or [0]
    at, bracket = case.rng.choice(found), case.rng.choice(_BRACKETS)
    depth = case.rng.choice([50, 2000, 100_000])
    return f"{depth} times {bracket!r} at {at}", text[:at] + bracket * depth + text[at:]


def _chance(rng: Random) -> str:
    return rng.randbytes(40).decode("utf-8", "surrogateescape")


def _replaced(text: str, match: re.Match[str], new: str) -> tuple[str, str]:
    label = f"{match.group()[:20]!r} at {match.start()} is {new[:30]!r}"
    return label, text[: match.start()] + new + text[match.end() :]
