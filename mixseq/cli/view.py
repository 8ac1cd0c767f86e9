"""``mixseq view``: show and edit models in a browser, set markers, or export pages that play without the viewer."""

from __future__ import annotations

import os
import sys
import threading
import warnings
import webbrowser
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import mixseq
from mixseq.cli import options
from mixseq.cli.files import (
    MODEL_EXTENSIONS,
    Claim,
    check_options,
    check_place,
    check_target,
    first_frame,
    is_model,
    options_of,
    scene_items,
    write_frames,
)
from mixseq.cli.group import announce, in_diagonals_of_all, needed, progress_bar, say
from mixseq.cli.options import POSITIVE_INTEGER, FrameRate, Group, Setting, argument, flag, length, option, setting
from mixseq.errors import MixseqWarning, OutputError, SettingsError
from mixseq.runtime.interrupts import acknowledge_signal
from mixseq.runtime.progress import Progress, log_progress

if TYPE_CHECKING:
    from mixseq.pictures.colours import SceneColours
    from mixseq.pictures.scene import SceneItem
    from mixseq.retargeting.markers import Markers
    from mixseq.runtime.parallel import Executor
    from mixseq.sequence.sequence import LazyFrames, MeshSequence
    from mixseq.signals.model import Model
    from mixseq.viewer.live.marking import MarkedMeshes


@options.command(
    "view",
    "mixseq view walk.h5",
    "mixseq view walk.usdc walk.h5 --against walk.usdc",
    "mixseq view shot.abc --set browser=no --set port=9000",
    "mixseq view walk.h5 --export walk.html",
    "mixseq view horse.obj camel.obj --markers pairs.txt",
    files=argument(nargs=-1, required=True),
    against=option("--against SEQUENCE", "The original in any format, to colour errors."),
    markers=option(
        "--markers FILE",
        "Set markers of two meshes, for mixseq transfer: click pairs of points. FILE is continued, if it is there.",
    ),
    rate=option(
        "--fps N",
        "Frames per second; models are decoded at any rate.  [default: those of the first file]",
        type=FrameRate(1000),
    ),
    live=Group(
        setting(
            "--host ADDRESS",
            "Listen here; 0.0.0.0 for all who reach it and have the address.  [default: 127.0.0.1, this machine only]",
        ),
        setting(
            "--port N",
            "Listen at this port.  [default: 8080, or the next one that is free]",
            type=click.IntRange(1, 65535),
        ),
        flag("--read-only", "Nothing can be edited or saved in the browser."),
    ),
    looks=Group(
        flag("--overlaid", "Meshes stand in one place at first, not side by side; on pages, too.", cls=Setting),
        options.camera,
        flag("--follow", "Bodies that travel stay in the middle at first.", name="following", cls=Setting),
    ),
    browser=setting("--browser/--no-browser", "Open a browser.  [default: where there is a screen]", default=None),
    shading=setting("--shading", "simple is quick without a graphics card.", type=click.Choice(["smooth", "simple"])),
    threads=options.threads("Threads that open files and decode.  [default: all cores]"),
    page=option("--export PAGE", "Write a page (.html) that plays on its own, without a network, and end."),
    paging=Group(
        setting("--every N", "Of the frames of PAGE, keep every N-th.", type=POSITIVE_INTEGER),
        length(
            "--max-error E",
            "No vertex of PAGE is farther off than this fraction of the bounding box's diagonal, or 0.5mm; compressed "
            "models are taken as they are.  [default: 0.001]",
        ),
        setting(
            "--inbetweens/--no-inbetweens",
            "Fit a model to the frames of PAGE, whose motion it shows between them.  [default: inbetweens]",
            default=None,
        ),
    ),
)
def command(
    files: tuple[Path, ...],
    against: Path | None,
    scalar: Path | None,
    markers: Path | None,
    rate: float | None,
    live: dict[str, Any],
    looks: dict[str, Any],
    browser: bool | None,
    shading: str | None,
    threads: int | None,
    page: Path | None,
    paging: dict[str, Any],
    reading: dict[str, Any],
    claim: Claim,
    quiet: bool,
) -> None:
    """Look at models and sequences in a browser, and edit models in place.

    FILES are models or sequences in any format, shown side by side or overlaid. They play and can be scrubbed; colours
    show parts and joints, the error against the original, strain, or the change of curvature. All bodies of a model are
    shown, and what is edited of one plays on all. A model also has its time
    curve, which can be dragged or redrawn, its coefficients, and keys to retime it; buttons repeat, cut, hold and
    exaggerate, and points of the mesh are dragged to new poses. All edits can be undone. Results are saved as a model,
    a sequence or a script of the edits in the folder where the command was started.

    With --markers, the two FILES are shown at rest, each in its first frame (from glTF, in the pose without animation).
    Their motion only helps to propose pairs. Click corresponding points in pairs; the viewer proposes pairs where it is
    sure, and shows how well all pairs fit.

    The viewer runs until Ctrl-C. On another machine, forward its port: ssh -L 8080:127.0.0.1:8080 machine.
    """
    if markers is not None:
        options.refuse(
            *("page", "against", "scalar", "rate", "overlaid", "following", "read_only", "threads"),
            why="is not about setting markers; leave it out, or --markers",
        )
    if page is not None:
        options.refuse(
            *("host", "port", "read_only", "browser", "shading"),
            why="is about the viewer in a browser; leave it out, or --export",
        )
        if page.suffix.lower() not in (".html", ".htm"):
            raise SettingsError(f"{page}: pages end in .html")
        claim(page)
    else:
        options.refuse("every", "max_error", "inbetweens", "overwrite", why="is about pages; give --export as well")
        from mixseq.viewer.live import check_viser

        check_viser()
    viewing = {"material": "toon5" if shading == "simple" else "standard", **live, **looks}
    if markers is not None:
        _set_markers(files, markers, reading, viewing, browser)
        return
    with options.thread_limit(threads) as work:
        with progress_bar(quiet) as progress:
            colours = _opened(files, against, scalar, rate, reading, progress)
            if page is not None:
                _export(page, colours, files, {"fps": rate, **paging, **looks}, progress, work)
        if page is None:
            _run(colours, files, viewing, browser)


