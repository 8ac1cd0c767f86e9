"""Writing glTF in a document of its own: closed forms."""

from __future__ import annotations

import tracemalloc
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mixseq.errors import InvalidSequenceError, MixseqWarning, OutputError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import CornerValues, FaceSet, MeshObject, Surface
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import FloatArray
from mixseq_io.gltf.new_document import _unique_tuples
from mixseq_io.gltf.writer import write_gltf
from tests.formats.conftest import CASES, lossy
from tests.formats.gltf_files import Gltf, read, validate, write_glb, written

pytestmark = pytest.mark.slow

TWO = Polygons.from_triangles([[0, 1, 2], [0, 2, 3]])
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float32)


def moving_square(frames: int = 3, **header: Any) -> MeshSequence:
    """Return a square whose upper edge is lifted by 0, 1, 4, 9 ..."""
    points = np.tile(SQUARE, (frames, 1, 1))
    points[:, 2:, 2] = (np.arange(frames) ** 2)[:, None]
    fields = {"polygons": TWO, "vertex_count": 4, "times": np.arange(frames) / 2, "fps": 2.0, "name": "square"}
    return MeshSequence(points=points, **{**fields, **header})


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_the_first_frame_is_the_mesh_and_the_others_are_targets(tmp_path: Path, suffix: str) -> None:
    file = written(tmp_path / f"a{suffix}", moving_square())
    np.testing.assert_array_equal(file.attribute("square", "POSITION"), SQUARE)
    assert file.triangles("square") == [[0, 1, 2], [0, 2, 3]]
    targets = [file.accessor(each["POSITION"]) for each in file.primitives("square")[0]["targets"]]
    lifts = np.array([[0, 0, 0], [0, 0, 0], [0, 0, 1], [0, 0, 1]])
    np.testing.assert_array_equal(targets, [lifts, 4 * lifts])
    np.testing.assert_array_equal(file.attribute("square", "_VERTEX"), [0, 1, 2, 3])


def test_pygltflib_reads_the_same(tmp_path: Path) -> None:
    import pygltflib

    write_gltf(tmp_path / "a.glb", moving_square().header, [moving_square().points])
    file = pygltflib.GLTF2().load(str(tmp_path / "a.glb"))
    (primitive,) = file.meshes[0].primitives

    def vectors(index: int) -> FloatArray:
        accessor = file.accessors[index]
        start = file.bufferViews[accessor.bufferView].byteOffset + (accessor.byteOffset or 0)
        return np.frombuffer(file.binary_blob(), np.float32, 3 * accessor.count, start).reshape(-1, 3)

    base = vectors(primitive.attributes.POSITION)
    moved = [base + vectors(target["POSITION"]) for target in primitive.targets]
    np.testing.assert_array_equal([base, *moved], moving_square().points)


