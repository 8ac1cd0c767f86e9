"""One module out of many: the same exports, and nothing else."""

from __future__ import annotations

from pathlib import Path

import pytest

from mixseq import web as bundle
from mixseq.web import SEQUENCE, bundled
from tests.web.conftest import WEB, Node
from tests.web.played import write_container

MODULES = {
    "decoder/sum.js": """// adds
const SIZE = 2; /* of what? */
export const add = (a, b) => a + b + 0 * SIZE; // "both"
""",
    "decoder/text.js": """import { add } from "./sum.js";
const SIZE = "// no comment";

/** A text of
    several lines. */
export function told() {
  return `${SIZE}
    ${add(1, 2)}`;
}
export class Told {}
""",
    "player/play.js": """import { told as heard, Told } from "../decoder/text.js";
import {
  add,
} from "../decoder/sum.js";
export async function* all() { yield heard(); }
export let last = add(4, 5), kind = typeof new Told();
""",
}


@pytest.fixture
def modules(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bundle, "module", MODULES.__getitem__)
    bundled.cache_clear()


@pytest.mark.usefixtures("modules")
def test_modules_become_one(node: Node, tmp_path: Path) -> None:
    text = bundled("player/play.js", "decoder/sum.js")
    assert "import" not in text
    assert "both" not in text
    assert "of what" not in text
    assert "several" not in text
    bundled_file = tmp_path / "mixseq.mjs"
    bundled_file.write_text(text, encoding="utf-8")
    said = node(
        "const all = await import(process.argv[2]);\n"
        "console.log(JSON.stringify([Object.keys(all), (await all.all().next()).value, all.last, all.kind]));",
        bundled_file,
    )
    assert said.strip() == '[["add","all","kind","last"],"// no comment\\n    3",9,"object"]'


def test_the_decoder_is_a_module_of_its_own(node: Node, tmp_path: Path) -> None:
    bundled_file = tmp_path / "mixseq.mjs"
    bundled_file.write_text(bundled(), encoding="utf-8")
    names = "console.log(Object.keys(await import(process.argv[2])).join());"
    assert node(names, bundled_file) == node(
        f'import * as all from "{SEQUENCE}";\nconsole.log(Object.keys(all).join());'
    )


def test_the_bundled_decoder_decodes(node: Node, tmp_path: Path) -> None:
    write_container(tmp_path, Path(__file__).parents[1] / "formats/golden/compressed-v1-uvs.h5")
    (tmp_path / "mixseq.mjs").write_text(bundled(), encoding="utf-8")
    script = """
    import { readFileSync } from "node:fs";
    const [module, folder] = process.argv.slice(2), { open } = await import(module);
    const text = readFileSync(`${folder}/text`, "latin1"), bytes = new Uint8Array(readFileSync(`${folder}/streams`));
    const sequence = await open(text, bytes);
    console.log(sequence.at(0.06).join(), sequence.weights(0).join());
    """
    own, bundle = WEB / SEQUENCE, tmp_path / "mixseq.mjs"
    assert node(script, bundle, tmp_path) == node(script, own, tmp_path)


def test_the_script_of_the_page_runs(node: Node, tmp_path: Path) -> None:
    """That of docs/web.md which goes on from the text and the bytes of a file."""
    write_container(tmp_path, Path(__file__).parents[1] / "formats/golden/compressed-v1-uvs.h5")
    (tmp_path / "mixseq.js").write_text(bundled(), encoding="utf-8")
    (tmp_path / "package.json").write_text('{"type": "module"}', encoding="utf-8")
    page = (Path(__file__).parents[2] / "docs/web.md").read_text(encoding="utf-8")
    given = """
    import { readFileSync } from "node:fs";
    const folder = process.argv[2], text = readFileSync(`${folder}/text`, "latin1");
    const bytes = new Uint8Array(readFileSync(`${folder}/streams`));
    """
    shown = page.partition("## The decoder")[2].partition("```js\n")[2].partition("```")[0]
    told = node(f"{given}{shown}\nconsole.log(positions.every(Number.isFinite), triangles.length);", tmp_path)
    assert told.split()[0] == "true"


def test_every_module_exports_the_same_in_a_bundle(node: Node, tmp_path: Path) -> None:
    """Also what other modules import of it: names that the bundle does not see would be undefined there."""
    paths = [
        path.relative_to(WEB).as_posix() for path in sorted(WEB.glob("*/*.js")) if "three" not in path.parts
    ]
    for number, path in enumerate(paths):
        (tmp_path / f"bundle{number}.mjs").write_text(bundled(path), encoding="utf-8")
    script = """
    const [root, folder, ...paths] = process.argv.slice(2);
    for (const [number, path] of paths.entries()) {
      const names = async (file) => Object.keys(await import(file)).sort().join();
      const [own, bundled] = [await names(`${root}/${path}`), await names(`${folder}/bundle${number}.mjs`)];
      if (own !== bundled) throw new Error(`${path} exports ${own}; bundled ${bundled}`);
    }
    """
    node(script, WEB, tmp_path, *paths)
