"""Models in HDF5: nothing is lost, nothing damaged is believed, signals can be edited with h5py."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import fields
from dataclasses import replace as replace_fields
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

import mixseq
from mixseq.choices import PLACEMENTS
from mixseq.errors import FormatError, OutputError
from mixseq.geometry.lengths_angles import dihedral_angles, edge_lengths, unwrap_angles
from mixseq.geometry.quaternions import rotations_of
from mixseq.geometry.rotations import continuous_vectors
from mixseq.retargeting.joint_solver import JointSolver
from mixseq.sequence import MeshSequence, Polygons
from mixseq.shells.fitting import ShellSettings
from mixseq.signals import Curve, Model
from mixseq.spaces import (
    AnchoredSpace,
    EdgeSpace,
    FreeSpace,
    GradientSpace,
    LRISpace,
    MixedSpace,
    VertexSpace,
)
from mixseq.surface import CornerValues, FaceSet, MeshObject, Origin, Surface
from mixseq_io.surface_arrays import surface_arrays
from tests.meshes import SEQUENCES, bar

GOLDEN = Path(__file__).parent / "golden"

COMMON = {
    "polygons/counts",
    "polygons/indices",
    "signals/time/frames",
    "signals/time/times",
    "signals/time/values",
    "signals/pose/offset",
    "signals/pose/matrix",
    "signals/placement/times",
    "signals/placement/rotations",
    "signals/placement/translations",
}

EDGE = COMMON | {
    "space/reference",
    "space/reference_lengths",
    "signals/shape/lengths",
    "signals/shape/angles",
    "signals/shape/volumes",
}

PARTS = COMMON | {
    "segmentation/part_of_face",
    "segmentation/widths",
    "segmentation/parts/vertices",
    "segmentation/parts/sizes",
    "segmentation/joints/faces",
    "segmentation/joints/sizes",
    "space/shapes",
    "space/reference",
    "signals/shape/lengths",
    "signals/shape/angles",
}

DATASETS = {
    "mixed": PARTS
    | {
        "space/free",
        "space/known",
        "space/shares/sizes",
        "space/shares/parts",
        "space/shares/weights",
        "signals/shape/unposed",
        "signals/shape/sides",
    },
    "free": PARTS | {"space/reference_lengths", "signals/shape/parts"},
    "vertex": COMMON | {"signals/shape/positions"},
    "gradient": COMMON | {"space/reference", "signals/shape/turns", "signals/shape/stretches"},
    "lri": COMMON | {"space/reference", "signals/shape/connections", "signals/shape/ends"},
    "edge": EDGE,
    "volume": EDGE,
}
"""By the names of `models`."""

SETTINGS = {
    "mixed": {"relaxation"},
    "free": {"relaxation"},
    "edge": {"shell", "edge"},
    "volume": {"shell", "edge"},
}

EACH_DATASET = [(space, name) for space, names in DATASETS.items() for name in sorted(names)]

VERSIONS = {"vertex": 2, "gradient": 3}
"""Of spaces whose files did not change when rotations became quaternions; the others have version 5."""

SHAPES = {
    "mixed": ["lengths", "angles", "unposed", "sides"],
    "free": ["lengths", "angles", "parts"],
    "vertex": ["positions"],
    "gradient": ["turns", "stretches"],
    "lri": ["connections", "ends"],
    "edge": ["lengths", "angles", "volumes"],
    "volume": ["lengths", "angles", "volumes"],
}
"""Key shapes: datasets in the order of the vector."""

POSES = {"mixed": [2, 2], "vertex": [0, 0], "gradient": [0, 1]}
"""How many rotations and translations a placement has; one of each in the other spaces."""

ATTRIBUTES = {
    "format",
    "version",
    "created_by",
    "settings",
    "space",
    "name",
    "fps",
    "up_axis",
    "metres_per_unit",
    "vertex_count",
}


@pytest.fixture(scope="module")
def models() -> dict[str, Model]:
    """Models of seven frames with three key shapes and five knots, in all spaces."""
    sequence = bar(sides=5, rings=13, frames=7)
    shell = ShellSettings(bending=0.4, iterations=77)
    return {
        "mixed": mixseq.fit(sequence, rank=2, knots=1, parts=2, joint_width=3),
        "free": mixseq.fit(sequence, rank=2, knots=1, parts=2, joint_width=3, placement="free"),
        "vertex": mixseq.fit(sequence, rank=2, knots=1, space="vertex", pose="keys"),
        "gradient": mixseq.fit(sequence, rank=2, knots=1, space="gradient"),
        "lri": mixseq.fit(sequence, rank=2, knots=1, space="lri"),
        "edge": mixseq.fit(sequence, rank=2, knots=1, space="edge"),
        "volume": mixseq.fit(
            sequence, rank=2, knots=1, space="edge", shell=shell, projection="dso", volume=0.5
        ),
    }


@pytest.fixture(scope="module")
def files(models: dict[str, Model], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("models")
    for name, model in models.items():
        mixseq.save(folder / f"{name}.h5", model)
    return folder


@pytest.fixture
def model(models: dict[str, Model]) -> Model:
    return models["mixed"]


@pytest.fixture
def stored(files: Path) -> Path:
    return files / "mixed.h5"


@pytest.fixture
def copy(files: Path, tmp_path: Path) -> Path:
    """A file to be edited or spoilt."""
    return Path(shutil.copy(files / "mixed.h5", tmp_path / "bar.h5"))


@pytest.fixture
def free(files: Path, tmp_path: Path) -> Path:
    """One in the free placement."""
    return Path(shutil.copy(files / "free.h5", tmp_path / "bar.h5"))


@pytest.fixture
def vertices(files: Path, tmp_path: Path) -> Path:
    """One in the vertex space."""
    return Path(shutil.copy(files / "vertex.h5", tmp_path / "bar.h5"))


def assert_equal(first: Model, second: Model) -> None:
    """Check that two models are equal bit by bit."""
    for name in ("time", "placement"):
        a, b = getattr(first, name), getattr(second, name)
        np.testing.assert_array_equal(a.times, b.times)
        np.testing.assert_array_equal(a.values, b.values)
    np.testing.assert_array_equal(first.pose.offset, second.pose.offset)
    np.testing.assert_array_equal(first.pose.matrix, second.pose.matrix)
    np.testing.assert_array_equal(first.shapes, second.shapes)
    np.testing.assert_array_equal(first.vectors, second.vectors)
    np.testing.assert_array_equal(first.times, second.times)
    assert first.header.polygons.same_as(second.header.polygons)
    for name in ("vertex_count", "fps", "up_axis", "metres_per_unit", "name"):
        assert getattr(first.header, name) == getattr(second.header, name)
    assert type(first.space) is type(second.space)
    if isinstance(first.space, VertexSpace):
        assert first.space == second.space
    elif isinstance(first.space, MixedSpace):
        assert_equal_spaces(first.space, second.space)
    else:
        assert_equal_fields(first.space, second.space)


def assert_equal_fields(first: Any, second: Any) -> None:
    for field in fields(first):
        if field.name != "topology":
            np.testing.assert_array_equal(getattr(first, field.name), getattr(second, field.name))


def assert_equal_spaces(first: Any, second: Any) -> None:
    arrays = ["shapes", "reference", *(["reference_lengths"] if isinstance(first, FreeSpace) else [])]
    for name in arrays:
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
        assert getattr(first, name).dtype == getattr(second, name).dtype
    for name in ("placement", "scale", "sizes", "relaxation"):
        assert getattr(first, name) == getattr(second, name)
    if isinstance(first, AnchoredSpace):
        np.testing.assert_array_equal(first.free, second.free)
        np.testing.assert_array_equal(first.known, second.known)
        assert first.shares.shape == second.shares.shape
        for name in ("indptr", "indices", "data"):
            np.testing.assert_array_equal(getattr(first.shares, name), getattr(second.shares, name))
    a, b = first.decomposition, second.decomposition
    np.testing.assert_array_equal(a.part_of_face, b.part_of_face)
    np.testing.assert_array_equal(a.widths, b.widths)
    for part, other in zip(a.parts, b.parts, strict=True):
        np.testing.assert_array_equal(part, other)
    for joint, other_joint in zip(a.joints, b.joints, strict=True):
        for name in ("vertices", "faces", "face_ids", "edge_ids", "hinge_ids", "free"):
            np.testing.assert_array_equal(getattr(joint, name), getattr(other_joint, name))


def assert_kept(original: Model, path: Path) -> None:
    """Check that a model comes back as it was, and decodes to the same."""
    mixseq.save(path, original)
    loaded = mixseq.load(path)
    assert_equal(original, loaded)
    middle = [float(np.mean(original.times))]
    np.testing.assert_array_equal(loaded.sample(middle).points, original.sample(middle).points)


@pytest.mark.parametrize("placement", PLACEMENTS)
@pytest.mark.parametrize(
    "name",
    ["bar", "rigid component", "several components", "unused vertices", "still", "one frame", "float32"],
)
def test_nothing_is_lost(name: str, placement: Any, tmp_path: Path) -> None:
    assert_kept(mixseq.fit(SEQUENCES[name](), placement=placement, exact=True), tmp_path / "model.h5")


@pytest.mark.parametrize("name", ["unused vertices", "still", "one frame", "float32"])
def test_nothing_is_lost_in_the_vertex_space(name: str, tmp_path: Path) -> None:
    assert_kept(mixseq.fit(SEQUENCES[name](), space="vertex"), tmp_path / "model.h5")


@pytest.mark.parametrize("space", ["gradient", "lri", "edge"])
@pytest.mark.parametrize(
    "name", ["rigid component", "several components", "unused vertices", "one frame", "float32"]
)
def test_nothing_is_lost_in_other_spaces(name: str, space: Any, tmp_path: Path) -> None:
    assert_kept(mixseq.fit(SEQUENCES[name](), space=space, exact=True), tmp_path / "model.h5")


@pytest.mark.parametrize(
    "settings",
    [
        {"tolerance": 1e-2},
        {"rank": 0},
        {"rank": 2, "knots": [0.3]},
        {"rank": 2, "pose": "keys"},
        {"rank": 2, "knots": 0, "space": "vertex"},
    ],
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
    ours, theirs = surface_arrays(surface), surface_arrays(loaded.header.surface)
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
        parts = isinstance(models[space].space, MixedSpace)
        assert set(file["space"].attrs) == {"scale"} | ({"placement"} if parts else set())
        assert file.attrs["format"] == "mixseq-model"
        assert file.attrs["version"] == VERSIONS.get(space, 5)
        assert file.attrs["space"] == models[space].space.name
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
    assert [pose.shape[2] for pose in poses] == [4 if poses[0].size else 3, 3]
    values = np.concatenate([pose.reshape(5, -1) for pose in poses], axis=1)
    np.testing.assert_array_equal(values, model.placement.values)
    norms = np.linalg.norm(poses[0], axis=2)
    assert not norms.size or np.abs(norms - 1.0).max() < 0.05  # curves with few knots cut corners
    if isinstance(model.space, AnchoredSpace):
        np.testing.assert_array_equal(found["space/free"], np.flatnonzero(model.space.free))
        np.testing.assert_array_equal(found["space/known"], np.flatnonzero(model.space.known))
        starts = np.cumsum([0, *found["space/shares/sizes"]])
        shares = model.space.shares
        np.testing.assert_array_equal(starts, shares.indptr)
        np.testing.assert_array_equal(found["space/shares/parts"], shares.indices)
        np.testing.assert_array_equal(found["space/shares/weights"], shares.data)


def test_a_failed_save_leaves_the_old_file(model: Model, copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = copy.read_bytes()

    def fail(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("mixseq_io.hdf5.model_files.write_signals", fail)
    with pytest.raises(OutputError, match=r"bar\.h5"):
        mixseq.save(copy, model)
    assert copy.read_bytes() == before
    assert [file.name for file in copy.parent.iterdir()] == ["bar.h5"]


def test_a_folder_that_is_not_there_is_an_output_error(model: Model, tmp_path: Path) -> None:
    with pytest.raises(OutputError):
        mixseq.save(tmp_path / "nowhere" / "model.h5", model)


def test_other_spaces_are_an_output_error(tmp_path: Path) -> None:
    class Volumes(mixseq.spaces.ShapeSpace):
        name = "volumes"
        dim = 3
        weights = np.ones(3)

        def encode_apart(self, points: Any) -> Any:
            return points.mean(axis=1)

        def decode(self, vectors: Any, progress: Any = None) -> Any:
            return vectors[:, None]

    given = mixseq.fit(bar(4, 3, 2), space="vertex")
    curve = Curve(given.times, np.zeros((2, 0)))
    pose = mixseq.signals.PoseMap(np.ones(1), np.zeros((0, 1)))
    model = Model(given.header, Volumes(), curve, pose, np.ones((1, 3)), curve)
    with pytest.raises(
        OutputError, match="the spaces mixed, vertex, gradient, lri, edge, basis, not in Volumes"
    ):
        mixseq.save(tmp_path / "model.h5", model)
    assert not list(tmp_path.iterdir())


# Damage ---------------------------------------------------------------------------------------------------


def test_truncated_files_are_format_errors(stored: Path, tmp_path: Path) -> None:
    whole = stored.read_bytes()
    cut = tmp_path / "cut.h5"
    for size in [0, 1, 7, 8, 47, 48, 95, 96, *range(100, len(whole), len(whole) // 150), len(whole) - 1]:
        cut.write_bytes(whole[:size])
        with pytest.raises(FormatError, match=r"cut\.h5"):
            mixseq.load(cut)


SPOILER = """
import sys
from pathlib import Path
import numpy as np
import mixseq
from mixseq.errors import FormatError

