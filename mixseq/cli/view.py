"""``mixseq view``.

``mixseq view --markers``: set the markers of two meshes in a browser.
"""

from __future__ import annotations

import os
import sys
import threading
import warnings
import webbrowser
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import mixseq
from mixseq.cli.files import (
    MODEL_EXTENSIONS,
    Claim,
    check_options,
    check_place,
    check_target,
    first_frame,
    free_name,
    is_model,
    overwrite_option,
    scene_items,
    write_frames,
)
from mixseq.cli.group import announce, needed, progress_bar, say
from mixseq.cli.options import (
    FILE,
    CommandWithSettings,
    camera_option,
    examples,
    quiet_option,
    reader_options,
    setting,
    threads_held,
)
from mixseq.errors import MixseqWarning, OutputError, SettingsError
from mixseq.runtime.interrupts import answered
from mixseq.runtime.progress import Progress, silent

if TYPE_CHECKING:
    from mixseq.pictures.colours import SceneColours
    from mixseq.pictures.scene import Scene
    from mixseq.retargeting.markers import Markers
    from mixseq.runtime.parallel import Executor
    from mixseq.sequence.sequence import FrameStore, MeshSequence
    from mixseq.signals.model import Model
    from mixseq.viewer.live.marking import MarkedMeshes
    from mixseq.viewer.live.viewer import ViewSettings


def set_markers(
    files: Sequence[Path],
    path: Path,
    reading: Mapping[str, Any],
    settings: ViewSettings,
    wait: Callable[[str], None],
) -> None:
    """Run a viewer for setting markers until `wait` returns; unsaved ones are then written beside the file."""
    from mixseq.viewer.live.marking import marking_viewer
    from mixseq_io.text.markers import write_markers

    if len(files) != 2:
        raise SettingsError(
            f"markers are of two meshes, a source and a target; {len(files)} files were given"
        )
    meshes = _open_marked_meshes(files, path, reading)

    def save(markers: Markers) -> str:
        write_markers(path, markers)
        return f"{len(markers)} markers are in {path.name}, for mixseq transfer --markers"

    with marking_viewer(meshes, settings, save) as running:
        try:
            wait(running.address)
        finally:
            answered()  # later saves are intentional
            if running.session.unsaved:
                kept = free_name(path.with_stem(f"{path.stem}-unsaved"))
                write_markers(kept, running.session.marking.markers)
                warnings.warn(f"the markers were not saved; they are in {kept}", MixseqWarning, stacklevel=2)


def _open_marked_meshes(files: Sequence[Path], path: Path, reading: Mapping[str, Any]) -> MarkedMeshes:
    """Read both meshes, and the markers if there are any."""
    import numpy as np

    from mixseq.mesh.topology import Topology
    from mixseq.retargeting.checks import check_numbers
    from mixseq.retargeting.markers import Markers
    from mixseq.viewer.live.marking import MarkedMeshes
    from mixseq_io.registry import FORMATS
    from mixseq_io.text.markers import read_markers

    check_place(path)
    check_options(files, reading)
    if path.suffix.lower() in (extension for form in FORMATS for extension in form.extensions):
        raise SettingsError(f"{path}: markers are a text; end the name in .txt, .json or .yml")
    markers = read_markers(path) if path.exists() else Markers.of(np.zeros((0, 2), np.int64))
    source, target = (_still(file, reading) for file in files)
    tops = [Topology(mesh.faces, mesh.vertex_count) for mesh in (source, target)]
    try:
        check_numbers(markers, *tops)
    except SettingsError as error:
        raise SettingsError(f"{path}: {error}") from None
    names = (files[0].name, files[1].name)
    if names[0] == names[1]:
        names = (str(files[0]), str(files[1]))
    return MarkedMeshes(source, target, names, markers, path.name)


def _still(path: Path, reading: Mapping[str, Any]) -> MeshSequence:
    """Read a mesh at rest, as in a transfer."""
    if not is_model(path):
        return first_frame(path, reading)
    model = mixseq.load(path)
    first = model(model.start)[None]
    return mixseq.MeshSequence.from_header(model.header.with_times(model.header.times[:1]), first)


