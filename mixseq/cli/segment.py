"""Implement the command ``mixseq segment``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

import mixseq
from mixseq.choices import SEGMENTATIONS
from mixseq.cli import options
from mixseq.cli.files import Claim, LabelChoice, check_picture, picture_path
from mixseq.cli.group import announce, print_json, print_table, progress_bar, say
from mixseq.cli.options import NON_NEGATIVE_INTEGER, argument, option, setting
from mixseq.errors import SettingsError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mixseq.choices import SegmentationName
    from mixseq.segmentation.methods import MethodSettings
    from mixseq.sequence.header import SequenceHeader
    from mixseq.types import FloatArray, Index
    from mixseq_io.reader import SequenceReader
    from mixseq_io.text.labels import Labels


_LABEL_METHODS = ("labels", "skeleton")
METHOD_NAMES = (*SEGMENTATIONS, *_LABEL_METHODS)


@options.command(
    "segment",
    "mixseq segment walk.usdc parts.usda",
    "mixseq segment walk.usdc parts.npz --parts 12 --no-picture",
    "mixseq segment man.glb parts.usdc --method skeleton",
    "mixseq segment man.glb parts.npz --against skeleton",
    "mixseq segment walk.usdc parts.usda --labels painted.ply",
    path=argument(metavar="SOURCE"),
    method=option(
        "--method",
        "How parts are found.  [default: motion; a model's own parts; labels with --labels or --source]",
        type=click.Choice(METHOD_NAMES),
    ),
    seed=setting(
        "--seed N",
        "Seed of the random choice of views of the method silhouettes.  [default: 0]",
        type=NON_NEGATIVE_INTEGER,
    ),
    against=option(
        "--against NAME", "Compare with labels of SOURCE, such as skeleton: prints the adjusted Rand index."
    ),
    picture=options.picture("TARGET"),
    flatten=option("--flatten", "Write USD that does not build on the original file."),
)
def command(
    path: Path,
    target: Path,
    method: str | None,
    parts: int | None,
    seed: int | None,
    labels: LabelChoice,
    against: str | None,
    picture: dict[str, Any],
    flatten: bool,
    as_json: bool,
    reading: dict[str, Any],
    claim: Claim,
    quiet: bool,
) -> None:
    """Cut a sequence into near-rigid parts.

    TARGET is an npz file with the part of every triangle, or the animation with its parts: GeomSubsets in USD, groups
    in OBJ, Alembic and HDF5. A picture of the parts is drawn next to TARGET.
    """
    from mixseq_io.text.label_files import check_label_target, write_labels

    method_name = _method(method, parts, labels)
    settings = None if seed is None else _with_seed(method_name, seed)
    check_label_target(target)
    picture_file = picture_path(target, "parts", **picture)
    claim(target, picture_file)
    if picture_file is not None:
        check_picture(picture_file)
    with progress_bar(quiet) as progress, mixseq.open_sequence(path, **reading) as reader:
        from mixseq.mesh.topology import Topology
        from mixseq.segmentation.joints import sample_frame_ids
        from mixseq.segmentation.methods import segment
        from mixseq.sequence.sequence import load_frames, own_parts

        frames = load_frames(reader, progress)
        points = frames.points[sample_frame_ids(len(frames.points))]
        if method_name in _LABEL_METHODS:
            choice = replace(labels, label_source="skeleton") if method_name == "skeleton" else labels
            parts_of_faces = split_into_connected(reader.header, choice.read(reader, reading))
        elif method is None and parts is None and settings is None and (own := own_parts(reader)) is not None:
            method_name, parts_of_faces = "model", _named(own.astype("int64"))
        else:
            topology = Topology(reader.header.faces, reader.header.vertex_count)
            parts_of_faces = _named(segment(points, topology, cast("SegmentationName", method_name), parts, settings))
        measures = _measure_parts(reader.header, points, parts_of_faces)
        agreement = None if against is None else _compare_labels(reader, points[0], parts_of_faces, against)
        write_labels(target, reader, parts_of_faces, flatten=flatten)
        if picture_file is not None:
            _draw(picture_file, reader.header, points[0], parts_of_faces)
    if as_json:
        compared = {} if agreement is None else {"agreement": agreement}
        print_json({"source": str(path), "method": method_name} | measures | compared)
        return
    if not quiet:
        print_table(_rows(measures), ("part", "faces", "area", "near-rigid error"))
    if agreement is not None and not quiet:
        say(
            "adjusted Rand index against {against} ({labels} labels): {by_faces:.3f} by faces, "
            "{by_area:.3f} by area".format(**agreement)
        )
    announce(target, picture_file)


def _rows(measures: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return table rows for the result of `_measure_parts`, with the whole mesh in the last row."""
    parts, count = measures["parts"], len(measures["parts"])
    total = {
        "name": f"{count} part{'s' * (count != 1)}",
        "faces": sum(row["faces"] for row in parts),
        "area": sum(row["area"] for row in parts),
        "near_rigid_percent": measures["near_rigid_percent"],
    }
    return [
        (row["name"], f"{row['faces']}", f"{row['area']:.1%}", f"{row['near_rigid_percent']:.2g} %")
        for row in (*parts, total)
    ]


