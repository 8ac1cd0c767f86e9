"""Skins and morph targets fitted to sequences, for engines.

`rigs` says what they are, `skeletons` how bones hang together; `rig_fitting` makes them, of frames that are `centred`:
`decomposition` alternates `weights` (with `weight_kernels`), how vertices follow bones, and `jointed_motions`, how
bones move; they start as `bones` tells, and `bone_tree` hangs them together, or all that is told by
`given_skeletons`. `bone_counts` tells how many an error asks for; `correctives` fits targets. `low_rank` fits basis
vectors of parts, for textures.
"""

from __future__ import annotations

from mixseq.rigging.rig_fitting import fit_morph, fit_skin
from mixseq.rigging.rigs import Morph, Skin
from mixseq.rigging.skeletons import Skeleton

__all__ = ["Morph", "Skeleton", "Skin", "fit_morph", "fit_skin"]
