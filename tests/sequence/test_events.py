"""Events of constructed sequences are found where they were made, whatever the noise, and none in others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mixseq.mesh.topology import Topology
from mixseq.sequence.events import MAX_GROUPS, Events, SequenceEvents, distinct_poses, find_events
from mixseq.sequence.sequence import FrameStore, MeshSequence
from mixseq.types import Float
from tests.meshes import joined
from tests.motions import MESH, TOPOLOGY, moving

COUNT = 36
FRAMES = np.arange(COUNT, dtype=float)
DIAGONAL = float(np.linalg.norm(np.ptp(MESH[0], axis=0)))
NOISES = ["none", "float32", "float16", "1e-5", "1e-4"]


def dirty(points: Float, noise: str) -> Float:
    if noise in ("float16", "float32"):
        return points.astype(noise).astype(float)
    return (
        points
        if noise == "none"
        else points + np.random.default_rng(7).normal(0, float(noise) * DIAGONAL, points.shape)
    )


def found(points: Float, noise: str = "none", times: Float | None = None) -> Events:
    times = np.arange(len(points)) / 24 if times is None else times
    return find_events(dirty(points, noise), times, TOPOLOGY).whole


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("thinned", [1, 2, 3])
def test_smooth_motion_has_no_events(noise: str, thinned: int) -> None:
    assert found(moving(FRAMES)[::thinned], noise) == Events()


@pytest.mark.parametrize("frames", [1, 2, 3, 4])
def test_few_frames_have_no_events(frames: int) -> None:
    assert found(moving(FRAMES[:frames])) == Events()


def test_still_meshes_have_no_events() -> None:
    assert found(moving(np.zeros(12))) == Events()


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("distance", [1.0, 100.0])
def test_teleports_are_cuts(noise: str, distance: float) -> None:
    points = moving(FRAMES)
    points[20:] += distance * DIAGONAL * np.array([0.0, 0.6, 0.8])
    assert found(points, noise).cuts == (19,)


@pytest.mark.parametrize("noise", NOISES)
def test_splices_are_cuts(noise: str) -> None:
    parts = moving(FRAMES[:15]), moving(FRAMES[:12] + 60), moving(FRAMES[:9] + 20)
    assert found(np.concatenate(parts), noise) == Events(cuts=(14, 26))


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("length", [2, 4, 9])
def test_holds_are_found(noise: str, length: int) -> None:
    frames = np.concatenate([FRAMES[:16], np.full(length, 15), FRAMES[16:]])
    assert found(moving(frames), noise) == Events(holds=((15, 15 + length),))


@pytest.mark.parametrize("noise", NOISES)
def test_held_ends_are_found(noise: str) -> None:
    frames = np.concatenate([np.zeros(5), FRAMES, np.full(6, COUNT - 1)])
    assert found(moving(frames), noise).holds == ((0, 5), (COUNT + 4, COUNT + 10))


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("rate", [2.0, 3.0, 30 / 24, 60 / 24, 30 / 25, 24 / 15])
def test_repeats_of_a_rate_are_found(noise: str, rate: float) -> None:
    poses = np.floor(np.arange(int(COUNT * rate)) / rate + 1e-9)
    events = found(moving(poses), noise)
    starts = np.flatnonzero(np.diff(poses, prepend=-1))
    assert len(set(events.poses) ^ set(starts.tolist())) <= 2
    assert events.frames_per_pose == pytest.approx(rate, abs=0.05)
    assert not events.cuts
    assert not events.keys


def test_repeats_of_any_durations_are_found() -> None:
    poses = np.repeat(FRAMES, np.random.default_rng(2).choice([4, 5, 6, 7], COUNT))
    events = found(moving(poses))
    assert events == Events(poses=tuple(np.flatnonzero(np.diff(poses, prepend=-1)).tolist()))


@pytest.mark.parametrize("noise", ["none", "float32", "1e-5"])
@pytest.mark.parametrize("lengths", [(4,), (3, 4, 5, 6)], ids=str)
def test_linearly_baked_keys_are_found(noise: str, lengths: tuple[int, ...]) -> None:
    keys = np.append(0, np.cumsum(np.random.default_rng(3).choice(lengths, 11)))
    points = moving(3.0 * keys)
    frames = np.arange(keys[-1] + 1)
    k = np.clip(np.searchsorted(keys, frames, side="right") - 1, 0, len(keys) - 2)
    b = ((frames - keys[k]) / (keys[k + 1] - keys[k]))[:, None, None]
    assert found(np.asarray((1 - b) * points[k] + b * points[k + 1]), noise) == Events(keys=tuple(keys.tolist()))


def test_uneven_times_are_no_events() -> None:
    uneven = np.cumsum(np.random.default_rng(5).integers(1, 4, COUNT)).astype(float)
    assert found(moving(uneven), times=uneven / 24) == Events()
    gap = np.where(FRAMES < 18, FRAMES, FRAMES + 90)
    assert found(moving(FRAMES), times=gap / 24) == Events()


def test_a_still_object_that_is_moved_once_is_cut() -> None:
    points = np.repeat(moving(np.zeros(1)), 12, axis=0)
    points[5:] += 5 * DIAGONAL
    assert found(points).cuts == (4,)


def test_components_are_cut_and_pop_by_themselves() -> None:
    count = len(MESH[0])
    apart = [4.0, 0, 0]
    faces = joined(MESH, (MESH[0] + apart, MESH[1]))[1]
    first, second = moving(FRAMES), moving(FRAMES + 50) + apart
    topology = Topology(faces, 2 * count)
    times = FRAMES / 24

    def events(one: Float, other: Float) -> dict[int, Events]:
        sequence = find_events(np.concatenate([one, other], axis=1), times, topology)
        assert sequence.whole == Events()
        return dict(sequence.components)

    assert not events(first, second)
    moved = second + 6 * DIAGONAL * (FRAMES >= 21)[:, None, None]
    assert events(first, moved) == {1: Events(cuts=(20,))}
    centres = second.mean(axis=1, keepdims=True)
    hidden = np.where((FRAMES < 9)[:, None, None], centres, second)
    assert events(first, hidden) == {1: Events(pops=(8,))}
    stopped = second.copy()
    stopped[10:16] = second[10]
    assert events(first, stopped)[1].holds == ((10, 15),)


def test_components_with_equal_cuts_and_pops_are_groups() -> None:
    """Groups are ordered by size, the smallest are united, and a group without components is left out."""
    labels = np.repeat(np.arange(12), np.arange(1, 13))  # component k has k + 1 vertices
    whole = Events(cuts=(4,))
    own = [(k, Events(cuts=(4,), pops=(k,))) for k in range(8, 12)] + [(7, Events(cuts=(4,), pops=(11,)))]
    held = (6, Events(cuts=(4,), holds=((1, 3),)))
    events, groups = SequenceEvents(whole, (*own, held)).group_components(labels)
    assert [each.pops for each in events] == [(), (11,), (10,), (9,), (8,)]
    assert groups.tolist() == np.repeat([0] * 7 + [1, 4, 3, 2, 1], np.arange(1, 13)).tolist()
    many = SequenceEvents(whole, tuple((k, Events(pops=(20 - k,))) for k in range(12)))
    events, groups = many.group_components(labels)
    assert [each.pops for each in events] == [(9,), (10,), (11,), (12,), (13,), (14,), tuple(range(15, 21))]
    assert groups.max() == len(events) - 1 == MAX_GROUPS - 2


def test_poses_are_kept_at_their_own_times() -> None:
    poses = np.repeat(FRAMES[:15], 2)
    sequence = MeshSequence.from_arrays(moving(poses), MESH[1], fps=24)
    store, (events,) = distinct_poses(FrameStore(sequence.header, sequence.points), [found(moving(poses))])
    np.testing.assert_allclose(store.header.times[:-1] * 24, np.arange(0, 30, 2), atol=1e-12)
    assert store.header.times[-1] == sequence.times[-1]
    np.testing.assert_array_equal(store.points[:-1], sequence.points[::2])
    assert events == Events(holds=((14, 15),))


@pytest.mark.realdata
def test_real_motions_have_no_false_events(data: Path) -> None:
    """Nothing but the keys of those that are baked, and what is held in a dance; as they are and thinned."""
    baked = {"q_horse_gallop": 15, "q_wolf_gallop": 14, "q_alpaca_gallop": 17}
    for path in sorted((data / "npz").glob("*.npz")):
        with np.load(path) as file:
            points, topology = file["points"], Topology(file["faces"], file["points"].shape[1])
        for thinned in (1, 2, 3, 5):
            frames = points[::thinned]
            sequence = find_events(frames, np.arange(len(frames)) / 24, topology)
            name = f"{path.stem}, every {thinned}"
            assert len(sequence.whole.keys) == (baked.get(path.stem, 0) if thinned == 1 else 0), name
            for events in (sequence.whole, *(each for _, each in sequence.components)):
                assert not (events.cuts or events.pops or events.poses), name
            if path.stem != "robotexpressive_dance":
                assert not sequence.whole.holds, name
