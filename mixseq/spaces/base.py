"""The contract of all shape spaces."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from mixseq.progress import Progress, silent
from mixseq.sequence import FloatArray

Float = NDArray[np.float64]


class ShapeSpace(ABC):
    """A space of vectors, each of which is a shape of one mesh, that may be added and scaled.

    For every space and all frames x of the sequence it was made for ``decode(encode(x)) = x``, and an affine
    combination of vectors (weights that add up to one) is a vector of the space.
    """

    @property
    @abstractmethod
    def dim(self) -> int:
        """Length D of a vector."""

    @abstractmethod
    def encode(self, points: FloatArray, previous: Float | None = None) -> Float:
        """Turn frames into vectors.

        Parameters
        ----------
        points : (T, V, 3) float
            Vertex positions in the units of the sequence, consecutive frames.
        previous : (D,) float64, optional
            Vector of the frame before the first one, where a sequence is encoded block by block: angles go on
            from there without jumps. By default the first frame stays near the reference of the space.

        Returns
        -------
        (T, D) float64
        """

    @abstractmethod
    def decode(self, vectors: Float, progress: Progress = silent) -> Float:
        """Turn vectors ``(T, D)`` into vertex positions ``(T, V, 3)`` in the units of the sequence.

        Raises
        ------
        ReconstructionError
            If no mesh could be found for a vector.
        """