source, target, seed, count = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])
original, whole = mixseq.load(source), source.read_bytes()
rng = np.random.default_rng(seed)
refused = silent = 0
for place in rng.integers(0, len(whole), count):
    spoilt = bytearray(whole)
    spoilt[place] ^= int(rng.integers(1, 256))
    target.write_bytes(spoilt)
    try:
        loaded = mixseq.load(target)
    except FormatError as error:
        assert target.name in str(error), error
        refused += 1
        continue
    # Bytes that nothing depends on may differ; numbers may not.
    assert np.array_equal(loaded.vectors, original.vectors), f"byte {place} changed the signals"
    assert np.array_equal(loaded.times, original.times), f"byte {place} changed the frames"
    for name in ("shapes", "reference"):
        assert np.array_equal(getattr(loaded.space, name), getattr(original.space, name)), f"byte {place}: {name}"
    assert np.array_equal(loaded.space.shares.toarray(), original.space.shares.toarray()), f"byte {place}: shares"
    silent += 1
print(refused, silent)
"""


def test_a_flipped_byte_is_refused_or_does_no_harm(stored: Path, tmp_path: Path) -> None:
    """In a process of its own: a byte that makes HDF5 crash must not take the tests along."""
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", SPOILER, stored, tmp_path / "spoilt.h5", "3", "300"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert result.returncode == 0, result.stderr
    refused, harmless = map(int, result.stdout.split())
    assert refused + harmless == 300
    assert refused > 100


def test_noise_after_a_valid_start_is_refused(stored: Path, tmp_path: Path) -> None:
    whole = bytearray(stored.read_bytes())
    rng = np.random.default_rng(0)
    for start in range(48, len(whole), len(whole) // 20):
        spoilt = bytes(whole[:start]) + rng.bytes(len(whole) - start)
        (tmp_path / "noise.h5").write_bytes(spoilt)
        with pytest.raises(FormatError, match=r"noise\.h5"):
            mixseq.load(tmp_path / "noise.h5")


def replace(path: Path, name: str, change: Callable[[Any], Any]) -> None:
    """Store other values in place of a dataset's."""
    with h5py.File(path, "r+") as file:
        values = change(file[name][...])
        del file[name]
        file[name] = values


