"""Mesh sequences: one mesh, new vertex positions every frame."""