def _opened(
    files: Sequence[Path],
    against: Path | None,
    scalar: Path | None,
    fps: float | None,
    reading: Mapping[str, Any],
    progress: Progress,
) -> SceneColours:
    """Open models and read sequences, as a scene with colourings."""
    from mixseq.pictures.colours import SceneColours, check_original
    from mixseq.pictures.scene import Scene
    from mixseq.sequence.sequence import load_frames

    with ExitStack() as stack:
        items, original = scene_items(files, _names(files), against, reading, stack, scalar)
        scene = Scene(tuple(item.with_random_access(progress) for item in items), fps).validated()
        stored = None if original is None else load_frames(original, progress)
    if stored is not None:
        check_original(scene, stored)
    return SceneColours(scene, stored)


def _names(files: Sequence[Path]) -> list[str]:
    """Return unique names of files, made with folder names or, if necessary, numbers."""
    for parts in range(1, max(len(file.parts) for file in files) + 1):
        names = ["/".join(file.parts[-parts:]) for file in files]
        if len(set(names)) == len(files):
            return names
    return [f"{number + 1} {file.name}" for number, file in enumerate(files)]


def _run(colours: SceneColours, files: Sequence[Path], viewing: Mapping[str, Any], browser: bool | None) -> None:
    """Run the viewer until it is interrupted."""
    from mixseq.runtime.parallel import thread_count
    from mixseq.viewer.live import ViewSettings
    from mixseq.viewer.live.viewer import run_viewer

    settings = ViewSettings(folder=Path.cwd(), threads=thread_count(), **viewing)
    with run_viewer(colours, settings, partial(_save, files)) as running:
        try:
            _wait(running.address, browser)
        finally:
            acknowledge_signal()  # later saves are intentional
            for name, model in running.session.unsaved.items():
                kept = _free_name(Path(f"{Path(name).stem}-unsaved.h5"))
                mixseq.save(kept, model)
                warnings.warn(f"what was edited of {name} was not saved; it is in {kept}", MixseqWarning, stacklevel=1)


