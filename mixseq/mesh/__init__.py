"""One mesh in one pose: connectivity, measures, rotations, closest points, decimation, and data for files.

`topology` is connectivity; `measures` are lengths, angles, areas and normals; `rigid` and `rotations` are rigid
motions; `nearest` searches a `box_tree`; `polygons` and `surface` are the mesh as authored.
"""
