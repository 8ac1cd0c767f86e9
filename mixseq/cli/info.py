"""Implement the command ``mixseq info``, and the tables about models that commands share."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mixseq
from mixseq.cli import options
from mixseq.cli.files import history_rows, is_model, load_or_fit, options_of, read_sequence
from mixseq.cli.group import format_bytes, length_text, print_json, print_table, progress_bar
from mixseq.cli.options import argument, setting
from mixseq.sequence.frame_rates import format_frames, format_rate, time_to_number

if TYPE_CHECKING:
    from mixseq.compression.bitstream.compressed_sequence import CompressedSequence
    from mixseq.sequence.header import SequenceHeader
    from mixseq.signals.model import Model


Rows = list[tuple[str, str]]

MAX_LIST_LENGTH = 240
"""Largest length of the text of a list, three lines of a table, in characters."""


@options.command(
    "info",
    "mixseq info walk.usdc",
    "mixseq info walk.h5 --json",
    "mixseq info run.h5 --set moments=walk.h5",
    path=argument(metavar="FILE"),
    moments=setting(
        "--moments FILE",
        "Find where it is best left for another motion of its mesh, or for the same file, where it loops.",
    ),
)
def command(path: Path, moments: Path | None, as_json: bool, reading: dict[str, Any], quiet: bool) -> None:
    """Show the contents of a sequence or a model.

    For a sequence, only the first frame is read, unless moments are to be found.
    """
    facts: dict[str, Any] = {"file": str(path), "bytes": {"total": path.stat().st_size if path.is_file() else None}}
    if is_model(path):
        from mixseq_io.model_files import is_compressed, read_compressed

        if is_compressed(path):
            coded = read_compressed(path)
            header = coded.header
            facts |= {"kind": "model", **_mesh(header, coded.parameters.diagonal), **coding_facts(path, coded)}
            facts["further_bodies"] = [body.header.name for body in coded.bodies]
        else:
            model = mixseq.load(path)
            header = model.header
            facts |= {"kind": "model", **_mesh(header, model.space.scale), **_dimensions(model)}
            headers = [model.body(name).header for name in model.body_names]
            facts["bytes"]["frames"] = sum(map(bytes_of_frames, headers))
    else:
        with mixseq.open_sequence(path, **reading) as reader:
            from mixseq.sequence.sequence import reference_diagonal

            header = reader.header
            facts |= {"kind": "sequence", **_mesh(header, reference_diagonal(reader.blocks(1)).length)}
    if moments is not None:
        facts["moments"] = _find_moments(path, moments, reading, quiet)
    if as_json:
        print_json(facts | {"provenance": header.provenance and header.provenance.to_plain()})
    elif not quiet:
        print_table([*_rows(facts), *history_rows(header)])


def _find_moments(path: Path, other: Path, reading: Mapping[str, Any], quiet: bool) -> list[dict[str, float]]:
    """Find the moments to leave a file for another one, or the loops of one; sequences are fitted."""
    from mixseq.operations import find_moments, fit_shots

    with progress_bar(quiet) as progress:
        if path.resolve() == other.resolve():
            a = b = load_or_fit(path, progress, reading=reading)
        elif is_model(path) or is_model(other):
            a, b = (load_or_fit(each, progress, reading=options_of(each, reading)) for each in (path, other))
        else:
            shots = [read_sequence(each, options_of(each, reading), progress) for each in (path, other)]
            a, b = fit_shots(shots, progress=progress)
        moments = find_moments(a, None if a is b else b)
    return [
        moment._asdict()
        | {
            "leave_frame": time_to_number(moment.leave, a.header.fps),
            "enter_frame": time_to_number(moment.enter, b.header.fps),
        }
        for moment in moments
    ]


def _moment_rows(moments: Sequence[Mapping[str, float]]) -> Rows:
    """Return table rows for the results of `_find_moments`."""
    text = (
        "leave at frame {leave_frame:.5g} ({leave:.4g} s), enter at frame {enter_frame:.5g} ({enter:.4g} s); "
        "distance {distance:.2g}, strain {strain:.2g}"
    )
    if not moments:
        return [("moments", "none: no loop of half a second or more")]
    return [(f"moment {number}", text.format_map(moment)) for number, moment in enumerate(moments, start=1)]


def coding_facts(path: Path, coded: CompressedSequence) -> dict[str, Any]:
    """Return the size in bytes, bit rates and errors of a compressed model in a file."""
    from mixseq_io.model_files import compressed_sizes

    sizes, bodies = compressed_sizes(path), [asdict(body.parameters) for body in coded.all_bodies]
    rate = 8 / (coded.header.frame_count * sum(body.header.vertex_count for body in coded.all_bodies))
    largest = {name: max(body[name] for body in bodies) for name in ("max_error", "kg_percent")}
    return {
        "bytes": sizes,
        "coding": {
            **bodies[0],
            **largest,
            "order": coded.order,
            "groups": len(coded.basis),
            "chunks": len(coded.chunks),
            "bits": {name: rate * sizes[name] for name in ("signals", "total")},
            "bits_of_motion": rate * (sizes["signals"] - sizes["surface"] - sizes["uvs"]),
        },
    }


def coding_rows(facts: dict[str, Any], metres_per_unit: float) -> Rows:
    """Return table rows for the result of `coding_facts`."""
    sizes, coding = facts["bytes"], facts["coding"]
    stated = "at most " if coding["promised"] else ""
    components = [
        ("connectivity", "faces"),
        ("uvs", "texture coordinates"),
        ("surface", f"{'texture coordinates' if coding['uv_error'] is None else 'face sets'} and the like"),
        ("still", "first frame and textures"),
        ("container", "container"),
    ]
    motion = sizes["signals"] - sizes["surface"] - sizes["uvs"]
    rates = [("signals", motion, coding["bits_of_motion"]), ("total", sizes["total"], coding["bits"]["total"])]
    rows = [
        *((name, f"{format_bytes(size)}, {rate:.3g} bits per vertex and frame") for name, size, rate in rates),
        ("of it", ", ".join(f"{format_bytes(sizes[name])} {what}" for name, what in components if sizes[name])),
        ("max error", stated + length_text(coding["max_error"], coding["diagonal"] * metres_per_unit, digits=3)),
        ("KG error", f"{coding['kg_percent']:.3g} %"),
    ]
    if coding["inbetween_error"] is not None:
        length = length_text(coding["inbetween_error"], coding["diagonal"] * metres_per_unit, digits=2)
        rows.append(("in-betweens", f"players are {length} from the model at most"))
    if coding["uv_error"] is not None:
        rows.append(("texture error", f"at most {coding['uv_error']:.3g} of the square"))
    return rows


def dimension_rows(model: Model) -> Rows:
    """Return table rows about the shape space of a model."""
    return _dimension_rows(_dimensions(model), len(model.header.faces))


def _mesh(header: SequenceHeader, diagonal: float) -> dict[str, Any]:
    topology = mixseq.Topology(header.faces, header.vertex_count)
    return {
        "name": header.name,
        "vertices": header.vertex_count,
        "polygons": len(header.polygons.counts),
        "triangles": len(header.faces),
        "frames": header.frame_count,
        "first_frame": time_to_number(header.times[0], header.fps),
        "last_frame": time_to_number(header.times[-1], header.fps),
        "first_time": float(header.times[0]),
        "last_time": float(header.times[-1]),
        "fps": header.fps,
        "up_axis": header.up_axis,
        "metres_per_unit": header.metres_per_unit,
        "diagonal": diagonal,
        "topology": topology.report(),
        "surface": _surface(header),
    }


def _surface(header: SequenceHeader) -> dict[str, Any]:
    surface = header.surface
    return {
        "objects": [
            {
                "name": each.name,
                "path": each.path,
                "vertices": each.vertex_count,
                "polygons": each.polygon_count,
                "subdivision": scheme,
            }
            for each, scheme in zip(surface.objects, surface.subdivisions, strict=False)
        ],
        "face_sets": [
            {"name": each.name, "polygons": len(each.polygons), "material": each.material} for each in surface.face_sets
        ],
        "uvs": None if surface.uvs is None else len(surface.uvs.values),
        "colours": None if surface.colours is None else len(surface.colours.values),
        "creases": surface.hard_edges is not None,
        "subdivision": surface.subdivision,
        "origin": None if surface.origin is None else surface.origin.path,
    }


def bytes_of_frames(header: SequenceHeader) -> int:
    """Return the size in bytes of all frames in single precision."""
    return 12 * header.frame_count * header.vertex_count


def size_row(total: int, frames: int) -> tuple[str, str]:
    """Return the table row that compares the bytes of a model with the bytes of its frames."""
    return "size", f"{format_bytes(total)}, {total / frames:.2f} times the frames in single precision"


def _dimensions(model: Model) -> dict[str, Any]:
    """Return the dimensions of a model's signals and, in the mixed space, of its parts, joints and edges."""
    signals = {
        "space": model.space.name,
        "dim": model.space.dim,
        "key_shapes": len(model.shapes),
        "time_knots": len(model.time.times),
        "placement_knots": len(model.placement.times),
        "further_bodies": list(model.body_names[1:]),
    }
    if model.space.segmentation is None:
        return signals
    space = model.mixed
    edges = 2 * len(space.topology.edges) + 6
    return signals | {
        "correction_knots": len(model.correction.times),
        "placement": space.placement,
        "dim_edges": edges,
        "edges_per_dim": edges / space.dim,
        "part_vertices": [len(part) for part in space.decomposition.parts],
        "placements": space.articulation.body_count,
        "joint_faces": int(space.joint_faces.sum()),
        "share": space.projection.share,
    }


