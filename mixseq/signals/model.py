r"""A model: a shape space and three signals in it, which can be asked for any time.

.. math:: s(t) = \sum_j \varphi_j(c(t))\, P_j, \qquad \sum_j \varphi_j = 1

- **time**: the curve :math:`c(t)` in pose space (`mixseq.signals.curve`),
- **pose**: the affine map :math:`\varphi` from pose space to weights of key shapes (`mixseq.signals.pose`),
- **shape**: the key shapes :math:`P_j`, points of the shape space.

Where the parts of the shape are in the world is no matter of shape: the **placement** is a curve of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.arrays import Float
from mixseq.errors import SettingsError
from mixseq.mapping import Executor, on_threads, serially
from mixseq.pickling import PickledWithoutCaches
from mixseq.polygons import frozen
from mixseq.progress import Progress, silent
from mixseq.renamed import renamed_attributes
from mixseq.segmentation.joints import Decomposition
from mixseq.sequence import MeshSequence
from mixseq.sequence_header import SequenceHeader, frame_times
from mixseq.signals.curve import Curve
from mixseq.signals.layout import Plane, plane
from mixseq.signals.pose import PoseMap
from mixseq.spaces import MixedSpace, ShapeSpace
from mixseq.threads import one_blas_thread

Decoded = TypeVar("Decoded")

FRAMES = 4
"""Frames decoded at once; each thread has as many in hand."""


class ResidualLayer(Protocol):
    """Displacements of vertices over time that are added to decoded frames, in the units of the sequence."""

    def at(self, times: Float) -> Float:
        """Return displacements ``(N, V, 3)`` at times ``(N,)`` in seconds."""

    def rates(self, times: Float) -> Float:
        """Return their derivatives ``(N, V, 3)`` by time, per second."""


@renamed_attributes(corrections="residual_layer")
@dataclass(frozen=True, eq=False)
class Model(PickledWithoutCaches):
    """A mesh sequence as signals in a shape space, continuous in time. Make it with `mixseq.fit` or `mixseq.load`.

    Attributes
    ----------
    header : SequenceHeader
        Polygons, units and name of the mesh; the times of its frames, which `sample` returns by default.
    space : ShapeSpace
        The shape space.
    time : Curve
        The time signal, a curve in pose space ``R^k``.
    pose : PoseMap
        The pose signal, from pose space to the weights of K key shapes.
    shapes : (K, S) float64
        The shape signal: key shapes without their placement, ``S = space.shape_dim``.
    placement : Curve
        Where the parts are: a curve of `ShapeSpace.placement_dim` coordinates.
    residual_layer : ResidualLayer, optional
        Displacements that the signals alone do not reproduce: with them a compressed sequence is within its bound.
        They belong to this motion: `dataclasses.replace` keeps them, `with_motion` does not.

    Raises
    ------
    SettingsError
        If the signals do not fit together.
    """

    header: SequenceHeader
    space: ShapeSpace
    time: Curve
    pose: PoseMap
    shapes: Float
    placement: Curve
    residual_layer: ResidualLayer | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "shapes", frozen(np.asarray(self.shapes, dtype=np.float64)))
        expected = (len(self.pose.offset), self.space.shape_dim)
        if self.shapes.shape != expected:
            raise SettingsError(f"the key shapes have shape {self.shapes.shape}; {expected} is expected")
        if self.time.dim != self.pose.dim:
            raise SettingsError(
                f"the time signal has {self.time.dim} coordinates, the pose signal {self.pose.dim}"
            )
        if self.placement.dim != self.space.placement_dim:
            raise SettingsError(
                f"the placement has {self.placement.dim} coordinates; {self.space.placement_dim} are expected"
            )
        for curve in (self.time, self.placement):
            if curve.start > self.times[0] or curve.end < self.times[-1]:
                raise SettingsError(
                    f"frames are from {self.times[0]:g} to {self.times[-1]:g} s, a signal only from "
                    f"{curve.start:g} to {curve.end:g} s"
                )

    def with_motion(
        self,
        time: Curve,
        placement: Curve,
        header: SequenceHeader | None = None,
        residual_layer: ResidualLayer | None = None,
    ) -> Model:
        """Return the model with another motion through its shapes.

        Parameters
        ----------
        time, placement : Curve
            Its signals.
        header : SequenceHeader, optional
            Tells the times of its frames, if they are others.
        residual_layer : ResidualLayer, optional
            What is added to its frames. That of this model is not: at other times, or added to another motion, it
            would do harm.
        """
        return replace(
            self, header=header or self.header, time=time, placement=placement, residual_layer=residual_layer
        )

    @property
    def times(self) -> Float:
        """Times ``(T,)`` of the frames in seconds."""
        times: Float = self.header.times
        return times

    @property
    def start(self) -> float:
        """First time of the model in seconds."""
        return max(self.time.start, self.placement.start)

    @property
    def end(self) -> float:
        """Last time of the model in seconds."""
        return min(self.time.end, self.placement.end)

    @property
    def decomposition(self) -> Decomposition:
        """Parts and joints of the mesh.

        Raises
        ------
        SettingsError
            If the shape space has none.
        """
        return self.mixed.decomposition

    @property
    def mixed(self) -> MixedSpace:
        """The space, if it is the mixed shape space.

        Raises
        ------
        SettingsError
            If it is another one, which has no parts.
        """
        return self.space.mixed()

    def __repr__(self) -> str:
        return (
            f"Model({self.header.name!r}: {self.start:g} to {self.end:g} s, {len(self.shapes)} key shapes, "
            f"{self.space.name} space of dim {self.space.dim}, "
            f"{len(self.time.times)} + {len(self.placement.times)} knots)"
        )

    def __call__(self, time: float) -> Float:
        """Return the vertex positions ``(V, 3)`` at a time in seconds.

        Raises
        ------
        SettingsError
            If the time is outside the sequence: models do not extrapolate.
        """
        frame: Float = next(self.blocks([time]))[0]
        return frame

    def curve(self, times: ArrayLike) -> Float:
        """Return the vectors ``(N, D)`` of the space at times ``(N,)`` in seconds; see `__call__`."""
        inside = self.inside(times)
        shapes = self._blended(self.pose.weights(self.time(inside)))
        return np.concatenate([shapes, self.placement(inside)], axis=1)

    def rates(self, times: ArrayLike) -> Float:
        """Return the derivatives ``(N, D)`` of `curve` by time, per second."""
        inside = self.inside(times)
        shapes = self._blended(self.pose.rates(self.time.derivative(inside)))
        return np.concatenate([shapes, self.placement.derivative(inside)], axis=1)

    def _blended(self, weights: Float) -> Float:
        """Return sums of key shapes ``(N, S)``, one by one: a frame is the same whatever is asked with it."""
        blended = np.empty((len(weights), self.shapes.shape[1]))
        with one_blas_thread():
            for row, weight in zip(blended, weights, strict=True):
                row[:] = weight @ self.shapes
        return blended

    @property
    def vectors(self) -> Float:
        """The vectors ``(T, D)`` of the frames."""
        return self.curve(self.times)

    def velocity(self, time: float) -> Float:
        """Return the velocities ``(V, 3)`` of the vertices in units per second: the analytic derivative."""
        frame: Float = next(self.moving_blocks([time]))[1][0]
        return frame

    def sample(
        self,
        times: ArrayLike | None = None,
        fps: float | None = None,
        progress: Progress = silent,
        *,
        frames: Iterable[int] | None = None,
        velocities: bool = False,
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
        frames : iterable of int, optional
            Numbers of the sequence's own frames, increasing, instead of times: ``range(10, 20)``.
        velocities : bool
            Also find `MeshSequence.velocities`, for motion blur.

        Returns
        -------
        MeshSequence
            float64 points in the units of the original.

        Raises
        ------
        SettingsError
            If a time is outside the sequence, there is no such frame, or fps is not positive.
        """
        header = self.header_at(times if frames is None else self._times_of(frames, times), fps)
        if velocities:
            moving = list(self.moving_blocks(header.times, progress=progress))
            points, speeds = (np.concatenate(arrays) for arrays in zip(*moving, strict=True))
            return MeshSequence.from_header(header, points, speeds)
        points = np.concatenate(list(self.blocks(header.times, progress=progress)))
        return MeshSequence.from_header(header, points)

    def _times_of(self, frames: Iterable[int], times: ArrayLike | None) -> Float:
        numbers = np.fromiter(frames, dtype=np.int64)
        if times is not None:
            raise SettingsError("give either times or frames")
        outside = (numbers < 0) | (numbers >= len(self.times))
        if outside.any() or not numbers.size:
            which = f"there is no frame {numbers[outside][0]}" if numbers.size else "no frame is asked for"
            raise SettingsError(f"{which}; the sequence has frames 0 to {len(self.times) - 1}")
        return np.asarray(self.times[numbers])

    def header_at(self, times: ArrayLike | None = None, fps: float | None = None) -> SequenceHeader:
        """Return the header of what `sample` returns, without decoding anything."""
        if fps is not None and not (np.isfinite(fps) and fps > 0):
            raise SettingsError(f"fps is {fps}; a positive number is expected")
        if times is None and fps is not None:
            times = frame_times(self.times[0], self.times[-1], fps)
        return self.header.with_times(self.times if times is None else self.inside(times), fps)

    def blocks(
        self,
        times: ArrayLike,
        size: int = FRAMES,
        progress: Progress = silent,
        workers: Executor | None = None,
    ) -> Iterator[Float]:
        """Decode frames block by block: yields points ``(B, V, 3)`` with ``B <= size``, for `times` in order.

        `workers` say who decodes the blocks, by default as many threads as there are cores. A frame is the same, to
        the last bit, whoever decodes it and whatever frames are asked for with it.
        """
        return self._decoded(_points, times, size, progress, workers)

    def moving_blocks(
        self,
        times: ArrayLike,
        size: int = FRAMES,
        progress: Progress = silent,
        workers: Executor | None = None,
    ) -> Iterator[tuple[Float, Float]]:
        """Decode frames block by block with velocities: yields points and units per second, ``(B, V, 3)`` each."""
        return self._decoded(_moving_points, times, size, progress, workers)

    def _decoded(
        self,
        decode: Callable[[Model, Float], Decoded],
        times: ArrayLike,
        size: int,
        progress: Progress,
        workers: Executor | None,
    ) -> Iterator[Decoded]:
        inside = self.inside(times)
        some = (inside[start : start + size] for start in range(0, len(inside), size))
        work = workers or (on_threads() if len(inside) > size else serially)
        self.space.prepared()
        done = 0
        for block in work(decode, self, some):
            yield block
            done = min(done + size, len(inside))
            progress(done, len(inside), "decoding frames")

    @property
    def key_frames(self) -> NDArray[np.int64]:
        """Frames ``(K,)`` that are a key shape and nothing else, -1 for key shapes that are no frame."""
        weights = self.pose.weights(self.time(self.times))
        frames = np.full(len(self.shapes), -1, dtype=np.int64)
        for key, only in enumerate(np.eye(len(self.shapes))):
            apart = np.abs(weights - only).max(axis=1)
            if apart.min() < 1e-6:
                frames[key] = apart.argmin()
        return frames

    def layout(self, times: ArrayLike, plane: Plane | None = None) -> Float:
        """Return where the model is ``(N, 2)`` in the plane that shows most of its motion, in diagonals.

        The plane of the first two principal components of the frames (classical multidimensional scaling of
        their distances in the shape space), fixed for the model; drawn, it is the default picture of the time
        signal (paper, Figure 18).

        Parameters
        ----------
        times : (N,) array_like
            Times in seconds.
        plane : Plane, optional
            The `plane` of another model with the same pose and shape signals, to compare the two; by default its own.

        Raises
        ------
        SettingsError
            If a time is outside the model, or the plane is of other key shapes.
        """
        origin, axes, _ = self.plane if plane is None else self.known(plane)
        weights = self.pose.weights(self.time(self.inside(times)))
        return np.asarray((weights - origin) @ axes)

    @cached_property
    def plane(self) -> Plane:
        """The plane of `layout`."""
        return plane(self.time(self.times), self.pose, self.shapes, self.space.layout_weights)

    def known(self, plane: Plane) -> Plane:
        """Return a plane as it is, if it can be one of this model.

        Raises
        ------
        SettingsError
            If it is of other key shapes.
        """
        if (len(plane.origin), len(plane.directions)) != (len(self.shapes), self.time.dim):
            raise SettingsError(
                f"the plane is of {len(plane.origin)} key shapes and {len(plane.directions)} coordinates of pose "
                f"space, the model has {len(self.shapes)} and {self.time.dim}; give the plane of a model with the "
                "same pose and shape signals"
            )
        return plane

    def inside(self, times: ArrayLike) -> Float:
        """Return times ``(N,)`` as they are, but for rounding at the ends.

        Raises
        ------
        SettingsError
            If a time is outside the model.
        """
        wanted = np.atleast_1d(np.asarray(times, dtype=np.float64))
        first, last = self.start, self.end
        slack = 1e-3 / self.header.fps  # times are typed and printed with a few digits
        outside = ~((wanted >= first - slack) & (wanted <= last + slack))
        if outside.any():
            raise SettingsError(
                f"time {wanted[outside][0]:g} s is outside the sequence, {first:g} to {last:g} s; "
                "models do not extrapolate"
            )
        return np.clip(wanted, first, last)


def _points(model: Model, times: Float) -> Float:
    points = model.space.decode(model.curve(times))
    return points if model.residual_layer is None else points + model.residual_layer.at(times)


def _moving_points(model: Model, times: Float) -> tuple[Float, Float]:
    points, speeds = model.space.decode_moving(model.curve(times), model.rates(times))
    if model.residual_layer is None:
        return points, speeds
    return points + model.residual_layer.at(times), speeds + model.residual_layer.rates(times)
