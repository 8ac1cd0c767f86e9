"""Alembic, reading: which meshes are meant."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

imath = pytest.importorskip("imath")
from alembic3d import Abc, AbcGeom  # noqa: E402

from mixseq.errors import AmbiguousError, FormatError, MixseqWarning  # noqa: E402
from tests.formats.alembic.alembic_maker import SQUARE, TRIANGLES, add_mesh, add_transform, load, rising, shift  # noqa: E402


@pytest.fixture
def scene(path: Path) -> Path:
    """A man of body and hat, a still house, a hidden proxy, an instance of the hat, and a camera."""
    archive = Abc.OArchive(str(path))
    man = add_transform(archive.getTop(), "man", np.eye(4))
    add_mesh(man, "body", rising())
    hat = add_mesh(add_transform(man, "head", shift(z=5)), "hat", 2 * rising())
    street = add_transform(archive.getTop(), "street", np.eye(4))
    add_mesh(street, "house", SQUARE[None])
    proxy = add_mesh(man, "proxy", rising())
    AbcGeom.CreateVisibilityProperty(proxy, 0).setValue(0)
    copy = add_transform(archive.getTop(), "copy", shift(x=9))
    copy.addChildInstance(hat, "hat")
    AbcGeom.OCamera(archive.getTop(), "camera")
    del archive, man, hat, street, proxy, copy
    return path


def test_all_that_moves_is_joined(scene: Path) -> None:
    with pytest.warns(MixseqWarning, match=r"stand still are left out; prim='/' .* takes them, too: '/street/house'"):
        got = load(scene)
    assert [each.path for each in got.surface.objects] == ["/man/body", "/man/head/hat", "/copy/hat"]
    assert got.name == "walk"  # nothing is above all
    up = np.array([0, 0, 5], np.float32)
    np.testing.assert_array_equal(got.points[:, :4], rising())
    np.testing.assert_array_equal(got.points[:, 4:8], 2 * rising() + up)
    np.testing.assert_array_equal(got.points[:, 8:], 2 * rising() + np.array([9, 0, 0], np.float32))
    assert got.polygons.indices.tolist() == [*TRIANGLES.indices, *(TRIANGLES.indices + 4), *(TRIANGLES.indices + 8)]


@pytest.mark.parametrize(
    ("prim", "paths", "name"),
    [
        ("/", ["/man/body", "/man/head/hat", "/street/house", "/copy/hat"], "walk"),
        ("/man", ["/man/body", "/man/head/hat"], "man"),
        ("/man/body", ["/man/body"], "body"),
        ("head", ["/man/head/hat"], "hat"),
        ("house", ["/street/house"], "house"),
        ("/man/proxy", ["/man/proxy"], "proxy"),
    ],
)
def test_prim(scene: Path, prim: str, paths: list[str], name: str) -> None:
    got = load(scene, prim)
    assert [each.path for each in got.surface.objects] == paths
    assert got.name == name


def test_a_still_mesh_alone_has_one_frame(scene: Path) -> None:
    assert load(scene, "house").times.tolist() == [0]


def test_unknown_and_ambiguous_names(scene: Path) -> None:
    with pytest.raises(FormatError, match=r"no mesh at or below 'dog'; its meshes are '/man/body', '/man/head/hat'"):
        load(scene, "dog")
    with pytest.raises(FormatError, match="no mesh at or below '/camera'"):
        load(scene, "/camera")
    with pytest.raises(AmbiguousError, match="'hat' is in several places, '/copy/hat', '/man/head/hat'; give its path"):
        load(scene, "hat")


def test_meshes_that_flicker(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    visible = AbcGeom.CreateVisibilityProperty(add_mesh(archive.getTop(), "spark", rising()), 0)
    visible.setValue(1)
    visible.setValue(0)
    del archive, visible
    with pytest.warns(MixseqWarning, match="'/spark' are hidden at times; they are read as visible"):
        load(path)
