"""Labels that ``--labels`` and ``--source`` choose."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mixseq.cli.files import options_of
from mixseq.errors import SettingsError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mixseq_io import Labels, SequenceReader


def chosen_labels(
    reader: SequenceReader, labels: Path | None, source: str | None, reading: Mapping[str, Any]
) -> Labels:
    """Read labels of an open sequence from a file, or from the sequence's own."""
    from mixseq_io.labels.reading import labels_of, read_labels

    if labels is None:
        return labels_of(reader, source)
    return read_labels(labels, reader, source, **options_of(labels, reading))


def parts_given(
    reader: SequenceReader,
    parts: int | None,
    labels: Path | None,
    source: str | None,
    reading: Mapping[str, Any],
) -> NDArray[np.int64]:
    """Return the part of every triangle ``(F,)`` that labels tell, unless a number of parts contradicts them."""
    if parts is not None:
        raise SettingsError("--labels and --source tell the parts; leave out --parts, or them")
    return chosen_labels(reader, labels, source, reading).part_of_face
