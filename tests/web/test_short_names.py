"""Scripts with short names do what they did, and others find what they found in them."""

from __future__ import annotations

import pytest

from mixseq.viewing.template import CHART_SCRIPTS, EDITING_SCRIPTS, PLAYER_SCRIPTS, POSE_SCRIPTS, script
from mixseq.web.bundle import module, stripped
from mixseq.web.short_names import _roles, _tokens, with_short_names
from tests.web.conftest import WEB, Node

CASES = {
    "properties keep their names": ("const one = two.three?.four;", "const a = b.three?.four;"),
    "keys keep their names": ("f({ one: two, three() {} });", "a({ one: b, three() {} });"),
    "names that are both": ("const { one, two = 2 } = { one };", "const { one:a, two:b = 2 } = { one:a };"),
    "statements are no keys": ("if (one) { two = 1; }", "if (a) { b = 1; }"),
    "members of classes": (
        "class One extends Two { #three = four; five(six) { this.#three = six; } }",
        "class b extends c { #three = d; five(a) { this.#three = a; } }",
    ),
    "templates": ("`one ${two ? `${two} {` : { two }.two} }`", "`one ${a ? `${a} {` : { two:a }.two} }`"),
    "texts": ("one('one', \"one\", /one/g.test(two));", "a('one', \"one\", /one/g.test(b));"),
    "numbers": ("one = 0x1f + 1e3;", "a = 0x1f + 1e3;"),
    "the language and browsers": ("new Map(window.one, mixseqOne);", "new Map(window.one, mixseqOne);"),
    "what is spread": ("const one = { ...two, three };", "const a = { ...b, three:c };"),
    "what follows a question": ("one ? two : three;", "a ? b : c;"),
}


@pytest.mark.parametrize("case", CASES)
def test_names(case: str) -> None:
    given, expected = CASES[case]
    assert with_short_names(given) == expected


def test_the_names_that_are_most_often_there_are_the_shortest() -> None:
    many = ", ".join(f"name{k}" for k in range(60))
    short = with_short_names(f"often = often + often; let {many};")
    assert short.startswith("a = a + a; let b, c, d")
    assert not {"do", "if", "in", "of", "as"} & set(short.replace(",", "").replace(";", "").split())


def test_scripts_work(node: Node) -> None:
    source = """
    class Counter {
      #start = 2;
      constructor({ step = 1, ...others } = {}) { Object.assign(this, { step, others, seen: [] }); }
      get start() { return this.#start; }
      *upTo(end) { for (let at = this.#start; at < end; at += this.step) { this.seen.push(at); yield at; } }
      async later(what) { const { then, given: { deep } } = await what; return `${then}-${deep ? `${deep}!` : ""}`; }
    }
    const counter = new Counter({ step: 3, left: 4 }), found = [...counter.upTo(10)];
    const swapped = ([first, second]) => { [first, second] = [second, first]; return { first, second }; };
    counter.later({ then: "now", given: { deep: 7 } }).then((said) =>
      console.log(JSON.stringify([found, counter.others, counter.start, swapped([1, 2]), said])));
    """
    short = with_short_names(stripped(source))
    assert "counter" not in short
    assert node(short) == node(source) == '[[2,5,8],{"left":4},2,{"first":2,"second":1},"now-7!"]\n'


def ours() -> dict[str, str]:
    """All scripts of ours that are made shorter."""
    scripts = (*CHART_SCRIPTS, *EDITING_SCRIPTS, *PLAYER_SCRIPTS, *POSE_SCRIPTS, "loader.js")
    paths = [
        path.relative_to(WEB).as_posix() for path in sorted(WEB.glob("*/*.js")) if path.parent.name != "three"
    ]
    return {**{name: script(name) for name in scripts}, **{path: module(path) for path in paths}}


@pytest.mark.parametrize("name", ours())
def test_all_names_that_are_made_short_are_declared(name: str) -> None:
    """A name of browsers that `KEPT` does not have would be lost."""
    all_tokens = list(_tokens(stripped(ours()[name])))
    places = [k for k, token in enumerate(all_tokens) if not token.isspace()]
    roles = _roles(all_tokens)
    used, declared = set[str](), set[str]()
    for number, place in enumerate(places):
        if not roles[place]:
            continue
        used.add(all_tokens[place])
        before = all_tokens[places[number - 1]] if number else ""
        after = all_tokens[places[number + 1]] if number + 1 < len(places) else ""
        binding = ("const", "let", "var", "function", "class", "*", "{", "[", "(", ",", "...", "as", ":")
        if before in binding or after == "=>":
            declared.add(all_tokens[place])
    assert used <= declared
