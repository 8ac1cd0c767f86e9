"""One mesh in one pose: connectivity, measures, rotations, closest points, decimation, and data for files.

Modules: `topology` (connectivity), `measures` (lengths, angles, areas, normals), `rigid` and `rotations` (rigid
motions), `nearest` and `box_tree` (closest points), `polygons` and `surface` (the mesh as authored).
"""
