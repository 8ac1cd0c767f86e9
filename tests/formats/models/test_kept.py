"""Models in HDF5: nothing is lost, and a failed save leaves the old file."""

from __future__ import annotations

import json
from dataclasses import replace as replace_fields
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import mixseq
from mixseq.choices import PLACEMENTS
from mixseq.errors import OutputError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import CornerValues, FaceSet, MeshObject, Origin, Surface
from mixseq.sequence.sequence import MeshSequence
from mixseq.shells.fitting import ShellSettings
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.spaces.base import ShapeSpace
from mixseq.spaces.edge import EdgeSpace
from mixseq.spaces.mixed.mixed_space import MixedSpace
from mixseq_io.surfaces import surface_to_arrays
from tests.formats.models.model_cases import ATTRIBUTES, DATASETS, POSES, SETTINGS, SHAPES, assert_equal
from tests.meshes import SEQUENCES, bar


def assert_kept(original: Model, path: Path) -> None:
    """Check that a model comes back as it was, and decodes to the same."""
    mixseq.save(path, original)
    loaded = mixseq.load(path)
    assert_equal(original, loaded)
    middle = [float(np.mean(original.times))]
    np.testing.assert_array_equal(loaded.sample(middle).points, original.sample(middle).points)


@pytest.mark.parametrize("placement", PLACEMENTS)
@pytest.mark.parametrize(
    "name", ["bar", "rigid component", "several components", "unused vertices", "still", "one frame", "float32"]
)
def test_nothing_is_lost(name: str, placement: Any, tmp_path: Path) -> None:
    assert_kept(mixseq.fit(SEQUENCES[name](), placement=placement, exact=True), tmp_path / "model.h5")


@pytest.mark.parametrize("name", ["unused vertices", "still", "one frame", "float32"])
def test_nothing_is_lost_in_the_vertex_space(name: str, tmp_path: Path) -> None:
    assert_kept(mixseq.fit(SEQUENCES[name](), space="vertex"), tmp_path / "model.h5")


@pytest.mark.parametrize("space", ["gradient", "lri", "edge"])
@pytest.mark.parametrize("name", ["rigid component", "several components", "unused vertices", "one frame", "float32"])
def test_nothing_is_lost_in_other_spaces(name: str, space: Any, tmp_path: Path) -> None:
    assert_kept(mixseq.fit(SEQUENCES[name](), space=space, exact=True), tmp_path / "model.h5")


@pytest.mark.parametrize(
    "settings",
    [{"tolerance": 1e-2}, {"rank": 0}, {"rank": 2, "knots": [0.3]}, {"rank": 2, "knots": 0, "space": "vertex"}],
    ids=str,
)
def test_nothing_is_lost_of_signals_with_less_detail(settings: dict[str, Any], tmp_path: Path) -> None:
    assert_kept(mixseq.fit(bar(sides=5, rings=13, frames=7), **settings), tmp_path / "model.h5")


def test_curves_may_be_longer_than_the_frames(models: dict[str, Model], tmp_path: Path) -> None:
    """And each may have knots of its own, and frames may lie between them."""
    a = models["vertex"]
    header = a.header.with_times([0.11, 0.3])
    assert_kept(Model(header, a.space, a.time, a.pose, a.shapes, a.placement), tmp_path / "model.h5")


def test_header_and_settings_are_kept(tmp_path: Path) -> None:
    """Quads, times that are no multiples of 1 / fps, units, names in any script."""
    counts, corners = np.array([4, 4, 3]), np.array([0, 1, 2, 3, 3, 2, 4, 5, 5, 4, 6])
    points = np.random.default_rng(0).normal(size=(3, 7, 3))
    sequence = MeshSequence.from_arrays(
        points, Polygons(counts, corners), [0.1, 0.25, 7 / 3], 29.97, "Z", 0.01, "走る Männchen"
    )
    surface = Surface(
        uvs=CornerValues(points[0, :, :2], corners),
        hard_edges=np.arange(11),
        face_sets=(FaceSet("Kopf", np.array([1]), "/Looks/皮"), FaceSet("empty", np.array([], dtype=int))),
        objects=(MeshObject("körper", "/world/körper", 7, 3),),
        subdivision="catmullClark",
        origin=Origin("USD", "/shots/walk.usd"),
    )
    sequence = replace_fields(sequence, surface=surface)
    shell = ShellSettings(bending=1 / 3, iterations=5, tolerance=1e-3, exact=1e-7)
    original = mixseq.fit(sequence, shell=shell, space="edge", projection="dso")
    mixseq.save(tmp_path / "model.h5", original)
    loaded = mixseq.load(str(tmp_path / "model.h5"))
    assert_equal(original, loaded)
    assert isinstance(loaded.space, EdgeSpace)
    assert loaded.space.shell == shell
    assert not loaded.header.polygons.only_triangles
    ours, theirs = surface_to_arrays(surface), surface_to_arrays(loaded.header.surface)
    assert ours.keys() == theirs.keys()
    for name, array in ours.items():
        np.testing.assert_array_equal(array, theirs[name], err_msg=name)


