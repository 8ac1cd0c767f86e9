"""Write vertex animation textures for shaders: `textures` encodes frames as images, `writer` writes the folder."""