def with_nan(frame: int) -> Callable[[Any], Any]:
    def change(values: Any) -> Any:
        values[frame, ...].flat[0] = np.nan
        return values

    return change


@pytest.mark.parametrize(
    ("name", "row"),
    [
        ("signals/time/values", 4),
        ("signals/pose/offset", 1),
        ("signals/pose/matrix", 0),
        ("signals/shape/lengths", 2),
        ("signals/shape/angles", 0),
        ("signals/shape/unposed", 1),
        ("signals/shape/sides", 2),
        ("signals/placement/times", 0),
        ("signals/placement/rotations", 1),
        ("signals/placement/translations", 2),
        ("space/shapes", 7),
        ("space/reference", 1),
        ("space/shares/weights", 3),
    ],
)
def test_numbers_that_are_not_finite_are_refused(copy: Path, name: str, row: int) -> None:
    replace(copy, name, with_nan(row))
    with pytest.raises(FormatError, match=rf"bar\.h5: {name} is not finite in row {row}"):
        mixseq.load(copy)


@pytest.mark.parametrize(("space", "name"), EACH_DATASET)
def test_missing_datasets_are_refused(files: Path, tmp_path: Path, space: str, name: str) -> None:
    copy = shutil.copy(files / f"{space}.h5", tmp_path / "bar.h5")
    with h5py.File(copy, "r+") as file:
        del file[name]
    with pytest.raises(FormatError, match=rf"bar\.h5.*{name.split('/')[-1]}"):
        mixseq.load(copy)


@pytest.mark.parametrize("name", sorted(ATTRIBUTES - {"created_by"}))
def test_missing_attributes_are_refused(free: Path, name: str) -> None:
    """In the anchored placement there are no settings, and nobody looks for them."""
    with h5py.File(free, "r+") as file:
        del file.attrs[name]
    with pytest.raises(FormatError, match=r"bar\.h5"):
        mixseq.load(free)


OTHER_SHAPES: dict[str, Callable[[Any], Any]] = {
    "shorter": lambda values: values[:-1],
    "longer": lambda values: np.concatenate([values, values[-1:]]),
    "flat": lambda values: values.reshape(-1)[:, None, None],
    "text": lambda values: np.array([b"text"] * len(values)),
    "scalar": lambda values: values.reshape(-1)[0] if values.size else 0.0,
}


