"""Which extensions of glTF matter to a moving mesh, and which of them are understood."""

from __future__ import annotations

from mixseq.errors import FormatError
from mixseq_io.gltf.fields import Fields

COMPRESSIONS = {
    "KHR_draco_mesh_compression": "Draco",
    "EXT_meshopt_compression": "meshopt",
    "KHR_meshopt_compression": "meshopt",
}

_UNDERSTOOD = ("KHR_mesh_quantization",)

# They change how a mesh looks, not where it is.
_APPEARANCE = (
    "KHR_materials_",
    "KHR_texture_",
    "EXT_texture_",
    "MSFT_texture_",
    "KHR_lights_",
    "EXT_lights_",
)
_HARMLESS = (
    "KHR_node_visibility",
    "KHR_node_selectability",
    "KHR_node_hoverability",
    "KHR_xmp",
    "KHR_xmp_json_ld",
)


def check_extensions(top: Fields) -> None:
    """Refuse files whose meshes cannot be understood without an extension that is not known here.

    Parameters
    ----------
    top : Fields
        The outermost object of the JSON.

    Raises
    ------
    FormatError
        Naming the extension.
    """
    for name in top.texts("extensionsRequired"):
        if name in COMPRESSIONS:
            raise FormatError(
                f"{top.file} is compressed with {COMPRESSIONS[name]} ({name}), which is not read; decompress it "
                f"first: gltf-transform cp {top.file.name} decompressed.glb"
            )
        if name not in (*_UNDERSTOOD, *_HARMLESS) and not name.startswith(_APPEARANCE):
            raise FormatError(
                f"{top.file} requires the extension {name[:80]}, which is not read; export without it"
            )
