"""USD, writing: samples in several files, stitched together by value clips.

Clip ``i`` holds the frames from its first one to the first one of clip ``i + 1``, inclusive, so that USD interpolates
within a clip. Clip times equal stage times and are authored for every frame: USD before 26.11 otherwise loses the
offset of referencing shots, and rounds times between the first and the last. A manifest lists the attributes in clips,
so that USD need not open all of them.

Specification: https://openusd.org/release/api/_usd__page__value_clips.html
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from pxr import Sdf, Vt

from mixseq.errors import OutputError
from mixseq_io.blocks import warn
from mixseq_io.temporary import put_away, temporary_name
from mixseq_io.usd.diagnostics import save_layer
from mixseq_io.usd.frame_values import Cast, Frame
from mixseq_io.usd.layers import Samples, declare
from mixseq_io.usd.paths import clips_folder

_CLIP_SET = "mixseq"
"""Name other than "default", which the file below may have; sets of one name are merged key by key."""


def save_in_clips(
    layer: Sdf.Layer, cast: Cast, frames: Iterable[Frame], length: int, folder: NewFolder
) -> None:
    """Write frames into clips of `length` frames, and save a layer with their order."""
    starts: list[float] = []
    times: list[float] = []
    clip: Samples | None = None
    for number, frame in enumerate(frames):
        times.append(frame[0])
        if number % length == 0:
            starts.append(frame[0])
            if clip:
                clip.put(frame)
                clip.save()
            clip = Samples(_empty(folder.path / folder.clip(len(starts)), cast, layer.timeCodesPerSecond))
        if clip:
            clip.put(frame)
    if clip:
        clip.save()
    save_layer(_empty(folder.path / folder.manifest, cast, layer.timeCodesPerSecond))
    assets = Sdf.AssetPathArray(
        [Sdf.AssetPath(folder.asset(folder.clip(number + 1))) for number in range(len(starts))]
    )
    for path in [*(mesh.path for mesh in cast.meshes), *(bounds.path for bounds in cast.bounds)]:
        description = {
            "assetPaths": assets,
            "times": Vt.Vec2dArray([(time, time) for time in times]),
            "active": Vt.Vec2dArray([(start, float(number)) for number, start in enumerate(starts)]),
            "primPath": path,
            "manifestAssetPath": Sdf.AssetPath(folder.asset(folder.manifest)),
        }
        layer.GetPrimAtPath(path).SetInfo("clips", {_CLIP_SET: description})
    save_layer(layer)


def _empty(file: Path, cast: Cast, rate: float) -> Sdf.Layer:
    layer = Sdf.Layer.CreateNew(str(file))
    layer.timeCodesPerSecond = rate
    declare(layer, cast)
    return layer


class NewFolder:
    """Folder for the clips of a file, written under a temporary name and installed when complete."""

    def __init__(self, owner: Path, resources: ExitStack) -> None:
        self.target = self.path = self._old = clips_folder(owner)
        self._stem = owner.stem
        self._resources = resources
        self._installed = False

    @property
    def manifest(self) -> str:
        """File name of the manifest."""
        return f"{self._stem}.manifest.usdc"

    def clip(self, number: int) -> str:
        """Return the file name of a clip, counted from 1."""
        return f"{self._stem}.{number:04d}.usdc"

    def asset(self, name: str) -> str:
        """Return the asset path, in a layer beside the folder, of a file in it."""
        return f"./{self.target.name}/{name}"

    def make(self) -> None:
        """Create the folder, empty."""
        if self.target.exists() and not _is_of_clips(self.target, self._stem):
            raise OutputError(
                f"{self.target} has other files than clips, which are not deleted; move it away, or write to another "
                "name"
            )
        name = self._resources.enter_context(temporary_name(self.target.parent))
        self.path, self._old = Path(f"{name}.new"), put_away(name, self.target)
        self.path.mkdir()

    def install(self) -> None:
        """Move the folder into place; the replaced one is kept until the end."""
        for file in self.path.iterdir():
            with file.open("rb") as stream:
                os.fsync(stream.fileno())
        if self.target.exists():
            self.target.rename(self._old)
        self.path.rename(self.target)
        self._installed = True

    def warn_if_unused(self) -> None:
        """Warn of clips left by an older file of this name that this one does not use."""
        with suppress(OSError):
            if _is_of_clips(self.target, self._stem) and (self.target / self.manifest).exists():
                warn(
                    f"{self.target} has the clips of an older file of this name; the new one does not use them, remove "
                    "them if no other does"
                )

    def undo(self) -> None:
        """Restore the previous folder."""
        if self._installed:
            self.target.rename(self.path)
        if self._old.exists():
            self._old.rename(self.target)


@contextmanager
def new_folder(owner: Path) -> Iterator[NewFolder]:
    """Yield a folder for the clips of a file; after an exception the previous state is restored."""
    with ExitStack() as resources:
        folder = NewFolder(owner, resources)
        try:
            yield folder
        except BaseException:
            with suppress(OSError):
                folder.undo()
            raise


def _is_of_clips(folder: Path, stem: str) -> bool:
    return folder.is_dir() and all(
        file.name.startswith(f"{stem}.") and file.suffix == ".usdc" for file in folder.iterdir()
    )
