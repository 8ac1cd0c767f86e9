"""Mesh sequences: a `header` with the mesh and its times, new points every frame (`sequence`), and `frame_rates`."""