@pytest.mark.parametrize(("space", "name"), EACH_DATASET)
@pytest.mark.parametrize("how", OTHER_SHAPES)
def test_datasets_of_another_size_or_type_are_refused_or_do_no_harm(
    files: Path, tmp_path: Path, models: dict[str, Model], space: str, name: str, how: str
) -> None:
    copy = Path(shutil.copy(files / f"{space}.h5", tmp_path / "bar.h5"))
    replace(copy, name, OTHER_SHAPES[how])
    if (name, how) == ("signals/time/frames", "shorter"):  # an edit that makes sense
        np.testing.assert_array_equal(mixseq.load(copy).times, models[space].times[:-1])
        return
    try:
        loaded = mixseq.load(copy)
    except FormatError as error:
        assert "bar.h5" in str(error)
    else:
        assert_equal(loaded, models[space])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        (name, value)
        for name in sorted(DATASETS["mixed"])
        if name.startswith(
            (
                "polygons",
                "segmentation",
                "space/free",
                "space/known",
                "space/shares/sizes",
                "space/shares/parts",
            )
        )
        for value in (-1, 10**6)
        if (name, value) != ("segmentation/widths", 10**6)
    ],
)
def test_numbers_out_of_range_are_refused(copy: Path, name: str, value: int) -> None:
    def change(values: Any) -> Any:
        if not len(values):
            return np.array([value])
        values[len(values) // 2] = value
        return values

    replace(copy, name, change)
    with pytest.raises(FormatError, match=r"bar\.h5"):
        mixseq.load(copy)


@pytest.mark.parametrize(
    ("where", "name", "value"),
    [
        ("/", "settings", "{"),
        ("/", "settings", "[]"),
        ("/", "settings", '{"shell": {"glue": 1}}'),
        ("/", "settings", '{"relaxation": {"steps": -1}}'),
        ("/", "version", "new"),
        ("/", "vertex_count", -5),
        ("/", "fps", 0.0),
        ("/", "up_axis", "W"),
        ("/", "space", "edges"),
        ("/", "space", "vertex"),
        ("space", "placement", "loose"),
        ("space", "scale", "wide"),
        ("space", "scale", float("nan")),
        ("space", "scale", 0.0),
    ],
)
def test_bad_attributes_are_refused(free: Path, where: str, name: str, value: Any) -> None:
    with h5py.File(free, "r+") as file:
        file[where].attrs[name] = value
    with pytest.raises(FormatError, match=r"bar\.h5"):
        mixseq.load(free)


def test_a_newer_version_asks_for_an_upgrade(copy: Path) -> None:
    with h5py.File(copy, "r+") as file:
        file.attrs["version"] = 6
    with pytest.raises(FormatError, match=r"has version 6, .* reads up to 5; .*upgrade"):
        mixseq.load(copy)


def test_a_setting_of_a_newer_version_asks_for_an_upgrade(free: Path) -> None:
    with h5py.File(free, "r+") as file:
        file.attrs["settings"] = json.dumps({"relaxation": {"bending": 0.3, "glue": 1}})
    with pytest.raises(FormatError, match=r"bar\.h5: .*'glue'; upgrade"):
        mixseq.load(free)


def test_other_files_are_not_models(tmp_path: Path) -> None:
    mixseq.write(tmp_path / "sequence.h5", bar(sides=4, rings=3, frames=2))
    with pytest.raises(FormatError, match=r"sequence\.h5 .* not a mixseq model .*mixseq encode"):
        mixseq.load(tmp_path / "sequence.h5")
    with h5py.File(tmp_path / "foreign.h5", "w") as file:
        file["data"] = np.arange(3)
    with pytest.raises(FormatError, match=r"foreign\.h5 .* not a mixseq model"):
        mixseq.load(tmp_path / "foreign.h5")
    (tmp_path / "text.h5").write_text("no HDF5 at all")
    with pytest.raises(FormatError, match=r"text\.h5"):
        mixseq.load(tmp_path / "text.h5")
    with pytest.raises(FormatError, match=r"nowhere\.h5 does not exist"):
        mixseq.load(tmp_path / "nowhere.h5")
    with pytest.raises(FormatError, match="is a folder"):
        mixseq.load(tmp_path)


# Use ------------------------------------------------------------------------------------------------------


def test_a_model_reads_as_a_sequence(stored: Path, model: Model) -> None:
    sequence = mixseq.read(stored)
    np.testing.assert_array_equal(sequence.points, model.sample().points)
    np.testing.assert_array_equal(sequence.times, model.times)


# Edits with h5py ------------------------------------------------------------------------------------------
#
# In the vertex space what they do is a formula; in the mixed space they meet a reconstruction.


def scale(model: Model) -> float:
    """Return the diagonal in the units of the sequence."""
    assert isinstance(model.space, MixedSpace | VertexSpace)
    return model.space.scale


def anchored(model: Model) -> AnchoredSpace:
    assert isinstance(model.space, AnchoredSpace)
    return model.space


def points_at(model: Model, times: Any) -> NDArray[np.float64]:
    """Decode without what is only for frames."""
    return np.concatenate(list(model.blocks(times)))


INSIDE = np.linspace(0.0, 0.6, 14)


def test_an_edited_key_shape_moves_frames_by_its_weight(vertices: Path, models: dict[str, Model]) -> None:
    model, bump = models["vertex"], np.array([0.1, -0.2, 0.3])
    with h5py.File(vertices, "r+") as file:
        file["signals/shape/positions"][1, 17] += bump
    moved = points_at(mixseq.load(vertices), INSIDE) - points_at(model, INSIDE)
    weight = model.pose.weights(model.time(INSIDE))[:, 1]
    assert np.abs(weight).max() > 0.5
    np.testing.assert_allclose(moved[:, 17], weight[:, None] * bump * scale(model), atol=1e-12)
    assert np.abs(np.delete(moved, 17, axis=1)).max() < 1e-12


def test_an_edited_value_moves_the_curve_there(vertices: Path, models: dict[str, Model]) -> None:
    model, knot, change = models["vertex"], 2, np.array([0.05, -0.02])
    with h5py.File(vertices, "r+") as file:
        file["signals/time/values"][knot] += change
    loaded = mixseq.load(vertices)
    moved = points_at(loaded, model.time.times) - points_at(model, model.time.times)
    expected = model.space.decode((change @ model.pose.matrix @ model.shapes)[None])[0]
    np.testing.assert_allclose(moved[knot], expected, atol=1e-12)
    assert np.abs(np.delete(moved, knot, axis=0)).max() < 1e-12


def test_knots_can_be_dropped(vertices: Path, models: dict[str, Model]) -> None:
    kept = [0, 1, 3, 4]
    for name in ("times", "values"):
        replace(vertices, f"signals/time/{name}", lambda array: array[kept])
    model = models["vertex"]
    cubic = Curve(model.time.times[kept], model.time.values[kept])
    np.testing.assert_array_equal(mixseq.load(vertices).time(INSIDE), cubic(INSIDE))


def test_a_knot_on_the_curve_changes_nothing(vertices: Path, models: dict[str, Model]) -> None:
    model, new = models["vertex"], 0.4
    place = int(np.searchsorted(model.time.times, new))
    value = model.time([new])[0]
    replace(vertices, "signals/time/times", lambda times: np.insert(times, place, new))
    replace(vertices, "signals/time/values", lambda values: np.insert(values, place, value, axis=0))
    loaded = mixseq.load(vertices)
    assert len(loaded.time.times) == len(model.time.times) + 1
    np.testing.assert_allclose(points_at(loaded, INSIDE), points_at(model, INSIDE), atol=1e-12)


def test_an_edited_offset_blends_key_shapes(vertices: Path, models: dict[str, Model]) -> None:
    model = models["vertex"]
    with h5py.File(vertices, "r+") as file:
        file["signals/pose/offset"][:2] += [0.25, -0.25]
    moved = points_at(mixseq.load(vertices), INSIDE) - points_at(model, INSIDE)
    expected = model.space.decode(0.25 * (model.shapes[:1] - model.shapes[1:2]))
    np.testing.assert_allclose(moved, np.repeat(expected, len(INSIDE), axis=0), atol=1e-12)


def test_an_edited_matrix_damps_a_coordinate(vertices: Path, models: dict[str, Model]) -> None:
    """Half the row is the same as half the coordinate."""
    model = models["vertex"]
    with h5py.File(vertices, "r+") as file:
        file["signals/pose/matrix"][1] *= 0.5
    damped = Curve(model.time.times, model.time.values * [1.0, 0.5])
    expected = Model(model.header, model.space, damped, model.pose, model.shapes, model.placement)
    np.testing.assert_allclose(
        points_at(mixseq.load(vertices), INSIDE), points_at(expected, INSIDE), atol=1e-12
    )


def test_key_shapes_can_be_added(vertices: Path, models: dict[str, Model]) -> None:
    """One that nothing uses yet, and as its offset is zero nothing changes."""
    replace(vertices, "signals/shape/positions", lambda keys: np.concatenate([keys, 2 * keys[:1]]))
    replace(vertices, "signals/pose/offset", lambda offset: np.append(offset, 0.0))
    replace(vertices, "signals/pose/matrix", lambda matrix: np.insert(matrix, 3, 0.0, axis=1))
    loaded = mixseq.load(vertices)
    assert len(loaded.shapes) == 4
    np.testing.assert_allclose(points_at(loaded, INSIDE), points_at(models["vertex"], INSIDE), atol=1e-12)


def test_an_edited_translation_moves_the_body_there(copy: Path, model: Model) -> None:
    """All parts alike, at one knot of the placement; at the others nothing moves."""
    knot, shift = 3, np.array([1.0, 0.0, -0.5])
    with h5py.File(copy, "r+") as file:
        file["signals/placement/translations"][knot] += shift
    times = model.placement.times
    moved = points_at(mixseq.load(copy), times) - points_at(model, times)
    np.testing.assert_allclose(
        moved[knot], np.broadcast_to(shift * scale(model), moved[knot].shape), atol=1e-9
    )
    assert np.abs(np.delete(moved, knot, axis=0)).max() < 1e-9


def held_by_one(space: AnchoredSpace, part: int) -> NDArray[np.int64]:
    """Return the vertices of a part that follow it alone."""
    vertices = space.decomposition.parts[part]
    alone: NDArray[np.int64] = vertices[space.frames.alone[vertices] == part]
    assert len(alone) > 3
    return alone


def test_an_edited_rotation_turns_a_part_there(copy: Path, model: Model) -> None:
    """By half a turn about z: vertices that follow the part alone go where it goes, about its centre."""
    space, knot = anchored(model), 2
    with h5py.File(copy, "r+") as file:
        file["signals/placement/rotations"][knot, 0] = [0.0, 0.0, 0.0, 1.0]
    time = model.placement.times[knot]
    rest, poses = space.frames.rest, space.poses(model.placement.values)
    before = rotations_of(rest.rotations[0, 0])
    assert np.abs(rotations_of(poses.rotations[knot, 0]) - np.diag([-1, -1, 1])).max() > 0.5
    alone = held_by_one(space, 0)
    shapes = model.pose.weights(model.time([time])) @ model.shapes
    unposed = space.split(np.append(shapes, model.placement.values[knot])[None]).unposed[0, alone]
    seen = (unposed - rest.centres[0, 0]) @ before  # from the part
    expected = space.scale * (seen @ np.diag([-1, -1, 1]) + poses.centres[knot, 0])
    np.testing.assert_allclose(mixseq.load(copy)(time)[alone], expected, atol=1e-9)


def test_quaternions_of_any_length_are_rotations(copy: Path, model: Model) -> None:
    """Where all are scaled alike, curves and shapes do not change."""
    with h5py.File(copy, "r+") as file:
        file["signals/placement/rotations"][...] *= 1.7
    np.testing.assert_allclose(points_at(mixseq.load(copy), INSIDE), points_at(model, INSIDE), atol=1e-12)


def test_an_edited_vertex_moves_with_its_frame(copy: Path, model: Model) -> None:
    """One that a part keeps, lifted in every key shape, is lifted as its frame is turned, whatever the pose."""
    space, bump = anchored(model), np.array([0.0, 0.02, 0.01])
    vertex = space.decomposition.parts[0][5]
    with h5py.File(copy, "r+") as file:
        file["signals/shape/unposed"][:, vertex] += bump
    times = model.placement.times
    moved = points_at(mixseq.load(copy), times) - points_at(model, times)
    poses = space.poses(model.placement.values)
    motions = np.stack([space.frames.motions(*pose) for pose in zip(*poses, strict=True)])
    np.testing.assert_allclose(
        moved[:, vertex], space.scale * rotations_of(motions[:, vertex, :4]) @ bump, atol=1e-9
    )


def test_edited_sides_move_free_vertices_only(copy: Path, model: Model) -> None:
    with h5py.File(copy, "r+") as file:
        file["signals/shape/sides"][...] *= 1.1
    moved = np.abs(points_at(mixseq.load(copy), INSIDE) - points_at(model, INSIDE)).max(axis=(0, 2))
    free = anchored(model).free
    assert free.any()
    assert moved[free].min() > 1e-3
    assert moved[~free].max() == 0.0


def test_frames_can_be_chosen_anew(copy: Path, model: Model) -> None:
    replace(copy, "signals/time/frames", lambda _: np.array([0.05, 0.5]))
    np.testing.assert_array_equal(mixseq.read(copy).points, model.sample([0.05, 0.5]).points)


def scaled(factor: float) -> Callable[[Any], Any]:
    return lambda values: values * factor


def with_zeros(values: Any) -> Any:
    """At one knot one part has no rotation."""
    values[3, 1] = 0.0
    return values


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("pose/offset", scaled(1.1), r"signals/pose: .*not add up to one .*offset adds up to 1\.1 "),
        ("pose/offset", lambda _: np.zeros(0), r"signals/pose/matrix .*floats of shape \(any, 0\)"),
        ("pose/offset", lambda values: values[:-1], r"signals/pose/matrix .*floats of shape \(any, 2\)"),
        (
            "pose/matrix",
            lambda values: values + 0.01,
            r"signals/pose: .*not add up .*rows of matrix to 0\.03",
        ),
        ("pose/matrix", lambda values: values[:-1], r"signals/time/values .*floats of shape \(5, 1\)"),
        ("pose/matrix", lambda values: values.astype(int), r"signals/pose/matrix is int64 .*floats"),
        (
            "time/times",
            lambda values: values[::-1],
            r"signals/time/times does not increase in row 1: .* s after",
        ),
        (
            "time/times",
            lambda values: values[[0, 1, 1, 3, 4]],
            r"signals/time/times does not increase in row 2",
        ),
        ("time/times", lambda values: values[:-1], r"signals/time/values .*floats of shape \(4, 2\)"),
        (
            "time/times",
            scaled(0.9),
            r"signals/time/frames .*0 to 0\.6 s, .*signals/time/times .*0 to 0\.54 s",
        ),
        ("time/times", lambda values: values + 0.1, r"signals/time/times are only from 0\.1 to 0\.7 s"),
        ("time/values", lambda values: values[1:], r"signals/time/values .*floats of shape \(5, 2\)"),
        ("time/frames", lambda values: values[::-1], r"signals/time/frames does not increase in row 1"),
        ("time/frames", lambda _: np.zeros(0), r"signals/time/frames is empty"),
        ("time/frames", lambda values: values - 0.1, r"signals/time/frames has times from -0\.1 to 0\.5 s"),
        ("placement/times", scaled(0.5), r"signals/placement/times are only from 0 to 0\.3 s"),
        (
            "placement/times",
            lambda values: values[::-1],
            r"signals/placement/times does not increase in row 1",
        ),
        ("placement/times", lambda _: np.zeros(0), r"signals/placement/times is empty"),
        ("placement/rotations", lambda values: values[1:], r"placement/rotations .*of shape \(5, 2, 4\)"),
        (
            "placement/rotations",
            lambda values: values[..., 1:],
            r"placement/rotations .*of shape \(5, 2, 4\)",
        ),
        (
            "placement/rotations",
            scaled(0.4),
            r"placement/rotations has quaternions that are nearly zero, no rot",
        ),
        (
            "placement/rotations",
            with_zeros,
            r"placement/rotations has quaternions that are nearly zero, no rot",
        ),
        ("placement/translations", lambda values: values[:, :1], r"placement/translations .*\(5, 2, 3\)"),
        ("shape/lengths", lambda values: values[1:], r"signals/shape/lengths .*floats of shape \(3, "),
        ("shape/angles", lambda values: values[:, 1:], r"signals/shape/angles .*floats of shape \(3, "),
        (
            "shape/sides",
            lambda values: values[:, 1:],
            r"signals/shape/sides .*floats of shape \(3, .*, 2, 3\)",
        ),
        (
            "shape/unposed",
            lambda values: values[:, 1:],
            r"signals/shape/unposed .*floats of shape \(3, 67, 3\)",
        ),
        (
            "shape/unposed",
            lambda values: values.reshape(3, -1),
            r"signals/shape/unposed .*floats of shape \(3, ",
        ),
    ],
)
def test_signals_that_contradict_each_other_are_refused(
    copy: Path, name: str, change: Callable[[Any], Any], message: str
) -> None:
    replace(copy, f"signals/{name}", change)
    with pytest.raises(FormatError, match=rf"bar\.h5: .*{message}"):
        mixseq.load(copy)


