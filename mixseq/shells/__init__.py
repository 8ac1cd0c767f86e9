"""Meshes from the lengths of their edges and the dihedral angles between their faces."""
