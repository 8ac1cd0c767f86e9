"""``mixseq view --markers``: set the markers of two meshes in a browser."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import mixseq
from mixseq.cli.files import check_options, check_place, free_name, is_model
from mixseq.cli.transfer_files import first_frame
from mixseq.errors import MixseqWarning, SettingsError
from mixseq.interrupts import answered

if TYPE_CHECKING:
    from mixseq.correspondence.markers import Markers
    from mixseq.sequence import MeshSequence
    from mixseq.viewing.live import MarkedMeshes, ViewSettings


def set_markers(
    files: Sequence[Path],
    path: Path,
    reading: Mapping[str, Any],
    settings: ViewSettings,
    wait: Callable[[str], None],
) -> None:
    """Run a viewer for setting markers until `wait` returns; unsaved ones are then written beside the file."""
    from mixseq.viewing.live import marking_viewer
    from mixseq_io.correspondence.markers import write_markers

    if len(files) != 2:
        raise SettingsError(
            f"markers are of two meshes, a source and a target; {len(files)} files were given"
        )
    meshes = _opened(files, path, reading)

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


def _opened(files: Sequence[Path], path: Path, reading: Mapping[str, Any]) -> MarkedMeshes:
    """Read both meshes, and the markers if there are any."""
    from mixseq.correspondence.checks import check_numbers
    from mixseq.correspondence.markers import Markers
    from mixseq.topology import Topology
    from mixseq.viewing.live import MarkedMeshes
    from mixseq_io import FORMATS
    from mixseq_io.correspondence.markers import read_markers

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
    first = np.asarray(model(model.start))[None]
    return mixseq.MeshSequence.from_header(model.header.with_times(model.header.times[:1]), first)
