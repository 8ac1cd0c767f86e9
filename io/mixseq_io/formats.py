"""Table of formats."""

from __future__ import annotations

from dataclasses import fields

from mixseq_io.format import OF_VERTICES, OPAQUE, Format, Holds

_YES = {True: "yes", False: "no"}

_FPS = "frames per second, 24 by default"
_GAPS = "accept missing numbers; the frames keep the times of their numbers"
_START = "number of the first file, by default that of the first frame"
_MESH = "file of the mesh; by default one of the same name beside it"
_PRIM = "path of a mesh or of something above it; / takes all meshes, by default all that move are taken"
_FLATTEN = "write a file that stands alone, not one that builds on the file that the sequence came from"
_SOURCES = "times of the original that the frames show, where these are others than their own"
_ONTO = "the file to build on, if it is another one than the sequence came from"

FORMATS: tuple[Format, ...] = (
    Format(
        name="USD",
        extensions=(".usd", ".usda", ".usdc", ".usdz"),
        holds=Holds(
            animation="point samples, transforms, skeletons, blend shapes, value clips",
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
            "pack_from": "folder from which textures may be packed into .usdz, besides that of the original",
            "sources": _SOURCES,
            "whole_stage": "retime everything else that moves in the original, too, by sources",
        },
        signatures=(b"PXR-USDC", b"#usda", b"#sdf", b"PK\x03\x04"),
        isolated=True,
    ),
    Format(
        name="HDF5 sequence",
        extensions=(".h5", ".hdf5"),
        holds=Holds(
            animation="point samples, models", points="float32, float64", units=True, velocities=True
        ),
        reader="mixseq_io.model_reader:open_h5",
        writer="mixseq_io.hdf5.sequence_files:write_h5",
        signatures=(b"\x89HDF\r\n\x1a\n",),
    ),
    Format(
        name="Alembic",
        extensions=(".abc",),
        holds=Holds(animation="point samples, transforms", velocities=True, materials="carried along"),
        reader="mixseq_io.alembic.reader:open_alembic",
        writer="mixseq_io.alembic.writer:write_alembic",
        read_options={"prim": _PRIM},
        write_options={"flatten": _FLATTEN, "onto": _ONTO, "sources": _SOURCES},
        signatures=(b"Ogawa", b"\x89HDF\r\n\x1a\n"),
        isolated=True,
    ),
    Format(
        name="glTF",
        extensions=(".glb", ".gltf"),
        holds=Holds(
            animation="skins, morph targets, transforms, compressed models",
            polygons="triangles",
            times="float32, from 0 on",
            materials="carried along",
        ),
        reader="mixseq_io.model_reader:open_gltf",
        writer="mixseq_io.gltf.writer:write_gltf",
        read_options={
            "prim": _PRIM,
            "animation": "name or number of the animation, the first by default",
            "fps": "frames per second; by default the frames are the animation's keys",
        },
        write_options={
            "flatten": _FLATTEN,
            "onto": _ONTO,
            "keep_start": "let the animation begin when the sequence does, and not at 0",
            "sources": _SOURCES,
        },
        signatures=(b"glTF",),
    ),
    Format(
        name="npz",
        extensions=(".npz",),
        holds=Holds(animation="point samples", points="float32, float64", units=True, velocities=True),
        reader="mixseq_io.npz:open_npz",
        writer="mixseq_io.npz:write_npz",
        read_options={"fps": "frames per second, where the file has neither fps nor times; 24 by default"},
        write_options={"compress": "deflate the arrays (False by default: slow, and points hardly shrink)"},
        signatures=(b"PK\x03\x04",),
    ),
    Format(
        name="PC2",
        extensions=(".pc2",),
        holds=Holds(animation="point samples", times="even, rate not told", colours=OPAQUE),
        reader="mixseq_io.pointcache.pc2:open_pc2",
        writer="mixseq_io.pointcache.pc2:write_pc2",
        read_options={"mesh": _MESH, "fps": _FPS},
        signatures=(b"POINTCACHE2\x00",),
    ),
    Format(
        name="MDD",
        extensions=(".mdd",),
        holds=Holds(animation="point samples", times="float32", colours=OPAQUE),
        reader="mixseq_io.pointcache.mdd:open_mdd",
        writer="mixseq_io.pointcache.mdd:write_mdd",
        read_options={"mesh": _MESH},
    ),
    Format(
        name="OBJ",
        extensions=(".obj",),
        holds=Holds(animation="a file per frame", points="all digits", times="no", colours=OPAQUE),
        reader="mixseq_io.numbered.obj:OBJ.open",
        writer="mixseq_io.numbered.obj:OBJ.write",
        read_options={"fps": _FPS, "allow_gaps": _GAPS},
        write_options={"start": _START},
        numbered=True,
    ),
    Format(
        name="PLY",
        extensions=(".ply",),
        holds=Holds(
            animation="a file per frame",
            points="float32, float64",
            times="no",
            hard_edges=False,
            face_sets=False,
            objects=False,
            materials="no",
        ),
        reader="mixseq_io.numbered.ply:PLY.open",
        writer="mixseq_io.numbered.ply:PLY.write",
        read_options={"fps": _FPS, "allow_gaps": _GAPS},
        write_options={"start": _START},
        signatures=(b"ply",),
        numbered=True,
    ),
    Format(
        name="STL",
        extensions=(".stl",),
        holds=Holds(
            animation="a file per frame",
            polygons="triangles",
            times="no",
            uvs=False,
            colours=False,
            hard_edges=False,
            face_sets=False,
            objects=False,
            materials="no",
        ),
        reader="mixseq_io.numbered.stl:STL.open",
        writer="mixseq_io.numbered.stl:STL.write",
        read_options={"fps": _FPS, "allow_gaps": _GAPS},
        write_options={"start": _START},
        numbered=True,
    ),
    Format(
        name="OFF",
        extensions=(".off",),
        holds=Holds(
            animation="a file per frame",
            polygons="triangles",
            points="all digits",
            times="no",
            uvs=False,
            colours=OF_VERTICES,
            hard_edges=False,
            face_sets=False,
            objects=False,
            materials="no",
        ),
        reader="mixseq_io.numbered.off:OFF.open",
        writer="mixseq_io.numbered.off:OFF.write",
        read_options={"fps": _FPS, "allow_gaps": _GAPS},
        write_options={"start": _START},
        signatures=(b"OFF", b"COFF"),
        numbered=True,
    ),
)


def capabilities() -> list[tuple[str, ...]]:
    """Return the formats' capabilities as a table: a row of titles, then a row per format."""
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
    """Return the kinds of motion that are read, and the options, as a table like `capabilities`."""
    titles = ("format", "motion that is read", "options for reading", "options for writing")
    rows = [
        (form.name, form.holds.animation, ", ".join(form.read_options), ", ".join(form.write_options))
        for form in FORMATS
    ]
    return [titles, *rows]


def _word(value: bool | str) -> str:
    return value if isinstance(value, str) else _YES[value]
