"""Meshes from the lengths of their edges and the dihedral angles between their faces.

`face_frames` finds rotations of faces, `shell` relaxes a mesh, `fitting` fits one by Gauss-Newton; `kernels` are their
compiled loops, `solvers` and `gauss_newton` factor sparse systems.
"""
