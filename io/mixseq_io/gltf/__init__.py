"""Khronos' glTF 2.0, as text (.gltf) and binary (.glb)."""
