"""Skins and morph targets fitted to sequences, for game engines.

`rigs` has the rigs, `bones` skinning weights, `bone_tree` joints and motions, `decomposition` whole skins, `fitting`
the functions `fit_skin` and `fit_morph`, `low_rank` parts of few basis vectors.
"""