def _rows(facts: dict[str, Any]) -> Rows:
    rows = [
        (facts["kind"], facts["name"]),
        ("vertices", f"{facts['vertices']:,}"),
        ("polygons", f"{facts['polygons']:,}"),
        ("triangles", f"{facts['triangles']:,}"),
        ("frames", format_frames(facts["frames"], facts["first_frame"], facts["last_frame"])),
        ("time", f"{facts['first_time']:g} to {facts['last_time']:g} s"),
        ("rate", f"{format_rate(facts['fps'])} frames per second"),
        ("up", facts["up_axis"]),
        ("units", f"{facts['metres_per_unit']:g} m"),
        ("diagonal", f"{facts['diagonal']:.6g}"),
        *_topology_rows(facts["topology"]),
        *_surface_rows(facts["surface"]),
        *([("further bodies", _list(facts["further_bodies"]))] if facts.get("further_bodies") else []),
    ]
    if "coding" in facts:
        rows += coding_rows(facts, facts["metres_per_unit"])
    elif facts["kind"] == "model":
        rows += [*_dimension_rows(facts, facts["triangles"]), size_row(**facts["bytes"])]
    elif facts["bytes"]["total"] is not None:
        rows.append(("size", format_bytes(facts["bytes"]["total"])))
    return rows + _moment_rows(facts["moments"]) if "moments" in facts else rows


