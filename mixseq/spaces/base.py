"""The contract of all shape spaces."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from mixseq.pickling import Remade
from mixseq.progress import Progress, silent
from mixseq.sequence import FloatArray

Float = NDArray[np.float64]

DIFFERENCE = 1e-4
"""Step of difference quotients, relative to the size of a vector's metric."""


class ShapeSpace(Remade, ABC):
    """A space of vectors, each of which is a shape of one mesh, that may be added and scaled.

    For every space and all frames x of the sequence it was made for ``decode(encode(x)) = x``, and an affine
    combination of vectors (weights that add up to one) is a vector of the space.

    A vector may end with a *placement*: numbers that say where the shape, or each of its parts, is. They have no
    part in distances between shapes, and are combined as accurately as they are known. Some of them may follow
    from the others (`complete_placement`): stated twice, they make blends of vectors better.
    """

    name: str
    """Name of the space, as `mixseq.fit` knows it."""

    scale: float
    """Length of the unit of the space, in the units of the sequence."""

    @property
    @abstractmethod
    def dim(self) -> int:
        """Length D of a vector."""

    def prepare(self) -> None:
        """Compute what all frames share, so that threads that decode do not all do it."""

    @property
    @abstractmethod
    def weights(self) -> Float:
        """Weights ``(D,)`` of the coordinates: a change by one moves vertices by so many diagonals."""

    @property
    def shape_weights(self) -> Float:
        """Weights ``(S + O,)`` of a vector without its placement, and of its offsets, which are in diagonals."""
        return np.append(self.weights[: self.dim - self.placement_dim], np.ones(self.offset_dim))

    @property
    def placement_dim(self) -> int:
        """How many numbers at the end of a vector are its placement."""
        return 0

    @property
    def stored_placement_dim(self) -> int:
        """How many of them, the first ones, are independent."""
        return self.placement_dim

    @property
    def placement_rotations(self) -> int:
        """How many of those, the first ones, belong to rotation vectors; the others to translations."""
        return self.stored_placement_dim // 2

    def complete_placement(self, own: Float) -> Float:
        """Return whole placements ``(N, placement_dim)`` of consecutive frames from their independent numbers."""
        return own

    @property
    def offset_dim(self) -> int:
        """How many numbers beside a vector help to decode blends of frames; see `offsets`."""
        return 0

    def offsets(self, points: FloatArray, vectors: Float) -> Float:
        """Return what frames ``(T, V, 3)`` with vectors ``(T, D)`` tell beside them ``(T, offset_dim)``.

        Vectors alone are a shape. Where vectors of several frames are blended, offsets of these frames, blended
        likewise, tell which of the shapes that are nearly as good was meant.
        """
        return np.zeros((len(vectors), 0))

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

    def encode_apart(self, points: FloatArray) -> Float:
        """Turn frames ``(T, V, 3)`` into vectors ``(T, D)``, each by itself: `without_jumps` makes them a sequence."""
        return self.encode(points)

    def without_jumps(self, vectors: Float, previous: Float | None = None) -> Float:
        """Let vectors ``(T, D)`` of `encode_apart` go on from frame to frame, and from the one before, as in `encode`.

        ``encode(points, previous)`` is ``without_jumps(encode_apart(points), previous)``: frames can be encoded in
        any order, which is most of the work, and be put in order afterwards.
        """
        return vectors

    @abstractmethod
    def decode(self, vectors: Float, progress: Progress = silent, offsets: Float | None = None) -> Float:
        """Turn vectors ``(T, D)`` into vertex positions ``(T, V, 3)`` in the units of the sequence.

        Parameters
        ----------
        vectors : (T, D) float64
            Vectors.
        progress : callable, optional
            Told about every frame.
        offsets : (T, offset_dim) float64, optional
            What `offsets` returned, combined like the vectors.

        Raises
        ------
        ReconstructionError
            If no mesh could be found for a vector.
        """

    def shape_difference(self, vector: Float, before: Float, after: Float) -> Float:
        """Return what a change of a frame is in the shape coordinates, its placement left as it is.

        Parameters
        ----------
        vector : (D,) float64
            Vector of the frame.
        before, after : (V, 3) float64
            The decoded frame and what became of it, in the units of the sequence.

        Returns
        -------
        (S,) float64
            Added to the shape of the vector, without the `placement_dim` numbers at its end, it decodes to `after`,
            but for the placement. Zeros if nothing was changed.
        """
        # Rotation vectors with more turns, or fewer, differ by something else: those of the vector count.
        encoded = self.encode(np.stack([before, after]), vector)[:, : self.dim - self.placement_dim]
        return np.asarray(encoded[1] - encoded[0])

    def decode_for_differences(self, vectors: Float, offsets: Float | None = None) -> Float:
        """Do what `decode` does, so accurately that the points of nearly the same vectors can be subtracted."""
        return self.decode(vectors, offsets=offsets)

    def decode_moving(
        self,
        vectors: Float,
        rates: Float,
        offsets: Float | None = None,
        offset_rates: Float | None = None,
    ) -> tuple[Float, Float]:
        """Turn vectors that change into points that move.

        Parameters
        ----------
        vectors, rates : (T, D) float64
            Vectors, and their derivatives by time.
        offsets, offset_rates : (T, offset_dim) float64, optional
            Offsets as for `decode`, and their derivatives.

        Returns
        -------
        points, velocities : (T, V, 3) float64
            Positions, and the derivative of `decode` in the direction of the rates. Spaces that know no
            derivative return central differences along that direction.
        """
        size = np.abs(rates * self.weights).max(axis=1, initial=0.0)
        step = np.divide(DIFFERENCE, size, out=np.zeros_like(size), where=size > 0)
        change = step[:, None] * rates
        if offsets is None or offset_rates is None:
            here = self.decode(vectors)
            ahead, behind = (self.decode_for_differences(v) for v in (vectors + change, vectors - change))
        else:
            shift = step[:, None] * offset_rates
            here = self.decode(vectors, offsets=offsets)
            ahead = self.decode_for_differences(vectors + change, offsets + shift)
            behind = self.decode_for_differences(vectors - change, offsets - shift)
        inverse = np.divide(0.5, step, out=np.zeros_like(step), where=step > 0)
        return here, (ahead - behind) * inverse[:, None, None]
