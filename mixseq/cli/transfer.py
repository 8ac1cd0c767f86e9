"""``mixseq transfer``, with its report as a table, as JSON and as a picture."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import mixseq
from mixseq.choices import TRANSFERS
from mixseq.cli import files, options
from mixseq.cli.group import announce, length_text, print_json, print_table, progress_bar
from mixseq.cli.options import POSITIVE_INTEGER, argument, option, setting
from mixseq.errors import MixseqWarning, OutputError, SettingsError
from mixseq.runtime.progress import forward_warnings

if TYPE_CHECKING:
    from mixseq.choices import TransferName
    from mixseq.retargeting.contacts import ContactReport
    from mixseq.retargeting.correspond import CorrespondenceQuality
    from mixseq.retargeting.report import FrameCounts, TransferReport
    from mixseq.retargeting.transfer import Transfer
    from mixseq.retargeting.verdict import Verdict
    from mixseq.sequence.header import SequenceHeader
    from mixseq.sequence.sequence import MeshSequence
    from mixseq.signals.model import Model
    from mixseq_io.reader import SequenceReader


_SHARED_READ_OPTIONS = ("up_axis", "metres_per_unit")  # reader options that apply to all files

MAX_LISTED_NAMES = 4  # largest number of followers in the table


def facts(transferred: Transfer, method: str, report: TransferReport, verdict: Verdict) -> dict[str, Any]:
    """Return the report of a transfer as plain values for JSON."""
    quality, proposal = transferred.quality, transferred.proposal
    return {
        "method": method,
        "frames": transferred.header.frame_count,
        "vertices": transferred.header.vertex_count,
        **_part_counts(transferred),
        "turned_limbs_degrees": transferred.turned,
        "correspondence": quality and _quality_facts(quality),
        "proposal": proposal
        and {"tips": proposal.tip_count, "score": proposal.score, "margin": min(proposal.margin, 1.0)},
        **report.as_dict(),
        "contacts": asdict(transferred.contacts),
        "verdict": asdict(verdict),
    }


def rows(transferred: Transfer, report: TransferReport, verdict: Verdict) -> list[tuple[str, str]]:
    """Return the report of a transfer as table rows."""
    from mixseq.sequence.sequence import bounding_diagonal

    header, parts, turned = transferred.header, _part_counts(transferred), transferred.turned
    quality, proposal, covered = transferred.quality, transferred.proposal, report.coverage
    diagonal = bounding_diagonal(transferred.target) * header.metres_per_unit
    by = ", ".join(_number(count, what[:-1]) for what, count in parts.items()) or "deformation gradients"
    frames = _number(header.frame_count, "frame")
    followers = [f"{each.name} ({each.vertices:,} vertices) follows {each.leads}" for each in covered.followers]
    tips = proposal and f"{proposal.tip_count} at tips, {len(proposal.markers) - proposal.tip_count} between them"
    strains = (100 * each.rms for each in (report.strain, report.source_strain, report.excess))
    return [
        ("verdict", verdict.text),
        ("transferred", f"{frames} to {header.vertex_count:,} vertices, by {by}"),
        *([("rest pose", f"limbs turned by up to {turned:.0f} degrees into the source's")] if turned else []),
        (
            "corresponds",
            f"{_percent(covered.area)} of the target's area, {_percent(covered.source_area)} of the source's",
        ),
        *([("without counterpart", _first_names(followers))] if followers else []),
        *([] if quality is None else _quality_rows(quality, diagonal)),
        *([] if proposal is None else [("proposed", f"all markers: {tips}; sure, but look at the picture")]),
        ("strain", "{:.3g} % rms, source {:.3g} %; {:.3g} % unlike the source's".format(*strains)),
        ("acceleration", _smoothness(report, header)),
        ("self-intersections", _crossings(report, header)),
        ("turned over", _triangles(report.turned_over, header)),
        *([("flat", _triangles(report.flat, header))] if report.flat.worst else []),
        *_contact_rows(transferred.contacts, diagonal),
    ]


def _part_counts(transferred: Transfer) -> dict[str, int]:
    """Return the numbers of parts and joints of the target, or an empty dictionary if there are none."""
    parts = transferred.method.parts
    return {} if parts is None else {"parts": len(parts.target.parts), "joints": len(parts.target.joints)}


def _quality_facts(quality: CorrespondenceQuality) -> dict[str, Any]:
    """Return the numeric attributes of a correspondence quality, and the values of all markers by name."""
    names = [quality.markers.name(number) for number in range(len(quality.markers))]
    missed = zip(names, quality.marker_distances.tolist(), strict=True)
    distances = {name: getattr(quality, name) for name in ("mean_distance", "p99_distance", "largest_distance")}
    return {
        "source_coverage": quality.source_coverage,
        "target_coverage": quality.target_coverage,
        **{name: value if math.isfinite(value) else None for name, value in distances.items()},
        "flipped": quality.flipped_count,
        "filled_vertices": quality.filled_vertex_count,
        "filled_triangles": quality.filled_face_count,
        "followers": quality.follower_count,
        "markers": [{"name": name, "distance": distance} for name, distance in missed],
    }


def _quality_rows(quality: CorrespondenceQuality, diagonal: float) -> list[tuple[str, str]]:
    mean, largest = (
        length_text(distance, diagonal, digits=2) for distance in (quality.mean_distance, quality.largest_distance)
    )
    distances = f"{mean} off on average, {largest} at most"
    if not math.isfinite(quality.largest_distance):
        distances = "no vertex is near the source"
    facing = f"; {_number(quality.flipped_count, 'triangle')} on its other side" if quality.flipped_count else ""
    worst = quality.worst_marker
    missed = length_text(float(quality.marker_distances[worst]), diagonal, digits=2)
    return [
        ("matched", f"{_percent(quality.target_coverage)} of the target's area, {distances}{facing}"),
        ("markers", f"{len(quality.markers)}, at most {missed} off: {quality.markers.name(worst)}"),
    ]


def _smoothness(report: TransferReport, header: SequenceHeader) -> str:
    smooth = report.smoothness
    if smooth is None:
        return "takes three frames"
    if smooth.ratio is None:
        return "the source has none"
    worst = header.frame_number(smooth.worst_frame)
    return f"{smooth.ratio:.2f} times the source's, {smooth.max / smooth.source_max:.2f} at most (frame {worst})"


def _crossings(report: TransferReport, header: SequenceHeader) -> str:
    counts, worst = report.intersections, header.frame_number(report.intersections.worst_frame)
    of_source = f"source {report.source_intersections.worst:,}"
    return f"{_number(counts.worst, 'pair')} at most (frame {worst}), {counts.rest:,} at rest; {of_source}"


def _triangles(counts: FrameCounts, header: SequenceHeader) -> str:
    if not counts.worst:
        return "no triangle"
    return f"{_number(counts.worst, 'triangle')} at most (frame {header.frame_number(counts.worst_frame)})"


def _contact_rows(contacts: ContactReport, diagonal: float) -> list[tuple[str, str]]:
    """Return table rows with the sliding of every contact, and the largest shift and rotation that reduce it."""
    result = []
    for group in contacts.groups:
        stances = _number(len(group.stances), "stance")
        before, after = (length_text(length, diagonal, digits=2) for length in (group.before, group.after))
        slid = f"slides {before} as transferred, {after} now"
        longer = f", limb longer by {100 * group.residual:.2g} %" if group.residual > 0 else ""
        result.append((group.name, f"{stances}, {slid}{longer}"))
    if contacts.groups:
        shift = length_text(contacts.shift, diagonal, digits=2)
        result.append(("moved", f"body by {shift}, limbs by {contacts.turn:.2g} degrees at most"))
    return result


def _first_names(names: list[str]) -> str:
    more = len(names) - MAX_LISTED_NAMES
    return ", ".join(names[:MAX_LISTED_NAMES]) + (f" and {more} more" if more > 0 else "")


def _number(count: int, what: str) -> str:
    return f"{count:,} {what}{'s' * (count != 1)}"


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


# Picture ---------------------------------------------------------------------------------------------------


def _frames_to_draw(transferred: Transfer, frame: int, rest_file: Path | None, verdict: Verdict) -> list[int]:
    """Choose up to 5 frames for the picture, with the worst ones and without the rest frame, which is always drawn."""
    from mixseq.types import evenly_spaced

    count = transferred.header.frame_count
    chosen = [int(each) for each in evenly_spaced(count, 5)]
    chosen = [each for each in chosen if rest_file is not None or each != frame % count] or chosen
    for worst in (finding.frame for finding in verdict.findings if finding.vertex is not None):
        if worst is not None and worst not in chosen:
            nearest = min(chosen, key=lambda each: abs(each - worst))
            chosen[chosen.index(nearest)] = worst
    return chosen


@options.command(
    "transfer",
    "mixseq transfer walk.usdc tall.obj tall_walk.usdc",
    "mixseq transfer horse.h5 camel.obj camel.usdc --markers pairs.txt --save-map map.npz",
    "mixseq transfer gallop.abc camel.obj camel.abc --map map.npz --rest horse.obj",
    "mixseq transfer gallop.h5 camel.obj herd.h5 --markers pairs.txt --as-body camel",
    out=argument(),
    markers=option("--markers FILE", "Pairs of vertices that are the same: SOURCE, TARGET.  [default: proposed]"),
    reverse=option("--reverse", "The vertices of TARGET come first in --markers."),
    map_file=option("--map FILE", "Dense correspondence, instead of markers."),
    save_map=option("--save-map FILE", "Keep the correspondence, for --map."),
    method=option(
        "--method",
        "Parts, joints and poses, or deformation gradients (Sumner and Popović).",
        type=click.Choice(TRANSFERS),
        default="mixed",
    ),
    rest=option(
        "--rest FRAME|FILE",
        "Frame in which SOURCE is in TARGET's pose, or a file with the same mesh in that pose.  [default: the first; "
        "of glTF SOURCE without animation]",
    ),
    parts=option(
        "--parts N",
        "Number of parts of SOURCE; every connected component has at least one.  [default: automatic]",
        type=POSITIVE_INTEGER,
    ),
    contacts=option(
        "--contacts FILE",
        'Vertices of TARGET that shall not slide while SOURCE rests there, as JSON: {"left foot": [12, 13], ...}.',
    ),
    as_body=option(
        "--as-body NAME",
        "OUT is the model SOURCE with TARGET as another body, which moves by the same time and pose signals; only key "
        "poses are transferred.",
    ),
    target_prim=setting("--target-prim PATH", "Mesh to read of TARGET, as --prim is of SOURCE."),
    picture=options.picture("OUT"),
)
def command(
    source: Path,
    target: Path,
    out: Path,
    markers: Path | None,
    reverse: bool,
    map_file: Path | None,
    save_map: Path | None,
    method: TransferName,
    rest: str | None,
    parts: int | None,
    joint_width: int,
    labels: files.LabelChoice,
    contacts: Path | None,
    as_body: str | None,
    target_prim: str | None,
    picture: dict[str, Any],
    as_json: bool,
    reading: dict[str, Any],
    writing: dict[str, Any],
    workers: options.Workers,
    claim: files.Claim,
    quiet: bool,
) -> None:
    """Move a mesh as another one moves.

    SOURCE is a sequence in any format, or a model. The first frame of TARGET is the mesh to move; its pose should be
    like the pose of SOURCE at --rest. From glTF files, both are read without animation, mostly in the bind pose. OUT's
    format follows from its extension, see "mixseq formats"; frames are written while later frames are computed.

    Meshes with the same triangles need nothing else. For two bodies of one kind (two humans, two four-legged animals),
    markers are proposed where they are sure; otherwise OUT is not made. --markers is a file with your own: one pair of
    vertices per line, counted from 0 ("mixseq view" sets them). The other correspondences are found by bending SOURCE
    onto TARGET, which takes a while; --save-map saves them for the next time. Components of TARGET without markers
    follow adjacent components.

    The first line says whether OUT is good, or where and in which frame to look; the table below it has the figures,
    and --json all of them. A picture of both is drawn next to OUT, with rings at the places to look at.

    With --as-body only the key poses of SOURCE are transferred, and OUT holds the bodies of SOURCE and one more.
    "mixseq edit" edits all of them at once, "mixseq decode --body" makes sequences of them.

    --up-axis and --units apply to all files, other reading options only to SOURCE.
    """
    if map_file is not None:
        options.refuse("markers", why="and --map are two ways to say the same; give one of them")
    if markers is None:
        options.refuse("reverse", why="is about the order of --markers; give both, or neither")
    picture_file = files.picture_path(out, "transfer", **picture)
    if method == "gradients":
        for name in options.given_options("parts", "joint_width", "labels", "label_source", "contacts"):
            raise SettingsError(f"the method gradients knows no parts; leave out {name}, or --method")
    if as_body is not None:
        if not (files.is_model(source) and out.suffix.lower() == ".h5"):
            raise SettingsError("--as-body makes a model of a model: SOURCE and OUT are .h5 files; see mixseq encode")
        why = "are kept frame by frame, and only key poses are transferred; leave one out"
        options.refuse("contacts", why=why)
    frame, rest_file = _rest_frame_or_file(rest, source)
    claim(out, picture_file, save_map, read=[rest_file])
    _check_formats(out, save_map)
    if picture_file is not None:
        files.check_picture(picture_file)
    common = {name: value for name, value in reading.items() if name in _SHARED_READ_OPTIONS}
    notes: list[str] = []
    with (
        workers as work,
        progress_bar(quiet) as progress,
        forward_warnings(notes.append),
        _open_source(source, reading) as source_motion,
    ):
        from mixseq.operations import key_poses, with_body
        from mixseq.retargeting.report import TransferMeter
        from mixseq.retargeting.sources import prepare_source
        from mixseq.retargeting.transfer import TransferSettings, plan_transfer
        from mixseq.retargeting.verdict import judge_transfer
        from mixseq.sequence.sequence import join_blocks
        from mixseq_io.files import atomic_file
        from mixseq_io.text.maps import read_map, to_correspondence, write_map
        from mixseq_io.text.markers import read_contacts, read_markers

        pairs = None if markers is None else read_markers(markers, reverse=reverse)
        feet = None if contacts is None else read_contacts(contacts)
        if rest is not None and rest_file is None and frame >= 0:
            frame = source_motion.header.index_of(frame)
        target_mesh = files.first_frame(target, common | ({} if target_prim is None else {"prim": target_prim}))
        rest_shape = frame if rest_file is None else _mesh_at_rest(rest_file, reading, source_motion, rest is None)
        source_parts = _parts_of_source(source_motion, parts, labels, reading)
        model: Any = source_motion
        if as_body is not None:
            if as_body in model.body_names:
                raise SettingsError(f"{source} has a body {as_body!r}; give another name")
            source_parts = model.parts
            if isinstance(rest_shape, int):
                rest_shape = model.sample(frames=[rest_shape])
        moving = source_motion if as_body is None else key_poses(model)
        motion = prepare_source(moving, rest_shape, source_parts, progress)
        mapping = None
        if map_file is not None:
            meshes = (motion.rest, motion.header.faces), (target_mesh.points[0], target_mesh.faces)
            mapping = to_correspondence(read_map(map_file), *meshes)
        settings = TransferSettings(pairs, mapping, method, contacts=feet, joint_width=joint_width)
        transferred = plan_transfer(motion, target_mesh, settings, progress, work)
        if save_map is not None:
            write_map(save_map, transferred.correspondence, transferred.source.header.faces, transferred.header.faces)
        meter = TransferMeter(transferred)
        blocks = meter.measure_blocks(transferred.blocks(progress, work))
        if as_body is not None:
            keys, found = join_blocks(transferred.header, blocks), transferred.method.parts
            target_parts, turn = None if found is None else found.labels, transferred.method.alignment.rotation
            mixseq.save(out, with_body(model, keys, as_body, target_parts, turn))
        else:
            files.write_sequence(out, transferred.header, blocks, None, writing)
        report = meter.report()
        verdict = judge_transfer(transferred, report)
        if picture_file is not None:
            from mixseq.pictures.sheets import transfer_sheet

            shown = _frames_to_draw(transferred, frame, rest_file, verdict)
            with atomic_file(picture_file) as temporary:
                transfer_sheet(temporary, transferred, shown, transferred.pose_frames(shown), verdict=verdict)
    if as_json:
        named = {"source": str(source), "target": str(target), "out": str(out)}
        print_json(named | facts(transferred, method, report, verdict) | {"warnings": notes})
        return
    if not quiet:
        print_table(rows(transferred, report, verdict))
    announce(save_map, out, picture_file)


def _rest_frame_or_file(text: str | None, source: Path) -> tuple[int, Path | None]:
    """Parse the rest pose: return a frame index, negative from the end, and the file if it is given as a file."""
    from mixseq_io.rig_files import GLTF_EXTENSIONS

    if text is None:
        return 0, source if source.suffix.lower() in GLTF_EXTENSIONS else None
    return (int(text), None) if re.fullmatch(r"-?\d+", text) else (0, Path(text))


def _mesh_at_rest(
    path: Path, reading: Mapping[str, Any], source_motion: SequenceReader | Model, is_default: bool
) -> MeshSequence | int:
    """Read the source's mesh at rest from a file; return frame 0 if a default file has a different mesh."""
    target_mesh = files.first_frame(
        path, {name: reading[name] for name in (*_SHARED_READ_OPTIONS, "prim") if name in reading}
    )
    header = source_motion.header
    if not is_default or (target_mesh.vertex_count, len(target_mesh.faces)) == (header.vertex_count, len(header.faces)):
        return target_mesh
    warnings.warn(
        f"{path}: without animation there are other meshes than those that move, so frame 0 counts as the rest; "
        "--prim / takes all meshes, --rest FRAME says that a frame is meant",
        MixseqWarning,
        stacklevel=2,
    )
    return 0


