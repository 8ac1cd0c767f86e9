r"""Refine parts to take fewer bytes: vertices join the part whose components code their motion in the fewest bits.

Near-rigid parts are the start. The motion y of a vertex, in the coordinates of the principal components, is taken to be
normal about the mean of the part. Rounded to steps :math:`\Delta` it takes about

.. math:: L_p(y) = \tfrac12 \log \det \Bigl(1 + \frac{C_p}{\Delta^2}\Bigr)
                   + \tfrac12 (y - m_p)^T (C_p + \Delta^2)^{-1} (y - m_p)

nats, with the mean :math:`m_p` and the covariance :math:`C_p` of the part. Vertices join the part of least length,
averaged with their neighbours, as borders cost bits, too. Then means and covariances are updated, and so on (Lloyd's
iteration).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from mixseq.arrays import Float, Index
from mixseq.coding.encoder.principal_components import PrincipalComponents
from mixseq.mapping import on_two_threads

ROUNDS = 5
"""Largest number of rounds in which vertices change parts."""

SMALLEST = 8
"""Smallest number of vertices of a part."""

MODES = 64
"""Largest number of components of the whole mesh that are used."""

VISIBLE = 0.1
"""Mean displacement of vertices by a component, in steps, below which it is ignored."""


def refined(components: PrincipalComponents, labels: Index, faces: NDArray[np.integer], step: float) -> Index:
    """Return better labels ``(V,)`` for the same number of parts of a mesh: faces ``(F, 3)``."""
    number, vertices = int(labels.max()) + 1, len(labels)
    seen = np.count_nonzero(components.norms > VISIBLE * step * np.sqrt(vertices))
    motion = components.vectors[: min(max(seen, 1), MODES), 0]
    mean_of_neighbours = _mean_of_neighbours(faces, vertices)
    squares = np.einsum("rv,rv->v", motion, motion)
    for _ in range(ROUNDS):
        found = on_two_threads()(_lengths, _Motion(motion, squares, labels, step), range(number))
        lengths = np.stack(list(found), axis=1)
        lengths = (lengths + mean_of_neighbours @ lengths) / 2
        changed = lengths.argmin(axis=1)
        sizes = np.bincount(changed, minlength=number)
        if sizes.min() < SMALLEST or np.array_equal(changed, labels):
            break
        labels = changed
    return labels


class _Motion(NamedTuple):
    """Motion ``(R, V)`` of the vertices, its squares ``(V,)``, the parts they are in ``(V,)``, and the step."""

    of_vertices: Float
    squares: Float
    labels: Index
    step: float


def _lengths(motion: _Motion, part: int) -> Float:
    """Return the approximate code length in nats of every vertex's motion in a part."""
    everywhere, unit = motion.of_vertices, motion.step**2
    own = everywhere[:, motion.labels == part]
    mean = own.mean(axis=1)
    covariance = own @ own.T / own.shape[1] - np.outer(mean, mean)
    values, directions = linalg.eigh(covariance, subset_by_value=(unit, np.inf), check_finite=False)
    # All other directions are taken to have rounding errors only.
    scores = directions.T @ everywhere - (directions.T @ mean)[:, None]
    squares = motion.squares - 2 * (mean @ everywhere) + mean @ mean
    explained = (1 - unit / (values + unit)) @ np.square(scores, out=scores)
    return np.asarray(((squares - explained) / unit + np.log1p(values / unit).sum()) / 2)


def _mean_of_neighbours(faces: NDArray[np.integer], vertices: int) -> sparse.csr_array:
    corners = np.roll(faces, 1, axis=1)
    rows, columns = np.append(faces, corners), np.append(corners, faces)
    beside = sparse.coo_array((np.ones(len(rows)), (rows, columns)), (vertices, vertices)).tocsr()
    sizes = np.maximum(beside.sum(axis=1), 1.0)
    return sparse.csr_array(sparse.diags_array(1 / sizes) @ beside)
