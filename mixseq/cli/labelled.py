"""Labels chosen by ``--labels`` and ``--source``, and their connected parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mixseq.cli.files import options_of
from mixseq.errors import SettingsError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mixseq.sequence import SequenceHeader
    from mixseq_io import Labels, SequenceReader


def chosen_labels(
    reader: SequenceReader, labels: Path | None, source: str | None, reading: Mapping[str, Any]
) -> Labels:
    """Read labels of an open sequence from a file, or from the sequence itself."""
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
    """Return the part of every triangle ``(F,)`` from labels; raises an error if a number of parts contradicts them."""
    if parts is not None:
        raise SettingsError("--labels and --source tell the parts; leave out --parts, or them")
    return chosen_labels(reader, labels, source, reading).part_of_face


def connected(header: SequenceHeader, labels: Labels) -> Labels:
    """Split labels into connected parts; the second part of a label "arm" is "arm_1", unless that is a label."""
    import numpy as np

    from mixseq.segmentation import segment_by_labels
    from mixseq.topology import Topology
    from mixseq_io import Labels

    parts = segment_by_labels(labels.part_of_face, Topology(header.faces, header.vertex_count))
    _, first = np.unique(parts, return_index=True)
    label_of_part = labels.part_of_face[first].tolist()
    return Labels(parts, numbered([labels.names[label] for label in label_of_part]))


def numbered(names: Sequence[str]) -> tuple[str, ...]:
    """Append numbers to repeated names, skipping existing ones: arm, arm, arm_1 become arm, arm_2, arm_1."""
    used, result = set(names), []
    counts: dict[str, count[int]] = {}
    for name in names:
        if name in counts:
            result.append(next(free for number in counts[name] if (free := f"{name}_{number}") not in used))
            used.add(result[-1])
        else:
            counts[name] = count(1)
            result.append(name)
    return tuple(result)
