"""Fields over the mesh and tracks over time whose products are the sequence, as few of them as there can be."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mixseq.arrays import Float
from mixseq.coding import factors as module
from mixseq.coding.coded import FactorName
from mixseq.coding.factors import Factors, factor
from mixseq.coding.search import FACTORS
from mixseq.frame_store import FrameStore, frame_store
from mixseq.sequence import MeshSequence
from tests.coding.one_part import basis_of
from tests.meshes import bar, rotation, tetrahedron, torus

NAMES: tuple[FactorName, ...] = FACTORS


def noise(frames: int, mesh: tuple[Float, NDArray[np.int64]] | None = None) -> FrameStore:
    points, faces = mesh or tetrahedron()
    rng = np.random.default_rng(frames)
    return frame_store(MeshSequence.from_arrays(points + rng.normal(size=(frames, *points.shape)), faces))


def left_over(sequence: FrameStore, factors: Factors) -> float:
    """Root of the sum of squares of what the factors leave of a sequence."""
    basis = basis_of(factors.name, factors.fields[:], len(sequence.points))
    return float(np.linalg.norm(basis.frames(basis.fit(sequence)) - np.asarray(sequence.points)))


CASES = {
    "more vertices than frames": lambda: frame_store(bar(frames=4)),
    "more frames than vertices": lambda: noise(9),
    "more coordinates than frames, more frames than vertices": lambda: noise(6),
    "as many frames as coordinates": lambda: noise(12),
    "many more frames": lambda: noise(40),
    "float32": lambda: frame_store(bar().with_points(bar().points.astype(np.float32))),
    "one frame": lambda: noise(1),
}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("case", CASES)
def test_products_are_the_sequence(case: str, name: FactorName) -> None:
    sequence = CASES[case]()
    factors = factor(sequence, name, 0.0)
    size = float(np.linalg.norm(np.asarray(sequence.points)))
    assert left_over(sequence, factors) < 1e-7 * size
    assert factors.fields.shape == (
        len(factors.sizes),
        1 if name == "trajectories" else 3,
        sequence.points.shape[1],
    )
    np.testing.assert_allclose(
        np.linalg.norm(factors.fields[:], axis=(1, 2)), factors.sizes, atol=1e-6 * size
    )


@pytest.mark.parametrize("name", NAMES)
def test_fields_are_principal_components(name: FactorName) -> None:
    """Their sizes are the singular values of the centred matrix: fields that are left out miss just their own."""
    sequence = frame_store(bar(frames=6))
    points = np.asarray(sequence.points)
    if name == "trajectories":
        centred = (
            (points - points.mean(axis=1, keepdims=True)).transpose(0, 2, 1).reshape(-1, points.shape[1])
        )
        first = 0
    else:
        centred = (points - points.mean(axis=0)).reshape(len(points), -1)
        first = 1
    values = np.linalg.svd(centred, compute_uv=False)
    whole = factor(sequence, name, 0.0)
    count = len(whole.sizes) - first
    np.testing.assert_allclose(whole.sizes[first:], values[:count], atol=1e-6)
    for rank in range(1, 5):
        least = float(np.sqrt(values[rank - 1] * values[rank]))
        some = factor(sequence, name, least)
        assert len(some.sizes) == rank + first
        assert left_over(sequence, some) == pytest.approx(np.linalg.norm(values[rank:]), rel=1e-6)
    flat = whole.fields[:].reshape(len(whole.fields), -1)[first:]
    np.testing.assert_allclose(flat @ flat.T, np.diag(whole.sizes[first:] ** 2), atol=1e-9)


def test_a_rigid_motion_has_three_trajectories() -> None:
    """Beside the constant one: affine functions of the place."""
    points, faces = torus(10, 7)
    frames = np.stack(
        [points @ rotation((t, 0.3 * t * t, -t)).T + [t, t * t, 0] for t in np.linspace(0, 3, 12)]
    )
    factors = factor(frame_store(MeshSequence.from_arrays(frames, faces)), "trajectories", 1e-6)
    assert len(factors.sizes) == 3
    corners = np.concatenate([points, np.ones((len(points), 1))], axis=1)
    for field in factors.fields[:][:, 0]:
        affine = corners @ np.linalg.lstsq(corners, field, rcond=None)[0]
        np.testing.assert_allclose(affine, field, atol=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_nothing_that_moves_leaves_a_field_of_zeros(name: FactorName) -> None:
    points = np.full((3, 4, 3), 2.5)
    factors = factor(frame_store(MeshSequence.from_arrays(points, tetrahedron()[1])), name, 1e-9)
    assert len(factors.fields) == (1 if name == "trajectories" else 2)
    assert not factors.fields[:][-1].any()


@pytest.mark.parametrize("name", NAMES)
def test_frames_are_left_out_of_long_sequences(name: FactorName, monkeypatch: pytest.MonkeyPatch) -> None:
    """What moves slowly is known from every other frame; sizes are as if all frames had been looked at."""
    sequence = frame_store(bar(sides=8, rings=12, frames=40))
    whole = factor(sequence, name, 0.0)
    monkeypatch.setattr(module, "MOST", 60 if name == "trajectories" else 20)
    some = factor(sequence, name, 0.0)
    assert len(some.sizes) < len(whole.sizes)
    np.testing.assert_allclose(some.sizes[:5], whole.sizes[:5], rtol=0.15)
    assert left_over(sequence, some) < 2e-3 * np.linalg.norm(np.asarray(sequence.points))