def test_weights_choose_one_target_at_each_key(tmp_path: Path) -> None:
    file = written(tmp_path / "a.glb", moving_square(4))
    animation = file.json["animations"][0]
    sampler = animation["samplers"][0]
    assert animation["name"] == "square"
    assert animation["extras"] == {"fps": 2.0}
    assert sampler["interpolation"] == "LINEAR"
    assert animation["channels"] == [{"sampler": 0, "target": {"node": 0, "path": "weights"}}]
    np.testing.assert_array_equal(file.accessor(sampler["input"]), [0, 0.5, 1, 1.5])
    np.testing.assert_array_equal(
        file.accessor(sampler["output"]).reshape(4, 3), [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    )


def test_between_frames_points_move_in_straight_lines(tmp_path: Path) -> None:
    file = written(tmp_path / "a.glb", moving_square())
    assert [file.played("square", time)[2, 2] for time in (0, 0.25, 0.5, 0.75, 1, 7)] == [0, 0.5, 1, 2.5, 4, 4]


def test_normals_follow_the_surface(tmp_path: Path) -> None:
    file = written(tmp_path / "a.glb", moving_square(2))
    np.testing.assert_array_equal(file.attribute("square", "NORMAL"), [[0, 0, 1]] * 4)
    tilted = np.array([0, -1, 1]) / np.sqrt(2)
    np.testing.assert_allclose(file.played("square", 0.5, "NORMAL"), [tilted] * 4, atol=1e-7)


def test_points_are_as_exact_as_float32_deltas_are(tmp_path: Path) -> None:
    points = np.random.default_rng(1).normal(size=(4, 4, 3)).astype(np.float32) * [1, 1e3, 1e-3]
    sequence = moving_square(4).with_points(points.astype(np.float32))
    file = written(tmp_path / "a.glb", sequence)
    for time, expected in zip(sequence.times, sequence.points.astype(np.float64), strict=True):
        bound = 2.0**-24 * np.abs(expected - sequence.points[0].astype(np.float64))
        assert (np.abs(file.played("square", time) - expected) <= bound).all()


def test_one_frame_is_no_animation(tmp_path: Path) -> None:
    file = written(tmp_path / "a.glb", moving_square(1))
    assert "animations" not in file.json
    assert "targets" not in file.primitives("square")[0]


def test_polygons_become_fans(tmp_path: Path) -> None:
    quad = moving_square(2, polygons=Polygons(np.array([4]), np.array([1, 2, 3, 0])))
    with pytest.warns(MixseqWarning, match=r"cannot hold polygons other than triangles"):
        file = written(tmp_path / "a.glb", quad)
    assert file.triangles("square") == [[1, 2, 3], [1, 3, 0]]


def test_vertices_are_split_where_textures_or_normals_are(tmp_path: Path) -> None:
    uvs = CornerValues(np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]), np.array([0, 1, 2, 0, 3, 1]))  # vertex 2 has two
    seam = written(tmp_path / "a.glb", moving_square(surface=Surface(uvs=uvs)))
    assert seam.attribute("square", "_VERTEX").tolist() == [0, 1, 2, 2, 3]
    assert seam.attribute("square", "TEXCOORD_0").tolist() == [[0, 1], [1, 1], [1, 0], [0, 0], [1, 1]]
    assert seam.triangles("square") == [[0, 1, 2], [0, 3, 4]]
    assert seam.played("square", 1)[:, 2].tolist() == [0, 0, 4, 4, 4]

    hard = moving_square(surface=Surface(hard_edges=np.array([0, 1, 2, 3, 4, 5])))
    crease = written(tmp_path / "b.glb", hard)
    assert crease.attribute("square", "_VERTEX").tolist() == [0, 0, 1, 2, 2, 3]
    flat = crease.played("square", 1, "NORMAL")
    np.testing.assert_allclose(flat[[0, 2, 3]], [np.array([0, -4, 1]) / np.sqrt(17)] * 3, atol=1e-6)


def test_vertices_that_no_polygon_uses_stay(tmp_path: Path) -> None:
    file = written(tmp_path / "a.glb", moving_square(polygons=Polygons.from_triangles([[3, 0, 2]])))
    assert file.attribute("square", "_VERTEX").tolist() == [0, 1, 2, 3]
    assert file.triangles("square") == [[3, 0, 2]]
    assert read(tmp_path / "a.glb").vertex_count == 4


def test_face_sets_become_primitives_with_plain_materials(tmp_path: Path) -> None:
    polygons = Polygons.from_triangles([[0, 1, 2], [0, 2, 3], [0, 1, 3], [1, 2, 3]])
    sets = (
        FaceSet("fur", np.array([0]), "/rig/materials/fur"),
        FaceSet("eye", np.array([2]), "eye"),
        FaceSet("tail", np.array([1]), "fur"),
    )
    with pytest.warns(MixseqWarning, match="cannot hold names of face sets other than their materials'"):
        file = written(tmp_path / "a.glb", moving_square(polygons=polygons, surface=Surface(face_sets=sets)))
    assert [each["name"] for each in file.json["materials"]] == ["fur", "eye"]
    assert [each.get("material") for each in file.primitives("square")] == [None, 0, 1, 0]
    numbers = [file.attribute("square", "_VERTEX", i)[file.triangles("square", i)].tolist() for i in range(4)]
    assert numbers == [[[1, 2, 3]], [[0, 1, 2]], [[0, 1, 3]], [[0, 2, 3]]]
    for primitive in range(4):
        assert len(file.primitives("square")[primitive]["targets"]) == 2


def test_of_overlapping_face_sets_the_first_with_a_material_wins(tmp_path: Path) -> None:
    sets = (FaceSet("left", np.array([0])), FaceSet("a", np.array([0]), "a"), FaceSet("b", np.array([0]), "b"))
    with pytest.warns(MixseqWarning, match="cannot hold face sets that overlap"):
        file = written(tmp_path / "a.glb", moving_square(surface=Surface(face_sets=sets)))
    assert [each["name"] for each in file.json["materials"]] == ["a"]
    assert [each.get("material") for each in file.primitives("square")] == [None, 0]


def test_face_sets_without_material_become_materials_unless_they_are_the_whole(tmp_path: Path) -> None:
    sets = (FaceSet("all", np.array([0, 1])), FaceSet("left", np.array([0])))
    file = written(tmp_path / "a.glb", moving_square(surface=Surface(face_sets=sets)))
    assert [each["name"] for each in file.json["materials"]] == ["left"]
    file = written(tmp_path / "b.glb", moving_square(surface=Surface(face_sets=sets[:1])))
    assert "materials" not in file.json