def with_more(values: Any) -> Any:
    """One of the weights is larger than it should be, by little."""
    values[7] += 1e-6
    return values


def with_two_signs(values: Any) -> Any:
    """Two shares of a vertex still add up to one."""
    values[np.flatnonzero(values < 1.0)[:2]] = [1.5, -0.5]
    return values


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("weights", scaled(0.9), "must be positive and add up to one for every vertex"),
        ("weights", scaled(-1.0), "must be positive and add up to one for every vertex"),
        ("weights", with_more, "must be positive and add up to one for every vertex"),
        ("weights", with_two_signs, "must be positive and add up to one for every vertex"),
        ("weights", lambda values: values[1:], r"is float64 .*floats of shape \(90\) are expected"),
        ("weights", lambda values: values.astype(int), "is int64 .*floats of shape"),
        ("parts", lambda values: values + 1, "has values outside 0 to 1"),
        ("parts", lambda values: values[1:], r"is int32 .*integers of shape \(90\) are expected"),
        ("sizes", lambda values: values * 0, "has values outside 1"),
    ],
)
def test_shares_that_do_not_fit_are_refused(
    copy: Path, name: str, change: Callable[[Any], Any], message: str
) -> None:
    replace(copy, f"space/shares/{name}", change)
    with pytest.raises(FormatError, match=rf"bar\.h5: space/shares/{name} {message}"):
        mixseq.load(copy)


