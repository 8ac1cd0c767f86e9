"""Labels of faces: what is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import UsdGeom, Vt

from mixseq.errors import AmbiguousError, FormatError, MixseqError, SettingsError
from mixseq.mesh.polygons import Polygons
from mixseq_io import read, read_labels
from tests.formats.labels.labelled_files import OBJ, groups, mesh, skinned_strip, subsets, told
from tests.formats.usd_maker import Asset
from tests.meshes import grid


def two_sources(path: Path) -> Path:
    asset = subsets(path)
    asset.mesh.CreateDisplayColorPrimvar("uniform").Set([(0, 0, 0), (1, 1, 1)])
    asset.stage.Save()
    return path


def nothing(path: Path) -> Path:
    path.write_text(OBJ + "f 1 2 3 4\nf 2 5 3\n")
    return path


def arrays(**values: Any) -> Callable[[Path], Path]:
    def save(path: Path) -> Path:
        np.savez(path, **values)
        return path

    return save


def many_colours(path: Path) -> Path:
    points, faces = grid(20, 20)
    rows = [f"{x:g} {y:g} {z:g} {n % 256} {n // 256} 0" for n, (x, y, z) in enumerate(points)]
    rows += ["3 " + " ".join(map(str, face)) for face in faces]
    colours = "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    head = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n"
    head += "property float x\nproperty float y\nproperty float z\n" + colours
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    path.write_text(head + "\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize(
    ("name", "make", "source", "kind", "message"),
    [
        ("a.obj", nothing, None, FormatError, "no labels of faces; it has no labels, face sets"),
        ("a.obj", groups, "skeleton", FormatError, "no 'skeleton' to label faces by; it has groups"),
        ("a.usda", two_sources, None, AmbiguousError, "several sources of labels: limbs, colours; choose one"),
        ("a.ply", many_colours, None, FormatError, "441 vertex colours, too many for a segmentation"),
        ("a.npz", arrays(labels=np.zeros(4, int)), None, FormatError, "4 labels, .* 3 triangles and 2 polygons"),
        ("a.npz", arrays(labels=[0.5, 1, 2]), None, FormatError, "whole numbers or names"),
        ("a.npz", arrays(labels=[[0, 1, 2]]), None, FormatError, r"shape \(1, 3\)"),
        ("a.npz", arrays(paint=[0, 1, 2]), None, FormatError, "arrays paint; `part_of_face` or `labels`"),
        ("a.npz", lambda path: path, None, FormatError, "does not exist"),
        ("a.npz", groups, None, FormatError, "damaged, truncated or of another type"),
    ],
)
def test_refusals(
    name: str, make: Callable[[Path], Path], source: str | None, kind: type[MixseqError], message: str, tmp_path: Path
) -> None:
    path = make(tmp_path / name)
    whole = read(path) if name.endswith(("usda", "ply")) else mesh()
    with pytest.raises(kind, match=message) as caught:
        read_labels(path, whole, source)
    assert str(path) in str(caught.value)


def test_labels_of_another_mesh(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="3 triangles, the sequence 1"):
        read_labels(groups(tmp_path / "a.obj"), mesh(Polygons.from_triangles([[0, 1, 2]])))


def test_the_smallest_joint_is_a_share(tmp_path: Path) -> None:
    path = skinned_strip(tmp_path / "man.usda")
    with pytest.raises(SettingsError, match="smallest_joint is 7"):
        read_labels(path, read(path), "skeleton", smallest_joint=7)


def test_a_painted_mesh_does_not_stand_in_the_way_of_labels(tmp_path: Path) -> None:
    many_colours(tmp_path / "a.ply")
    points, faces = grid(20, 20)
    asset = Asset(tmp_path / "a.usda", Polygons.from_triangles(faces))
    asset.mesh.GetPointsAttr().Clear()
    asset.mesh.GetPointsAttr().Set(Vt.Vec3fArrayFromBuffer(points.astype(np.float32)))
    asset.mesh.CreateDisplayColorPrimvar("vertex").Set([(n / 440, n % 2, 0) for n in range(441)])
    UsdGeom.Subset.CreateGeomSubset(asset.mesh, "half", "face", Vt.IntArray(list(range(400))), "")
    asset.stage.Save()
    assert set(told(read_labels(asset.path, read(asset.path)))) == {"half", "(none)"}
