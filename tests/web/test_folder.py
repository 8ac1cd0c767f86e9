"""What `mixseq web` writes: all that is promised, whole, and of a piece."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

import mixseq
from mixseq.cli import main
from mixseq.web import contents
from tests.formats.gltf.test_mesh_sequences import document, dressed_bar
from tests.web.conftest import Node

ROOT = Path(__file__).parents[2]


def test_the_command_writes_a_package(tmp_path: Path) -> None:
    out = tmp_path / "site"
    result = CliRunner().invoke(main, ["web", "--out", str(out)])
    assert (result.exit_code, result.output) == (0, f"wrote {out}\n")
    assert {file.name: file.read_text(encoding="utf-8") for file in out.iterdir()} == contents()
    package = json.loads((out / "package.json").read_text())
    assert package["version"] == mixseq.__version__
    for export in package["exports"].values():
        assert all((out / path).is_file() for path in export.values())
    before = CliRunner().invoke(main, ["web", "--out", str(out), "--no-overwrite"])
    assert before.exit_code == 2
    assert "exist" in before.output


def test_the_readme_names_every_file() -> None:
    named = re.findall(r"`([\w.-]+\.(?:js|ts|html|json))`", contents()["README.md"])
    assert {*named, "README.md", "package.json"} == set(contents())


def test_scripts_of_the_documentation_are_those_of_the_readme() -> None:
    shown = re.findall(r"^```js\n(.*?)^```", (ROOT / "docs/web.md").read_text(), re.MULTILINE | re.DOTALL)
    ours = re.findall(r"^```js\n(.*?)^```", contents()["README.md"], re.MULTILINE | re.DOTALL)
    assert len(shown) == 6
    assert shown[0] == ours[0]
    assert shown[1].splitlines()[:4] == ours[1].splitlines()[:4]


def test_types_are_of_what_is_exported(node: Node, tmp_path: Path) -> None:
    for script, types in (("mixseq.js", "mixseq.d.ts"), ("mesh_sequence.js", "mesh_sequence.d.ts")):
        text = contents()[script]
        told = set(re.findall(r"^export (?:class|function) (\w+)", contents()[types], re.MULTILINE))
        if script == "mixseq.js":
            (tmp_path / script).write_text(text)
            address = (tmp_path / script).as_uri()
            listed = node(f"console.log(JSON.stringify(Object.keys(await import('{address}'))));")
            found = set(json.loads(listed)) - {"NAME", "COPIED", "GIVEN_AWAY", "serve"}
        else:
            found = set(re.findall(r"^export (?:class|function) (\w+)", text, re.MULTILINE))
        assert told == found


def test_the_plugin_is_short() -> None:
    assert contents()["mesh_sequence.js"].count("\n") < 150


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
    schema = json.loads(contents()["MIXSEQ_mesh_sequence.schema.json"])
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
        ("file.slice(0, 12)", "this is no GLB file"),
        ("new ArrayBuffer(40)", "this is no GLB file"),
        ("file.slice(0, file.byteLength - 100)", "this GLB file is not all there"),
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
