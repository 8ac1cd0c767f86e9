"""Pixar's Universal Scene Description.

`stage`: diagnostics, prims, transforms; `motion`: skins and frames; `surface`: faces and what is stored on them;
`reader`; `layers`: samples, clips, packages; `overlay`: layers over an original; `writer`; `rigs`: skins and morphs.
"""
