from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np
import pytest

from mixseq import metrics
from mixseq.errors import InvalidSequenceError
from mixseq.metrics import compare, match_frames
from mixseq.runtime.low_memory import Statistics
from mixseq.sequence.sequence import Frames, LazyFrames, MeshSequence
from mixseq.types import Float
from tests.meshes import SEQUENCES, bar, grid, rotation, tetrahedron, topology_of, tube


def still(points: Float, faces: object, frames: int = 1) -> MeshSequence:
    return MeshSequence.from_arrays(np.repeat(points[None], frames, axis=0), np.asarray(faces), fps=10)


def cube() -> MeshSequence:
    """The unit cube."""
    z, y, x = (axis.reshape(-1) for axis in np.mgrid[:2, :2, :2].astype(float))
    quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    faces = [corners for a, b, c, d in quads for corners in ([a, b, c], [a, c, d])]
    return still(np.stack([x, y, z], axis=1), faces)


# Closed forms ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SEQUENCES)
def test_identical_sequences_differ_by_nothing(name: str) -> None:
    sequence = SEQUENCES[name]()
    result = compare(sequence, sequence)
    assert (result.frames, result.vertices) == sequence.points.shape[:2]
    assert (result.kg_percent, result.rms_error, result.max_error) == (0, 0, 0)
    assert (result.worst_frame, result.worst_time) == (0, sequence.times[0])
    for values in (result.edge_strain, result.dihedral_degrees):
        assert (values.rms, values.p999, values.max) == (0, 0, 0)
    assert result.volume is None or (result.volume.mean, result.volume.max) == (0, 0)
    assert not result.per_frame_max.any()


def test_translation() -> None:
    a = bar()
    shift = np.array([0.3, -0.4, 1.2])
    result = compare(a, a.with_points(a.points + shift))
    assert result.diagonal == a.diagonal
    assert result.max_error == pytest.approx(1.3 / a.diagonal)
    assert result.rms_error == pytest.approx(1.3 / a.diagonal)
    assert result.per_frame_max == pytest.approx(np.full(a.frame_count, 1.3 / a.diagonal))
    centred = a.points - a.points.mean(axis=1, keepdims=True)
    squares = 1.3**2 * a.frame_count * a.vertex_count
    assert result.kg_percent == pytest.approx(100 * np.sqrt(squares / np.square(centred).sum()))
    assert result.edge_strain.max < 1e-12
    assert result.dihedral_degrees.max < 1e-9
    assert result.volume is not None
    assert result.volume.max < 1e-12


@pytest.mark.parametrize("scale", [1.25, 0.5, 1.0001])
def test_uniform_scale(scale: float) -> None:
    a = bar()
    result = compare(a, a.with_points(scale * a.points))
    strain, swelling = abs(scale - 1), abs(scale**3 - 1)
    values = result.edge_strain
    assert (values.rms, values.p999, values.max) == pytest.approx((strain,) * 3)
    assert values.skipped == 0
    assert result.dihedral_degrees.max < 1e-9
    assert result.volume is not None
    assert (result.volume.mean, result.volume.max) == pytest.approx((swelling, swelling))


def test_rotation() -> None:
    a = bar()
    result = compare(a, a.with_points(a.points @ rotation((0.5, -1.0, 2.0)).T))
    assert result.max_error > 0.1
    assert result.edge_strain.max < 1e-12
    assert result.dihedral_degrees.max < 1e-9
    assert result.volume is not None
    assert result.volume.max < 1e-12


def test_folding_changes_only_the_dihedral_angle() -> None:
    points = np.array([[0.0, 0, 0], [0, 1, 0], [1, 0, 0], [-1, 0, 0]])
    a = still(points, [[0, 2, 1], [0, 1, 3]])
    folded = points.copy()
    folded[3] = -np.cos(np.radians(25)), 0, np.sin(np.radians(25))
    result = compare(a, still(folded, a.faces))
    values = result.dihedral_degrees
    assert (values.rms, values.p999, values.max) == pytest.approx((25, 25, 25))
    assert result.edge_strain.max < 1e-12


