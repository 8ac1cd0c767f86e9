"""Implement the command ``mixseq edit``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mixseq
from mixseq.cli import options
from mixseq.cli.files import MODEL_EXTENSIONS, Claim, check_target, history_rows, load_or_fit, write_frames
from mixseq.cli.group import announce, print_table, progress_bar
from mixseq.cli.options import argument, option, setting
from mixseq.errors import SettingsError

if TYPE_CHECKING:
    from mixseq.operations.script import Edit
    from mixseq.signals.model import Model


SCRIPT_HELP = """\b
A script has a table for every edit:
  [[edit]]
  operation = "repeat"
  start = 0.2
  end = 0.9
  times = 3
\b
  [[edit]]
  operation = "transition"
  b = "slash.h5"
  at = 1.5
  duration = 0.25

"""


@options.command(
    "edit",
    "mixseq edit run.h5 attack.h5 --script attack.toml",
    "mixseq edit walk.h5 long.usdc --script edits.toml --fps 48",
    before=SCRIPT_HELP,
    source=argument(metavar="SOURCE"),
    target=argument(metavar="OUT"),
    script=option("--script FILE", "The edits, a TOML file.", required=True),
    folders=setting(
        "--files-from FOLDER",
        "Let the script read files in this folder, too, besides its own; may be given several times.",
        multiple=True,
    ),
    travel=setting(
        "--travel FILE",
        "Also write what in_place takes away, for engines to move the character by: a CSV file of seconds,x,y,z.",
    ),
    body=options.body("Body of a model with several that edits see, and that OUT shows first.  [default: its first]"),
    fps=options.fps("Frames per second, where OUT is a sequence.  [default: the frames of the model]"),
    velocities=options.velocities("Also write the velocities of all vertices, where OUT is a sequence."),
)
def command(
    source: Path,
    target: Path,
    script: Path,
    folders: tuple[Path, ...],
    travel: Path | None,
    body: str | None,
    fps: float | None,
    velocities: bool,
    writing: dict[str, Any],
    workers: options.Workers,
    claim: Claim,
    quiet: bool,
) -> None:
    """Edit the motion of a model or a sequence by a script.

    SOURCE is a model, or a sequence in any format, which is turned into an exact model first. OUT is a model if it ends
    in .h5 or .hdf5, and a sequence in any other format, see "mixseq formats".

    A model with several bodies, from "mixseq transfer --as-body", is edited once: OUT has them all, if it is a model.

    The script is a TOML file; its edits are applied in order. Operations are cut, repeat, loop, shift, speed,
    reverse, retime, concatenate, transition, blend, in_place, exaggerate, exaggerate_part, hold, smooth, sculpt, pose,
    drag and sketch; their settings are the parameters of these functions in mixseq.operations. Paths in a
    script are relative to the script's folder, and must be in this folder or its subfolders.
    """
    from mixseq.operations.script import RETIMING_OPERATIONS, Readers, read_script

    as_model = target.suffix.lower() in MODEL_EXTENSIONS
    if as_model:
        options.refuse(
            *("fps", "velocities", *writing), why="is for sequences; OUT is a model, decode or resample it then"
        )
    claim(target, travel)

    def unlike_target(path: Path) -> Path:
        check_target(target, path)
        return path

    readers = Readers(
        model=lambda path: mixseq.load(unlike_target(path)),
        mesh=lambda path: mixseq.read(unlike_target(path)),
        folders=folders,
    )
    rows = []
    with workers as work, progress_bar(quiet) as progress:
        model = load_or_fit(source, progress, body, exact=True, workers=work)
        edits = read_script(script, readers)
        in_place = [edit for edit in edits if edit.operation == "in_place"]
        if travel is not None and len(in_place) != 1:
            raise SettingsError(
                f"the script has the operation in_place {len(in_place)} times; travel is what it takes away, have it "
                "once"
            )
        for edit in edits:
            progress(edit.number - 1, len(edits), edit.operation)
            if travel is not None and edit in in_place:
                _write_travel(travel, model, edit)
            edited = edit(model)
            rows.append((f"{edit.number}  {edit.operation}", _extent(model), _extent(edited)))
            model = edited
        if as_model:
            mixseq.save(target, model)
        else:
            header = model.header_at(fps=fps)
            retimed = any(edit.operation in RETIMING_OPERATIONS for edit in edits)
            sources = [math.nan] * header.frame_count if retimed else None
            write_frames(target, model, header, velocities, writing, progress, work, sources)
    if not quiet:
        print_table(rows, ("edit", "before", "after"))
        print_table(history_rows(model.header))
    announce(target)


def _write_travel(path: Path, model: Model, edit: Edit) -> None:
    """Write the displacement of the body at every frame of a model, which an edit will remove."""
    from mixseq.operations import travel_of
    from mixseq_io.files import atomic_file

    places = travel_of(model, **edit.arguments)(model.times)
    rows = (
        ",".join(f"{number:.9g}" for number in (time, *place)) for time, place in zip(model.times, places, strict=True)
    )
    with atomic_file(path) as file:
        file.write_text("\n".join(["seconds,x,y,z", *rows, ""]), encoding="utf-8")


def _extent(model: Model) -> str:
    header = model.header
    return f"{model.start:g} to {model.end:g} s, {header.frame_count:,} frames ({header.frame_numbers})"
