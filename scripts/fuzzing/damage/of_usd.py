"""Damage to what USD says: its text is changed, also that of binary files, which are written anew."""

from __future__ import annotations

import os
import re

from pxr import Sdf, Tf

from scripts.fuzzing.case import Case, NotMadeError
from scripts.fuzzing.damage.of_text import ESCAPES, damaged_text

_KINDS = ("references", "payload", "inherits", "specializes")

_TEXTURE = """
def Shader "picture"
{{
    uniform token info:id = "UsdUVTexture"
    asset inputs:file = @{}@
}}
"""


def damage_usd(case: Case) -> str:
    """Change one to three things in a layer."""
    text = _text(case)
    labels = []
    for _ in range(case.rng.choice([1, 1, 2, 3])):
        label, text = _arc(text, case) if case.rng.random() < 0.3 else damaged_text(text, case)
        labels.append(label)
    if case.file.read_bytes()[:8] != b"PXR-USDC":
        case.file.write_bytes(text.encode("utf-8", "surrogateescape"))
        return ", ".join(labels)
    layer = Sdf.Layer.CreateAnonymous(".usda")
    try:
        made = layer.ImportFromString(text)
    except (Tf.ErrorException, UnicodeError, ValueError):
        made = False
    if not made:
        raise NotMadeError
    layer.Export(str(case.file), args={"format": "usdc"})
    return ", ".join(labels)


def _text(case: Case) -> str:
    if case.file.read_bytes()[:8] != b"PXR-USDC":
        return case.file.read_bytes().decode("utf-8", "surrogateescape")
    layer = Sdf.Layer.FindOrOpen(str(case.file))
    if not layer:
        raise NotMadeError
    return layer.ExportToString()


def _arc(text: str, case: Case) -> tuple[str, str]:
    """Let a prim or the layer refer to something that is not there, to itself, out, or to a pipe."""
    rng = case.rng
    targets = [
        case.out(),
        case.file.name,
        "pipe.usda",
        ESCAPES,
        "",
        "a" * 5000,
        f"{case.file.name}[x]",
        "./missing.usd",
    ]
    target = rng.choice(targets)
    if target == "pipe.usda":
        os.mkfifo(case.file.with_name(target))
    materials = list(re.finditer(r'def Material "[^"]*"\s*{', text))
    if materials and rng.random() < 0.3:
        end = rng.choice(materials).end()
        return f"a texture {target[:80]!r}", text[:end] + _TEXTURE.format(target) + text[end:]
    prims = list(re.finditer(r'(def|over) *\w* *"([^"]*)" *\(?', text))
    if rng.random() < 0.4 or not prims:
        line = rng.choice(
            [f"subLayers = [@{target}@]\n", f'customLayerData = {{ string a = "{ESCAPES}" }}\n']
        )
        if "(" in text[:20]:
            return f"{line!r:.80}", text.replace("(", f"(\n{line}", 1)
        return f"{line!r:.80}", text.replace("\n", f"\n(\n{line})\n", 1)
    prim = rng.choice(prims)
    kind = rng.choice([*_KINDS, "clips", "instance"])
    path = rng.choice([each.group(2) for each in prims])
    value = {
        "references": f"references = @{target}@",
        "payload": f"payload = @{target}@",
        "inherits": f"inherits = </{path}>",
        "specializes": f"specializes = </{path}>",
        "clips": f'clips = {{ dictionary default = {{ asset[] assetPaths = [@{target}@] string primPath = "/{path}" '
        "double2[] active = [(0, 0)] double2[] times = [(0, 0), (1e9, 1)] asset manifestAssetPath = @x.usda@ } }",
        "instance": f"instanceable = true\nreferences = </{path}>",
    }[kind]
    head = prim.group()
    new = f"{head}\n{value}\n" if head.endswith("(") else f"{head} (\n{value}\n)\n"
    return f"{prim.group(2)}: {value[:80]!r}", text[: prim.start()] + new + text[prim.end() :]