def _topology_rows(report: dict[str, Any]) -> Rows:
    what = ("non-manifold edges", "inconsistent edges", "unused vertices")
    counts = {name: report[name.replace("-", "_").replace(" ", "_")] for name in what}
    return [
        ("closed", "yes" if report["closed"] else f"no, {report['boundary_edges']:,} boundary edges"),
        ("components", f"{report['components']:,}"),
        *((name, f"{count:,}") for name, count in counts.items() if count),
    ]


def _surface_rows(surface: dict[str, Any]) -> Rows:
    objects, face_sets = surface["objects"], surface["face_sets"]
    schemes = Counter(each["subdivision"] for each in objects)
    rows = [
        ("meshes", [each["path"] or each["name"] for each in objects] if len(objects) > 1 else []),
        ("face sets", [each["name"] for each in face_sets]),
    ]
    texts = [
        *((what, f"{len(names)}: {_list(names)}" if names else "") for what, names in rows),
        ("texture", f"{surface['uvs']:,} coordinates" if surface["uvs"] else ""),
        ("colours", f"{surface['colours']:,}" if surface["colours"] else ""),
        ("hard edges", "yes" if surface["creases"] else ""),
    ]
    if len(schemes) > 1:
        each_scheme = ", ".join(f"{name} of {count:,}" for name, count in schemes.most_common())
        texts.append(("subdivision", each_scheme))
    elif surface["subdivision"] != "none":
        texts.append(("subdivision", surface["subdivision"]))
    return [row for row in texts if row[1]]


def _dimension_rows(facts: dict[str, Any], triangles: int) -> Rows:
    knots = f"{facts['time_knots']:,} of the time signal, {facts['placement_knots']:,} of the placement"
    vector, shapes = f"{facts['dim']:,} numbers", ("key shapes", f"{facts['key_shapes']:,}")
    if facts["space"] != "mixed":
        return [("space", facts["space"]), ("vector", vector), shapes, ("knots", knots)]
    shorter, parts, joints = facts["edges_per_dim"], facts["part_vertices"], facts["joint_faces"]
    ratio = f"{shorter:.2f} times shorter" if shorter >= 1 else f"{1 / shorter:.2f} times longer"
    return [
        ("space", f"mixed, {facts['placement']} placement"),
        ("vector", f"{vector}, {ratio} than all lengths and angles"),
        shapes,
        ("knots", f"{knots}, {facts['correction_knots']:,} of corrections"),
        ("parts", f"{len(parts)} with {_list(parts)} vertices"),
        ("placements", f"{facts['placements']}"),
        ("joints", f"{joints:,} faces, {100 * joints / max(triangles, 1):.1f} % of all"),
        ("share", f"{facts['share']:g}"),
    ]


def _list(items: Sequence[object]) -> str:
    return textwrap.shorten(", ".join(map(str, items)), MAX_LIST_LENGTH, placeholder=" ...")
