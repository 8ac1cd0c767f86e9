"""Who may import whom: every layer stands on those before it, and importing mixseq costs nothing."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]

LAYERS = (
    ("arrays", "choices"),
    (
        "diagonal",
        "errors",
        "forwarding",
        "frame_numbers",
        "frame_rates",
        "interrupts",
        "pickling",
        "progress",
        "public",
        "statistics",
        "threads",
        "version",
    ),
    ("compiled", "dask_executor", "mapping", "polygons", "disk_array", "warned"),
    ("cluster", "polygon_matching", "surface"),
    ("sequence_header",),
    ("sequence",),
    ("topology", "geometry", "frame_store", "unit_conversion"),
    ("prediction", "segmentation"),
    ("shells",),
    ("spaces",),
    ("signals",),
    ("coding", "correspondence", "rigging"),
    ("retargeting",),
    ("operations",),
    ("metrics", "scene", "creature"),
    ("plots", "web"),
    ("mixseq_io",),
    ("viewing", "blender"),
    ("cli",),
    ("__main__",),
)
"""From the ground up; those side by side know nothing of each other."""

LEVEL = {name: level for level, names in enumerate(LAYERS) for name in names}


RELATIVE = "."

ADDON = ROOT / "mixseq/blender/addon"
"""Blender names the package of an add-on, which imports its own modules by relative names; others by absolute ones."""


def layer_of(file: Path) -> str:
    inside = file.relative_to(ROOT).with_suffix("").parts
    return "mixseq_io" if inside[0] == "io" else inside[1]


def imported_layers(source: str) -> set[str]:
    """Layers that a module imports, anywhere in it, also for type checking."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            if node.level:
                found.add(RELATIVE)
                continue
            module = node.module or ""
            names = [f"mixseq.{alias.name}" for alias in node.names] if module == "mixseq" else [module]
        for name in names:
            parts = name.split(".")
            if parts[0] == "mixseq_io":
                found.add("mixseq_io")
            elif parts[0] == "mixseq" and len(parts) > 1:
                found.add(parts[1])
    return found


FILES = sorted(
    file
    for folder in (ROOT / "mixseq", ROOT / "io" / "mixseq_io")
    for file in folder.rglob("*.py")
    if file != ROOT / "mixseq" / "__init__.py"
)


def test_every_module_has_a_layer() -> None:
    assert {layer_of(file) for file in FILES} == set(LEVEL)


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(ROOT)))
def test_layers_stand_on_those_before(file: Path) -> None:
    own, found = layer_of(file), imported_layers(file.read_text(encoding="utf-8"))
    assert RELATIVE not in found or file.parent == ADDON, "imports are absolute"
    for other in found & LEVEL.keys():
        assert other == own or LEVEL[other] < LEVEL[own], f"{own} imports {other}"
    unknown = found - LEVEL.keys() - {"__version__", RELATIVE}
    assert not unknown or own in ("cli", "mixseq_io"), unknown  # the lazy names of mixseq


@pytest.mark.parametrize(
    ("source", "layers"),
    [
        ("import mixseq.spaces.mixed", {"spaces"}),
        ("from mixseq.signals import fit", {"signals"}),
        ("from mixseq import topology", {"topology"}),
        ("def f():\n    from mixseq_io.hdf5.h5_files import whole", {"mixseq_io"}),
        ("import numpy as np, mixseq", set()),
    ],
)
def test_imports_are_found(source: str, layers: set[str]) -> None:
    assert imported_layers(source) == layers


def loaded_by(statement: str) -> set[str]:
    """Top-level modules in memory after a statement, in a fresh interpreter."""
    code = f"{statement}\nimport sys\nprint(*{{name.split('.')[0] for name in sys.modules}})"
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    )
    return set(result.stdout.split())


HEAVY = {"scipy", "h5py", "pxr", "matplotlib", "trimesh", "click", "rich", "viser"}


def test_importing_mixseq_loads_nothing_heavy() -> None:
    loaded = loaded_by("import mixseq; dir(mixseq); mixseq.__version__")
    assert "mixseq" in loaded
    assert not loaded & (HEAVY | {"numpy", "mixseq_io"})


@pytest.mark.parametrize(
    ("statement", "without"),
    [
        ("from mixseq import MeshSequence", HEAVY),
        ("from mixseq import read", HEAVY),
        ("from mixseq import fit", HEAVY - {"scipy"}),
        ("from mixseq import load", HEAVY),
        ("from mixseq import Model", HEAVY),
    ],
)
def test_names_load_only_what_they_need(statement: str, without: set[str]) -> None:
    assert not loaded_by(statement) & without


def test_decoding_a_compressed_model_imports_little() -> None:
    path = ROOT / "tests/formats/golden/compressed-v1-uvs.h5"
    decode = f"import mixseq\nmixseq.load({str(path)!r})(0.0)\n"
    listed = "import sys\nprint(*sys.modules)"
    for _ in range(2):  # where something must be compiled, numba imports far more
        result = subprocess.run(
            [sys.executable, "-c", decode + listed], capture_output=True, text=True, check=True, cwd=ROOT
        )
    modules = set(result.stdout.split())
    assert modules >= {"mixseq.coding.bitstream.compressed_sequence", "numba"}
    assert not {name.split(".")[0] for name in modules} & (
        HEAVY - {"scipy"}
    )  # numba asks scipy for its version
    parts = ("integrate", "interpolate", "linalg", "optimize", "sparse", "spatial", "special", "stats")
    assert not modules & {f"scipy.{part}" for part in parts}
    rooms = {name.split(".")[1] for name in modules if name.startswith("mixseq.")}
    assert not rooms & {"cli", "operations", "rigging", "segmentation", "shells"}
    assert not modules & {"mixseq.signals.fitting", "mixseq.spaces.mixed", "mixseq_io.hdf5.model_files"}


def test_every_name_of_mixseq_is_there() -> None:
    import mixseq

    assert dir(mixseq) == sorted(mixseq.__all__)
    for name in mixseq.__all__:
        assert getattr(mixseq, name) is not None
    with pytest.raises(AttributeError, match="module 'mixseq' has no attribute 'nothing'"):
        mixseq.nothing  # noqa: B018


@pytest.mark.parametrize("path", ["io/__init__.py", "tests/io", "tests/__init__.py"])
def test_names_of_the_standard_library_are_not_shadowed(path: str) -> None:
    assert not (ROOT / path).exists()
