r"""``KHR_texture_transform``: texture coordinates translated, rotated and scaled by a material.

With scale :math:`s`, rotation :math:`r` and offset :math:`o`, texture coordinates (u, v), v downwards, are

.. math::
    u' = s_u u \cos r + s_v v \sin r + o_u, \quad v' = -s_u u \sin r + s_v v \cos r + o_v

as in the specification's example and all renderers; its listing has another sign
(https://github.com/KhronosGroup/glTF/issues/1563). The base colour's texture decides, or else the first.

Specification: https://github.com/KhronosGroup/glTF/blob/main/extensions/2.0/Khronos/KHR_texture_transform/README.md
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from mixseq_io.gltf.document import Document
from mixseq_io.gltf.json_fields import Fields

_NAME = "KHR_texture_transform"
_TEXTURES = ("normalTexture", "occlusionTexture", "emissiveTexture")


def texture_transform(document: Document, primitive: Fields) -> NDArray[np.float64]:
    """Return a material's transform of TEXCOORD_0 as a matrix ``(2, 3)``, the offset in the last column."""
    index = primitive.index("material")
    textures = [] if index is None else _textures(document.item("materials", index))
    for texture in textures:
        transform = texture.object("extensions").object(_NAME)
        if transform.integer("texCoord", texture.integer("texCoord", 0)) == 0:
            return _matrix(transform)
    return np.eye(2, 3)


def _textures(material: Fields) -> Iterator[Fields]:
    """Yield the textures of a material, the base colour's first."""
    metal = material.object("pbrMetallicRoughness")
    for owner, names in (
        (metal, ("baseColorTexture", "metallicRoughnessTexture")),
        (material, _TEXTURES),
    ):
        yield from (owner.object(name) for name in names if name in owner)


def _matrix(transform: Fields) -> NDArray[np.float64]:
    offset, scale = transform.numbers("offset", 2), transform.numbers("scale", 2)
    rotation = transform.number("rotation", 0.0)
    cosine, sine = np.cos(rotation), np.sin(rotation)
    turn = np.array([[cosine, sine], [-sine, cosine]])
    scaled = turn * (np.ones(2) if scale is None else scale)
    return np.column_stack([scaled, np.zeros(2) if offset is None else offset])
