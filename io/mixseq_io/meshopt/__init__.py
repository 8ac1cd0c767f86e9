"""Bytes of vertices and triangles as meshoptimizer packs them, which glTF files hold as ``EXT_meshopt_compression``.

The loops are our own: the package `meshoptimizer` on the package index has no wheels (as of 0.2.30a0), and who installs
mixseq needs no compiler. They are compiled by numba as all others, check every read against the end of the data, and so
need no process of their own for damaged files.
"""