@click.command(
    "view",
    cls=CommandWithSettings,
    epilog=examples(
        "mixseq view walk.h5",
        "mixseq view walk.usdc walk.h5 --against walk.usdc",
        "mixseq view shot.abc --no-browser --port 9000",
        "mixseq view walk.h5 --export walk.html",
        "mixseq view horse.obj camel.obj --markers pairs.txt",
    ),
)
@click.argument("files", nargs=-1, required=True, type=FILE)
@click.option(
    "--against", type=FILE, metavar="SEQUENCE", help="The original in any format, to colour errors."
)
@click.option(
    "--markers",
    type=FILE,
    metavar="FILE",
    help="Set markers of two meshes, for mixseq transfer: click pairs of points. FILE is continued, if it is there.",
)
@click.option(
    "--fps",
    "rate",
    type=click.FloatRange(min=0, min_open=True, max=1000),
    metavar="N",
    help="Frames per second; models are decoded at any rate.  [default: those of the first file]",
)
@setting(
    "--host",
    metavar="ADDRESS",
    help="Listen here; 0.0.0.0 for all who reach it and have the address.  [default: 127.0.0.1, this machine only]",
)
@setting(
    "--port",
    type=click.IntRange(1, 65535),
    metavar="N",
    help="Listen at this port.  [default: 8080, or the next one that is free]",
)
@setting(
    "--overlaid", is_flag=True, help="Meshes stand in one place at first, not side by side; on pages, too."
)
@camera_option
@setting("--follow", is_flag=True, default=None, help="Bodies that travel stay in the middle at first.")
@click.option("--read-only", is_flag=True, help="Nothing can be edited or saved in the browser.")
@setting("--browser/--no-browser", default=None, help="Open a browser.  [default: where there is a screen]")
@setting(
    "--shading", type=click.Choice(["smooth", "simple"]), help="simple is quick without a graphics card."
)
@click.option(
    "--threads",
    type=click.IntRange(min=1),
    metavar="N",
    help="Threads that open files and decode.  [default: all cores]",
)
@click.option(
    "--export",
    "page",
    type=FILE,
    metavar="PAGE",
    help="Write a page (.html) that plays on its own, without a network, and end.",
)
@setting("--every", type=click.IntRange(min=1), metavar="N", help="Of the frames of PAGE, keep every N-th.")
@click.option(
    "--max-error",
    type=click.FloatRange(min=0, min_open=True),
    metavar="E",
    help="No vertex of PAGE is farther off, in diagonals; models that are compressed are taken as they are.  "
    "[default: 0.001]",
)
@reader_options
@overwrite_option
@quiet_option
def command(
    files: tuple[Path, ...],
    against: Path | None,
    markers: Path | None,
    rate: float | None,
    host: str | None,
    port: int | None,
    overlaid: bool,
    camera: tuple[float, float] | None,
    follow: bool | None,
    read_only: bool,
    browser: bool | None,
    shading: str | None,
    threads: int | None,
    page: Path | None,
    every: int | None,
    max_error: float | None,
    reading: dict[str, Any],
    claim: Claim,
    quiet: bool,
) -> None:
    """Look at models and sequences in a browser, and edit models in place.

    FILES are models or sequences in any format, shown side by side or in one place. They play and can be scrubbed;
    colours show parts and joints, the error against the original, strain, or the change of curvature. Of a model there
    are the time curve, which can be dragged or drawn anew, its coefficients, and keys to retime it; buttons repeat,
    cut, hold and exaggerate. All of it can be undone, and saved as a model or a sequence in the folder where this was
    started.

    With --markers, the two FILES are shown at rest, each in its first frame (of glTF, in the pose without animation),
    and points that are the same are clicked in pairs. Some are proposed; how well they fit is told meanwhile.

    The viewer runs until Ctrl-C. On another machine, forward its port: ssh -L 8080:127.0.0.1:8080 machine.
    """
    if markers is not None:
        others: dict[str, Any] = {
            "export": page,
            "against": against,
            "fps": rate,
            "overlaid": overlaid or None,
            "follow": follow,
            "read-only": read_only or None,
            "threads": threads,
        }
        for name, value in others.items():
            if value is not None:
                raise SettingsError(f"--{name} is not about setting markers; leave it out, or --markers")
    only_live = {
        "host": host,
        "port": port,
        "read-only": read_only or None,
        "browser": browser,
        "shading": shading,
    }
    only_page = {"every": every, "max-error": max_error}
    for name, value in (only_live if page else only_page | {"overwrite": claim.overwrite}).items():
        if value is not None:
            about = (
                "the viewer in a browser; leave it out, or --export"
                if page
                else "pages; give --export as well"
            )
            raise SettingsError(f"--{name} is about {about}")
    if page is not None:
        _check_page(page)
        claim(page)
    else:
        from mixseq.viewer.live.viewer import check_viser

        check_viser()
    if markers is not None:
        how = {"host": host, "port": port, "camera": camera}
        set_markers(files, markers, reading, _settings(how, shading), partial(_wait, browser=browser))
        return
    with threads_held(threads) as work:
        with progress_bar(quiet) as progress:
            scene, original = _opened(files, against, rate, reading, progress)
            colours = _scene_colours(scene, original)
            if page is not None:
                of_page: dict[str, Any] = {
                    "fps": rate,
                    "every": every,
                    "max_error": max_error,
                    "overlaid": overlaid,
                    "camera": camera,
                    "following": follow,
                }
                _export(page, colours, files, of_page, progress, work)
        if page is None:
            how = {
                "host": host,
                "port": port,
                "overlaid": overlaid,
                "read_only": read_only,
                "camera": camera,
                "following": follow,
            }
            _run(colours, files, how, browser, shading)


