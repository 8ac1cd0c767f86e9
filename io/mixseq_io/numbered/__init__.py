"""Read and write numbered files of one frame each; `files` drives the formats `obj`, `ply` and `stl_off`."""
