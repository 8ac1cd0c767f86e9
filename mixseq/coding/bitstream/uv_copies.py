r"""Regions of texture coordinates that are copies of earlier ones: translated, rotated, scaled, mirrored.

The two sides of a character are usually unwrapped alike, and then packed: each piece is the mirror image of another
one. So a polygon may have an *image*, an earlier polygon with the same number of corners. The image of its first
corner, and whether it is mirrored, is coded where a *region* begins; from there the image of a polygon follows from
that of an adjacent one. With o a corner whose coordinates and whose image's are known, the one before or after x, or
else the region's first, and :math:`p, q` two more of the region, far from each other, the copy of x is

.. math:: x = o + \frac{q - p}{q' - p'}\, (x' - o')

as complex numbers, where primes are images, conjugated if they are mirrored. With only one known corner the image is
translated, and mirrored in u.

Frozen: changing this breaks old files (golden: ``tests/coding/golden/uvs.npz``). numba caches compiled loops by the
text of their own file: edit `mixseq.coding.bitstream.uv_values` whenever this module changes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Index
from mixseq.coding.bitstream.growing import Corners, after, before
from mixseq.coding.bitstream.uv_guesses import Guess, Known
from mixseq.compiled import compiled

_PRECISION = 17
"""Bits of the numbers by which copies are rotated and scaled. Frozen: breaks old files."""


class Copies(NamedTuple):
    """Images so far."""

    places: Index  # (P,) when a polygon is visited
    image: Index  # (C,) the image of every corner, -1 if there is none
    mirrored: NDArray[np.bool_]  # (P,) whether the image of a polygon is mirrored
    region: Index  # (P,) when the region of a polygon began, -1 for none
    # (P, 2) for every region, by when it began: the first corner that is known with its image, and the one whose image
    # is farthest from the image of that; -1 for none.
    anchors: Index


def no_copies(corners: Corners, order: Index) -> Copies:
    """Return a state without regions."""
    places = np.empty(len(order), dtype=np.int64)
    places[order] = np.arange(len(order))
    return Copies(
        places=places,
        image=np.full(len(corners.node), -1, dtype=np.int64),
        mirrored=np.zeros(len(order), dtype=np.bool_),
        region=np.full(len(order), -1, dtype=np.int64),
        anchors=np.full((len(order), 2), -1, dtype=np.int64),
    )


@compiled
def image_of(corners: Corners, copies: Copies, corner: int) -> int:
    """Return the image of a corner that follows from the polygon across the half-edge from it; -1 if there is none."""
    there = corners.twin[corner]
    if there < 0 or copies.region[corners.polygon[there]] < 0:
        return -1
    if not copies.mirrored[corners.polygon[there]]:
        image: int = corners.twin[copies.image[there]]
        return image
    edge = corners.twin[copies.image[after(corners, there)]]
    return after(corners, edge) if edge >= 0 else -1


@compiled
def follow(corners: Corners, copies: Copies, polygon: int) -> bool:
    """Set a polygon's image from an adjacent polygon, its corners in order; return whether there is one."""
    for corner in range(corners.starts[polygon], corners.starts[polygon + 1]):
        image = image_of(corners, copies, corner)
        if image >= 0 and fits(corners, copies, polygon, corners.polygon[image]):
            beside = corners.polygon[corners.twin[corner]]
            give_image(corners, copies, corner, image, copies.mirrored[beside], copies.region[beside])
            return True
    return False


@compiled
def fits(corners: Corners, copies: Copies, polygon: int, image: int) -> bool:
    """Return whether a polygon can be the image of another one."""
    starts, places = corners.starts, copies.places
    same = starts[image + 1] - starts[image] == starts[polygon + 1] - starts[polygon]
    return bool(same and places[image] < places[polygon])


@compiled
def give_image(
    corners: Corners, copies: Copies, corner: int, image: int, mirrored: bool, region: int
) -> None:
    """Set the image of a corner, and with it of all corners of its polygon."""
    polygon = corners.polygon[corner]
    copies.mirrored[polygon] = mirrored
    copies.region[polygon] = region
    for _ in range(corners.starts[polygon + 1] - corners.starts[polygon]):
        copies.image[corner] = image
        corner = after(corners, corner)
        image = before(corners, image) if mirrored else after(corners, image)


@compiled
def drop_anchor(corners: Corners, copies: Copies, known: Known, corner: int) -> None:
    """Make a corner an anchor of its region, if it is the first one, or its image farther from the first one's."""
    node, values, image = corners.node, known.values, copies.image[corner]
    anchors = copies.anchors[copies.region[corners.polygon[corner]]]
    if not (known.there[node[corner]] and known.there[node[image]]):
        return
    if anchors[0] < 0:
        anchors[0] = corner
        return
    origin = values[node[copies.image[anchors[0]]]]
    far, at = 0, values[node[image]]
    if anchors[1] >= 0:
        other = values[node[copies.image[anchors[1]]]]
        far = abs(other[0] - origin[0]) + abs(other[1] - origin[1])
    if abs(at[0] - origin[0]) + abs(at[1] - origin[1]) > far:
        anchors[1] = corner


@compiled
def copy(corners: Corners, copies: Copies, known: Known, corner: int, guess: Guess) -> int:
    """Set the guess at a corner to the copy of its image; return its number of anchors, 0 if there is no copy."""
    node, values, there, images = corners.node, known.values, known.there, copies.image
    polygon = corners.polygon[corner]
    if copies.region[polygon] < 0 or not there[node[images[corner]]]:
        return 0
    p, q = copies.anchors[copies.region[polygon]]
    if p < 0:
        return 0
    o = before(corners, corner)
    if not (there[node[o]] and there[node[images[o]]]):
        o = after(corners, corner)
    if not (there[node[o]] and there[node[images[o]]]):
        o = p
    sign = -1 if copies.mirrored[polygon] else 1
    away_u = values[node[images[corner]], 0] - values[node[images[o]], 0]
    away_v = values[node[images[corner]], 1] - values[node[images[o]], 1]
    if q < 0:
        guess.at[0], guess.at[1] = values[node[o], 0] + sign * away_u, values[node[o], 1] + away_v
        return 1
    here_u = values[node[q], 0] - values[node[p], 0]
    here_v = values[node[q], 1] - values[node[p], 1]
    there_u = values[node[images[q]], 0] - values[node[images[p]], 0]
    there_v = sign * (values[node[images[q]], 1] - values[node[images[p]], 1])
    away_v *= sign
    size = abs(here_u) + abs(here_v) + abs(there_u) + abs(there_v)
    while size >> _PRECISION:
        here_u, here_v, there_u, there_v = here_u >> 1, here_v >> 1, there_u >> 1, there_v >> 1
        size >>= 1
    whole = there_u * there_u + there_v * there_v
    if whole == 0:
        return 0
    turn_u = here_u * there_u + here_v * there_v
    turn_v = here_v * there_u - here_u * there_v
    guess.at[0] = values[node[o], 0] + (2 * (turn_u * away_u - turn_v * away_v) + whole) // (2 * whole)
    guess.at[1] = values[node[o], 1] + (2 * (turn_u * away_v + turn_v * away_u) + whole) // (2 * whole)
    return 2
