"""A glTF document whose numbers are quantised and packed, of one whose are not: ``EXT_meshopt_compression``.

Points are rounded as far as was asked for, normals to bytes, texture coordinates and colours as far as nobody sees it;
all else is packed as it is: animations, joints, weights, numbers of a kind that is not known here.

Specification: https://github.com/KhronosGroup/glTF/blob/main/extensions/2.0/Vendor/EXT_meshopt_compression/README.md
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import numpy as np

from mixseq.errors import SettingsError
from mixseq_io.choosing import listed
from mixseq_io.gltf.buffers import BufferWriter, Json, Layout, append, writing_buffer
from mixseq_io.gltf.containers import chunks, data_of_file
from mixseq_io.gltf.document import Document, load_document
from mixseq_io.gltf.document_edits import unknown_extensions
from mixseq_io.gltf.json_fields import Fields
from mixseq_io.gltf.meshopt import require_package
from mixseq_io.gltf.packing_roles import Roles, add_as_it_is
from mixseq_io.gltf.vertex_order import neighbours_together

ROUNDING = "mixseq:rounding"
"""In the ``extras`` of the asset: how far points are off at most, in diagonals of their meshes."""


def packed(document: Document, error: float) -> Layout:
    """Return the document packed; how far points are off stands in the ``extras`` of its asset.

    Parameters
    ----------
    document : Document
        Without compression.
    error : float
        Largest error of points, in diagonals of their mesh.

    Raises
    ------
    FormatError
        If the document is damaged.
    SettingsError
        If points are too far from the origin for that error, or extensions that are not known here may refer to
        what is packed.
    """
    unknown = unknown_extensions(document.json)
    if unknown:
        raise SettingsError(
            f"{document.path}: {listed(unknown)} may refer to what is packed; leave meshopt out, or write the "
            "sequence alone (--flatten, flatten=True)"
        )
    document = neighbours_together(document)
    roles = Roles(document, error)
    json = deepcopy({key: each for key, each in document.json.items() if key not in _REPLACED})
    layout = Layout(json)
    views = _Views(document, layout)
    for image in json.get("images", ()):
        if "bufferView" in image:
            image["bufferView"] = views.copied(image["bufferView"])
    for number, accessor in enumerate(document.items("accessors")):
        values = document.stored(accessor) if _is_packable(accessor) else np.zeros((0, 0))
        add = roles.adding.get(number, add_as_it_is)
        made = add(layout, values, accessor) if len(values) else None
        if made is None:
            append(json, "accessors", views.moved(accessor))
    extras = json["asset"].setdefault("extras", {})
    if isinstance(extras, dict):
        extras[ROUNDING] = roles.rounding
    return layout


@contextmanager
def writing_document(
    path: Path, temporary: Path, layout: Layout, error: float | None = None
) -> Iterator[BufferWriter]:
    """Write a file as `writing_buffer` does, and pack it when all is there; None as the error leaves it as it is.

    Raises
    ------
    OutputError
        If the file, or what is packed, becomes too large for its kind.
    SettingsError
        See `packed`.
    """
    if error is None:
        with writing_buffer(path, temporary, layout) as writer:
            yield writer
        return
    loose = temporary.with_suffix(".loose.glb")
    with writing_buffer(loose, loose, layout) as writer:
        yield writer
    with writing_buffer(path, temporary, packed(replace(load_document(loose), path=path), error)):
        pass  # all of it is in the layout already


def check_error(error: float | None) -> None:
    """Refuse an error that is not positive, and any without the package that packs."""
    if error is None:
        return
    require_package("packing by meshoptimizer needs a package that is not here; to get it")
    if not 0 < error < 1:
        raise SettingsError(
            f"meshopt is {error:g}; the largest error of points is expected, in diagonals, such as 1e-4"
        )


def told_rounding(path: Path) -> float | None:
    """Return how far points of a file are off that was packed, in diagonals; None if it was not."""
    text = chunks(path, data_of_file(path))[0] if path.suffix.lower() == ".glb" else path.read_bytes()
    found = re.search(f'"{ROUNDING}":([-+.0-9e]+)'.encode(), text)
    return None if found is None else float(found[1])


_REPLACED = ("accessors", "bufferViews", "buffers")


def _is_packable(accessor: Fields) -> bool:
    return "bufferView" in accessor and "sparse" not in accessor


class _Views:
    """Views of a document that stay as they are, as far as something needs them."""

    def __init__(self, document: Document, layout: Layout) -> None:
        self._document, self._layout = document, layout
        self._copies: dict[int, int] = {}

    def copied(self, number: int) -> int:
        """Return the view's number in the layout."""
        if number not in self._copies:
            view = self._document.item("bufferViews", number)
            data = self._document.part(view)
            rest = {key: each for key, each in view.values.items() if key not in _PLACE}
            self._copies[number] = self._layout.add([data], len(data), **rest)
        return self._copies[number]

    def moved(self, accessor: Fields) -> Json:
        """Return an accessor that refers to copies."""
        entry: Json = deepcopy(dict(accessor.values))
        sparse = entry.get("sparse", {})
        for owner in (entry, sparse.get("indices", {}), sparse.get("values", {})):
            if "bufferView" in owner:
                owner["bufferView"] = self.copied(owner["bufferView"])
        return entry


_PLACE = ("buffer", "byteOffset", "byteLength")
