"""Components whose sums are the sequence, as few of them as there can be."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mixseq.compression.bitstream.spatial_basis import BasisKind
from mixseq.compression.encoder import components as module
from mixseq.compression.encoder.components import PrincipalComponents
from mixseq.compression.encoder.search import BASIS_KINDS
from mixseq.sequence.sequence import FrameStore, MeshSequence, load_frames
from mixseq.types import Float
from tests.compression.one_part import principal_components
from tests.meshes import bar, rotation, tetrahedron, torus

KINDS: tuple[BasisKind, ...] = BASIS_KINDS


def noise(frames: int, mesh: tuple[Float, NDArray[np.int64]] | None = None) -> FrameStore:
    points, faces = mesh or tetrahedron()
    rng = np.random.default_rng(frames)
    return load_frames(MeshSequence.from_arrays(points + rng.normal(size=(frames, *points.shape)), faces))


def frames_of(components: PrincipalComponents) -> Float:
    """The frames ``(T, V, 3)`` that components add up to."""
    mean = components.mean[:, None] if components.kind == "trajectories" else components.mean.T
    return np.asarray(
        mean
        + np.einsum("ktd,kcv->tvdc", components.curves, components.vectors).squeeze(
            -1 if components.kind == "trajectories" else -2
        )
    )


def left_over(sequence: FrameStore, components: PrincipalComponents) -> float:
    """Root of the sum of squares of what the components leave of a sequence."""
    return float(np.linalg.norm(frames_of(components) - np.asarray(sequence.points)))


CASES = {
    "more vertices than frames": lambda: load_frames(bar(frames=4)),
    "more frames than vertices": lambda: noise(9),
    "more coordinates than frames, more frames than vertices": lambda: noise(6),
    "as many frames as coordinates": lambda: noise(12),
    "many more frames": lambda: noise(40),
    "float32": lambda: load_frames(bar().with_points(bar().points.astype(np.float32))),
    "one frame": lambda: noise(1),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("case", CASES)
def test_products_are_the_sequence(case: str, kind: BasisKind) -> None:
    sequence = CASES[case]()
    components = principal_components(sequence, kind, 0.0)
    size = float(np.linalg.norm(np.asarray(sequence.points)))
    assert left_over(sequence, components) < 1e-7 * size
    assert components.vectors.shape == (
        len(components.norms),
        1 if kind == "trajectories" else 3,
        sequence.points.shape[1],
    )
    curves = components.curves.reshape(len(components.curves), -1)
    np.testing.assert_allclose(curves @ curves.T, np.eye(len(curves)), atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_vectors_are_principal_components(kind: BasisKind) -> None:
    """Their norms are the singular values of the centred matrix: components that are left out miss just their own."""
    sequence = load_frames(bar(frames=6))
    points = np.asarray(sequence.points)
    if kind == "trajectories":
        centred = (points - points.mean(axis=1, keepdims=True)).transpose(0, 2, 1).reshape(-1, points.shape[1])
    else:
        centred = (points - points.mean(axis=0)).reshape(len(points), -1)
    values = np.linalg.svd(centred, compute_uv=False)
    whole = principal_components(sequence, kind, 0.0)
    np.testing.assert_allclose(whole.norms, values[: len(whole.norms)], atol=1e-6)
    for rank in range(1, 5):
        least = float(np.sqrt(values[rank - 1] * values[rank]))
        some = principal_components(sequence, kind, least)
        assert len(some.norms) == rank
        assert left_over(sequence, some) == pytest.approx(np.linalg.norm(values[rank:]), rel=1e-6)
        assert np.sqrt(some.left_out) == pytest.approx(np.linalg.norm(values[rank:]), rel=1e-6)
    flat = whole.vectors.reshape(len(whole.vectors), -1)
    np.testing.assert_allclose(flat @ flat.T, np.diag(whole.norms**2), atol=1e-9)


def test_a_rigid_motion_has_three_trajectories() -> None:
    """Beside the constant one: affine functions of the place."""
    points, faces = torus(10, 7)
    frames = np.stack([points @ rotation((t, 0.3 * t * t, -t)).T + [t, t * t, 0] for t in np.linspace(0, 3, 12)])
    components = principal_components(load_frames(MeshSequence.from_arrays(frames, faces)), "trajectories", 1e-6)
    assert len(components.norms) == 3
    corners = np.concatenate([points, np.ones((len(points), 1))], axis=1)
    for vector in components.vectors[:, 0]:
        affine = corners @ np.linalg.lstsq(corners, vector, rcond=None)[0]
        np.testing.assert_allclose(affine, vector, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_that_moves_leaves_a_vector_of_zeros(kind: BasisKind) -> None:
    points = np.full((3, 4, 3), 2.5)
    components = principal_components(load_frames(MeshSequence.from_arrays(points, tetrahedron()[1])), kind, 1e-9)
    assert len(components.vectors) == 1
    assert not components.vectors.any()


@pytest.mark.parametrize("kind", KINDS)
def test_frames_are_left_out_of_long_sequences(kind: BasisKind, monkeypatch: pytest.MonkeyPatch) -> None:
    """What moves slowly is known from every other frame; sizes are as if all frames had been looked at."""
    sequence = load_frames(bar(sides=8, rings=12, frames=40))
    whole = principal_components(sequence, kind, 0.0)
    monkeypatch.setattr(module, "MAX_TABLE_SIDE", 15)
    some = principal_components(sequence, kind, 0.0)
    assert kind == "shapes" or len(some.norms) < len(whole.norms)
    np.testing.assert_allclose(some.norms[:5], whole.norms[:5], rtol=0.15)
    assert left_over(sequence, some) < 2e-3 * np.linalg.norm(np.asarray(sequence.points))
    assert np.sqrt(some.left_out) == pytest.approx(left_over(sequence, some), rel=1e-3, abs=2e-6)
