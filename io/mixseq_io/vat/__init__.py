"""Vertex animation textures for vertex shaders: `textures` encodes frames as pictures, `writer` writes the folder."""