def test_objects_become_nodes_of_one_animation(tmp_path: Path) -> None:
    objects = (MeshObject("left", "/a/left", 3, 1), MeshObject("right", "/a/right", 4, 2))
    points = np.random.default_rng(2).normal(size=(3, 7, 3)).astype(np.float32)
    polygons = Polygons.from_triangles([[0, 1, 2], [3, 4, 5], [3, 5, 6]])
    sequence = MeshSequence(
        points=points,
        polygons=polygons,
        vertex_count=7,
        times=np.arange(3.0),
        name="pair",
        surface=Surface(objects=objects),
    )
    file = written(tmp_path / "a.glb", sequence)
    (root,) = file.json["scenes"][0]["nodes"]
    assert file.json["nodes"][root]["name"] == "pair"
    assert [file.json["nodes"][child]["name"] for child in file.json["nodes"][root]["children"]] == ["left", "right"]
    assert len(file.json["animations"]) == 1
    np.testing.assert_allclose(file.played("left", 2), points[2, :3], atol=1e-6)
    np.testing.assert_allclose(file.played("right", 2), points[2, 3:], atol=1e-6)


def test_objects_without_polygons_are_left_out(tmp_path: Path) -> None:
    objects = (MeshObject("square", "/s", 4, 2), MeshObject("dust", "/d", 1, 0))
    points = moving_square().points[:, [0, 1, 2, 3, 0]]
    sequence = MeshSequence(
        points=points, polygons=TWO, vertex_count=5, times=np.arange(3.0), surface=Surface(objects=objects)
    )
    with pytest.warns(MixseqWarning, match=r"objects without polygons \('dust'\)"):
        file = written(tmp_path / "a.glb", sequence)
    assert len(file.json["meshes"]) == 1


@pytest.mark.parametrize(
    ("up_axis", "upwards"), [("X", [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]), ("Z", [[1, 0, 0], [0, 0, -1], [0, 1, 0]])]
)
def test_a_node_shows_points_upright_and_in_metres(tmp_path: Path, up_axis: str, upwards: list[list[int]]) -> None:
    sequence = moving_square(up_axis=up_axis, metres_per_unit=0.5)
    with pytest.warns(MixseqWarning, match=f"in 0.5 metres per unit with {up_axis} up, under a node"):
        file = written(tmp_path / "a.glb", sequence)
    np.testing.assert_array_equal(file.attribute("square", "POSITION"), SQUARE)
    matrix = np.reshape(file.node("square")["matrix"], (4, 4))
    np.testing.assert_array_equal(matrix[:3, :3], 0.5 * np.array(upwards))
    assert np.linalg.det(matrix) > 0
    up = np.eye(3)["XYZ".index(up_axis)]
    np.testing.assert_array_equal(up @ matrix[:3, :3], [0, 0.5, 0])


def keys_of(file: Gltf) -> list[float]:
    return list(file.accessor(file.json["animations"][0]["samplers"][0]["input"]).tolist())


@pytest.mark.parametrize("first", [-1.5, 3.0])
def test_animations_begin_at_zero(tmp_path: Path, first: float) -> None:
    times = [first, first + 1.5, first + 3.5]
    file = written(tmp_path / "a.glb", moving_square(times=times))
    assert keys_of(file) == [0, 1.5, 3.5]
    assert file.json["animations"][0]["extras"]["start"] == first
    assert read(tmp_path / "a.glb").times.tolist() == times


def test_a_shot_from_frame_1001_on_keeps_its_times_for_us(tmp_path: Path) -> None:
    times = np.arange(1001, 1097) * 1001 / 24000
    shot = moving_square(96, times=times, fps=24000 / 1001)
    assert keys_of(written(tmp_path / "a.glb", shot))[0] == 0
    np.testing.assert_allclose(read(tmp_path / "a.glb").times, times, rtol=1e-15)


def test_starts_that_are_kept(tmp_path: Path) -> None:
    late = written(tmp_path / "a.glb", moving_square(times=[3, 4, 5]), keep_start=True)
    assert keys_of(late) == [3, 4, 5]
    assert "start" not in late.json["animations"][0]["extras"]
    with pytest.warns(MixseqWarning, match=r"begin at 0; all times are moved by 1.5 s"):
        early = written(tmp_path / "b.glb", moving_square(times=[-1.5, 0, 2]), keep_start=True)
    assert keys_of(early) == [0, 1.5, 3.5]
    with pytest.warns(MixseqWarning, match="all times are moved by -3 s"):
        written(tmp_path / "c.glb", moving_square(1, times=[3]))


