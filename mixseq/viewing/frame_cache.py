"""Cache of decoded frames within a memory limit, and the threads that decode them.

The newest requested frame comes first. Idle threads decode the frames after it.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from traceback import print_exception

from mixseq.arrays import Single
from mixseq.errors import MixseqError, ReconstructionError
from mixseq.scene.items import Scene, SceneItem
from mixseq.threads import one_blas_thread
from mixseq.viewing.background import Background

MEMORY = 1 << 30
"""Size of the cache, in bytes."""

Key = tuple[SceneItem, float]


@dataclass(frozen=True)
class _Wish:
    scene: Scene
    frame: int
    ahead: bool


class FrameCache(Background):
    """Frames of scenes, decoded in the background."""

    def __init__(self, ready: Callable[[], None], threads: int = 2, memory: int = MEMORY) -> None:
        self._ready = ready
        self._memory = memory
        self._kept: OrderedDict[Key, Single | MixseqError] = OrderedDict()
        self._size = 0
        self._busy: set[Key] = set()
        self._wish: _Wish | None = None
        super().__init__(self._decode, threads)

    def want(self, scene: Scene, frame: int, ahead: bool = True) -> tuple[Single, ...] | None:
        """Request a frame, and return its poses ``(V, 3)``, None if they are not decoded yet."""
        elapsed = scene.elapsed(frame)
        with self._changed:
            self._wish = _Wish(scene, frame, ahead)
            self._changed.notify_all()
            poses = []
            for item in scene.items:
                key = item, elapsed
                pose = self._kept.get(key)
                if pose is None:
                    return None
                if isinstance(pose, MixseqError):
                    del self._kept[key]  # another try may do better, and should be possible
                    raise pose
                self._kept.move_to_end(key)
                poses.append(pose)
            return tuple(poses)

    def _decode(self) -> None:
        while True:
            with self._changed:
                while (key := self._next()) is None and not self._closed:
                    self._changed.wait()
                if self._closed or key is None:
                    return
                self._busy.add(key)
            item, elapsed = key
            found: Single | MixseqError
            try:
                with one_blas_thread():
                    found = item.pose(elapsed)
            except MixseqError as error:
                found = error
            except Exception as error:  # a bug, or no memory: this frame cannot be shown, others may be
                print_exception(error)
                found = ReconstructionError(f"{type(error).__name__}: {error}")
            with self._changed:
                self._busy.discard(key)
                self._keep(key, found)
            self._ready()

    def _next(self) -> Key | None:
        """Return the next pose to decode: a requested one, or the first missing one after it."""
        if self._wish is None:
            return None
        scene, first = self._wish.scene, self._wish.frame
        for step in range(self._horizon(scene) if self._wish.ahead else 1):
            elapsed = scene.elapsed((first + step) % scene.count)
            for item in scene.items:
                key = item, elapsed
                if key not in self._kept and key not in self._busy:
                    return key
        return None

    def _horizon(self, scene: Scene) -> int:
        """Return the number of frames in three quarters of the memory."""
        size = sum(12 * item.header.vertex_count for item in scene.items)
        return max(1, min(scene.count, 3 * self._memory // (4 * size)))

    def _keep(self, key: Key, found: Single | MixseqError) -> None:
        self._kept[key] = found
        self._size += _bytes(found)
        while self._size > self._memory and len(self._kept) > 1:
            self._size -= _bytes(self._kept.popitem(last=False)[1])


def _bytes(found: Single | MixseqError) -> int:
    return 0 if isinstance(found, MixseqError) else found.nbytes
