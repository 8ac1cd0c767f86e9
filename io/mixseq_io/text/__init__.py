"""Read and write text and array files with data of faces and vertices.

`labels` and `label_files` handle parts, `markers` markers and contacts, and `maps` correspondences.
"""
