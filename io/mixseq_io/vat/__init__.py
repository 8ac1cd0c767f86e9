"""Vertex animation textures: frames in pictures for vertex shaders."""
