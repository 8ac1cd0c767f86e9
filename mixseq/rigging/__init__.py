"""Skins and morph targets fitted to sequences, for game engines.

`rigs` holds the rigs, `bones` weights and motions, `bone_tree` joints, `decomposition` whole skins. `fitting` has
`fit_skin` and `fit_morph`, `low_rank` parts of few basis vectors.
"""
