"""Pixar's Universal Scene Description.

`reader` opens files; `stage` handles diagnostics, prims and transforms, `motion` skinning and frames, `surface` faces
and their attributes. `writer` makes files; `layers` writes samples, clips and packages; `overlay` layers over an
original; `rigs` reads and writes skins.
"""
