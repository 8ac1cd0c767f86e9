"""The model of a compressed sequence: its streams at the frames, and a fitted model between them and in edits.

A compressed sequence stores vertex positions at frames. Interpolated in time, they shrink parts that rotate. So between
frames, and for every edit, the frames are fitted exactly in S_m, as those of any other file, when this is first needed.
Of several bodies, each is what its own streams decode to, and is fitted to its own frames. In edits, the others move by
the signals of the body in front, and their frames are their key shapes.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import Any

import numpy as np

from mixseq.compression.bitstream.compressed_sequence import CompressedSequence, Playback, decode
from mixseq.mesh.rotations import quat_to_matrix
from mixseq.runtime.progress import Progress, log_progress
from mixseq.sequence.events import CutChoice
from mixseq.sequence.frame_rates import FRAME_ROUNDING
from mixseq.sequence.sequence import LazyFrames, MeshSequence
from mixseq.signals.bodies import SAME_BODY, Body, Relation
from mixseq.signals.curve import Curve
from mixseq.signals.decoding import Decodable
from mixseq.signals.model import Model
from mixseq.signals.pose import PoseMap
from mixseq.spaces.base import ShapeSpace
from mixseq.types import Float, Index


def _signal(name: str) -> Any:
    return property(attrgetter(f"fitted.{name}"), doc=f"`Model.{name}`, fitted at first use.")


class CompressedModel(Model):
    """A compressed sequence as a model. Make it with `mixseq.load`.

    At its frames, it is what the streams decode to. Between frames it is `fitted`, which has all signals and is thus
    what operations edit. It is a subclass of `Model`, so that it is one everywhere, without a case for it.

    Attributes
    ----------
    playback : Playback
        The streams, with splines of vertices through frames and in-betweens, as players in browsers show them.
    """

    playback: Playback
    _playbacks: Sequence[Playback]  # of all bodies, the same object for each of them in front
    _fitted: Model | None
    _lock: threading.Lock

    space: ShapeSpace = _signal("space")
    time: Curve = _signal("time")
    pose: PoseMap = _signal("pose")
    shapes: Float = _signal("shapes")
    placement: Curve = _signal("placement")
    correction: Curve = _signal("correction")

    def __new__(cls, *signals: Any, **named_signals: Any) -> Any:
        """Return a plain model of signals: `dataclasses.replace` edits, and an edit has no streams."""
        return Model(*signals, **named_signals)

    @classmethod
    def from_sequence(cls, coded: CompressedSequence) -> CompressedModel:
        """Decode the streams of a compressed sequence."""
        return cls.from_playbacks([decode(each) for each in coded.all_bodies])

    @classmethod
    def from_playbacks(
        cls, playbacks: Sequence[Playback], index: int = 0, fitted: Model | None = None
    ) -> CompressedModel:
        """Make the model of the decoded streams of all bodies, with one of them in front."""
        model: CompressedModel = object.__new__(cls)
        facts = {"header": playbacks[index].header, "playback": playbacks[index], "_playbacks": playbacks}
        model.__dict__.update(facts, _fitted=fitted, _lock=threading.Lock())
        return model

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return CompressedModel.from_playbacks, (self._playbacks, self._playbacks.index(self.playback), self._fitted)

    def __repr__(self) -> str:
        bodies = f", bodies {', '.join(self.body_names)}" if self._others else ""
        frames = f"{self.start:g} to {self.end:g} s, {len(self.times)} frames{bodies}"
        return f"CompressedModel({self.header.name!r}: {frames})"

    @property
    def _others(self) -> list[Playback]:
        return [each for each in self._playbacks if each is not self.playback]

    @property
    def body_names(self) -> tuple[str, ...]:
        """`Model.body_names`."""
        return self.header.name, *(each.header.name for each in self._others)

    def _with_body(self, name: str) -> CompressedModel:
        return self.from_playbacks(self._playbacks, [each.header.name for each in self._playbacks].index(name))

    @property
    def relations(self) -> tuple[Relation, ...]:
        """`Model.relations`."""
        return SAME_BODY, *(each.relation.relative_to(self.playback.relation) for each in self._others)

    @property
    def signals_id(self) -> int:
        """`Model.signals_id`."""
        return id(self._playbacks)

    @property
    def bodies(self) -> tuple[Body, ...]:
        """`Model.bodies`, made at first use: the frames of the others are their key shapes."""
        fitted = self.fitted
        with self._lock:
            if "_bodies" not in self.__dict__:
                from mixseq.signals.shape_exchange import key_times, make_body

                times, bodies = key_times(fitted), []
                for playback, relation in zip(self._others, self.relations[1:], strict=True):
                    header = playback.header.with_times(np.arange(len(times)), 1.0)
                    keys = MeshSequence.from_header(header, playback.decode_points(times))
                    parts, turn = playback.parts if relation.same_parts else None, np.array(relation.turn)
                    bodies.append(make_body(fitted, keys, header.name, parts, quat_to_matrix(turn)))
                self.__dict__["_bodies"] = tuple(bodies)
            made: tuple[Body, ...] = self.__dict__["_bodies"]
            return made

    @property
    def fitted(self) -> Model:
        """The exact model of the decoded frames in S_m."""
        return self.fit()

    def fit(self, progress: Progress = log_progress) -> Model:
        """Return `fitted`, and report the progress of the first call."""
        from mixseq.signals.fitting import fit  # slow import, unused at frames

        with self._lock:
            fitted = self._fitted
            if fitted is None:
                frames = LazyFrames(self.header, lambda size: self.playback.blocks(self.times, size))
                cuts: CutChoice = self.playback.between.cuts or "auto"
                fitted = fit(frames, exact=True, parts=self.parts, cuts=cuts, progress=progress)
                self.__dict__["_fitted"] = fitted
            return fitted

    @property
    def parts(self) -> Index | None:
        """Part ``(F,)`` of every triangle, stored in the file; None if they are found when the model is fitted."""
        return self.playback.parts

    start = Decodable.start
    end = Decodable.end

    def frame_ids(self, times: Float) -> Index:
        """Return the frames ``(N,)`` at times, -1 between; a tolerance above rounding would stop motion there."""
        positions = np.interp(times, self.times, np.arange(len(self.times)))
        nearest = np.rint(positions).astype(np.int64)
        return np.where(np.abs(positions - nearest) <= FRAME_ROUNDING, nearest, -1)

    def prepare(self, times: Float, velocities: bool, progress: Progress) -> None:
        """Fit the model if times ``(N,)`` need it."""
        if velocities or (self.frame_ids(times) < 0).any():
            self.fit(progress).prepare(times, velocities, progress)
        self.playback.prepare(times, velocities, progress)

    def decode_points(self, times: Float) -> Float:
        """Implement `Decodable.decode_points`: streams at frames, and the fitted model elsewhere."""
        between_mask = self.frame_ids(times) < 0
        points = np.empty((len(times), self.header.vertex_count, 3))
        if between_mask.any():
            points[between_mask] = self.fitted.decode_points(times[between_mask])
        return self._with_frames(points, times)

    def decode_moving(self, times: Float) -> tuple[Float, Float]:
        """Implement `Decodable.decode_moving`, with velocities of the fitted model also at frames."""
        points, velocities = self.fitted.decode_moving(times)
        return self._with_frames(points, times), velocities

    def _with_frames(self, points: Float, times: Float) -> Float:
        """Set points ``(N, V, 3)`` at times that are frames to what the streams decode to, and return them."""
        frame_ids = self.frame_ids(times)
        rows = np.flatnonzero(frame_ids >= 0)
        if len(rows):
            points[rows] = self.playback.decode_points(self.times[frame_ids[rows]])
        return points