def _check_formats(out: Path, save_map: Path | None) -> None:
    """Raise an error before the work if an extension is not supported."""
    from mixseq_io.registry import FORMATS

    extensions = [extension for each in FORMATS for extension in each.extensions]
    if out.suffix.lower() not in extensions:
        raise OutputError(f"{out}: the extension {out.suffix!r} is not known; write one of {', '.join(extensions)}")
    if save_map is not None and save_map.suffix.lower() != ".npz":
        raise OutputError(f"{save_map}: maps are written as npz files; end the name in .npz")


def _open_source(source: Path, reading: Mapping[str, Any]) -> AbstractContextManager[SequenceReader | Model]:
    """Open a sequence, or load a model."""
    if not files.is_model(source):
        return mixseq.open_sequence(source, **reading)
    unused = [name for name in reading if name not in _SHARED_READ_OPTIONS]
    if unused:
        raise SettingsError(f"{source} is a model, which is read without options; leave out those for sequences")
    return nullcontext(mixseq.load(source))


def _parts_of_source(
    motion: SequenceReader | Model, parts: int | None, labels: files.LabelChoice, reading: Mapping[str, Any]
) -> Any:
    """Return the number of parts or the part labels of triangles, or None if neither is given."""
    from mixseq.signals.model import Model

    if not isinstance(motion, Model):
        return labels.parts(motion, parts, reading)
    if labels.is_given:
        raise SettingsError("labels are for sequences; leave out --labels and --source, the model has its own parts")
    return parts
