"""A method at several weights: its blends, the bands of its errors, and numbers that sum them up."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixseq.types import Float
from scripts.paper_study.common.errors import errors
from scripts.paper_study.common.methods import Blended, Method
from scripts.paper_study.common.poses import MESHES, Poses, between
from scripts.paper_study.common.record import Json


class Along(NamedTuple):
    """Blends of two poses.

    Attributes
    ----------
    blends : list of Blended
        At all weights.
    bands : dict
        Bands of lengths and degrees, for `pictures.envelopes`.
    found : dict
        Errors at 99, 99.9 and 100 %: at w = 0.5 (``middle``) and the largest of all weights (``worst``), and how many
        fits did not converge.
    """

    blends: list[Blended]
    bands: Json
    found: Json

    @property
    def middle(self) -> Float:
        """The blend at w = 0.5."""
        return self.blends[len(self.blends) // 2].points


def weights_of(poses: Poses) -> list[float]:
    """Return the weights of the second pose that are tried on a mesh."""
    weights: list[float] = np.linspace(0, 1, MESHES[poses.mesh].steps + 1).tolist()
    return weights


def along(poses: Poses, method: Method) -> Along:
    """Blend two poses with all weights."""
    method.prepare()
    weights = weights_of(poses)
    blends = [method.at(between(w)) for w in weights]
    away = [errors(poses, between(w), blend.points) for w, blend in zip(weights, blends, strict=True)]
    lengths, degrees = zip(*(each.bands() for each in away), strict=True)
    summaries = [each.summary() for each in away]
    found = {
        "middle": summaries[len(weights) // 2],
        "worst": {kind: np.max([s[kind] for s in summaries], axis=0).tolist() for kind in summaries[0]},
        "unconverged": sum(not report.converged for blend in blends for report in blend.reports),
    }
    return Along(blends, {"lengths": lengths, "degrees": degrees}, found)