def test_shares_of_another_number_of_vertices_are_refused(copy: Path) -> None:
    replace(copy, "space/shares/sizes", lambda sizes: np.append(sizes, 1))
    replace(copy, "space/shares/parts", lambda parts: np.append(parts, 0))
    replace(copy, "space/shares/weights", lambda weights: np.append(weights, 1.0))
    with pytest.raises(FormatError, match=r"bar\.h5: space/shares has 68 rows for 67 vertices"):
        mixseq.load(copy)


def test_shares_that_are_edited_by_hand_move_vertices(copy: Path, model: Model) -> None:
    """Vertices follow one part each: key shapes mean something else between frames, but it is a model."""

    def first(values: Any) -> Any:
        return values[anchored(model).shares.indptr[:-1]]

    replace(copy, "space/shares/parts", first)
    replace(copy, "space/shares/weights", lambda values: np.ones(67))
    replace(copy, "space/shares/sizes", lambda sizes: np.ones_like(sizes))
    space = anchored(mixseq.load(copy))
    assert (space.frames.alone >= 0).all()
    points = bar(sides=5, rings=13, frames=7).points
    np.testing.assert_allclose(space.decode(space.encode(points)), points, atol=1e-12)


def test_free_vertices_that_key_shapes_are_not_of_are_refused(copy: Path) -> None:
    """They say which lengths, angles and sides there are."""
    replace(copy, "space/free", lambda values: values[1:])
    with pytest.raises(FormatError, match=r"bar\.h5: signals/shape/lengths is .*; floats of shape \(3, "):
        mixseq.load(copy)


@pytest.mark.parametrize("name", ["mixed", "free"])
def test_other_placements_are_refused(files: Path, tmp_path: Path, name: str) -> None:
    copy = shutil.copy(files / f"{name}.h5", tmp_path / "bar.h5")
    with h5py.File(copy, "r+") as file:
        file["space"].attrs["placement"] = "loose"
    with pytest.raises(FormatError, match=r"bar\.h5: the placement 'loose' is not known"):
        mixseq.load(copy)


def test_a_placement_that_the_datasets_are_not_of_is_refused(files: Path, tmp_path: Path) -> None:
    """Each lacks what the other has."""
    for name, other, missing in (
        ("mixed", "free", "space/reference_lengths"),
        ("free", "anchored", "space/shares/sizes"),
    ):
        copy = shutil.copy(files / f"{name}.h5", tmp_path / "bar.h5")
        with h5py.File(copy, "r+") as file:
            file["space"].attrs["placement"] = other
        with pytest.raises(FormatError, match=rf"bar\.h5: {missing} is missing"):
            mixseq.load(copy)


def test_reference_lengths_of_another_segmentation_are_refused(free: Path) -> None:
    replace(free, "space/reference_lengths", lambda values: values[1:])
    with pytest.raises(FormatError, match=r"bar\.h5: space/reference_lengths does not fit the segmentation"):
        mixseq.load(free)


@pytest.mark.parametrize(
    ("space", "old", "projection"),
    [
        ("edge", {"projection": "msgi", "volume": 0.0, "coarse": None, "steps": 5}, "steps"),
        ("volume", {"projection": "dso", "volume": 0.5, "coarse": 20, "steps": 2}, "dso"),
        ("volume", {"volume": 0.5}, "dso"),
    ],
)
def test_projections_that_are_no_more_are_read(
    files: Path, tmp_path: Path, space: str, old: dict[str, Any], projection: str
) -> None:
    """Small patches, and a coarse mesh, whose lengths and angles such files have, too."""
    copy = shutil.copy(files / f"{space}.h5", tmp_path / "bar.h5")
    with h5py.File(copy, "r+") as file:
        file.attrs["settings"] = json.dumps(json.loads(file.attrs["settings"]) | {"edge": old})
        if old.get("coarse"):
            file["signals/shape/coarse_lengths"] = np.ones((3, 54))
            file["space/coarse/vertices"] = np.arange(20, dtype=np.int32)
    read, made = mixseq.load(copy), mixseq.load(files / f"{space}.h5")
    assert isinstance(read.space, EdgeSpace) and read.space.settings.projection == projection
    np.testing.assert_array_equal(read.sample().points, made.sample().points)


@pytest.mark.parametrize(
    ("space", "change", "message"),
    [
        ("edge", {"edge": {"projection": "glue"}}, "projection is 'glue'"),
        ("edge", {"edge": {"projection": "dso", "glue": 1}}, "does not know the setting 'glue'; upgrade"),
        ("edge", {"shell": {"glue": 1}}, "does not know the setting 'glue'; upgrade"),
        ("edge", {"shell": {"iterations": "many"}}, "iterations is 'many'; a whole number of 0 or more"),
        ("edge", {"shell": {"bending": -1.0}}, r"bending is -1\.0; a number of 0 or more"),
        ("edge", {"edge": {"projection": "dso", "volume": 1.0}}, r"signals/shape/volumes .*shape \(3, 1\)"),
    ],
)
def test_settings_of_edge_spaces_are_checked(
    files: Path, tmp_path: Path, space: str, change: dict[str, Any], message: str
) -> None:
    copy = shutil.copy(files / f"{space}.h5", tmp_path / "bar.h5")
    with h5py.File(copy, "r+") as file:
        file.attrs["settings"] = json.dumps(json.loads(file.attrs["settings"]) | change)
    with pytest.raises(FormatError, match=rf"bar\.h5: .*{message}"):
        mixseq.load(copy)


def test_lengths_below_zero_are_refused(files: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copy(files / "edge.h5", tmp_path / "bar.h5"))
    replace(copy, "space/reference_lengths", scaled(-1.0))
    with pytest.raises(FormatError, match=r"bar\.h5: space/reference_lengths has lengths below zero"):
        mixseq.load(copy)


# Version 1 ------------------------------------------------------------------------------------------------


def as_version_1(path: Path, model: Model) -> None:
    """Store an exact model in the anchored placement as version 1 did: lengths, angles and parts of all frames."""
    space, points = anchored(model), model.sample().points
    mixseq.save(path, model)
    solved = JointSolver(space.topology, space.decomposition, space.shapes, space.reference).solved
    edges, hinges = space.topology.edges[solved.edge_ids], space.topology.hinges[solved.hinge_ids]
    x = points / space.scale
    parts, turns, centres = zip(*(space.registered(frame) for frame in x), strict=True)
    lengths = edge_lengths(x, edges)
    with h5py.File(path, "r+") as file:
        file.attrs["version"] = 1
        file.attrs["settings"] = json.dumps({"shell": {"bending": 0.3}})
        del file["signals"], file["space/shares"]
        del file.attrs["space"]
        file["space/reference_lengths"] = lengths.mean(axis=0)
        file["signals/time/times"] = model.times
        file["signals/shape/lengths"] = lengths
        angles = dihedral_angles(x, hinges)
        file["signals/shape/angles"] = unwrap_angles(angles, dihedral_angles(space.reference, hinges))
        file["signals/shape/parts"] = np.stack(parts)
        file["signals/placement/rotations"] = continuous_vectors(np.stack(turns))
        file["signals/placement/translations"] = np.stack(centres)


@pytest.fixture
def old(tmp_path: Path) -> Path:
    path = tmp_path / "old.h5"
    as_version_1(path, mixseq.fit(bar(sides=5, rings=13, frames=6), parts=2, exact=True))
    return path


