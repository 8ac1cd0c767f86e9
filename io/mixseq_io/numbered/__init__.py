"""Numbered files of one frame each: `files` is the driver of `obj`, `ply` and `stl_off`."""
