"""The size limit of a page: its bytes are counted as they come, and so is the progress of the work."""

from __future__ import annotations

from mixseq.errors import SettingsError
from mixseq.progress import Progress


class Budget:
    """Counts frames and bytes of a page.

    Parameters
    ----------
    frames : int
        Of all meshes.
    largest : float
        The page may have so many megabytes (:math:`10^6` bytes).
    empty : int
        Bytes that it has without any mesh.
    progress : callable
        Told about every frame, twice: when it is there and when it is packed.

    Raises
    ------
    SettingsError
        If the empty page is too large already.
    """

    def __init__(self, frames: int, largest: float, empty: int, progress: Progress) -> None:
        self._frames, self._largest, self._progress = frames, largest, progress
        self._gathered = self._packed = self._streamed = 0
        self._fixed = empty
        if empty > 1e6 * largest:
            raise SettingsError(
                f"a page has {empty / 1e6:.2g} MB even without a mesh, more than {largest:g} MB; allow more with "
                "--largest"
            )

    def gathered(self, frames: int) -> None:
        """Tell that there are so many more frames."""
        self._gathered += frames
        self._progress(self._gathered + self._packed, 2 * self._frames, "decoding frames")

    def packed(self, frames: int, size: int) -> None:
        """Tell that so many more frames made so many more bytes.

        Raises
        ------
        SettingsError
            If the page is too large.
        """
        self._packed, self._streamed = self._packed + frames, self._streamed + size
        self._check()
        self._progress(self._gathered + self._packed, 2 * self._frames, "packing frames")

    def described(self, size: int) -> None:
        """Tell that so many more bytes are in the page, however many frames it has.

        Raises
        ------
        SettingsError
            If the page is too large.
        """
        self._fixed += size
        self._check()

    def _check(self) -> None:
        if self._fixed + self._streamed > 1e6 * self._largest:
            expected = (self._fixed + self._streamed / max(self._packed, 1) * self._frames) / 1e6
            raise SettingsError(
                f"the page would have about {expected:.3g} MB, more than {self._largest:g} MB; take fewer frames "
                "(--every 2, or a lower --fps) or fewer meshes, or allow more with --largest"
            )