def test_version_1_becomes_an_exact_model_with_shares(old: Path, tmp_path: Path) -> None:
    sequence = bar(sides=5, rings=13, frames=6)
    expected, loaded = mixseq.fit(sequence, parts=2, exact=True), mixseq.load(old)
    shares = anchored(loaded).shares
    assert (np.diff(shares.indptr) > 1).any()
    np.testing.assert_allclose(shares.toarray(), anchored(expected).shares.toarray(), atol=1e-6)
    np.testing.assert_allclose(loaded.sample().points, sequence.points, atol=1e-9)
    between = [0.05, 0.33]
    np.testing.assert_allclose(loaded.sample(between).points, expected.sample(between).points, atol=1e-6)
    assert_kept(loaded, tmp_path / "new.h5")


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("signals/time/times", lambda values: values[::-1]),
        ("signals/time/times", lambda values: values[1:]),
        ("signals/shape/angles", lambda values: values[:, 1:]),
        ("signals/placement/rotations", lambda values: values[:, 1:]),
        ("signals/placement/translations", lambda values: values * np.nan),
    ],
)
def test_damaged_files_of_version_1_are_refused(old: Path, name: str, change: Callable[[Any], Any]) -> None:
    replace(old, name, change)
    with pytest.raises(FormatError, match=r"old\.h5: signals/"):
        mixseq.load(old)


# Versions 2 to 4 in the mixed space -----------------------------------------------------------------------
#
# Anchored models are decoded by the fit that they were made for, and encoded again.


@pytest.fixture
def second(tmp_path: Path) -> Path:
    """An exact model of version 2, to be edited or spoilt."""
    return Path(shutil.copy(GOLDEN / "model-v2.h5", tmp_path / "old.h5"))


def golden_points(name: str) -> NDArray[np.float64]:
    with np.load(GOLDEN / f"{name}.npz") as file:
        return np.array(file["points"])


def test_an_old_model_becomes_one_of_this_version(second: Path, tmp_path: Path) -> None:
    loaded = mixseq.load(second)
    assert len(loaded.time.times) == len(loaded.placement.times) == 11  # frames and middles
    assert_kept(loaded, tmp_path / "new.h5")
    with h5py.File(tmp_path / "new.h5") as file:
        assert file.attrs["version"] == 5
        assert "links" not in file["space"]


def test_old_models_with_few_knots_are_what_they_were_there() -> None:
    """Knots that are no frames are kept, too. At other frames links had a say, which is small: 0.0004 here."""
    model = mixseq.load(GOLDEN / "model-v2-rank.h5")
    with np.load(GOLDEN / "model-v2-rank.npz") as expected:
        points, knots, there = expected["points"], expected["between_times"], expected["between"]
    assert not np.isin(knots[1], model.times)
    assert np.isin(knots, model.time.times).all()
    np.testing.assert_allclose(model.sample(knots).points, there, atol=1e-9)
    np.testing.assert_allclose(model.sample().points, points, atol=1e-3)


def test_an_old_model_of_low_rank_loses_as_little_as_the_modes_are_worth(second: Path) -> None:
    """What is left out of pose space shows in the shapes of free vertices and parts, not in where parts are."""
    for name, change in (
        ("time/values", lambda values: values[:, :2]),
        ("pose/matrix", lambda matrix: matrix[:2]),
    ):
        replace(second, f"signals/{name}", change)
    model, points = mixseq.load(second), golden_points("model-v2")
    away = np.abs(model.sample().points - points)
    assert 1e-4 < away.max() < 0.1  # of a bar of length 4
    for part in model.decomposition.parts:
        centres, expected = model.sample().points[:, part].mean(axis=1), points[:, part].mean(axis=1)
        np.testing.assert_allclose(centres, expected, atol=1e-9)


def test_old_models_whose_frames_were_chosen_anew_keep_their_knots(second: Path) -> None:
    """Also those before the first of these frames, and after the last."""
    knots = mixseq.load(GOLDEN / "model-v2.h5").times
    replace(second, "signals/time/frames", lambda _: np.array([0.15, 0.33]))
    model = mixseq.load(second)
    np.testing.assert_array_equal(model.times, [0.15, 0.33])
    assert (model.start, model.end) == (0.0, 0.5)
    np.testing.assert_allclose(points_at(model, knots), golden_points("model-v2"), atol=1e-9)


def test_old_curves_may_have_knots_of_their_own(second: Path) -> None:
    """The placement loses a knot where its curve passes: there the other curve has one, and nothing moves far."""
    kept = [0, 1, 2, 4, 5]
    for name in ("times", "rotations", "translations"):
        replace(second, f"signals/placement/{name}", lambda values: values[kept])
    model, points = mixseq.load(second), golden_points("model-v2")
    np.testing.assert_allclose(model.sample().points[kept], points[kept], atol=1e-9)
    np.testing.assert_allclose(model.sample().points[3], points[3], atol=0.02)


def test_old_knots_that_differ_by_rounding_are_one(second: Path) -> None:
    replace(second, "signals/placement/times", lambda times: times + np.array([0, 0, 1e-12, 0, -1e-12, 0]))
    replace(second, "signals/time/times", lambda times: times + np.array([0, -1e-12, 0, 0, 1e-12, 0]))
    model = mixseq.load(second)
    assert len(model.time.times) == 11
    np.testing.assert_allclose(model.sample().points, golden_points("model-v2"), atol=1e-9)


def test_an_edited_translation_moves_an_old_model(second: Path) -> None:
    shift = np.array([1.0, 0.0, -0.5])
    with h5py.File(second, "r+") as file:
        file["signals/placement/translations"][...] += shift
        scale = file["space"].attrs["scale"]
    moved = mixseq.load(second).sample().points - golden_points("model-v2")
    np.testing.assert_allclose(moved, np.broadcast_to(shift * scale, moved.shape), atol=1e-9)


def test_old_free_models_turn_as_they_did(tmp_path: Path) -> None:
    """Rotation vectors become the quaternions of the same rotations, with signs that do not jump."""
    frames = np.arange(5.0)
    path = tmp_path / "old.h5"
    original = mixseq.fit(bar(sides=5, rings=13, frames=5), placement="free", parts=2, exact=True)
    mixseq.save(path, original)
    turns = np.stack([0 * frames, 1.5 * frames, 0 * frames], axis=1)[:, None]  # nearly a turn in all
    with h5py.File(path, "r+") as file:
        file.attrs["version"] = 2
        for name in ("times", "rotations", "translations"):
            values = file[f"signals/placement/{name}"][::2]
            del file[f"signals/placement/{name}"]
            file[f"signals/placement/{name}"] = turns if name == "rotations" else values
    loaded = mixseq.load(path)
    quaternions = loaded.placement.values[:, :4]
    expected = np.stack([np.cos(0.75 * frames), 0 * frames, np.sin(0.75 * frames), 0 * frames], axis=1)
    np.testing.assert_allclose(quaternions, expected, atol=1e-12)
    np.testing.assert_array_equal(loaded.shapes, original.shapes)
    np.testing.assert_array_equal(loaded.placement.values[:, 4:], original.placement.values[::2, 4:])


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("signals/placement/rotations", lambda values: values[:, :1], r"is float64 .*of shape \(6, 2, 3\)"),
        ("signals/placement/rotations", lambda values: values[:, [0, 1, 1]], r"is float64 .*\(6, 2, 3\)"),
        (
            "signals/placement/translations",
            lambda values: values[:, :1],
            r"is float64 .*of shape \(6, 2, 3\)",
        ),
        ("signals/placement/rotations", with_nan(2), "is not finite in row 2"),
        ("signals/placement/times", lambda values: values[::-1], "does not increase in row 1"),
        ("signals/shape/lengths", lambda values: values[:, 1:], r"is float64 .*floats of shape \(6, "),
        ("signals/shape/angles", lambda values: values[1:], r"is float64 .*floats of shape \(6, "),
        ("signals/shape/parts", lambda values: values[:, 1:], r"is float64 .*floats of shape \(6, "),
        ("signals/shape/offsets", lambda values: values[:, 1:], r"is float64 .*floats of shape \(6, 5, 3\)"),
        ("signals/time/values", lambda values: values[:, 1:], r"is float64 .*floats of shape \(6, 5\)"),
        ("space/shapes", lambda values: values[1:], r"is float64 .*floats of shape"),
        ("space/reference", lambda values: values[1:], r"is float64 .*floats of shape \(67, 3\)"),
        ("space/reference_lengths", lambda values: values[1:], r"is float64 .*floats of shape"),
        ("space/trust", lambda values: np.append(values, 1.0), r"is float64 .*floats of shape \(1\)"),
        ("space/reference_lengths", scaled(-1.0), "has lengths below zero"),
        ("space/trust", scaled(0.0), "has weights that are not positive"),
        ("space/trust", scaled(-1.0), "has weights that are not positive"),
    ],
)
def test_damaged_old_models_are_refused(
    second: Path, name: str, change: Callable[[Any], Any], message: str
) -> None:
    replace(second, name, change)
    with pytest.raises(FormatError, match=rf"old\.h5: {name} {message}"):
        mixseq.load(second)