def _opened(
    files: Sequence[Path],
    against: Path | None,
    fps: float | None,
    reading: Mapping[str, Any],
    progress: Progress,
) -> tuple[Scene, FrameStore | None]:
    """Open models, and read sequences."""
    from mixseq.pictures.scene import Scene
    from mixseq.sequence.sequence import frame_store

    with ExitStack() as stack:
        items, original = scene_items(files, _names(files), against, reading, stack)
        scene = Scene(tuple(item.stored(progress) for item in items), fps).checked()
        return scene, None if original is None else frame_store(original, progress)


def _names(files: Sequence[Path]) -> list[str]:
    """Return the names of files, with enough folders to be unique, or else a number."""
    for parts in range(1, max(len(file.parts) for file in files) + 1):
        names = ["/".join(file.parts[-parts:]) for file in files]
        if len(set(names)) == len(files):
            return names
    return [f"{number + 1} {file.name}" for number, file in enumerate(files)]


def _scene_colours(scene: Scene, original: FrameStore | None) -> SceneColours:
    from mixseq.pictures.colours import SceneColours, check_original

    if original is not None:
        check_original(scene, original)
    return SceneColours(scene, original)


def _run(
    colours: SceneColours,
    files: Sequence[Path],
    given: Mapping[str, Any],
    browser: bool | None,
    shading: str | None,
) -> None:
    """Run the viewer until it is interrupted."""
    from mixseq.runtime.parallel import thread_count
    from mixseq.viewer.live.viewer import viewer

    settings = _settings({"folder": Path.cwd(), "threads": thread_count(), **given}, shading)
    with viewer(colours, settings, partial(_save, files)) as running:
        try:
            _wait(running.address, browser)
        finally:
            answered()  # later saves are intentional
            for name, model in running.session.unsaved.items():
                kept = free_name(Path(f"{Path(name).stem}-unsaved.h5"))
                mixseq.save(kept, model)
                warnings.warn(
                    f"what was edited of {name} was not saved; it is in {kept}", MixseqWarning, stacklevel=1
                )


def _settings(given: Mapping[str, Any], shading: str | None) -> ViewSettings:
    """Return the settings of the viewer, from the given options."""
    from mixseq.viewer.live.viewer import ViewSettings

    material = "toon5" if shading == "simple" else "standard"
    return ViewSettings(
        material=material, **{name: value for name, value in given.items() if value is not None}
    )


def _wait(address: str, browser: bool | None) -> None:
    """Print the address, open it if there is a screen, and wait for Ctrl-C."""
    say(f"mixseq view: {address} (Ctrl-C ends it)")
    if browser or (browser is None and _has_screen()):
        webbrowser.open(address)
    try:
        threading.Event().wait()
    except KeyboardInterrupt:
        click.echo()


def _has_screen() -> bool:
    """Return whether a browser would be visible: not in a remote session, and not in a console."""
    if "SSH_CONNECTION" in os.environ:
        return False
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _save(sources: Sequence[Path], path: Path, model: Model, replace: bool) -> str:
    """Write an edited model, as a model or as a sequence; return a message with its name and the files it needs."""
    from mixseq.runtime.parallel import on_threads
    from mixseq_io.numbered.files import files_of_pattern

    for source in sources:
        check_target(path, source)
    if not replace and (path.exists() or any(files_of_pattern(path))):
        raise OutputError(f"{path.name} exists; give another name, or tick Replace")
    try:
        if path.suffix.lower() in MODEL_EXTENSIONS:
            mixseq.save(path, model)
        else:
            write_frames(path, model, model.header, False, {}, silent, on_threads())
    except OSError as error:
        raise OutputError(f"{path}: {error.strerror or error}") from None
    return f"{path.name} in {path.parent}{needed(path)}"


# Pages that play on their own -----------------------------------------------------------------------------


def _check_page(page: Path) -> None:
    if page.suffix.lower() not in (".html", ".htm"):
        raise SettingsError(f"{page}: pages end in .html")


def _export(
    page: Path,
    colours: SceneColours,
    files: Sequence[Path],
    given: Mapping[str, Any],
    progress: Progress,
    workers: Executor,
) -> None:
    """Write a page with all meshes."""
    from mixseq.viewer.export import ExportSettings, export_page
    from mixseq.viewer.export_data import page_items
    from mixseq_io.files import replacing
    from mixseq_io.verification import is_compressed, read_compressed

    settings = ExportSettings(**{name: value for name, value in given.items() if value is not None})
    items = page_items(
        colours, [read_compressed(file) if is_model(file) and is_compressed(file) else None for file in files]
    )
    with replacing(page) as temporary:
        report = export_page(temporary, items, settings, progress, workers)
    announce(page)
    for item in report.items:
        about = f"{item.name}: n" if len(report.items) > 1 else "n"
        say(
            f"{about}o vertex is off by more than {item.max_error:.3g} of the diagonal, {item.error:.2g} units"
        )
