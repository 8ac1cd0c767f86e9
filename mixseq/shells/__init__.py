"""Reconstruct meshes from edge lengths and the dihedral angles between faces.

`face_frames` computes rotations of faces, `shell` relaxes meshes, and `fitting` fits meshes by Gauss-Newton. `kernels`
contains the compiled loops of both; `solvers` factors sparse systems.
"""