OLD = [
    *(f"signals/shape/{name}" for name in ("lengths", "angles", "parts", "offsets")),
    *(f"signals/placement/{name}" for name in ("times", "rotations", "translations")),
    *("signals/pose/offset", "signals/pose/matrix", "signals/time/times", "signals/time/values"),
    *(f"space/{name}" for name in ("trust", "reference_lengths", "reference", "shapes")),
    *("segmentation/part_of_face", "segmentation/parts/vertices", "segmentation/joints/faces"),
]
"""What anchored models of versions 2 to 4 are read from, but for the frames and what is as in this version."""


@pytest.mark.parametrize("name", OLD)
@pytest.mark.parametrize("how", OTHER_SHAPES)
def test_old_datasets_of_another_size_or_type_are_refused(second: Path, name: str, how: str) -> None:
    replace(second, name, OTHER_SHAPES[how])
    with pytest.raises(FormatError, match=r"old\.h5"):
        mixseq.load(second)


@pytest.mark.parametrize("name", OLD)
def test_old_models_without_a_dataset_are_refused(second: Path, name: str) -> None:
    with h5py.File(second, "r+") as file:
        del file[name]
    with pytest.raises(FormatError, match=rf"old\.h5: {name} is missing"):
        mixseq.load(second)


@pytest.mark.parametrize("name", ["time", "placement"])
def test_old_models_with_frames_outside_a_curve_are_refused(second: Path, name: str) -> None:
    replace(second, f"signals/{name}/times", scaled(0.9))
    with pytest.raises(FormatError, match=rf"old\.h5: .*signals/{name}/times are only from 0 to 0\.45 s"):
        mixseq.load(second)


def test_old_models_without_settings_of_the_fit_are_refused(second: Path) -> None:
    for settings in ("{}", '{"shell": {"glue": 1}}', "["):
        with h5py.File(second, "r+") as file:
            file.attrs["settings"] = settings
        with pytest.raises(FormatError, match=r"old\.h5"):
            mixseq.load(second)


@pytest.mark.parametrize("seed", range(3))
def test_bytes_of_old_models_that_are_flipped_are_refused_or_do_no_harm(second: Path, seed: int) -> None:
    """Points are as they were, or an error tells of the damage."""
    whole, points = second.read_bytes(), golden_points("model-v2")
    rng = np.random.default_rng(seed)
    for place in rng.integers(2048, len(whole), 20):
        spoilt = bytearray(whole)
        spoilt[place] ^= int(rng.integers(1, 256))
        second.write_bytes(spoilt)
        try:
            loaded = mixseq.load(second)
        except FormatError as error:
            assert "old.h5" in str(error)
        else:
            np.testing.assert_allclose(loaded.sample().points, points, atol=1e-9)


# Golden files ---------------------------------------------------------------------------------------------


GOLDEN_FILES = {
    # Anchored and free mixed models of old versions have other curves now: frames are encoded again, and predicted
    # as poses that agree with each other. The bar is 4 units long.
    "model-v1": 1e-2,
    "model-v2": 5e-3,
    "model-v2-vertex": 1e-9,
    "model-v3-gradient": 1e-9,
    # Their rotations were splines of rotation vectors, and are splines of quaternions now.
    "model-v3-lri": 1e-3,
    "model-v3-edge": 1e-3,
    "model-v5": 1e-9,
    # Steps between frames differ by rounding in other versions.
    "model-v5-free": 1e-3,
    "model-v5-lri": 1e-9,
    "model-v5-edge": 1e-3,
}
"""How near points between frames are to what they were when the file was made."""


@pytest.mark.parametrize("name", GOLDEN_FILES)
def test_golden_files_still_decode_to_the_same_points(name: str) -> None:
    with np.load(GOLDEN / f"{name}.npz") as expected:
        points, times = expected["points"], expected["times"]
        between, between_times = expected["between"], expected["between_times"]
    model = mixseq.load(GOLDEN / f"{name}.h5")
    np.testing.assert_array_equal(model.times, times)
    np.testing.assert_allclose(model.sample().points, points, atol=1e-9)
    np.testing.assert_allclose(model.sample(between_times).points, between, atol=GOLDEN_FILES[name])


@pytest.mark.parametrize(
    ("name", "kind", "frames", "knots"),
    [
        ("model-v1", FreeSpace, 4, 7),
        ("model-v2", AnchoredSpace, 6, 11),
        ("model-v2-rank", AnchoredSpace, 7, 17),
        ("model-v2-vertex", VertexSpace, 7, 5),
        ("model-v3-gradient", GradientSpace, 5, 5),
        ("model-v3-lri", LRISpace, 5, 5),
        ("model-v3-edge", EdgeSpace, 5, 5),
        ("model-v5", AnchoredSpace, 6, 11),
        ("model-v5-free", FreeSpace, 4, 7),
        ("model-v5-lri", LRISpace, 5, 9),
        ("model-v5-edge", EdgeSpace, 5, 9),
    ],
)
def test_golden_files_hold_what_they_should(name: str, kind: type, frames: int, knots: int) -> None:
    with h5py.File(GOLDEN / f"{name}.h5") as file:
        assert file.attrs["version"] == int(name[7])
    model = mixseq.load(GOLDEN / f"{name}.h5")
    assert isinstance(model.space, kind)
    assert (len(model.times), len(model.time.times)) == (frames, knots)
    if isinstance(model.space, MixedSpace):
        assert len(model.decomposition.parts) == 2
        assert any(joint.free.any() for joint in model.decomposition.joints)
    if isinstance(model.space, AnchoredSpace):
        assert len(model.space.seams.faces) > 10
        assert (np.diff(model.space.shares.indptr) > 1).sum() > 10
    if isinstance(model.space, VertexSpace):
        assert len(model.shapes) == 3
    if isinstance(model.space, GradientSpace | LRISpace | EdgeSpace):
        assert len(model.shapes) == 5
        assert model.space.centre_count == 2  # a bar and a rigid part
        assert model.space.rotation_count == (0 if kind is GradientSpace else 2)
    if isinstance(model.space, EdgeSpace):
        assert (model.space.settings.projection, model.space.settings.volume) == ("dso", 0.5)
