"""What is found in few coordinates is what frames would have said."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.compression.bitstream.signal_graph import mesh_graph
from mixseq.compression.bitstream.spatial_basis import BasisKind, Part
from mixseq.compression.encoder.components import (
    MAX_VANISHING_VECTORS,
    MIN_VECTOR_STEPS,
    PrincipalComponents,
    shape_components,
    trajectory_components,
)
from mixseq.compression.encoder.search import BASIS_KINDS, expected_error, step_for_error
from mixseq.compression.encoder.trial import Candidate, decode_blocks, squared_error, try_step
from mixseq.sequence.sequence import FrameStore, load_frames
from mixseq.types import Float, Index
from tests.meshes import bar

KINDS: tuple[BasisKind, ...] = BASIS_KINDS
SEQUENCE = load_frames(bar(sides=6, rings=20, frames=9))
GRAPH = mesh_graph(SEQUENCE.header.faces, SEQUENCE.header.vertex_count)
LABELS: Index = (np.arange(SEQUENCE.header.vertex_count) >= 50).astype(np.int64)


def candidate_of(kind: BasisKind, labels: Index | None = None, least: float = 0.0) -> Candidate:
    components = trajectory_components(SEQUENCE, least)
    components = components if kind == "trajectories" else shape_components(components, least)
    labels = np.zeros_like(LABELS) if labels is None else labels
    return Candidate.from_labels(components, labels, SEQUENCE.header.faces, GRAPH, least)


def of_part(sequence: FrameStore, part: Part) -> tuple[Float, PrincipalComponents]:
    """Singular values of a part's centred trajectories, and its components from its frames alone."""
    points = np.asarray(sequence.points)[:, part.vertices]
    rows = (points - points.mean(axis=1, keepdims=True)).transpose(0, 2, 1).reshape(-1, len(part.vertices))
    return np.linalg.svd(rows, compute_uv=False), trajectory_components(FrameStore(sequence.header, points), 1e-3)


def test_components_of_a_part_are_those_of_its_frames() -> None:
    for part in candidate_of("trajectories", LABELS).parts:
        values, alone = of_part(SEQUENCE, part.part)
        np.testing.assert_allclose(part.norms[:4], values[:4], rtol=1e-6)
        for place in range(len(alone.vectors)):
            found, expected = part.vector(place)[0], alone.vectors[place, 0]
            np.testing.assert_allclose(found * np.sign(found @ expected), expected, atol=1e-6)


def test_the_rank_ends_before_vectors_that_do_not_pay() -> None:
    [part] = candidate_of("trajectories").parts
    largest = [np.abs(part.vector(place)).max() for place in range(len(part.norms))]
    for rank in (1, 2, 4):
        step = 0.99 * largest[rank - 1] / MIN_VECTOR_STEPS
        found = part.rank(step)
        assert found >= rank
        assert max(largest[found : found + MAX_VANISHING_VECTORS], default=0.0) < MIN_VECTOR_STEPS * step
    assert part.rank(1e9) == 1


@pytest.mark.parametrize("labels", [None, LABELS])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("step", [0.3, 0.03, 1e-4])
def test_errors_are_those_of_the_frames(kind: BasisKind, labels: Index | None, step: float) -> None:
    if kind == "shapes" and labels is not None:
        return
    trial = try_step(SEQUENCE, candidate_of(kind, labels), step)
    measured = squared_error(SEQUENCE, trial.basis, trial.coefficients)
    assert trial.error == pytest.approx(np.sqrt(measured), rel=1e-4)


def test_what_is_left_out_is_part_of_the_error() -> None:
    trial = try_step(SEQUENCE, candidate_of("trajectories", least=0.5), 1e-3)
    assert trial.error == pytest.approx(np.sqrt(squared_error(SEQUENCE, trial.basis, trial.coefficients)), rel=1e-3)
    assert trial.error >= np.sqrt(trial.candidate.components.left_out) > 1e-3


def test_tiny_errors_are_measured() -> None:
    """Beside the squares of the motion they have no digits left."""
    trial = try_step(SEQUENCE, candidate_of("trajectories"), 1e-9)
    points = np.concatenate(list(decode_blocks(trial.basis, trial.coefficients)))
    assert trial.error == pytest.approx(float(np.linalg.norm(points - SEQUENCE.points)), rel=1e-6)
    assert trial.error < 1e-6


@pytest.mark.parametrize("kind", KINDS)
def test_first_steps_are_near(kind: BasisKind) -> None:
    candidate = candidate_of(kind)
    for error in (1.0, 0.1):
        step = step_for_error(candidate, error)
        assert expected_error(candidate, step) == pytest.approx(error, rel=1e-3)
        assert 0.4 * error < try_step(SEQUENCE, candidate, step).error < 2 * error
