"""``mixseq segment``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

import mixseq
from mixseq.choices import SEGMENTATIONS
from mixseq.cli.files import Claim, chosen_labels, connected, overwrite_option
from mixseq.cli.group import announce, print_json, print_table, progress_bar, say
from mixseq.cli.options import (
    FILE,
    CommandWithSettings,
    examples,
    json_option,
    labels_options,
    quiet_option,
    reader_options,
    setting,
)
from mixseq.errors import OutputError, SettingsError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mixseq.choices import SegmentationName
    from mixseq.segmentation.methods import MethodSettings
    from mixseq.sequence.header import SequenceHeader
    from mixseq.types import FloatArray
    from mixseq_io.reader import SequenceReader
    from mixseq_io.text.labels import Labels


_GIVEN = ("labels", "skeleton")
METHODS = (*SEGMENTATIONS, *_GIVEN)


@click.command(
    "segment",
    cls=CommandWithSettings,
    epilog=examples(
        "mixseq segment walk.usdc parts.usda",
        "mixseq segment walk.usdc parts.npz --parts 12 --no-picture",
        "mixseq segment man.glb parts.usdc --method skeleton",
        "mixseq segment man.glb parts.npz --against skeleton",
        "mixseq segment walk.usdc parts.usda --labels painted.ply",
    ),
)
@click.argument("path", metavar="SOURCE", type=FILE)
@click.argument("target", type=FILE)
@click.option(
    "--method",
    type=click.Choice(METHODS),
    help="How parts are found.  [default: motion; labels with --labels or --source]",
)
@click.option(
    "--parts",
    type=click.IntRange(min=1),
    metavar="N",
    help="Number of parts; every connected component has at least one.  [default: automatic]",
)
@setting(
    "--seed",
    type=click.IntRange(min=0),
    metavar="N",
    help="Seed of the random choice of views of the method silhouettes.  [default: 0]",
)
@labels_options
@click.option(
    "--against",
    metavar="NAME",
    help="Compare with labels of SOURCE, such as skeleton: prints the adjusted Rand index.",
)
@click.option("--picture", type=FILE, metavar="PNG", help="Name of the picture.  [default: beside TARGET]")
@click.option("--no-picture", is_flag=True, help="Draw no picture.")
@click.option("--flatten", is_flag=True, help="Write USD that does not build on the original file.")
@json_option
@reader_options
@overwrite_option
@quiet_option
def command(
    path: Path,
    target: Path,
    method: str | None,
    parts: int | None,
    seed: int | None,
    labels: Path | None,
    label_source: str | None,
    against: str | None,
    picture: Path | None,
    no_picture: bool,
    flatten: bool,
    as_json: bool,
    reading: dict[str, Any],
    claim: Claim,
    quiet: bool,
) -> None:
    """Cut a sequence into near-rigid parts.

    TARGET is an npz file with the part of every triangle, or the animation with its parts: as GeomSubsets in USD, as
    groups in OBJ, Alembic and HDF5. A picture of the parts is drawn beside it.
    """
    from mixseq_io.text.label_files import check_holds_labels, write_labels

    how = _method(method, parts, labels, label_source)
    if seed is not None:
        _with_seed(how, seed)  # before the work
    check_holds_labels(target)
    if picture is not None and no_picture:
        raise SettingsError("--picture and --no-picture exclude each other")
    drawn = None if no_picture else picture or _picture_beside(target)
    claim(target, drawn)
    if drawn is not None:
        _check_picture(drawn)
    with progress_bar(quiet) as progress, mixseq.open_sequence(path, **reading) as reader:
        from mixseq.segmentation.joints import frames_to_look_at
        from mixseq.sequence.sequence import frame_store

        frames = frame_store(reader, progress)
        some = frames.points[frames_to_look_at(len(frames.points))]
        if how in _GIVEN:
            wanted = "skeleton" if how == "skeleton" else label_source
            given = connected(reader.header, chosen_labels(reader, labels, wanted, reading))
        else:
            given = _found(reader.header, some, how, parts, seed)
        found = _measured(reader.header, some, given)
        agreement = None if against is None else _agreement(reader, some[0], given, against)
        write_labels(target, reader, given, flatten=flatten)
        if drawn is not None:
            _draw(drawn, reader.header, some[0], given)
    if as_json:
        told = {} if agreement is None else {"agreement": asdict(agreement)}
        print_json({"source": str(path), "method": how} | found.as_dict() | told)
        return
    if not quiet:
        print_table(found.rows, ("part", "faces", "area", "near-rigid error"))
    if agreement is not None and not quiet:
        say(str(agreement))
    for each in filter(None, (target, drawn)):
        announce(each)


@dataclass(frozen=True)
class _Measured:
    """Measures of parts: names, numbers of triangles, shares of the area, errors in percent."""

    names: Sequence[str]
    faces: Sequence[int]
    areas: Sequence[float]
    errors: Sequence[float]
    whole: float

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """Table rows, the whole mesh last."""
        columns = zip(self.names, self.faces, self.areas, self.errors, strict=True)
        rows = [(name, f"{faces}", f"{area:.1%}", f"{error:.2g} %") for name, faces, area, error in columns]
        total = (
            f"{len(self.names)} part{'s' * (len(self.names) != 1)}",
            f"{sum(self.faces)}",
            f"{sum(self.areas):.1%}",
            f"{self.whole:.2g} %",
        )
        return [*rows, total]

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        keys = ("name", "faces", "area", "near_rigid_percent")
        columns = zip(self.names, self.faces, self.areas, self.errors, strict=True)
        return {
            "parts": [dict(zip(keys, each, strict=True)) for each in columns],
            "near_rigid_percent": self.whole,
        }


def _method(method: str | None, parts: int | None, labels: Path | None, source: str | None) -> str:
    """Return the method chosen by the options."""
    told = labels is not None or source is not None
    how = method or ("labels" if told else "motion")
    if told and how not in _GIVEN:
        raise SettingsError(f"--labels and --source are no settings of the method {how}; leave out --method")
    if how == "skeleton" and source not in (None, "skeleton"):
        raise SettingsError(f"the method skeleton takes labels from the skeleton, not from {source}")
    if how in _GIVEN and parts is not None:
        raise SettingsError("given labels tell how many parts there are; leave out --parts")
    return how


def _picture_beside(target: Path) -> Path:
    """Return the path of the picture; that of numbered files has no number."""
    stem = re.sub(r"[-_. ]*(#+|\*+|%\d*d)", "", target.stem)
    return target.with_name(f"{stem}-parts.png" if stem else "parts.png")


def _check_picture(picture: Path) -> None:
    """Raise an error, before the work, for other extensions, or if the drawing library is missing."""
    from mixseq.pictures.page import matplotlib_module

    if picture.suffix.lower() != ".png":
        raise OutputError(f"{picture}: the picture is a PNG file; end the name in .png")
    matplotlib_module("figure")


def _found(
    header: SequenceHeader, points: FloatArray, method: str, parts: int | None, seed: int | None
) -> Labels:
    from mixseq.mesh.topology import Topology
    from mixseq.segmentation.methods import segment
    from mixseq_io.text.labels import Labels

    topology = Topology(header.faces, header.vertex_count)
    settings = None if seed is None else _with_seed(method, seed)
    labels = segment(points, topology, cast("SegmentationName", method), parts, settings)
    return Labels(labels, tuple(f"part_{number:02d}" for number in range(int(labels.max(initial=-1)) + 1)))


def _with_seed(method: str, seed: int) -> MethodSettings:
    from mixseq.segmentation.methods import METHODS

    found = METHODS.get(cast("SegmentationName", method))
    if found is None or "seed" not in {field.name for field in fields(found.settings)}:
        raise SettingsError(f"the method {method} has no random numbers; leave out --seed")
    return found.settings(seed=seed)  # type: ignore[call-arg]


def _areas(points: FloatArray, header: SequenceHeader) -> NDArray[np.float64]:
    """Return twice the area of every triangle in a pose ``(V, 3)``."""
    import numpy as np

    a, b, c = (points[header.faces[:, corner]].astype(np.float64) for corner in range(3))
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1))


def _measured(header: SequenceHeader, points: FloatArray, labels: Labels) -> _Measured:
    import numpy as np

    from mixseq.segmentation.methods import near_rigid_errors

    parts, count = labels.part_of_face, len(labels.names)
    errors, whole = near_rigid_errors(points, header.faces, parts)
    area = np.bincount(parts, _areas(points[0], header), count)
    return _Measured(
        names=labels.names,
        faces=np.bincount(parts, minlength=count).tolist(),
        areas=(area / (area.sum() or 1.0)).tolist(),
        errors=errors.tolist(),
        whole=whole,
    )


@dataclass(frozen=True)
class _Agreement:
    """Adjusted Rand indices against other labels: by triangles, and weighted by area."""

    against: str
    labels: int
    by_faces: float
    by_area: float

    def __str__(self) -> str:
        return (
            f"adjusted Rand index against {self.against} ({self.labels} labels): {self.by_faces:.3f} by faces, "
            f"{self.by_area:.3f} by area"
        )


def _agreement(reader: SequenceReader, points: FloatArray, labels: Labels, source: str) -> _Agreement:
    from mixseq.segmentation.methods import adjusted_rand_index
    from mixseq_io.text.label_files import labels_of

    others = labels_of(reader, source)
    ours, theirs = labels.part_of_face, others.part_of_face
    by_area = adjusted_rand_index(ours, theirs, _areas(points, reader.header))
    return _Agreement(source, len(others.names), adjusted_rand_index(ours, theirs), by_area)


def _draw(picture: Path, header: SequenceHeader, points: FloatArray, labels: Labels) -> None:
    import numpy as np

    from mixseq.pictures.sheets import draw_segmentation
    from mixseq_io.files import replacing

    no_joints: NDArray[np.int64] = np.full(len(header.faces), -1)
    title = f"{header.name}: {len(labels.names)} parts"
    with replacing(picture) as temporary:
        draw_segmentation(
            temporary, points, header.faces, labels.part_of_face, no_joints, header.up_axis, title
        )
