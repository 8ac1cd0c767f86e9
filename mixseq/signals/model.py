r"""A model: a shape space and three signals in it, continuous in time.

.. math:: s(t) = \sum_j \varphi_j(c(t))\, P_j, \qquad \sum_j \varphi_j = 1

- **time**: the curve :math:`c(t)` in pose space (`mixseq.signals.curve`),
- **pose**: the affine map :math:`\varphi` from pose space to weights of key shapes (`mixseq.signals.pose`),
- **shape**: the key shapes :math:`P_j`, points of the shape space.

The **placement** of bodies in the world is a separate curve. Further bodies, other meshes, can move by the same signals
(`mixseq.signals.bodies`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import SettingsError
from mixseq.mesh.polygons import read_only
from mixseq.runtime.lazy import PickledWithoutCaches
from mixseq.runtime.parallel import one_blas_thread
from mixseq.sequence.events import Events
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.provenance import as_edited
from mixseq.sequence.sequence import LazyFrames, warn_of_loss
from mixseq.signals.bodies import SAME_BODY, Body, Relation
from mixseq.signals.curve import Curve
from mixseq.signals.decoding import Decodable
from mixseq.signals.pose import Plane, PoseMap, fit_plane
from mixseq.spaces.base import ShapeSpace
from mixseq.spaces.temporal import Timing
from mixseq.types import Float, IntArray

if TYPE_CHECKING:
    from mixseq.segmentation.joints import Decomposition
    from mixseq.spaces.mixed.mixed_space import MixedSpace


BLENDED_NUMBERS = 1 << 17  # coordinates of key shapes that stay in a core's cache while several frames are blended


@dataclass(frozen=True, eq=False)
class Model(Decodable, PickledWithoutCaches):
    """A mesh sequence as signals in a shape space, continuous in time. Make it with `mixseq.fit` or `mixseq.load`.

    Attributes
    ----------
    header : SequenceHeader
        Polygons, units and name of the mesh, and the times of the frames that `sample` returns by default.
    space : ShapeSpace
        The shape space.
    time : Curve
        The time signal, a curve in pose space ``R^k``.
    pose : PoseMap
        The pose signal, from pose space to the weights of K key shapes.
    shapes : (K, S) float64
        The shape signal: key shapes without their placement, ``S = space.shape_dim``.
    placement : Curve
        Poses of the bodies: a curve of `ShapeSpace.placement_dim` coordinates.
    correction : Curve, optional
        Curve of `ShapeSpace.correction_dim` coordinates that corrects blended shapes between frames, and at frames in a
        model of few modes. By default, there is no correction.
    bodies : tuple of Body
        Further bodies that move by the same time and pose signals, see `body`; all edits play on them. By default none.

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
    correction: Curve = None  # type: ignore[assignment]  # set below by default
    bodies: tuple[Body, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "shapes", read_only(np.asarray(self.shapes, dtype=np.float64)))
        expected = (len(self.pose.offset), self.space.shape_dim)
        if self.shapes.shape != expected:
            raise SettingsError(f"the key shapes have shape {self.shapes.shape}; {expected} is expected")
        if self.correction is None:
            ends = np.unique(self.placement.times[[0, -1]])
            zero = np.zeros((len(ends), self.space.correction_dim))
            object.__setattr__(self, "correction", Curve(ends, zero))
        dims = self.pose.dim, self.space.placement_dim, self.space.correction_dim
        first, last = self.times[[0, -1]]
        for name, curve, dim in zip(("time", "placement", "correction"), self.curves, dims, strict=True):
            if curve.dim != dim:
                raise SettingsError(f"the {name} signal has {curve.dim} coordinates; {dim} are expected")
            if curve.start > first or curve.end < last:
                raise SettingsError(
                    f"frames are from {first:g} to {last:g} s, the {name} signal only from {curve.start:g} to "
                    f"{curve.end:g} s"
                )
        if len(set(self.body_names)) <= len(self.bodies):
            raise SettingsError(f"two bodies have the same name; names are {', '.join(map(repr, self.body_names))}")
        for body in self.bodies:
            counts = [(len(each.shapes), each.space.rotation_count) for each in (self, body)]
            if counts[0] != counts[1]:
                raise SettingsError(
                    f"the body {body.header.name!r} has {counts[1][0]} key shapes and {counts[1][1]} placements; "
                    f"{counts[0][0]} and {counts[0][1]} are expected"
                )

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of all bodies: that of the model's own mesh, and those of its further `bodies`."""
        return self.header.name, *(body.header.name for body in self.bodies)

    def body(self, name: str) -> Model:
        """Return the model with another of its bodies in front: what is decoded, shown and edited is that body.

        All others remain its `bodies`, so that an edit of one body plays on all.

        Parameters
        ----------
        name : str
            One of `body_names`.

        Raises
        ------
        SettingsError
            If there is no such body.

        Examples
        --------
        >>> import mixseq
        >>> from mixseq.creature import walk_cycle
        >>> from mixseq.operations import key_poses, speed, with_body
        >>> fox = mixseq.fit(walk_cycle(frames=6), exact=True)
        >>> keys = key_poses(fox)
        >>> both = with_body(fox, keys.with_points(keys.points * [1.0, 1.5, 1.0]), "tall fox")
        >>> speed(both, 2.0).body("tall fox").end < fox.end
        True
        """
        if name == self.header.name:
            return self
        if name not in self.body_names:
            raise SettingsError(f"there is no body {name!r}; bodies are {', '.join(map(repr, self.body_names))}")
        return self._with_body(name)

    def _with_body(self, name: str) -> Model:
        """Return the model with one of its further bodies in front."""
        chosen = self.bodies[self.body_names.index(name) - 1]
        turns = np.tile(np.eye(3), (self.space.correction_dim // 6, 1, 1))
        turn, shifts = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros((self.space.centre_count, 3))
        rotations = np.tile(turn, (self.space.rotation_count, 1))
        own = Body(self.header, self.space, self.shapes, turn, rotations, shifts, turns)
        others = tuple((own if body is chosen else body).relative_to(chosen) for body in self.bodies)
        return replace(self.alone_as(chosen), bodies=others)

    def alone_as(self, body: Body) -> Model:
        """Return the model of another body alone, which moves by the signals of this model."""
        poses = body.place(self.space.unpack_placements(self.placement.values))
        return replace(
            self,
            header=replace(body.header, times=self.header.times, fps=self.header.fps, keys=None),
            space=body.space,
            shapes=body.shapes,
            placement=Curve(self.placement.times, body.space.pack_placements(poses)),
            correction=body.turn_correction(self.correction, self.mixed.articulation.body_of_part),
            bodies=(),
        )

    @property
    def curves(self) -> tuple[Curve, Curve, Curve]:
        """The time, placement and correction curves."""
        return self.time, self.placement, self.correction

    def edited(self, **changes: Any) -> Model:
        """Return the model with other fields, and mark it as edited: it is no longer within a bound of its source.

        Key shapes that are added after the others change this body alone; on its other `bodies` they equal the first.
        """
        header = changes.pop("header", self.header)
        bodies = changes.pop("bodies", self.bodies)
        if bodies:
            count = len(changes.get("shapes", self.shapes))
            bodies = tuple(body.edited(count) for body in bodies)
        header = replace(header, provenance=as_edited(header.provenance))
        return replace(self, header=header, bodies=bodies, **changes)

    @property
    def start(self) -> float:
        """First time of the model in seconds."""
        return max(curve.start for curve in self.curves)

    @property
    def end(self) -> float:
        """Last time of the model in seconds."""
        return min(curve.end for curve in self.curves)

    @property
    def decomposition(self) -> Decomposition:
        """Parts and joints of the mesh; raises `SettingsError` if the shape space has none."""
        return self.mixed.decomposition

    @property
    def parts(self) -> IntArray | None:
        """Part ``(F,)`` of every triangle; None if the shape space has no parts."""
        return None if self.space.segmentation is None else self.space.segmentation.part_of_face

    @property
    def frames(self) -> LazyFrames:
        """The frames of the body in front, decoded on demand, with their parts; warns of further bodies."""
        if self.body_names[1:]:
            text = f"further bodies, {', '.join(self.body_names[1:])}, are left out"
            warn_of_loss(self.header, text, "take them by Model.body, or write them by mixseq decode --body")
        return next(self.frames_of_bodies())

    def frames_of_bodies(self) -> Iterator[LazyFrames]:
        """Yield the frames of every body, decoded on demand, with their parts."""
        for model in map(self.body, self.body_names):
            yield LazyFrames(model.header, partial(model.blocks, model.times), model.parts)

    @property
    def relations(self) -> tuple[Relation, ...]:
        """The relations of all bodies to the one in front."""
        return SAME_BODY, *(body.relation for body in self.bodies)

    @property
    def signals_id(self) -> int:
        """A number that a model has in common with `body`, and no other model has."""
        return id(self.time)

    @property
    def mixed(self) -> MixedSpace:
        """The mixed shape space of the model; raises `SettingsError` for other kinds of space."""
        from mixseq.spaces.mixed.mixed_space import as_mixed  # slow import, unused by compressed models

        return as_mixed(self.space)

    def __repr__(self) -> str:
        return (
            f"Model({self.header.name!r}: {self.start:g} to {self.end:g} s, {len(self.shapes)} key shapes, "
            f"{self.space.name} space of dim {self.space.dim}, "
            f"{len(self.time.times)} + {len(self.placement.times)} knots"
            + (f", bodies {', '.join(self.body_names)})" if self.bodies else ")")
        )

    def curve(self, times: ArrayLike) -> Float:
        """Return the vectors ``(N, D)`` of the space at times ``(N,)`` in seconds; see `__call__`."""
        clipped = self.clip_times(times)
        weights = self.pose.weights(self.time(clipped))
        return self._blend_shapes(weights, self.placement(clipped), self.correction(clipped))

    def rates(self, times: ArrayLike) -> Float:
        """Return the derivatives ``(N, D)`` of `curve` by time, per second."""
        clipped = self.clip_times(times)
        weights = self.pose.rates(self.time.derivative(clipped))
        return self._blend_shapes(weights, self.placement.derivative(clipped), self.correction.derivative(clipped))

    def decode_points(self, times: Float) -> Float:
        """Implement `Decodable.decode_points`."""
        return self.space.decode(self.curve(times))

    def decode_moving(self, times: Float) -> tuple[Float, Float]:
        """Implement `Decodable.decode_moving`."""
        return self.space.decode_with_velocities(self.curve(times), self.rates(times))

    def _blend_shapes(self, weights: Float, *others: Float) -> Float:
        """Return weighted sums of key shapes, followed by other columns: ``(N, D)``; rows do not depend on others."""
        count, size = self.shapes.shape
        vectors = np.empty((len(weights), self.space.dim))
        vectors[:, size:] = np.concatenate(others, axis=1)
        width = BLENDED_NUMBERS // count + 1
        with one_blas_thread():
            for start in range(0, size, width):
                columns = np.s_[start : min(start + width, size)]
                for vector, weight in zip(vectors, weights, strict=True):
                    np.matmul(weight, self.shapes[:, columns], out=vector[columns])
        return vectors

    @property
    def timing(self) -> Timing:
        """The timing of the frames, from the breaks of the signals: jumps between frames, and corners at frames."""
        breaks = np.unique(np.concatenate([curve.breaks for curve in self.curves]))
        before = np.searchsorted(self.times, breaks, side="right") - 1
        is_inside = (before >= 0) & (before < len(self.times) - 1)
        is_frame = self.times[before] == breaks
        cuts, keys = (tuple(np.unique(before[is_inside & mask]).tolist()) for mask in (~is_frame, is_frame))
        return Timing(Events(cuts=cuts, keys=keys))

    @property
    def vectors(self) -> Float:
        """The vectors ``(T, D)`` of the frames."""
        return self.curve(self.times)

    def embedding(self, times: ArrayLike, plane: Plane | None = None) -> Float:
        """Return the coordinates ``(N, 2)`` of the model in its main plane, in diagonals.

        The main plane is spanned by the first two principal components of the frames, and fixed for the model. This is
        classical multidimensional scaling of their distances in the shape space. The default picture of the time signal
        shows these coordinates (paper, Figure 18).

        Parameters
        ----------
        times : (N,) array_like
            Times in seconds.
        plane : Plane, optional
            The `plane` of another model with the same pose and shape signals, to compare both models; by default the
            plane of this model.

        Raises
        ------
        SettingsError
            If a time is outside the model, or the plane belongs to other key shapes.
        """
        origin, axes, _ = self.plane if plane is None else self.check_plane(plane)
        weights = self.pose.weights(self.time(self.clip_times(times)))
        return np.asarray((weights - origin) @ axes)

    def check_plane(self, plane: Plane) -> Plane:
        """Return a plane; raise `SettingsError` if it does not fit the pose and shape signals of this model."""
        if (len(plane.origin), len(plane.directions)) != (len(self.shapes), self.time.dim):
            raise SettingsError(
                f"the plane is of {len(plane.origin)} key shapes and {len(plane.directions)} coordinates of pose "
                f"space, the model has {len(self.shapes)} and {self.time.dim}; give the plane of a model with the "
                "same pose and shape signals"
            )
        return plane

    @cached_property
    def plane(self) -> Plane:
        """The main plane of the model, used by `embedding`."""
        return fit_plane(self.time(self.times), self.pose, self.shapes, self.space.embedding_weights)
