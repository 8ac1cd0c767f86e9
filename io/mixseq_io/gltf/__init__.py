"""Khronos' glTF 2.0, as text (.gltf) and binary (.glb).

`document` and `codecs` access JSON, buffers and compressed data. `scene`, `primitives`, `animation` and `reader` read;
`buffers`, `new_document`, `writer` and `rigs` write. `mesh_sequence` stores compressed models.
"""
