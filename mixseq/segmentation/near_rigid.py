r"""How far the parts of a segmentation are from moving rigidly, as a Karni-Gotsman error.

With B the vertices of A moved by the best rigid motion of their part in every frame (Kabsch), from the first frame on,

.. math:: \mathrm{KG} = 100\, \frac{\|A - B\|_F}{\|A - \bar A\|_F},

where :math:`\bar A` holds centroids of every frame: of the part for the error of a part, of all vertices for that of
the whole. Vertices on a boundary count once in each of their parts.

Karni and Gotsman, "Compression of soft-body animation sequences", Computers & Graphics 2004.
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, FloatArray, IntArray
from mixseq.segmentation.rigid_error import moments


def near_rigid_errors(points: FloatArray, faces: IntArray, part_of_face: IntArray) -> tuple[Float, float]:
    """Measure how near-rigid parts are.

    Parameters
    ----------
    points : (T, V, 3) float
        The sequence, or some frames of it.
    faces : (F, 3) int
        Triangles.
    part_of_face : (F,) int
        Part of every triangle, numbered 0, 1, ...

    Returns
    -------
    of_parts : (p,) float64
        Error of every part, in percent of its own deviation; 0 where nothing moves off its centroid.
    whole : float
        Error of all parts together, in percent of the deviation of the whole mesh.
    """
    count = int(part_of_face.max(initial=-1)) + 1
    centroids = points.mean(axis=1, dtype=np.float64)[None]  # (1, T, 3)
    errors, own, whole = np.zeros(count), np.zeros(count), 0.0
    for part in range(count):
        vertices = np.unique(faces[part_of_face == part])
        x = np.moveaxis(np.asarray(points[:, vertices], dtype=np.float64), 1, 0) - centroids
        errors[part] = moments(x[:, 0], x, np.ones(len(vertices))).error()
        own[part] = np.square(x - x.mean(axis=0)).sum()
        whole += float(np.square(x).sum())
    ratios = np.sqrt(np.divide(errors, own, out=np.zeros(count), where=own > 0))
    return 100 * ratios, 100 * float(np.sqrt(errors.sum() / whole)) if whole > 0 else 0.0
