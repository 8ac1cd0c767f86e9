"""Mesh sequences: the mesh and frame times (`header`), points of every frame (`sequence`), and `frame_rates`."""
