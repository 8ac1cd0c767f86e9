"""Where meshes are in an archive of their own."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("imath")
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import MeshObject, Surface
from mixseq.sequence.header import SequenceHeader
from mixseq_io.alembic.samples import object_places
from mixseq_io.scene_meshes import split


def places(name: str, *paths: str) -> list[str]:
    objects = tuple(MeshObject(path.rpartition("/")[2], path, 3, 1) for path in paths)
    header = SequenceHeader(
        polygons=Polygons.from_triangles(np.arange(3 * len(paths)).reshape(-1, 3)),
        vertex_count=3 * len(paths),
        times=np.zeros(1),
        name=name,
        surface=Surface(objects=objects),
    )
    return ["/" + "/".join(place) for place in object_places(header, split(header))]


@pytest.mark.parametrize(
    ("name", "paths"),
    [
        ("body", ["/rig/body/body"]),
        ("rig", ["/rig/body/body", "/rig/sword/sword"]),
        ("shot", ["/body/body", "/sword/sword"]),
    ],
)
def test_paths_are_kept(name: str, paths: list[str]) -> None:
    assert places(name, *paths) == paths


@pytest.mark.parametrize(
    ("name", "paths", "expected"),
    [
        ("body", ["/body"], ["/body/body"]),  # without a transform tools have no name for it
        ("hero", ["/rig/body/body"], ["/hero/hero"]),  # the name is read from the path
        ("rig", ["Root/body", "Root/hat"], ["/rig/body/body", "/rig/hat/hat"]),  # of glTF
        ("rig", ["/rig/body", "/rig/body/hat"], ["/rig/body/body", "/rig/hat/hat"]),
        ("rig", ["/rig/body", "/rig/body"], ["/rig/body/body", "/rig/body_2/body_2"]),
        ("rig", ["/rig//body", "/rig/hat"], ["/rig/body/body", "/rig/hat/hat"]),
    ],
)
def test_other_paths_are_made(name: str, paths: list[str], expected: list[str]) -> None:
    assert places(name, *paths) == expected