def _wait(address: str, browser: bool | None) -> None:
    """Print the address of the viewer, open it in a browser if there is a screen, and wait for Ctrl-C."""
    say(f"mixseq view: {address} (Ctrl-C ends it)")
    if browser or (browser is None and _has_screen()):
        webbrowser.open(address)
    try:
        threading.Event().wait()
    except KeyboardInterrupt:
        click.echo()


def _free_name(path: Path) -> Path:
    """Return a path for a new file; if the given file exists, append a number."""
    tries = (path, *(path.with_stem(f"{path.stem}-{number}") for number in range(2, 10_000)))
    return next(each for each in tries if not each.exists())


def _has_screen() -> bool:
    """Return whether a browser would be visible, which is false in a remote session or on a console."""
    if "SSH_CONNECTION" in os.environ:
        return False
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _save(sources: Sequence[Path], path: Path, edited: Model | str, replace: bool) -> str:
    """Write an edited model as a model or a sequence, or the text of a script; return a message.

    The message has the file name and the files that it needs.
    """
    from mixseq.runtime.parallel import thread_executor
    from mixseq_io.files import atomic_file
    from mixseq_io.numbered.files import find_numbered_files

    for source in sources:
        check_target(path, source)
    if not replace and (path.exists() or any(find_numbered_files(path))):
        raise OutputError(f"{path.name} exists; give another name, or tick Replace")
    try:
        if isinstance(edited, str):
            with atomic_file(path) as temporary:
                temporary.write_text(edited, encoding="utf-8")
        elif path.suffix.lower() in MODEL_EXTENSIONS:
            mixseq.save(path, edited)
        else:
            write_frames(path, edited, edited.header, False, {}, log_progress, thread_executor())
    except OSError as error:
        raise OutputError(f"{path}: {error.strerror or error}") from None
    return f"{path.name} in {path.parent}{needed(path)}"


# Markers of two meshes -----------------------------------------------------------------------------------


def _set_markers(
    files: Sequence[Path], path: Path, reading: Mapping[str, Any], viewing: Mapping[str, Any], browser: bool | None
) -> None:
    """Run a viewer for setting markers until it is interrupted, then write unsaved markers to a new file."""
    from mixseq.viewer.live import ViewSettings
    from mixseq.viewer.live.marking import run_marking_viewer
    from mixseq_io.text.markers import write_markers

    if len(files) != 2:
        raise SettingsError(f"markers are of two meshes, a source and a target; {len(files)} files were given")
    meshes = _open_marked_meshes(files, path, reading)

    def save(markers: Markers) -> str:
        write_markers(path, markers.with_meshes(meshes.source, meshes.target))
        return f"{len(markers)} markers are in {path.name}, for mixseq transfer --markers"

    with run_marking_viewer(meshes, ViewSettings(**viewing), save) as running:
        try:
            _wait(running.address, browser)
        finally:
            acknowledge_signal()  # later saves are intentional
            if running.session.has_changes:
                kept = _free_name(path.with_stem(f"{path.stem}-unsaved"))
                markers = running.session.marking.markers
                write_markers(kept, markers.with_meshes(meshes.source, meshes.target))
                warnings.warn(f"the markers were not saved; they are in {kept}", MixseqWarning, stacklevel=2)


