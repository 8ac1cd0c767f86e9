r"""A model: a shape space and a curve in it, which can be asked for any time.

The curve passes through one vector :math:`P_j` of the space for every frame of the sequence,

.. math:: s(t) = \sum_j \varphi_j(t)\, P_j, \qquad \sum_j \varphi_j(t) = 1

with the cardinal cubic splines :math:`\varphi_j` of the frames' times (1 at the time of frame j, 0 at all others,
not-a-knot ends), so at the frames the model is the sequence, exactly.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline, make_interp_spline

from mixseq.errors import SettingsError
from mixseq.progress import Progress, silent
from mixseq.segmentation.joints import Decomposition
from mixseq.sequence import MeshSequence, SequenceHeader
from mixseq.spaces.mixed import MixedSpace
from mixseq.threads import one_blas_thread

Float = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Model:
    """A mesh sequence in a shape space, continuous in time. Make it with `mixseq.fit` or `mixseq.load`.

    Attributes
    ----------
    header : SequenceHeader
        Polygons, frame times, units and name of the sequence.
    space : MixedSpace
        The shape space.
    vectors : (T, D) float64
        Key shapes: the vector of every frame.
    """

    header: SequenceHeader
    space: MixedSpace
    vectors: Float

    @property
    def times(self) -> Float:
        """Times ``(T,)`` of the key shapes in seconds."""
        times: Float = self.header.times
        return times

    @property
    def decomposition(self) -> Decomposition:
        """Parts and joints of the mesh."""
        return self.space.decomposition

    def __repr__(self) -> str:
        parts, joints = len(self.decomposition.parts), len(self.decomposition.joints)
        return (
            f"Model({self.header.name!r}: {self.header.frame_count} key shapes, {parts} parts, {joints} joints, "
            f"{self.space.placement} placement, dim {self.space.dim})"
        )

    def __call__(self, time: float) -> Float:
        """Return the vertex positions ``(V, 3)`` at a time in seconds.

        Raises
        ------
        SettingsError
            If the time is outside the sequence: models do not extrapolate.
        """
        frame: Float = self.space.decode(self.curve([time]))[0]
        return frame

    def curve(self, times: ArrayLike) -> Float:
        """Return the vectors ``(N, D)`` of the space at times ``(N,)`` in seconds; see `__call__`."""
        with one_blas_thread():
            vectors: Float = self._weights(self._inside(times)) @ self.vectors
        return vectors

    def sample(
        self, times: ArrayLike | None = None, fps: float | None = None, progress: Progress = silent
    ) -> MeshSequence:
        """Decode frames.

        Parameters
        ----------
        times : (N,) array_like, optional
            Times in seconds, increasing; by default those of the sequence.
        fps : float, optional
            Frames per second: without `times` the whole sequence is sampled at this rate, from its first time
            on. With `times` it only says which time line they are on.
        progress : callable, optional
            Told about every frame.

        Returns
        -------
        MeshSequence
            float64 points in the units of the original.

        Raises
        ------
        SettingsError
            If a time is outside the sequence, or fps is not positive.
        """
        header = self.header_at(times, fps)
        points = self.space.decode(self.curve(header.times), progress)
        return MeshSequence.from_header(header, points)

    def header_at(self, times: ArrayLike | None = None, fps: float | None = None) -> SequenceHeader:
        """Return the header of what `sample` returns, without decoding anything."""
        if fps is not None and not (np.isfinite(fps) and fps > 0):
            raise SettingsError(f"fps is {fps}; a positive number is expected")
        if times is None and fps is not None:
            first, last = self.times[0], self.times[-1]
            times = np.minimum(first + np.arange(int(np.floor((last - first) * fps + 1e-6)) + 1) / fps, last)
        return self.header.with_times(self.times if times is None else self._inside(times), fps)

    def blocks(self, times: ArrayLike, size: int = 16, progress: Progress = silent) -> Iterator[Float]:
        """Decode frames block by block: yields points ``(B, V, 3)`` with ``B <= size``, for `times` in order."""
        inside = self._inside(times)
        for start in range(0, len(inside), size):
            yield self.space.decode(self.curve(inside[start : start + size]))
            progress(min(start + size, len(inside)), len(inside), "decoding frames")

    @cached_property
    def _cardinal(self) -> BSpline:
        count = len(self.times)
        return make_interp_spline(self.times, np.eye(count), k=min(3, count - 1))

    def _weights(self, times: Float) -> Float:
        """The weights ``(N, T)`` of the key shapes; at a key's time exactly that key."""
        weights = np.asarray(self._cardinal(times), dtype=np.float64)
        nearest = np.clip(np.searchsorted(self.times, times), 0, len(self.times) - 1)
        at_key = self.times[nearest] == times
        weights[at_key] = 0.0
        weights[at_key, nearest[at_key]] = 1.0
        return weights

    def _inside(self, times: ArrayLike) -> Float:
        wanted = np.atleast_1d(np.asarray(times, dtype=np.float64))
        first, last = self.times[0], self.times[-1]
        slack = 1e-3 / self.header.fps  # times are typed and printed with a few digits
        outside = ~((wanted >= first - slack) & (wanted <= last + slack))
        if outside.any():
            raise SettingsError(
                f"time {wanted[outside][0]:g} s is outside the sequence, {first:g} to {last:g} s; "
                "models do not extrapolate"
            )
        return np.clip(wanted, first, last)
