"""What Blender's side and ours both know about the shot."""

FIRST, LAST, BASE = 1001, 1096, 24
"""Its first and last frame, at so many frames per second."""

RATES = (BASE, 120)
"""Frames per second at which it is exported: as it is given to mixseq, and finer."""
