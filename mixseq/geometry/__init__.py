"""Quantities of meshes: edge lengths and dihedral angles, rigid motions, rotations."""