def test_dihedral_angles_go_the_shorter_way_around() -> None:
    points = np.array([[0.0, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, 0]])

    def closed_up_to(degrees: float) -> MeshSequence:
        angle = np.radians(degrees)
        return still(np.vstack([points[:3], [np.cos(angle), 0, np.sin(angle)]]), [[0, 2, 1], [0, 1, 3]])

    # The book is all but shut, and opens a little to the other side: 8 degrees, not 352.
    result = compare(closed_up_to(5), closed_up_to(-3))
    assert result.dihedral_degrees.max == pytest.approx(8)


@pytest.mark.parametrize(
    ("mesh", "volume"),
    [
        (lambda: still(*tetrahedron()), 8 / 3),
        (cube, 1.0),
        (lambda: still(*tube(4, 3, length=3.0, radius=1.0)), 6.0),
    ],
    ids=["tetrahedron", "cube", "square tube"],
)
def test_volume(mesh: Callable[[], MeshSequence], volume: float) -> None:
    a = mesh()
    moved = a.points.astype(np.float64) @ rotation((1, 2, 3)).T + 50
    assert metrics._signed_volumes(moved, a.faces) == pytest.approx([volume])
    assert metrics._signed_volumes(a.points.astype(np.float64), a.faces[:, ::-1]) == pytest.approx([-volume])


def test_volume_error_of_a_sheared_and_of_a_stretched_cube() -> None:
    a = cube()
    sheared = compare(a, a.with_points(a.points + 0.7 * a.points[..., 2:] * [1, 0, 0]))
    stretched = compare(a, a.with_points(a.points * [1, 1, 1.5]))
    assert sheared.volume is not None
    assert sheared.volume.max < 1e-12
    assert stretched.volume is not None
    assert stretched.volume.max == pytest.approx(0.5)


def test_volume_error_over_frames() -> None:
    a = still(cube().points[0], cube().faces, frames=3)
    b = a.with_points(a.points * np.array([1.0, 1.1, 0.8])[:, None, None])
    volume = compare(a, b).volume
    assert volume is not None
    assert volume.max == pytest.approx(1 - 0.8**3)
    assert volume.mean == pytest.approx((0 + 1.1**3 - 1 + 1 - 0.8**3) / 3)


@pytest.mark.parametrize("name", ["open bar", "folding sheet", "three pages", "inconsistent"])
def test_no_volume(name: str) -> None:
    sequence = SEQUENCES[name]()
    result = compare(sequence, sequence.with_points(sequence.points * 1.1))
    assert result.volume is None


def test_a_flat_closed_mesh_has_no_volume() -> None:
    points, faces = tetrahedron()
    flat = still(points * [1, 1, 0], faces)
    assert compare(flat, flat).volume is None


