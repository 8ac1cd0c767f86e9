"""One module out of many: the same exports, and nothing else."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

import mixseq
from mixseq import web as bundle
from mixseq.cli import main
from mixseq.web import SEQUENCE_MODULE, bundled, package_files
from tests.formats.gltf.test_mesh_sequences import document, dressed_bar
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
    monkeypatch.setattr(bundle, "read_module", MODULES.__getitem__)
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
        f'import * as all from "{SEQUENCE_MODULE}";\nconsole.log(Object.keys(all).join());'
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
    own, bundle = WEB / SEQUENCE_MODULE, tmp_path / "mixseq.mjs"
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
        path.relative_to(WEB).as_posix()
        for path in sorted(WEB.glob("*/*.js"))
        if path.parent.name not in ("three", "page")
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


# What `mixseq web` writes: all that is promised, whole, and of a piece

ROOT = Path(__file__).parents[2]


def test_the_command_writes_a_package(tmp_path: Path) -> None:
    out = tmp_path / "site"
    result = CliRunner().invoke(main, ["web", "--out", str(out)])
    assert (result.exit_code, result.output) == (0, f"wrote {out}\n")
    assert {file.name: file.read_text(encoding="utf-8") for file in out.iterdir()} == package_files()
    package = json.loads((out / "package.json").read_text())
    assert package["version"] == mixseq.__version__
    for export in package["exports"].values():
        assert all((out / path).is_file() for path in export.values())
    before = CliRunner().invoke(main, ["web", "--out", str(out), "--no-overwrite"])
    assert before.exit_code == 2
    assert "exist" in before.output


def test_the_readme_names_every_file() -> None:
    named = re.findall(r"`([\w.-]+\.(?:js|ts|html|json|css))`", package_files()["README.md"])
    assert {*named, "README.md", "package.json"} == set(package_files())


def test_scripts_of_the_documentation_are_those_of_the_readme() -> None:
    shown = re.findall(r"^```js\n(.*?)^```", (ROOT / "docs/web.md").read_text(), re.MULTILINE | re.DOTALL)
    ours = re.findall(r"^```js\n(.*?)^```", package_files()["README.md"], re.MULTILINE | re.DOTALL)
    assert len(shown) == 6
    assert shown[0] == ours[0]
    assert shown[1].splitlines()[:4] == ours[1].splitlines()[:4]


def test_types_are_of_what_is_exported(node: Node, tmp_path: Path) -> None:
    for script, types in (("mixseq.js", "mixseq.d.ts"), ("mesh_sequence.js", "mesh_sequence.d.ts")):
        text = package_files()[script]
        told = set(re.findall(r"^export (?:class|function) (\w+)", package_files()[types], re.MULTILINE))
        if script == "mixseq.js":
            (tmp_path / script).write_text(text)
            address = (tmp_path / script).as_uri()
            listed = node(f"console.log(JSON.stringify(Object.keys(await import('{address}'))));")
            found = set(json.loads(listed))
        else:
            found = set(re.findall(r"^export (?:class|function) (\w+)", text, re.MULTILINE))
        assert told == found


def test_the_plugin_is_short() -> None:
    assert package_files()["mesh_sequence.js"].count("\n") < 150


def conforms(value: Any, schema: dict[str, Any]) -> bool:
    """Whether a value has what a schema of the few words that ours has asks for."""
    kinds = {"object": dict, "integer": int, "array": list}
    if "type" in schema and not isinstance(value, kinds[schema["type"]]):
        return False
    if "const" in schema and value != schema["const"]:
        return False
    if isinstance(value, dict):
        return set(schema["required"]) <= set(value) <= set(schema["properties"]) and all(
            conforms(value[name], schema["properties"][name]) for name in value
        )
    if isinstance(value, list):
        return len(value) >= schema["minItems"] and all(conforms(each, schema["items"]) for each in value)
    return bool(value >= schema.get("minimum", value))


def test_files_are_as_the_schema_says(tmp_path: Path) -> None:
    schema = json.loads(package_files()["MIXSEQ_mesh_sequence.schema.json"])
    mixseq.save(tmp_path / "walk.glb", mixseq.compress(dressed_bar(), max_error=1e-2), still="none")
    content, _ = document(tmp_path / "walk.glb")
    extension = content["meshes"][0]["extensions"]["MIXSEQ_mesh_sequence"]
    assert set(extension) == {"version", "coding", "streams", "polygons"}
    assert conforms(extension, schema)
    for wrong in ({"version": 9}, {"streams": -1}, {"polygons": [0]}, {"other": 1}):
        assert not conforms(extension | wrong, schema)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("file.slice(0, 12)", "this is not a GLB file"),
        ("new ArrayBuffer(40)", "this is not a GLB file"),
        ("file.slice(0, file.byteLength - 100)", "this GLB file is incomplete"),
    ],
)
def test_other_files_are_refused_in_javascript(node: Node, tmp_path: Path, change: str, message: str) -> None:
    mixseq.save(tmp_path / "walk.glb", mixseq.compress(dressed_bar(), max_error=1e-2), still="none")
    told = node(
        f"""
        import {{ readFileSync }} from "node:fs";
        import {{ readGlb }} from "player/glb.js";
        import {{ MixseqError }} from "decoder/errors.js";
        const file = new Uint8Array(readFileSync(process.argv[2])).buffer;
        console.log(readGlb(file).mesh.name);
        try {{ readGlb({change}); }} catch (error) {{ console.log(error instanceof MixseqError, error.message); }}
        """,
        tmp_path / "walk.glb",
    )
    assert told.splitlines() == ["Stange", f"true {message}"]
