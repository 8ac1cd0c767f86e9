"""The space of lengths and angles: exact at frames, blind to rigid motions, whatever solves it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mixseq
from mixseq.errors import ReconstructionError, SettingsError
from mixseq.mesh.measures import edge_lengths, signed_volume
from mixseq.mesh.rigid import kabsch
from mixseq.mesh.topology import Topology
from mixseq.segmentation.joints import decompose
from mixseq.sequence.sequence import MeshSequence, bounding_diagonal
from mixseq.shells import shell
from mixseq.shells.fitting import ShellSettings
from mixseq.shells.shell import BENDING_WEIGHT
from mixseq.spaces.edge import EdgeSettings, EdgeSpace
from mixseq.spaces.mixed.construction import mixed_space
from mixseq.spaces.mixed.mixed_space import Projection
from mixseq.types import Float
from tests.meshes import SEQUENCES, bent, rotation, torus, tube

pytestmark = pytest.mark.slow

STEPS = EdgeSettings()
DSO = EdgeSettings("dso")
VOLUME = EdgeSettings("dso", volume=10.0)
ALL = {"steps": STEPS, "dso": DSO, "volume": VOLUME}

EXACT = sorted(SEQUENCES.keys() - {"zero area"})
"""Angles at a triangle without area say nothing."""


@cache
def sequence_of(name: str) -> MeshSequence:
    if name == "torus":
        points, faces = torus(12, 8)
        frames = [points * [1, 1 + 0.3 * t, 1 - 0.2 * t] @ rotation((t, 2 * t, 0.0)).T for t in range(3)]
        return MeshSequence.from_arrays(np.stack(frames), faces)
    return SEQUENCES[name]()


def space_of(sequence: MeshSequence, settings: EdgeSettings = STEPS, shell: ShellSettings | None = None) -> EdgeSpace:
    points = sequence.points.astype(np.float64)
    topology, scale = Topology(sequence.faces, sequence.vertex_count), bounding_diagonal(points[0])
    lengths = edge_lengths(points / scale, topology.edges).mean(axis=0)
    return EdgeSpace(topology, scale, points[0] / scale, lengths, replace(settings, shell=shell))


def two(first: Float, second: Float, faces: Any) -> MeshSequence:
    return MeshSequence.from_arrays(np.stack([first, second]), faces)


@pytest.mark.parametrize("settings", ALL.values(), ids=ALL)
@pytest.mark.parametrize("name", [*EXACT, "torus"])
def test_frames_come_back(name: str, settings: EdgeSettings) -> None:
    sequence = sequence_of(name)
    space = space_of(sequence, settings)
    vectors = space.encode(sequence.points)
    assert vectors.shape == (sequence.frame_count, space.dim)
    assert len(space.weights) == space.dim
    assert np.isfinite(space.weights).all()
    points, reports = space.decode_with_reports(vectors)
    assert np.abs(points - sequence.points).max() < 1e-9 * space.scale
    np.testing.assert_array_equal(space.decode(vectors[-1:]), points[-1:])
    assert all(report.converged for frame in reports for report in frame)


def test_dimensions() -> None:
    sequence = sequence_of("bar")
    space = space_of(sequence)
    edges = len(space.topology.edges)
    assert space.dim - 1 == space.paper_dimension == 2 * edges + 6  # a quaternion has a number more
    assert space_of(sequence, VOLUME).dim == space.dim + 1
    open_space = space_of(sequence_of("several components"))
    assert open_space.dim == len(open_space.topology.edges) + len(open_space.topology.hinges) + 3 * 7


@pytest.mark.parametrize("settings", ALL.values(), ids=ALL)
def test_rigid_motions_change_poses_only(settings: EdgeSettings) -> None:
    sequence = sequence_of("bar")
    space = space_of(sequence, settings)
    turn = rotation((0.5, -0.3, 1.0))
    moved = sequence.points @ turn.T + [1.0, -20.0, 3.0]
    there, here = space.encode(moved), space.encode(sequence.points)
    np.testing.assert_allclose(there[:, : space.shape_dim], here[:, : space.shape_dim], atol=1e-11)
    half = 0.5 * (here[:1] + here[-1:])
    half_moved = half.copy()
    half_moved[0, space.shape_dim :] = there[0, space.shape_dim :]
    one, other = space.decode(half)[0], space.decode(half_moved)[0]
    turned, shift = kabsch(one, other)
    np.testing.assert_allclose(one @ turned.T + shift, other, atol=1e-9)


@pytest.mark.parametrize("settings", ALL.values(), ids=ALL)
def test_half_way_a_bent_tube_keeps_its_lengths(settings: EdgeSettings) -> None:
    """Vertices half way shrink where a tube turns by 120 degrees; lengths and angles do not."""
    points, faces = tube(8, 41, length=8.0)
    sequence = two(bent(points, -1.05, 4.0, 4.0), bent(points, 1.05, 4.0, 4.0), faces)
    space = space_of(sequence, settings)
    vectors = space.encode(sequence.points)
    (half,) = space.decode(vectors.mean(axis=0, keepdims=True))
    edges = space.topology.edges
    wanted = edge_lengths(sequence.points, edges).mean(axis=0)
    strain = np.abs(edge_lengths(half, edges) / wanted - 1)
    averaged = np.abs(edge_lengths(sequence.points.mean(axis=0), edges) / wanted - 1)
    assert strain.max() < 0.05
    assert averaged.max() > 0.1
    ends = np.linalg.norm(half[-1] - half[-2])
    assert ends > np.linalg.norm(sequence.points[:, -1] - sequence.points[:, -2], axis=1).max()


def test_blocks_are_as_the_whole() -> None:
    points, faces = tube(8, 21)
    # The two sides of a sharp bend pass each other: angles go over half a turn.
    frames = np.stack([bent(points, angle, 2.0, 0.01) for angle in np.linspace(0, 4.0, 9)])
    space = space_of(MeshSequence.from_arrays(frames, faces))
    whole = space.encode(frames)
    first = space.encode(frames[:4])
    second = space.encode(frames[4:], first[-1])
    np.testing.assert_array_equal(np.concatenate([first, second]), whole)
    np.testing.assert_array_equal(space.unwrap(space.encode_independently(frames)), whole)
    assert np.abs(np.diff(whole[:, : space.shape_dim], axis=0)).max() < np.pi


def test_velocities_are_those_of_meshes_that_fit_best() -> None:
    """Fits that end early are as good to look at, but not to be subtracted from each other."""
    mesh = tube(8, 17)
    sequence = two(mesh[0], bent(mesh[0], 2.5) * [1.3, 0.8, 1.0], mesh[1])
    early = space_of(sequence, DSO, ShellSettings(accuracy=1e-2, tolerance=0.1))
    best = space_of(sequence, DSO, ShellSettings(accuracy=1e-12, tolerance=1e-12))
    first, last = early.encode(sequence.points)
    middle, rate, step = (first + last)[None] / 2, (last - first)[None], 1e-5
    _, velocities = early.decode_with_velocities(middle, rate)
    expected = (best.decode(middle + step * rate) - best.decode(middle - step * rate)) / (2 * step)
    rough = (early.decode(middle + step * rate) - early.decode(middle - step * rate)) / (2 * step)
    assert np.linalg.norm(velocities - expected) < 1e-3 * np.linalg.norm(expected)
    assert np.linalg.norm(rough - expected) > 1e-2 * np.linalg.norm(expected)


def test_volume_is_kept_better_with_its_term() -> None:
    """A tube bent to both sides is thinner half way, unless it is told what it holds."""
    points, faces = tube(10, 41, length=8.0, radius=1.0)
    sequence = two(bent(points, -1.4, 4.0, 1.0), bent(points, 1.4, 4.0, 1.0), faces)
    off = []
    for weight in (0.0, 1.0, 10.0, 100.0):
        space = space_of(sequence, EdgeSettings("dso", volume=weight))
        vectors = space.encode(sequence.points)
        (half,) = space.decode(vectors.mean(axis=0, keepdims=True))
        wanted = np.mean([signed_volume(frame, faces) for frame in sequence.points])
        off.append(abs(signed_volume(half, faces) / wanted - 1))
    assert off == sorted(off, reverse=True)
    assert off[0] > 0.01
    assert off[-1] < 0.1 * off[0]


def test_a_mesh_that_is_one_joint_is_the_same_in_the_mixed_space(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the free placement, where all faces are of joints."""
    monkeypatch.setattr(shell, "SLENDER_HEIGHT_RATIO", 1e-3)  # all hinges count the same, as in S_e
    monkeypatch.setattr(shell, "MIN_AREA_RATIO", 0.0)  # whatever the areas of their triangles
    sequence = sequence_of("bar")
    topology = Topology(sequence.faces, sequence.vertex_count)
    whole = decompose(topology, np.zeros(len(topology.faces), dtype=np.int64))
    mixed = replace(
        mixed_space(sequence.points, topology, whole, "free"),
        joint_faces=np.ones(len(topology.faces), dtype=bool),
        projection=Projection("free", 1.0, steps=400),
    )
    edge = space_of(sequence, DSO, ShellSettings(bending=BENDING_WEIGHT, tolerance=1e-14, accuracy=1e-11))
    space = replace(edge, reference_lengths=edge_lengths(mixed.reference, topology.edges))
    ours, theirs = space.encode(sequence.points), mixed.encode(sequence.points)
    edges = len(topology.edges)
    blocks = mixed.split(theirs)
    np.testing.assert_allclose(ours[:, :edges], blocks.lengths, atol=1e-12)
    np.testing.assert_allclose(ours[:, edges : space.shape_dim], blocks.angles, atol=1e-12)

    weights = np.array([0.6, 0.0, 0.0, 0.0, 0.4])
    (their,), (our,) = mixed.decode((weights @ theirs)[None]), space.decode((weights @ ours)[None])
    turn, shift = kabsch(our, their)
    np.testing.assert_allclose(our @ turn.T + shift, their, atol=1e-5 * space.scale)
    assert not np.allclose(edge_lengths(our, topology.edges), (weights @ ours)[:edges] * space.scale, atol=1e-4)


