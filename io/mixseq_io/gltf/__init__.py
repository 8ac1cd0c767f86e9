"""Khronos' glTF 2.0, as text (.gltf) and binary (.glb).

`document`, `codecs`: JSON, buffers, compression; `scene`, `primitives`, `animation`, `reader`: reading; `new_document`,
`edits`, `writer`, `rigs`: writing; `mesh_sequence`: compressed models.
"""
