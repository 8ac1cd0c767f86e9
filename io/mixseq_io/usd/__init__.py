"""Pixar's Universal Scene Description.

`stage`: diagnostics, prims, transforms; `motion`: skins and frames; `surface`: faces, materials, subsets; `reader`;
`layers`: samples and packages; `overlay`: layers over an original; `writer`; `rigs`: skins and morphs.
"""
