"""Which room may import which, no circles, and importing mixseq costs nothing."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]

ROOMS = (
    "types",
    "choices",
    "errors",
    "runtime",
    "mesh",
    "sequence",
    "segmentation",
    "shells",
    "spaces",
    "signals",
    "compression",
    "rigging",
    "retargeting",
    "operations",
    "metrics",
    "creature",
    "pictures",
    "web",
    "mixseq_io",
    "viewer",
    "blender",
    "cli",
    "__main__",
)
"""From the ground up, as in docs/architecture.md: a room imports only those before it."""

ADDON = ROOT / "mixseq/blender/addon"
"""Blender names the package of an add-on, which imports its own modules by relative names; others by absolute ones."""


PACKAGES = {"mixseq": ROOT / "mixseq", "mixseq_io": ROOT / "io" / "mixseq_io"}

MODULES = {
    ".".join((package, *file.relative_to(folder).with_suffix("").parts)).removesuffix(".__init__"): file
    for package, folder in PACKAGES.items()
    for file in sorted(folder.rglob("*.py"))
    if ADDON not in file.parents  # imports of the add-on are relative
}


def imported_modules(source: str) -> set[str]:
    """Modules of ours that a module imports, anywhere in it, also for type checking."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, "imports are absolute"
            whole = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in MODULES else str(node.module) for name in whole}
    return found & MODULES.keys()


def room_of(module: str) -> str:
    package, _, inside = module.partition(".")
    return package if package == "mixseq_io" else inside.partition(".")[0]


@pytest.fixture(scope="module")
def imports() -> dict[str, set[str]]:
    """What each module imports of ours."""
    return {module: imported_modules(file.read_text(encoding="utf-8")) for module, file in MODULES.items()}


def test_every_module_is_in_a_room() -> None:
    assert {room_of(module) for module in MODULES} - {"", "version"} == set(ROOMS)


def test_rooms_import_only_those_before(imports: dict[str, set[str]]) -> None:
    for module in imports.keys() - {"mixseq"}:
        own = room_of(module)
        for other in {room_of(name) for name in imports[module]} - {"version", own}:
            if other == "":  # the lazy names of mixseq
                assert own in ("blender", "cli", "mixseq_io", "__main__"), f"{module} imports mixseq"
            else:
                assert ROOMS.index(other) < ROOMS.index(own), f"{module} imports {other}"


def test_no_modules_import_each_other_in_a_circle(imports: dict[str, set[str]]) -> None:
    graph = {module: names - {"mixseq"} for module, names in imports.items() if module != "mixseq"}
    while leaves := {module for module, names in graph.items() if not names & graph.keys()}:
        graph = {module: names for module, names in graph.items() if module not in leaves}
    assert not graph, "these are in circles, or import some that are"


@pytest.mark.parametrize(
    ("source", "modules"),
    [
        ("import mixseq.spaces.lri", {"mixseq.spaces.lri"}),
        ("from mixseq.signals.fitting import fit", {"mixseq.signals.fitting"}),
        ("from mixseq.mesh import topology", {"mixseq.mesh.topology"}),
        ("def f():\n    from mixseq_io.hdf5.contents import whole", {"mixseq_io.hdf5.contents"}),
        ("import numpy as np, mixseq", {"mixseq"}),
    ],
)
def test_imports_are_found(source: str, modules: set[str]) -> None:
    assert imported_modules(source) == modules


def loaded_by(*statements: str) -> list[set[str]]:
    """Top-level modules in memory after each of the statements, which run in turn in a fresh interpreter."""
    listed = "print(*{name.split('.')[0] for name in sys.modules})"
    code = "\n".join(["import sys", *(f"{statement}\n{listed}" for statement in statements)])
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    return [set(line.split()) for line in result.stdout.splitlines()]


HEAVY = {"scipy", "h5py", "pxr", "matplotlib", "trimesh", "click", "rich", "viser"}


def test_names_load_only_what_they_need() -> None:
    names = ("MeshSequence", "read", "load", "Model", "fit")
    whole, *loaded = loaded_by(
        "import mixseq; dir(mixseq); mixseq.__version__", *(f"from mixseq import {name}" for name in names)
    )
    assert "mixseq" in whole
    assert not whole & (HEAVY | {"numpy", "mixseq_io"})
    for name, modules in zip(names, loaded, strict=True):
        assert not modules & (HEAVY - {"scipy"} if name == "fit" else HEAVY), name


def test_reading_files_loads_no_compiler() -> None:
    """Every worker that opens a file would wait for it."""
    (loaded,) = loaded_by("import mixseq_io.usd.reader, mixseq_io.gltf.reader")
    assert "pxr" in loaded
    assert not loaded & (HEAVY - {"pxr", "scipy"} | {"numba"})


def test_decoding_a_compressed_model_imports_little() -> None:
    path = ROOT / "tests/formats/golden/compressed-v1-uvs.h5"
    decode = f"import mixseq\nmixseq.load({str(path)!r})(0.0)\n"
    listed = "import sys\nprint(*sys.modules)"
    parts = ("integrate", "interpolate", "linalg", "optimize", "sparse", "spatial", "special", "stats")
    needless = {f"scipy.{part}" for part in parts}
    for _ in range(2):  # where something must be compiled, numba imports far more
        result = subprocess.run(
            [sys.executable, "-c", decode + listed], capture_output=True, text=True, check=True, cwd=ROOT
        )
        modules = set(result.stdout.split())
        if not modules & needless:
            break
    assert modules >= {"mixseq.compression.bitstream.compressed_sequence", "numba"}
    assert not {name.split(".")[0] for name in modules} & (HEAVY - {"scipy"})  # numba asks scipy for its version
    assert not modules & needless
    rooms = {name.split(".")[1] for name in modules if name.startswith("mixseq.")}
    assert not rooms & {"cli", "operations", "rigging", "segmentation", "shells"}
    assert not modules & {
        "mixseq.signals.fitting",
        "mixseq.spaces.mixed.mixed_space",
        "mixseq_io.hdf5.models",
    }


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