def test_angles_of_triangles_without_area_say_nothing() -> None:
    """What the space cannot hold comes back near, not wild."""
    sequence = sequence_of("zero area")
    space = space_of(sequence)
    points = space.decode(space.encode(sequence.points))
    assert np.abs(points - sequence.points).max() < 0.05 * space.scale


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"projection": "gauss"}, "projection is 'gauss'; 'steps' or 'dso' is expected"),
        ({"volume": -1.0}, "volume is -1.0; a weight of 0"),
        ({"volume": np.nan}, "volume is nan"),
        ({"volume": 1.0}, "projection 'steps' has no use for volume; leave it out, or choose 'dso'"),
    ],
)
def test_settings_out_of_range_are_refused(settings: Any, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        EdgeSettings(**settings)


def test_vectors_that_are_not_of_the_space_are_refused() -> None:
    space = space_of(sequence_of("bar"))
    with pytest.raises(SettingsError, match="vectors have shape"):
        space.decode(np.zeros((1, 3)))
    with pytest.raises((ReconstructionError, np.linalg.LinAlgError)):
        space.decode(np.full((1, space.dim), np.nan))


@pytest.mark.realdata
@pytest.mark.parametrize("settings", [STEPS, DSO], ids=["steps", "dso"])
@pytest.mark.parametrize("name", ["lion_poses", "cat_poses", "horse_poses"])
def test_animals_come_back(data: Path, name: str, settings: EdgeSettings) -> None:
    whole = mixseq.read(data / "npz" / f"{name}.npz")
    sequence = MeshSequence.from_header(whole.header.with_times([0.0, 1.0]), whole.points[[1, 3]])
    space = space_of(sequence, settings)
    points = space.decode(space.encode(sequence.points))
    assert np.linalg.norm(points - sequence.points, axis=2).max() < 1e-9 * space.scale