def _open_marked_meshes(files: Sequence[Path], path: Path, reading: Mapping[str, Any]) -> MarkedMeshes:
    """Read both meshes, and the markers if their file exists."""
    import numpy as np

    from mixseq.mesh.topology import Topology
    from mixseq.retargeting.checks import check_marker_vertices
    from mixseq.retargeting.markers import Markers
    from mixseq.viewer.live.marking import MarkedMeshes
    from mixseq_io.registry import FORMATS
    from mixseq_io.text.markers import read_markers

    check_place(path)
    check_options(files, reading)
    if path.suffix.lower() in (extension for form in FORMATS for extension in form.extensions):
        raise SettingsError(f"{path}: markers are a text; end the name in .txt, .json or .yml")
    markers = read_markers(path) if path.exists() else Markers.from_pairs(np.zeros((0, 2), np.int64))
    source, target = (_with_motion(file, reading, _still(file, reading)) for file in files)
    tops = [Topology(mesh.faces, mesh.vertex_count) for mesh in (source, target)]
    try:
        markers = markers.renumbered(source, target)
        check_marker_vertices(markers, *tops)
    except SettingsError as error:
        raise SettingsError(f"{path}: {error}") from None
    names = (files[0].name, files[1].name)
    if names[0] == names[1]:
        names = (str(files[0]), str(files[1]))
    return MarkedMeshes(source, target, names, markers, path.name)


def _still(path: Path, reading: Mapping[str, Any]) -> MeshSequence:
    """Read a mesh at rest in the same way as a transfer."""
    if not is_model(path):
        return first_frame(path, reading)
    model = mixseq.load(path)
    first = model(model.start)[None]
    return mixseq.MeshSequence.from_header(model.header.with_times(model.header.times[:1]), first)


def _with_motion(path: Path, reading: Mapping[str, Any], rest: MeshSequence) -> MeshSequence:
    """Return a mesh at rest with some frames of its motion, by which markers are proposed."""
    import numpy as np

    from mixseq.retargeting.proposals import MAX_POSES
    from mixseq.sequence.sequence import load_frames
    from mixseq.types import evenly_spaced

    if is_model(path):
        frames = load_frames(mixseq.load(path).frames)
    else:
        with mixseq.open_sequence(path, **options_of(path, reading)) as reader:
            frames = load_frames(reader)
    if frames.header.vertex_count != rest.vertex_count:
        return rest
    chosen, header = evenly_spaced(len(frames.points), MAX_POSES - 1), frames.header
    times = np.append(header.times[0] - 1 / header.fps, header.times[chosen])  # frames keep their numbers
    poses = np.concatenate([rest.points[:1], frames.points[chosen]])
    return mixseq.MeshSequence.from_header(rest.header.with_times(times, header.fps), poses)


# Pages that play without the viewer -----------------------------------------------------------------------------


def _poses(item: SceneItem) -> LazyFrames:
    """Return the poses of a mesh at its frames as a sequence."""
    from mixseq.sequence.sequence import LazyFrames

    times = item.header.times
    return LazyFrames(item.header, lambda _: (item.pose(time)[None] for time in times - times[0]))


def _export(
    page: Path,
    colours: SceneColours,
    files: Sequence[Path],
    settings: Mapping[str, Any],
    progress: Progress,
    workers: Executor,
) -> None:
    """Write a web page that shows all meshes."""
    from mixseq.compression.compressed_model import CompressedModel
    from mixseq.viewer.export import ExportSettings, export_page
    from mixseq.viewer.export_data import page_items
    from mixseq_io.files import atomic_file
    from mixseq_io.model_files import is_compressed, read_compressed

    bound = in_diagonals_of_all(settings, map(_poses, colours.scene.items))
    compressed = (read_compressed(file) for file in files if is_model(file) and is_compressed(file))
    coded = (body for each in compressed for body in each.all_bodies)
    is_coded = [isinstance(item.motion, CompressedModel) for item in colours.scene.items]
    items = page_items(colours, [next(coded) if each else None for each in is_coded])
    with atomic_file(page) as temporary:
        reports = export_page(temporary, items, ExportSettings(**bound), progress, workers)
    announce(page)
    for item in reports:
        about = f"{item.name}: n" if len(reports) > 1 else "n"
        length = f"{item.max_error:.3g} of the diagonal, {item.error:.2g} units"
        between = "" if item.between is None else f"; between frames, {item.between:.2g} of the diagonal from the model"
        say(f"{about}o vertex is off by more than {length}{between}: {item.history}")
