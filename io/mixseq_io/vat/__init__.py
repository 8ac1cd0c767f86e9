"""Vertex animation textures: frames in pictures, which graphics cards look up in the vertex shader."""
