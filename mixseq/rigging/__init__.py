"""Skins and morph targets fitted to sequences, for game engines.

Modules: `rigs` (data types of rigs), `bones` (skinning weights), `bone_tree` (joints and motions), `decomposition`
(fits of whole skins), `fitting` (`fit_skin` and `fit_morph`), `low_rank` (parts as sums of few basis vectors).
"""
