"""Numbered files of one frame each: OBJ, PLY, STL, OFF."""
