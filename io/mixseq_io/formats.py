"""The table of formats: what each can hold, and the functions that read and write it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from importlib import import_module
from pathlib import Path
from typing import Any

from mixseq.errors import SettingsError
from mixseq.sequence import FloatArray, SequenceHeader
from mixseq_io.isolation import can_isolate, open_isolated
from mixseq_io.reader import SequenceReader

_YES = {True: "yes", False: "no"}


@dataclass(frozen=True, kw_only=True)
class Holds:
    """What a format has a place for; what it has none for is warned about when it is written.

    Parameters
    ----------
    animation : str
        The kinds of motion that are read.
    polygons : str
        Which polygons.
    points : str
        How exactly.
    times : str
        Which times of the frames.
    uvs, creases, face_sets, objects, units, velocities : bool
        Texture coordinates; hard edges; named sets of polygons; several meshes; up axis and length of a unit;
        velocities of the vertices.
    materials : str
        What becomes of materials.
    """

    animation: str
    polygons: str = "any"
    points: str = "float32"
    times: str = "any"
    uvs: bool = False
    creases: bool = False
    face_sets: bool = False
    objects: bool = False
    units: bool = False
    velocities: bool = False
    materials: str = "no"


@dataclass(frozen=True)
class Format:
    """A file format.

    Parameters
    ----------
    name : str
        Its name in messages.
    extensions : tuple of str
        Its extensions, all read and written, in lower case with the dot.
    holds : Holds
        What it has a place for.
    reader, writer : str
        ``"module:function"``, imported at first use. A reader is ``(path, **options) -> SequenceReader``, a
        writer ``(path, header, blocks, velocities, **options) -> None``.
    read_options, write_options : mapping of str to str
        The keyword options and what they mean.
    signatures : tuple of bytes
        What the files begin with, as far as there is something.
    numbered : bool
        Whether a file holds one frame, so that a sequence is a folder or a pattern of files.
    isolated : bool
        Whether files are parsed by a C++ library, which is kept in a process of its own, see `mixseq_io.isolation`.
    """

    name: str
    extensions: tuple[str, ...]
    holds: Holds
    reader: str
    writer: str
    read_options: Mapping[str, str] = field(default_factory=dict)
    write_options: Mapping[str, str] = field(default_factory=dict)
    signatures: tuple[bytes, ...] = ()
    numbered: bool = False
    isolated: bool = False

    def open(self, path: Path, **options: Any) -> SequenceReader:
        """Open a file for reading, see `mixseq_io.open_sequence`."""
        self._check_options("read", self.read_options, options)
        if self.isolated and can_isolate():
            return open_isolated(self.reader, path, options)
        reader: SequenceReader = _load(self.reader)(path, **options)
        return reader

    def write(
        self,
        path: Path,
        header: SequenceHeader,
        blocks: Iterable[FloatArray],
        velocities: Iterable[FloatArray] | None = None,
        **options: Any,
    ) -> None:
        """Write a file, see `mixseq_io.write_blocks`."""
        self._check_options("written", self.write_options, options)
        _load(self.writer)(path, header, blocks, velocities, **options)

    def _check_options(self, verb: str, known: Mapping[str, str], given: Mapping[str, Any]) -> None:
        for option in given:
            if option not in known:
                takes = "with " + ", ".join(known) if known else "without options"
                raise SettingsError(f"{self.name} has no option {option!r}; it is {verb} {takes}")


def _load(reference: str) -> Callable[..., Any]:
    module, function = reference.split(":")
    loaded: Callable[..., Any] = getattr(import_module(module), function)
    return loaded


_FPS = "frames per second, 24 by default"
_GAPS = "accept missing numbers; the frames keep the times of their numbers"
_START = "number of the first file, 1 by default"
_MESH = "file of the mesh; by default one of the same name beside it"
_PRIM = "path of a mesh or of something above it; / takes all meshes, by default all that move are taken"
_FLATTEN = "write a file that stands alone, not one that builds on the file that the sequence came from"
_ONTO = "the file to build on, if it is another one than the sequence came from"

FORMATS: tuple[Format, ...] = (
    Format(
        name="USD",
        extensions=(".usd", ".usda", ".usdc", ".usdz"),
        holds=Holds(
            animation="point samples, transforms, skeletons, blend shapes, value clips",
            uvs=True,
            creases=True,
            face_sets=True,
            objects=True,
            units=True,
            velocities=True,
            materials="carried along",
        ),
        reader="mixseq_io.usd.reader:open_usd",
        writer="mixseq_io.usd.writer:write_usd",
        read_options={"prim": _PRIM},
        write_options={
            "flatten": _FLATTEN,
            "onto": _ONTO,
            "clips": "frames per file of value clips, for long shots; 0, the default, keeps all in one file",
        },
        signatures=(b"PXR-USDC", b"#usda", b"#sdf", b"PK\x03\x04"),
        isolated=True,
    ),
    Format(
        name="HDF5 sequence",
        extensions=(".h5", ".hdf5"),
        holds=Holds(
            animation="point samples, models",
            points="float32, float64",
            uvs=True,
            creases=True,
            face_sets=True,
            objects=True,
            units=True,
            velocities=True,
            materials="names",
        ),
        reader="mixseq_io.hdf5.sequence:open_h5",
        writer="mixseq_io.hdf5.sequence:write_h5",
        signatures=(b"\x89HDF\r\n\x1a\n",),
    ),
    Format(
        name="Alembic",
        extensions=(".abc",),
        holds=Holds(
            animation="point samples, transforms",
            uvs=True,
            creases=True,
            face_sets=True,
            objects=True,
            velocities=True,
            materials="names",
        ),
        reader="mixseq_io.alembic.reader:open_alembic",
        writer="mixseq_io.alembic.writer:write_alembic",
        read_options={"prim": _PRIM},
        signatures=(b"Ogawa", b"\x89HDF\r\n\x1a\n"),
        isolated=True,
    ),
    Format(
        name="glTF",
        extensions=(".glb", ".gltf"),
        holds=Holds(
            animation="skins, morph targets, transforms",
            polygons="triangles",
            times="float32, from 0 on",
            uvs=True,
            creases=True,
            face_sets=True,
            objects=True,
            materials="carried along",
        ),
        reader="mixseq_io.gltf.reader:open_gltf",
        writer="mixseq_io.gltf.writer:write_gltf",
        read_options={
            "prim": _PRIM,
            "animation": "name or number of the animation, the first by default",
            "fps": "frames per second; by default the frames are the animation's keys",
        },
        write_options={"flatten": _FLATTEN, "onto": _ONTO},
        signatures=(b"glTF",),
    ),
    Format(
        name="npz",
        extensions=(".npz",),
        holds=Holds(
            animation="point samples",
            points="float32, float64",
            uvs=True,
            creases=True,
            face_sets=True,
            objects=True,
            units=True,
            velocities=True,
            materials="names",
        ),
        reader="mixseq_io.npz:open_npz",
        writer="mixseq_io.npz:write_npz",
        read_options={"fps": "frames per second, where the file has neither fps nor times; 24 by default"},
        write_options={"compress": "deflate the arrays (False by default: slow, and points hardly shrink)"},
        signatures=(b"PK\x03\x04",),
    ),
    Format(
        name="PC2",
        extensions=(".pc2",),
        holds=Holds(
            animation="point samples",
            times="even, rate not told",
            uvs=True,
            creases=True,
            face_sets=True,
            objects=True,
            materials="names",
        ),
        reader="mixseq_io.pointcache.pc2:open_pc2",
        writer="mixseq_io.pointcache.pc2:write_pc2",
        read_options={"mesh": _MESH, "fps": _FPS},
        signatures=(b"POINTCACHE2\x00",),
    ),
    Format(
        name="MDD",
        extensions=(".mdd",),
        holds=Holds(
            animation="point samples",
            times="float32",
            uvs=True,
            creases=True,
            face_sets=True,
            objects=True,
            materials="names",
        ),
        reader="mixseq_io.pointcache.mdd:open_mdd",
        writer="mixseq_io.pointcache.mdd:write_mdd",
        read_options={"mesh": _MESH},
    ),
    Format(
        name="OBJ",
        extensions=(".obj",),
        holds=Holds(
            animation="a file per frame",
            points="all digits",
            times="no",
            uvs=True,
            creases=True,
            face_sets=True,
            objects=True,
            materials="names",
        ),
        reader="mixseq_io.numbered.obj:open_obj",
        writer="mixseq_io.numbered.obj:write_obj",
        read_options={"fps": _FPS, "allow_gaps": _GAPS},
        write_options={"start": _START},
        numbered=True,
    ),
    Format(
        name="PLY",
        extensions=(".ply",),
        holds=Holds(animation="a file per frame", points="float32, float64", times="no", uvs=True),
        reader="mixseq_io.numbered.ply:open_ply",
        writer="mixseq_io.numbered.ply:write_ply",
        read_options={"fps": _FPS, "allow_gaps": _GAPS},
        write_options={"start": _START},
        signatures=(b"ply",),
        numbered=True,
    ),
    Format(
        name="STL",
        extensions=(".stl",),
        holds=Holds(animation="a file per frame", polygons="triangles", times="no"),
        reader="mixseq_io.numbered.stl:open_stl",
        writer="mixseq_io.numbered.stl:write_stl",
        read_options={"fps": _FPS, "allow_gaps": _GAPS},
        write_options={"start": _START},
        numbered=True,
    ),
    Format(
        name="OFF",
        extensions=(".off",),
        holds=Holds(animation="a file per frame", polygons="triangles", points="all digits", times="no"),
        reader="mixseq_io.numbered.off:open_off",
        writer="mixseq_io.numbered.off:write_off",
        read_options={"fps": _FPS, "allow_gaps": _GAPS},
        write_options={"start": _START},
        signatures=(b"OFF", b"COFF"),
        numbered=True,
    ),
)


def capabilities() -> list[tuple[str, ...]]:
    """Return what the formats have a place for as a table: a row of titles, then a row per format."""
    columns = [column.name for column in fields(Holds) if column.name != "animation"]
    titles = ("format", "reads", "writes", *(column.replace("_", " ") for column in columns))
    rows = [
        (
            form.name,
            " ".join(form.extensions),
            " ".join(form.extensions),
            *(_word(getattr(form.holds, column)) for column in columns),
        )
        for form in FORMATS
    ]
    return [titles, *rows]


def motions() -> list[tuple[str, ...]]:
    """Return which kinds of motion are read, and the options, as a table like `capabilities`."""
    titles = ("format", "motion that is read", "options for reading", "options for writing")
    rows = [
        (form.name, form.holds.animation, ", ".join(form.read_options), ", ".join(form.write_options))
        for form in FORMATS
    ]
    return [titles, *rows]


def _word(value: bool | str) -> str:
    return value if isinstance(value, str) else _YES[value]