# Where and when -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("block", [1, 100, 10**6])
def test_worst_frame(block: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(metrics, "_MAX_BLOCK_VERTICES", block)
    a = bar(frames=7)
    points = a.points.copy()
    points[2, 11] += [0, 3e-3, 4e-3]
    points[5, 40, 0] += 0.02
    points[6, 40, 0] -= 0.01
    result = compare(a, a.with_points(points))
    assert result.worst_frame == 5
    assert result.worst_time == pytest.approx(0.5)
    assert result.max_error == pytest.approx(0.02 / a.diagonal)
    expected = np.array([0, 0, 0.005, 0, 0, 0.02, 0.01]) / a.diagonal
    assert result.per_frame_max == pytest.approx(expected, abs=1e-15)


@pytest.mark.parametrize("name", SEQUENCES)
def test_blocks_do_not_matter(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    a = SEQUENCES[name]()
    noise = np.random.default_rng(3).normal(size=a.points.shape) * 1e-3 * a.diagonal
    b = a.with_points((a.points + noise).astype(a.points.dtype))
    whole = compare(a, b)
    monkeypatch.setattr(metrics, "_MAX_BLOCK_VERTICES", 1)
    single = compare(a, b)
    assert single.per_frame_max.tolist() == whole.per_frame_max.tolist()
    assert single.kg_percent == pytest.approx(whole.kg_percent)
    for one, other in (
        (single.edge_strain, whole.edge_strain),
        (single.dihedral_degrees, whole.dihedral_degrees),
    ):
        assert (one.max, one.p999, one.skipped) == (other.max, other.p999, other.skipped)
        assert one.rms == pytest.approx(other.rms)


def test_edges_without_length_and_faces_without_area_are_skipped() -> None:
    points, faces = tetrahedron()
    a = still(np.vstack([points, points[:1]]), [*faces.tolist(), [0, 1, 4]], frames=2)
    result = compare(a, a)
    assert result.edge_strain.skipped == 2  # the edge 0-4 in both frames
    assert result.dihedral_degrees.skipped > 0
    collapsed = compare(still(points, faces), still(points * 0, faces))
    hinges = len(topology_of((points, faces)).hinges)
    assert collapsed.dihedral_degrees == Statistics(rms=0.0, p999=0.0, max=0.0, skipped=hinges)


def test_a_mesh_in_one_point() -> None:
    points, faces = tetrahedron()
    a = still(points * 0, faces)
    same, moved = compare(a, a), compare(a, still(points, faces))
    assert (same.kg_percent, same.rms_error, same.max_error) == (0, 0, 0)
    assert (moved.kg_percent, moved.rms_error, moved.max_error) == (np.inf,) * 3
    assert moved.edge_strain.skipped == 6
    plain = moved.as_dict()
    assert (plain["kg_percent"], plain["rms_error"], plain["max_error"]) == (None, None, None)
    json.dumps(plain, allow_nan=False)


@pytest.mark.parametrize("streams", [False, True])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_a_mesh_that_grows_from_a_point(scale: float, streams: bool) -> None:
    points, faces = tetrahedron()
    a = MeshSequence.from_arrays(scale * np.stack([0 * points, 2 * points, points]) + 3 * scale, faces)
    b = a.with_points(a.points + np.array([0.01 * scale, 0, 0]))
    reference: Frames = LazyFrames(a.header, lambda _: iter(a.points[:, None])) if streams else a
    result = compare(reference, b)
    assert result.diagonal == a.diagonal == pytest.approx(2 * scale * np.linalg.norm(np.ptp(points, axis=0)))
    assert result.per_frame_max == pytest.approx(np.full(3, 0.01 * scale / a.diagonal))


@pytest.mark.parametrize("exponent", [-1000, -600, 600, 1000])
def test_scale_does_not_matter(exponent: int) -> None:
    bent = bar()
    off = bent.with_points(bent.points * 1.01)
    near, far = (
        compare(bent.with_points(np.ldexp(bent.points, shift)), off.with_points(np.ldexp(off.points, shift)))
        for shift in (0, exponent)
    )
    assert far.as_dict() == {**near.as_dict(), "diagonal": np.ldexp(near.diagonal, exponent)}


def test_percentile_of_strain() -> None:
    points, faces = grid(20, 20)
    a = still(points, faces, frames=4)
    rng = np.random.default_rng(0)
    b = a.with_points(a.points + 0.1 * rng.normal(size=a.points.shape))
    edges = topology_of((points, faces)).edges
    lengths = [np.linalg.norm(x[:, edges[:, 1]] - x[:, edges[:, 0]], axis=2) for x in (a.points, b.points)]
    strain = np.abs(lengths[1] / lengths[0] - 1)
    found = compare(a, b).edge_strain
    assert found.p999 == pytest.approx(np.quantile(strain, 0.999, method="inverted_cdf"))
    assert found.max == pytest.approx(strain.max())
    assert found.rms == pytest.approx(np.sqrt(np.square(strain).mean()))


# What cannot be compared ----------------------------------------------------------------------------------


def test_faces_in_another_order_are_the_same_mesh() -> None:
    faces = np.roll(bar().faces[::-1], 1, axis=1)
    other = MeshSequence.from_arrays(1.01 * bar().points, faces, fps=10)
    same = MeshSequence.from_arrays(1.01 * bar().points, bar().faces, fps=10)
    assert compare(bar(), other).as_dict() == compare(bar(), same).as_dict()


def _turned_face() -> MeshSequence:
    faces = bar().faces.copy()
    faces[7] = faces[7, ::-1]
    return MeshSequence.from_arrays(bar().points, faces, fps=10)


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (lambda: bar(rings=26), r"the reference has 202 vertices, the other sequence 210"),
        (
            lambda: MeshSequence.from_arrays(bar().points, bar().faces[:-1], fps=10),
            r"polygon 399 of the reference \(vertices \d+ \d+ \d+\) is not in the other sequence; vertices must be",
        ),
        (lambda: bar(frames=6), r"the reference has 5 frames, the other sequence 6"),
        (_turned_face, r"polygon 7 of the reference \(.*\) is flipped in the other sequence"),
        (
            lambda: MeshSequence.from_arrays(bar().points, bar().faces, times=[0, 0.1, 0.2, 0.31, 0.4]),
            r"frame 3 is at 0\.3 s in the reference, at 0\.31 s in the other",
        ),
    ],
    ids=["vertices", "triangles", "frames", "faces", "times"],
)
def test_what_differs_is_named(other: Callable[[], MeshSequence], message: str) -> None:
    with pytest.raises(InvalidSequenceError, match=message):
        compare(bar(), other())