@pytest.mark.parametrize("space", DATASETS)
def test_a_model_saved_twice_is_the_same_file(files: Path, space: str, tmp_path: Path) -> None:
    mixseq.save(tmp_path / "again.h5", mixseq.load(files / f"{space}.h5"))
    assert (tmp_path / "again.h5").read_bytes() == (files / f"{space}.h5").read_bytes()


@pytest.mark.parametrize("space", DATASETS)
def test_what_the_documentation_names_is_there(space: str, files: Path, models: dict[str, Model]) -> None:
    found: dict[str, Any] = {}
    with h5py.File(files / f"{space}.h5") as file:

        def note(name: str, item: Any) -> None:
            if isinstance(item, h5py.Dataset):
                found[name] = item[...]

        file.visititems(note)
        assert set(file.attrs) == ATTRIBUTES
        assert set(file["space"].attrs) == {"scale"}
        assert file.attrs["format"] == b"mixseq-model"
        assert file.attrs["version"] == 1
        assert file.attrs["space"].decode() == models[space].space.name
        settings = json.loads(file.attrs["settings"])
        assert settings.keys() == SETTINGS.get(space, set())
        assert space != "volume" or settings["shell"]["bending"] == 0.4
        for item in (file[name] for name in DATASETS[space]):
            assert item.fletcher32 or not item.size, item.name
    assert set(found) == DATASETS[space]
    model = models[space]
    np.testing.assert_array_equal(found["signals/time/frames"], model.times)
    np.testing.assert_array_equal(found["signals/time/values"], model.time.values)
    np.testing.assert_array_equal(found["signals/pose/matrix"], model.pose.matrix)
    rows = [found[f"signals/shape/{name}"].reshape(3, -1) for name in SHAPES[space]]
    np.testing.assert_array_equal(np.concatenate(rows, axis=1), model.shapes)
    poses = found["signals/placement/rotations"], found["signals/placement/translations"]
    assert [pose.shape[1] for pose in poses] == POSES.get(space, [1, 1])
    assert [pose.shape[2] for pose in poses] == [4, 3]
    values = np.concatenate([pose.reshape(5, -1) for pose in poses], axis=1)
    np.testing.assert_array_equal(values, model.placement.values)
    norms = np.linalg.norm(poses[0], axis=2)
    assert not norms.size or np.abs(norms - 1.0).max() < 0.05  # curves with few knots cut corners
    if isinstance(model.space, MixedSpace):
        assert settings["projection"]["placement"] == model.mixed.placement
        np.testing.assert_array_equal(found["space/joint_faces"], np.flatnonzero(model.mixed.joint_faces))
        weights = model.mixed.skinning_weights
        np.testing.assert_array_equal(np.cumsum([0, *found["space/skinning/sizes"]]), weights.indptr)
        np.testing.assert_array_equal(found["space/skinning/parts"], weights.indices)
        np.testing.assert_array_equal(found["space/skinning/weights"], weights.data)
        for name, steadiness in model.mixed.articulation.steadiness._asdict().items():
            np.testing.assert_array_equal(found[f"space/steadiness/{name}"], steadiness)
        corrections = [found[f"signals/correction/{name}"] for name in ("rotations", "translations")]
        values = np.concatenate([each.reshape(5, -1) for each in corrections], axis=1)
        np.testing.assert_array_equal(values, model.correction.values)


def test_a_failed_save_leaves_the_old_file(model: Model, copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = copy.read_bytes()

    def fail(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("mixseq_io.hdf5.models.write_signals", fail)
    with pytest.raises(OutputError, match=r"bar\.h5"):
        mixseq.save(copy, model)
    assert copy.read_bytes() == before
    assert [file.name for file in copy.parent.iterdir()] == ["bar.h5"]


def test_a_folder_that_is_not_there_is_an_output_error(model: Model, tmp_path: Path) -> None:
    with pytest.raises(OutputError):
        mixseq.save(tmp_path / "nowhere" / "model.h5", model)


def test_other_spaces_are_an_output_error(tmp_path: Path) -> None:
    class Volumes(ShapeSpace):
        name = "volumes"
        dim = 3
        weights = np.ones(3)

        def encode_independently(self, points: Any) -> Any:
            return points.mean(axis=1)

        def decode(self, vectors: Any, progress: Any = None) -> Any:
            return vectors[:, None]

    given = mixseq.fit(bar(4, 3, 2), space="vertex")
    curve = Curve(given.times, np.zeros((2, 0)))
    pose = mixseq.PoseMap(np.ones(1), np.zeros((0, 1)))
    model = Model(given.header, Volumes(), curve, pose, np.ones((1, 3)), curve)
    with pytest.raises(OutputError, match="the spaces mixed, vertex, gradient, lri, edge, not in Volumes"):
        mixseq.save(tmp_path / "model.h5", model)
    assert not list(tmp_path.iterdir())