@pytest.mark.parametrize("start", ["now", None, True, float("nan"), 1e300])
def test_starts_that_are_none(tmp_path: Path, start: object) -> None:
    written(tmp_path / "a.glb", moving_square(times=[0, 1, 2]))
    file = Gltf(tmp_path / "a.glb")
    file.json["animations"][0]["extras"]["start"] = start
    write_glb(tmp_path / "b.glb", file.json, file.buffer)
    assert read(tmp_path / "b.glb").times.tolist() == [0, 1, 2]


def test_times_too_close_for_float32(tmp_path: Path) -> None:
    with pytest.raises(InvalidSequenceError, match=r"frames 1 and 2 are at .* too close, or too late, for glTF"):
        written(tmp_path / "a.glb", moving_square(times=[0, 1e6, 1e6 + 1e-3]))
    assert list(tmp_path.iterdir()) == []


def test_points_too_far_from_the_first_frame(tmp_path: Path) -> None:
    sequence = moving_square()
    far = sequence.points + np.array([-3e38, 3e38, 3e38], np.float32)[:, None, None]
    with pytest.raises(InvalidSequenceError, match=r"frame 1: vertex 0 .* too large for glTF"):
        written(tmp_path / "a.glb", sequence.with_points(far))
    assert list(tmp_path.iterdir()) == []


def test_velocities_and_subdivision_are_lost(tmp_path: Path) -> None:
    sequence = moving_square(surface=Surface(subdivision="loop"))
    with pytest.warns(MixseqWarning, match="cannot hold velocities, loop subdivision; USD, .npz and .h5 can"):
        write_gltf(tmp_path / "a.glb", sequence.header, [sequence.points], [np.zeros_like(sequence.points)])


def no_blocks(sequence: MeshSequence) -> Iterator[FloatArray]:
    yield sequence.points[:1]
    raise AssertionError("the size is known before the second block")


@pytest.mark.parametrize(
    ("suffix", "frames", "message"),
    [(".glb", 33_000, r"take 4.3\d GB, but a GLB file cannot exceed"), (".gltf", 11_000, "text file; write .glb")],
)
def test_too_large_files_are_refused_at_once(tmp_path: Path, suffix: str, frames: int, message: str) -> None:
    sequence = moving_square()
    header = sequence.header.with_times(np.arange(frames))
    with lossy(), pytest.raises(OutputError, match=message):
        write_gltf(tmp_path / f"a{suffix}", header, no_blocks(sequence))
    assert list(tmp_path.iterdir()) == []


def test_many_frames_are_warned_about(tmp_path: Path) -> None:
    with pytest.warns(
        MixseqWarning, match="each of the 1001 frames is a morph target, of which browsers usually show about 1000"
    ):
        written(tmp_path / "a.glb", moving_square(1001))


def test_memory_does_not_grow_with_the_frames(tmp_path: Path) -> None:
    vertices = 4000
    fan = [[0, i, i + 1] for i in range(1, vertices - 1)]
    points = np.random.default_rng(3).normal(size=(1, vertices, 3)).astype(np.float32)
    header = MeshSequence.from_arrays(points, fan).header

    def peak(frames: int) -> int:
        tracemalloc.start()
        write_gltf(tmp_path / "a.glb", header.with_times(np.arange(frames)), (points for _ in range(frames)))
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most

    few, many = peak(2), peak(22)
    assert many - few < 20 * 10_000  # of which a frame has 96000


def test_warnings_point_at_the_caller(tmp_path: Path) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        write_gltf(tmp_path / "a.glb", moving_square(up_axis="Z").header, [moving_square().points])
    assert [each.filename for each in caught] == [__file__]


def test_the_validator_passes_what_is_written(tmp_path: Path) -> None:
    for name, make in CASES.items():
        for suffix in (".glb", ".gltf"):
            with lossy():
                written(tmp_path / f"{name}{suffix}", make())
    validate(*sorted(tmp_path.iterdir()))


@pytest.mark.parametrize("columns", [1, 2, 3])
def test_corners_that_are_alike_become_one_vertex(columns: int) -> None:
    rows = np.random.default_rng(0).integers(0, 4, (60, columns)) * 1000
    chosen, kinds = _unique_tuples(list(rows.T))
    expected, inverse = np.unique(rows, axis=0, return_inverse=True)
    np.testing.assert_array_equal(rows[chosen], expected)
    np.testing.assert_array_equal(kinds, inverse)