def test_rounded_times_are_the_same() -> None:
    a = bar()
    times = a.times.astype(np.float32).astype(np.float64)
    assert (times != a.times).any()
    assert compare(a, MeshSequence.from_arrays(a.points, a.faces, times=times)).max_error == 0


def test_shared_frames() -> None:
    slow = bar(frames=5).header
    fast = slow.with_times(np.arange(9) / 20 + 1e-9, fps=20)
    chosen = match_frames(slow, fast)
    assert chosen is not None
    assert chosen.tolist() == [0, 2, 4, 6, 8]
    uneven = slow.with_times(np.arange(12) / 25, fps=25)  # the same numbers are other moments
    assert match_frames(slow, uneven) is None
    assert match_frames(fast, slow) is None
    assert match_frames(slow, slow.with_times(np.arange(9) / 20 + 0.01)) is None
    one = slow.with_times([0.2])
    found = match_frames(one, slow)
    assert found is not None
    assert found.tolist() == [2]
    assert match_frames(slow, one) is None


def test_times_of_late_frames_in_single_precision_are_the_same() -> None:
    header = bar().header.with_times(np.arange(1001, 1006) / 24, fps=24)
    rounded = header.with_times(header.times.astype(np.float32))
    assert np.abs(rounded.times - header.times).max() * 24 > 1e-5
    found = match_frames(header, rounded)
    assert found is not None
    assert found.tolist() == [0, 1, 2, 3, 4]
    assert match_frames(header, header.with_times(header.times + 2e-3 / 24)) is None


def test_frames_close_in_time_are_not_confused() -> None:
    header = bar().header.with_times(np.arange(5) * 1e-3 / 24, fps=24)
    assert match_frames(header, header.with_times(header.times + 0.9e-3 / 24)) is None
    assert match_frames(header, header.with_times(header.times[:3] + 0.1e-3 / 24)) is None
    assert match_frames(header, header.with_times(header.times + 0.1e-3 / 24)) is not None


# As numbers -----------------------------------------------------------------------------------------------


def test_as_dict() -> None:
    a = bar()
    result = compare(a, a.with_points(1.1 * a.points))
    plain = result.as_dict()
    assert json.loads(json.dumps(plain, allow_nan=False)) == plain
    assert "per_frame_max" not in plain
    assert plain["edge_strain"]["max"] == result.edge_strain.max
    assert plain["volume"]["max"] == pytest.approx(0.331)
    full = result.as_dict(per_frame=True)
    assert json.loads(json.dumps(full)) == full
    assert full["per_frame_max"] == result.per_frame_max.tolist()


def test_frames_pair_by_time_or_number_and_the_difference_is_told() -> None:
    points = np.random.default_rng(0).normal(size=(40, 4, 3))
    faces = [[0, 1, 2], [0, 2, 3]]
    a = MeshSequence.from_arrays(points, faces, times=np.arange(1001, 1041) / 24, fps=24)
    drifting = MeshSequence.from_arrays(points, faces, times=a.times + np.linspace(0, 4e-5, 40), fps=24)
    ntsc = MeshSequence.from_arrays(points, faces, times=np.arange(1001, 1041) * 1.001 / 24, fps=24 / 1.001)
    for b, difference in ((a, 0.0), (drifting, 4e-5), (ntsc, 1040 * 0.001 / 24)):
        result = compare(a, b)
        assert result.max_error == 0
        assert result.max_time_difference == pytest.approx(difference, rel=1e-6, abs=1e-12)
    late = MeshSequence.from_arrays(points, faces, times=a.times + 2e-3 / 24, fps=24)
    with pytest.raises(InvalidSequenceError, match="with the same times"):
        compare(a, late)
