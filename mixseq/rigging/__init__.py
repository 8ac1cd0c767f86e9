"""Fit skins and morph targets to sequences, for engines.

`rigs` holds skins and morphs, `skeletons` trees of bones, `centred` the frames to fit; `rig_fitting` fits both rigs.
`decomposition` alternates `weights` (with `weight_kernels`) and `jointed_motions`, starting from `bones` and
`bone_tree` (`found_bones`), or from `given_skeletons`. `bone_counts` finds the number of bones for an error;
`correctives` fits targets, `low_rank` basis vectors of parts, for textures.
"""

from __future__ import annotations

from mixseq.rigging.rig_fitting import fit_morph, fit_skin
from mixseq.rigging.rigs import Morph, Skin
from mixseq.rigging.skeletons import Skeleton

__all__ = ["Morph", "Skeleton", "Skin", "fit_morph", "fit_skin"]
