"""A `Surface` as named arrays, for formats that hold any arrays: npz, HDF5.

========================  ====================  =====================================================
array                     shape                 meaning
========================  ====================  =====================================================
``uv_values``             (n, 2) float32        texture coordinates, v upwards
``uv_indices``            (corners,) int32      row of ``uv_values`` for every corner of the polygons
``colour_values``         (n, 4) float32        red, green, blue, alpha, from 0 to 1; or uint8, of which 255 is 1
``colour_indices``        (corners,) int32      row of ``colour_values`` for every corner
``creases``               (corners,) int32      corners with the same number share a normal
``face_set_names``        (S,) str              names of the face sets
``face_set_materials``    (S,) str              their materials, "" for none
``face_set_sizes``        (S,) int32            number of their polygons
``face_set_polygons``     (sum of sizes,) int32 the polygons
``object_names``          (M,) str              the meshes that the sequence joins
``object_paths``          (M,) str              where they are in the file they came from
``object_sizes``          (M, 2) int32          numbers of their vertices and polygons
``object_subdivisions``   (M,) str              how renderers subdivide each, absent where all are alike
``subdivision``           (1,) str              how they subdivide, or most of the meshes; absent for "none"
``origin``                (2,) str              format and path of the file that it was read from
========================  ====================  =====================================================

All are optional; those that begin with the same word come together.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import InvalidSequenceError
from mixseq.surface import CornerValues, FaceSet, MeshObject, Origin, Surface
from mixseq_io.colours import as_bytes, of_bytes

Arrays = dict[str, NDArray[Any]]

_GROUPS = (
    ("uv_values", "uv_indices"),
    ("colour_values", "colour_indices"),
    ("creases",),
    ("face_set_names", "face_set_materials", "face_set_sizes", "face_set_polygons"),
    ("object_names", "object_paths", "object_sizes"),
    ("object_subdivisions",),
    ("subdivision",),
    ("origin",),
)
SURFACE_ARRAYS = tuple(name for group in _GROUPS for name in group)


def surface_arrays(surface: Surface) -> Arrays:
    """Return a surface as arrays; strings as NumPy's Unicode."""
    arrays: Arrays = {}
    if surface.uvs is not None:
        arrays |= {"uv_values": surface.uvs.values, "uv_indices": surface.uvs.indices}
    if surface.colours is not None:
        values = surface.colours.values
        exact = as_bytes(values)
        arrays |= {
            "colour_values": values if exact is None else exact,
            "colour_indices": surface.colours.indices,
        }
    if surface.hard_edges is not None:
        arrays["creases"] = surface.hard_edges
    sets = surface.face_sets
    if sets:
        arrays |= {
            "face_set_names": np.array([each.name for each in sets]),
            "face_set_materials": np.array([each.material for each in sets]),
            "face_set_sizes": np.array([each.polygons.size for each in sets], dtype=np.int32),
            "face_set_polygons": np.concatenate([each.polygons for each in sets]),
        }
    objects = surface.objects
    if objects:
        arrays |= {
            "object_names": np.array([each.name for each in objects]),
            "object_paths": np.array([each.path for each in objects]),
            "object_sizes": np.array(
                [(each.vertex_count, each.polygon_count) for each in objects], dtype=np.int32
            ),
        }
    if len(set(surface.subdivisions)) > 1:
        arrays["object_subdivisions"] = np.array(surface.subdivisions)
    if surface.subdivision != "none":
        arrays["subdivision"] = np.array([surface.subdivision])
    if surface.origin is not None:
        arrays["origin"] = np.array([surface.origin.format, surface.origin.path])
    return arrays


def surface_of_arrays(arrays: Mapping[str, NDArray[Any]], folder: Path | None = None) -> Surface:
    """Make a surface from the arrays of `surface_arrays`."""
    for group in _GROUPS:
        missing = [name for name in group if name not in arrays]
        if missing and len(missing) < len(group):
            raise InvalidSequenceError(f"{', '.join(missing)} of the surface are missing")
    uvs = colours = None
    if "uv_values" in arrays:
        uvs = CornerValues(arrays["uv_values"], _whole_numbers(arrays, "uv_indices"))
    if "colour_values" in arrays:
        values = arrays["colour_values"]
        values = of_bytes(values) if values.dtype == np.uint8 else values
        colours = CornerValues(values, _whole_numbers(arrays, "colour_indices"))
    origin = None
    if "origin" in arrays:
        if arrays["origin"].size != 2:
            raise InvalidSequenceError("the origin of the surface is not a format and a path")
        origin = _beside(Origin(*map(str, arrays["origin"].reshape(-1))), folder)
    return Surface(
        uvs=uvs,
        colours=colours,
        hard_edges=_whole_numbers(arrays, "creases") if "creases" in arrays else None,
        face_sets=_face_sets(arrays) if "face_set_names" in arrays else (),
        objects=_objects(arrays) if "object_names" in arrays else (),
        subdivision=str(arrays["subdivision"].item()) if "subdivision" in arrays else "none",
        origin=origin,
    )


def _beside(origin: Origin, folder: Path | None) -> Origin:
    """Return the origin's current path, if it moved together with the file that names it."""
    if folder is None or Path(origin.path).exists():
        return origin
    moved = folder.absolute() / Path(origin.path).name
    return Origin(origin.format, str(moved)) if moved.is_file() else origin


def _face_sets(arrays: Mapping[str, NDArray[Any]]) -> tuple[FaceSet, ...]:
    names, materials = arrays["face_set_names"].reshape(-1), arrays["face_set_materials"].reshape(-1)
    sizes, polygons = _whole_numbers(arrays, "face_set_sizes"), _whole_numbers(arrays, "face_set_polygons")
    if not len(names) == len(materials) == len(sizes) or (sizes < 0).any() or sizes.sum() != polygons.size:
        raise InvalidSequenceError(
            "the face sets' names, materials, sizes and polygons do not fit each other"
        )
    lists = np.split(polygons, np.cumsum(sizes))
    return tuple(
        FaceSet(str(name), each, str(material))
        for name, each, material in zip(names, lists, materials, strict=False)
    )


def _objects(arrays: Mapping[str, NDArray[Any]]) -> tuple[MeshObject, ...]:
    names, paths = arrays["object_names"].reshape(-1), arrays["object_paths"].reshape(-1)
    sizes = _whole_numbers(arrays, "object_sizes")
    usual = str(arrays["subdivision"].item()) if "subdivision" in arrays else "none"
    schemes = arrays.get("object_subdivisions", np.full(len(names), usual)).reshape(-1)
    if not len(names) == len(paths) == len(sizes) == len(schemes) or sizes.shape[1:] != (2,):
        raise InvalidSequenceError(
            "the objects' names, paths, sizes and schemes of subdivision do not fit each other"
        )
    return tuple(
        MeshObject(
            str(name), str(path), int(vertices), int(polygons), None if scheme == usual else str(scheme)
        )
        for name, path, (vertices, polygons), scheme in zip(names, paths, sizes, schemes, strict=True)
    )


def _whole_numbers(arrays: Mapping[str, NDArray[Any]], name: str) -> NDArray[np.int64]:
    array = arrays[name]
    if array.dtype.kind not in "iu":
        raise InvalidSequenceError(f"{name} of the surface are {array.dtype}; integers are expected")
    return array.astype(np.int64)