def _method(method: str | None, parts: int | None, labels: LabelChoice) -> str:
    """Return the segmentation method chosen by the options."""
    method_name = method or ("labels" if labels.is_given else "motion")
    if labels.is_given and method_name not in _LABEL_METHODS:
        raise SettingsError(f"--labels and --source are no settings of the method {method_name}; leave out --method")
    if method_name == "skeleton" and labels.label_source not in (None, "skeleton"):
        raise SettingsError(f"the method skeleton takes labels from the skeleton, not from {labels.label_source}")
    if method_name in _LABEL_METHODS and parts is not None:
        raise SettingsError("given labels tell how many parts there are; leave out --parts")
    return method_name


def split_into_connected(header: SequenceHeader, labels: Labels) -> Labels:
    """Split labels into connected parts; a second part with the label "arm" is named "arm_1" if this name is unused."""
    import numpy as np

    from mixseq.mesh.topology import Topology
    from mixseq.segmentation.methods import segment_by_labels
    from mixseq_io.text.labels import Labels

    parts = segment_by_labels(labels.part_of_face, Topology(header.faces, header.vertex_count))
    _, first = np.unique(parts, return_index=True)
    label_of_part = labels.part_of_face[first].tolist()
    return Labels(parts, numbered([labels.names[label] for label in label_of_part]))


def numbered(names: Sequence[str]) -> tuple[str, ...]:
    """Append numbers to repeated names, skipping names in use: arm, arm, arm_1 become arm, arm_2, arm_1."""
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


def _named(labels: Index) -> Labels:
    """Return the labels ``(F,)`` of parts, with names."""
    from mixseq_io.text.labels import Labels

    return Labels(labels, tuple(f"part_{number:02d}" for number in range(int(labels.max(initial=-1)) + 1)))


def _with_seed(method: str, seed: int) -> MethodSettings:
    from mixseq.segmentation.methods import METHODS

    measures = METHODS.get(cast("SegmentationName", method))
    if measures is None or "seed" not in {field.name for field in fields(measures.settings)}:
        raise SettingsError(f"the method {method} has no random numbers; leave out --seed")
    return measures.settings(seed=seed)  # type: ignore[call-arg]


def _measure_parts(header: SequenceHeader, points: FloatArray, labels: Labels) -> dict[str, Any]:
    """Return the triangle count, the area fraction and the error in percent of every part, as plain values for JSON."""
    import numpy as np

    from mixseq.mesh.measures import triangle_areas
    from mixseq.segmentation.methods import near_rigid_errors

    parts, count = labels.part_of_face, len(labels.names)
    errors, whole = near_rigid_errors(points, header.faces, parts)
    area = np.bincount(parts, triangle_areas(points[0].astype(np.float64), header.faces), count)
    faces = np.bincount(parts, minlength=count)
    columns = (labels.names, faces.tolist(), (area / (area.sum() or 1.0)).tolist(), errors.tolist())
    keys = ("name", "faces", "area", "near_rigid_percent")
    return {
        "parts": [dict(zip(keys, row, strict=True)) for row in zip(*columns, strict=True)],
        "near_rigid_percent": whole,
    }


def _compare_labels(reader: SequenceReader, points: FloatArray, labels: Labels, source: str) -> dict[str, Any]:
    """Return adjusted Rand indices of labels against the labels in `source`, by triangle count and weighted by area."""
    from mixseq.mesh.measures import triangle_areas
    from mixseq.segmentation.methods import adjusted_rand_index
    from mixseq_io.text.label_files import extract_labels

    other_labels = extract_labels(reader, source)
    own, other = labels.part_of_face, other_labels.part_of_face
    return {
        "against": source,
        "labels": len(other_labels.names),
        "by_faces": adjusted_rand_index(own, other),
        "by_area": adjusted_rand_index(own, other, triangle_areas(points, reader.header.faces)),
    }


def _draw(picture: Path, header: SequenceHeader, points: FloatArray, labels: Labels) -> None:
    import numpy as np

    from mixseq.pictures.sheets import draw_segmentation
    from mixseq_io.files import atomic_file

    no_joints: NDArray[np.int64] = np.full(len(header.faces), -1)
    title = f"{header.name}: {len(labels.names)} parts"
    with atomic_file(picture) as temporary:
        draw_segmentation(temporary, points, header.faces, labels.part_of_face, no_joints, header.up_axis, title)
