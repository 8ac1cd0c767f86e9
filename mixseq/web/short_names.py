"""Short names for the variables of scripts, so that pages are small; what others see of a script keeps its name.

A variable is told from a property by the tokens around it, which is enough for scripts in the style of ours: statements
end with semicolons, there are no labels, and no ``with`` or ``eval``. In ``{ a, b: c }`` a is both, and becomes
``{ a: x, b: y }``.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from itertools import product
from string import ascii_letters

_LANGUAGE = """
arguments async await break case catch class const continue default delete do else export extends false finally for
from function get if import in instanceof let new null of return set static super switch this throw true try typeof
undefined var void while with yield as Array ArrayBuffer BigInt Boolean DataView Date Error Float32Array
Float64Array Infinity Int16Array Int32Array Int8Array Intl JSON Map Math NaN Number Object Promise RangeError RegExp
Set String Symbol TypeError Uint16Array Uint32Array Uint8Array WeakMap isFinite isNaN parseFloat parseInt
"""
_BROWSERS = """
AbortController Blob DecompressionStream Event HTMLButtonElement HTMLElement HTMLInputElement HTMLSelectElement
Image ImageData Option Request ResizeObserver Response TextDecoder TextEncoder URL URLSearchParams WebSocket Worker
WorkerGlobalScope atob btoa cancelAnimationFrame clearInterval clearTimeout console createImageBitmap crypto
customElements document fetch getComputedStyle globalThis localStorage location matchMedia navigator onmessage
performance postMessage queueMicrotask requestAnimationFrame setInterval setTimeout structuredClone window
"""
KEPT = frozenset((_LANGUAGE + _BROWSERS).split())
"""Names that are not ours. A variable of ours that has one of them keeps it."""

SHARED = re.compile(r"(mixseq|module\d)\w*$")
"""Names that scripts have in common."""

_TOKEN = re.compile(
    r""""(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*'"""
    r"|(?<![\w$#])[A-Za-z_$][\w$]*|\d[\w.]*|\#[\w$]+"
    r"|(?:(?<=[(,=:])|(?<=[(,=:] ))/(?![/*])(?:\\.|\[[^\]\n]*\]|[^/\\\n])+/\w*"
    r"|\.\.\.|=>|\s+|.",
    re.DOTALL,
)
_BLOCK = frozenset(["", ")", "=>", ";", "{", "}", "else", "try", "finally", "do", "catch"])
"""Tokens after which a brace begins statements."""


def with_short_names(script: str) -> str:
    """Return a script without comments, with short names for variables that only it has.

    Examples
    --------
    >>> with_short_names("const total = ({ count, sizes: [first] }) => first * count + this.total;")
    'const c = ({ count:a, sizes: [b] }) => b * a + this.total;'
    """
    tokens = list(_tokens(script))
    roles = _roles(tokens)
    counts = Counter(token for token, role in zip(tokens, roles, strict=True) if role)
    short = dict(zip((name for name, _ in counts.most_common()), _names(), strict=False))
    return "".join(
        f"{token}:{short[token]}" if role == "both" else short[token] if role else token
        for token, role in zip(tokens, roles, strict=True)
    )


def _names() -> Iterator[str]:
    for length in (1, 2, 3):
        yield from (name for name in map("".join, product(ascii_letters, repeat=length)) if name not in KEPT)


def _tokens(script: str) -> Iterator[str]:
    """Yield the tokens of a script; texts of templates are tokens, what is computed in them is taken apart."""
    place, depths = 0, list[int]()  # of braces, in every template that is not over
    while place < len(script):
        if script[place] == "`" or (script[place] == "}" and depths and depths[-1] == 0):
            end = re.compile(r"(?:\\.|[^`\\$]|\$(?!\{))*(`|\$\{)", re.DOTALL).match(script, place + 1)
            assert end, "a template has no end"
            if script[place] == "}":
                depths.pop()
            if end[1] == "${":
                depths.append(0)
        else:
            end = _TOKEN.match(script, place)
            assert end
            if depths:
                depths[-1] += {"{": 1, "}": -1}.get(end[0], 0)
        yield script[place : end.end()]
        place = end.end()


def _roles(tokens: list[str]) -> list[str]:
    """Return for every token whether it is a "variable" of ours, "both" that and a property, or neither, ""."""
    roles = [""] * len(tokens)
    places = [k for k, token in enumerate(tokens) if not token.isspace()]
    braces = list[str]()  # around a token: what they are, and other brackets
    before, heading = "", False
    for number, place in enumerate(places):
        token = tokens[place]
        after = tokens[places[number + 1]] if number + 1 < len(places) else ""
        inside = braces[-1] if braces else ""
        if token == "class":
            heading = True
        if token == "{":
            braces.append("class" if heading else "block" if before in _BLOCK else "object")
            heading = False
        elif token in ("(", "["):
            braces.append(token)
        elif token in ("}", ")", "]"):
            braces.pop()
        elif _is_name(token) and token not in KEPT and not SHARED.match(token):
            roles[place] = _role(before, after, inside)
        before = token
    return roles


def _is_name(token: str) -> bool:
    return token[0].isalpha() or token[0] in "_$"


def _role(before: str, after: str, inside: str) -> str:
    if before == ".":
        return ""
    if inside == "class":
        return "variable" if before == "=" else ""
    if inside == "object" and before in ("{", ",", "async", "get"):
        if after in (":", "("):
            return ""
        if after in (",", "}", "="):
            return "both"
    return "variable"
