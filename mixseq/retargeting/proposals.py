r"""Propose markers of two bodies of one kind, in any poses, from their shapes and their motions.

*Tips* (of limbs, tail and head) are maxima of the mean distance along the surface with a large prominence
(`mixseq.retargeting.bodies`). All injective maps of the tips of one body to those of the other are ranked by

.. math::
    \operatorname{mean}_{ij} |\log (d_{ij} / d'_{ij})| + \tfrac12 \operatorname{mean}_i |\log (m_i / m'_i)| + 2 r ,

with distances d between tips, their mean distances m to the surface, and the least residual r of a proper similarity
between the tips over all pairs of poses. That pair of poses is where both bodies are most alike.

A *dense map* starts at the nearest neighbours in a space of features: distances to the tips, positions after the
similarity, and the *handedness* :math:`n \cdot (\nabla d_p \times \nabla d_q)` of pairs of tips p, q. A mirror changes
the sign of the handedness, a change of the pose does not. ZoomOut (Melzi et al. 2019) refines the map, both ways, in
the lowest eigenfunctions of the Laplacian with the features kept. So a map that exchanges left and right also
exchanges chest and back, which is refuted by shape. The *score* of a map is the mean relative residual of similarities
of patches, plus the residuals of similarities of the whole body and, with half the weight, of the tips. The *margin* is
the score of the best map with other partners of the tips, minus the score.

A proposal is sure if a second run on other coarse surfaces, the other way round, has the same tips, and both runs have
a low score, a margin and maps that preserve orientation. Sure maps are sampled at points far apart. A point is held out
of one of two registrations, which have the tips and half of the other points as markers, and kept if the registration
maps it to about the same point. A tip is left out if a registration by the points between tips maps it elsewhere.

*Left and right* of one body are exchanged by a dense map of the body to its mirror image, whose tips correspond to
themselves or to each other.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations, permutations
from typing import cast

import numpy as np

from mixseq.errors import MixseqWarning, SettingsError
from mixseq.mesh.rigid import aligning_rotations, kabsch
from mixseq.mesh.topology import Topology
from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.retargeting.bodies import SAME_TIP_DISTANCE, CoarseBody, find_largest_component
from mixseq.retargeting.correspond import correspond_and_assess
from mixseq.retargeting.markers import Markers
from mixseq.runtime.parallel import one_blas_thread
from mixseq.runtime.public import FileOr, HasFrames, public
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float, FloatArray, Index, Mask, evenly_spaced

RUN_VERTEX_COUNTS = 1000, 700  # number of vertices of coarse surfaces in the first and in the second run
MAX_POSES = 13  # largest number of sampled poses of a body
MIN_MATCHED_TIPS = 4  # smallest number of matched tips: fewer have similarities to their mirror image


def _fit_similarities(covariances: Float, first_norms: Float, second_norms: Float) -> tuple[Float, Float, Float]:
    """Fit proper similarities of centred points from covariances ``(..., 3, 3)`` and squared norms ``(...)``.

    Return rotations ``(..., 3, 3)``, scales ``(...)`` and sums of squared residuals ``(...)``.
    """
    rotations = aligning_rotations(covariances)
    products = (rotations * covariances).sum(axis=(-2, -1))
    scales = products / np.maximum(first_norms, 1e-12)
    return rotations, scales, np.maximum(second_norms - scales * products, 0.0)


def similarity_residuals(poses: Float, points: Float) -> Float:
    """Return the root mean square residuals ``(T,)`` of poses ``(T, n, 3)`` fitted to points, in their mean radius."""
    x, y = poses - poses.mean(axis=1, keepdims=True), points - points.mean(axis=0)
    norms = (x * x).sum(axis=(1, 2)), np.full(len(x), (y * y).sum())
    squares = _fit_similarities(np.einsum("ni,tnj->tij", y, x), *norms)[2]
    return np.asarray(np.sqrt(squares / np.maximum(norms[1], np.finfo(float).tiny)))


@dataclass(frozen=True)
class PosePair:
    """The most similar poses of two bodies."""

    poses: tuple[int, int]  # pose of each body
    rotation: Float  # (3, 3) rotation of the first body
    scale: float  # scale of the first body
    residual: float  # root mean square of residuals at the corresponding vertices


def find_pose_pair(first: CoarseBody, second: CoarseBody, pairs: Index) -> PosePair:
    """Find the poses in which corresponding vertices ``(k, 2)`` of two bodies are most similar."""
    x, y = first.poses[:, pairs[:, 0]], second.poses[:, pairs[:, 1]]
    x, y = x - x.mean(axis=1, keepdims=True), y - y.mean(axis=1, keepdims=True)
    norms = np.broadcast_arrays((x * x).sum(axis=(1, 2))[:, None], (y * y).sum(axis=(1, 2))[None])
    rotations, scales, squares = _fit_similarities(np.einsum("gni,fnj->fgij", y, x, optimize=True), *norms)
    f, g = np.unravel_index(int(squares.argmin()), squares.shape)
    residual = float(np.sqrt(squares[f, g] / len(pairs)))
    return PosePair((int(f), int(g)), rotations[f, g], float(scales[f, g]), residual)


MAX_TIP_MAPS = 300  # number of maps of tips, by distances, for which poses are compared
UNMATCHED_TIP_COST = 0.06  # additional cost of a map that leaves out one more tip
MIN_TIPS_TO_LEAVE_OUT = 5  # smallest number of tips of maps that leave out one tip that both bodies could have
RESIDUAL_WEIGHT = 2.0  # weight of residuals in ranks of maps, per root of the area


def rank_tip_maps(first: CoarseBody, second: CoarseBody) -> list[tuple[float, Index]]:
    """Return maps of tips by increasing cost of distances: costs and vertices ``(k, 2)``, known pairs first."""
    ends = [np.concatenate([body.known, body.tips]) for body in (first, second)]
    logs = [
        np.log(np.maximum(body.distances[np.ix_(e, e)], 1e-3)) for body, e in zip((first, second), ends, strict=True)
    ]
    mean_logs = [np.log(body.mean_distances[e]) for body, e in zip((first, second), ends, strict=True)]
    known_count = len(first.known)
    known_ids = np.arange(known_count)
    largest = min(len(first.tips), len(second.tips))
    sizes = {largest, largest - 1} if known_count + largest - 1 >= MIN_TIPS_TO_LEAVE_OUT else {largest}
    maps: list[tuple[float, Index]] = []
    for size in sorted(sizes, reverse=True):
        partners = np.array(list(permutations(range(len(second.tips)), size)), np.int64).reshape(-1, size)
        columns = np.concatenate([np.tile(known_ids, (len(partners), 1)), known_count + partners], axis=1)
        i, j = np.triu_indices(known_count + size, 1)
        for chosen in combinations(range(len(first.tips)), size):
            rows = np.concatenate([known_ids, known_count + np.array(chosen, np.int64)])
            if len(rows) < 3:
                continue
            costs = np.abs(logs[0][rows[i], rows[j]] - logs[1][columns[:, i], columns[:, j]]).mean(axis=1)
            costs += 0.5 * np.abs(mean_logs[0][rows] - mean_logs[1][columns]).mean(axis=1)
            costs += UNMATCHED_TIP_COST * (largest - size)
            for best in np.argsort(costs, kind="stable")[:MAX_TIP_MAPS].tolist():
                maps.append((float(costs[best]), np.stack([ends[0][rows], ends[1][columns[best]]], axis=1)))
    return sorted(maps, key=lambda ranked: ranked[0])[:MAX_TIP_MAPS]


def _rank_with_poses(first: CoarseBody, second: CoarseBody) -> list[Index]:
    """Return maps of tips ``(k, 2)`` by increasing cost of distances and residuals in the most similar poses."""
    ranked = [
        (cost + RESIDUAL_WEIGHT * find_pose_pair(first, second, pairs).residual, pairs)
        for cost, pairs in rank_tip_maps(first, second)
    ]
    return [pairs for _, pairs in sorted(ranked, key=lambda each: each[0])]


POSITION_WEIGHT, HANDEDNESS_WEIGHT, FEATURE_WEIGHT = 0.2, 0.3, 0.5  # weights of features; the last one in ZoomOut
EIGENFUNCTION_WEIGHT = 0.35  # weight of eigenfunctions in ZoomOut, divided by the root of their number
FIRST_EIGENFUNCTIONS, EIGENFUNCTION_STEP = 12, 6  # numbers of eigenfunctions of ZoomOut's first map and per step
POSE_SAMPLES = 80  # number of sample vertices that choose the most similar poses of a dense map


@dataclass(frozen=True, eq=False)
class DenseMap:
    """Map between the vertices of two bodies, which extends a map of tips."""

    pairs: Index  # (k, 2) corresponding tips
    to_first: Index  # (n',) vertex of the first body for every vertex of the second
    to_second: Index  # (n,) vertex of the second body for every vertex of the first
    poses: PosePair  # most similar poses
    score: float  # residuals of similarities; lower is better
    orientation: float  # share of the area on which the map preserves orientation


def contradict(pairs: Index, other_pairs: Index) -> bool:
    """Return whether a tip has different partners in two maps of tips ``(k, 2)`` and ``(m, 2)``."""
    is_same = pairs[:, None] == other_pairs[None]
    return bool((is_same[..., 0] != is_same[..., 1]).any())


def extend_tip_map(first: CoarseBody, second: CoarseBody, pairs: Index) -> DenseMap:
    """Extend corresponding tips ``(k, 2)`` to a dense map."""
    poses = find_pose_pair(first, second, pairs)
    samples = second.sample(POSE_SAMPLES)
    for _ in range(2):  # the first dense map finds poses that are more similar than those of the tips
        features = _features(first, second, pairs, poses)
        to_first, to_second = _zoom_out(first, second, *_nearest_rows(*features), features)
        poses = find_pose_pair(first, second, np.stack([to_first[samples], samples], axis=1))
    return assess_map(first, second, pairs, to_first, to_second, poses)


def _features(first: CoarseBody, second: CoarseBody, pairs: Index, poses: PosePair) -> tuple[Float, Float]:
    """Return features ``(n, c)`` and ``(n', c)`` that correspond under a map of tips."""
    a, b = pairs.T
    i, j = np.triu_indices(len(pairs), 1)
    to_tips = first.distances[:, a], second.distances[:, b]
    ratio = float(np.median(to_tips[0][a[i], j] / np.maximum(to_tips[1][b[i], j], 1e-9)))
    x, y = first.poses[poses.poses[0]], second.poses[poses.poses[1]]
    x = (x - x[a].mean(axis=0)) @ poses.rotation.T
    y = (y - y[b].mean(axis=0)) / max(poses.scale, 1e-9)
    tip_weight, pair_weight = 1 / np.sqrt(len(pairs)), HANDEDNESS_WEIGHT / np.sqrt(len(i))
    return (
        np.concatenate([tip_weight * to_tips[0], POSITION_WEIGHT * x, pair_weight * first.handedness(a)], axis=1),
        np.concatenate(
            [tip_weight * ratio * to_tips[1], POSITION_WEIGHT * y, pair_weight * second.handedness(b)], axis=1
        ),
    )


def _nearest_rows(first: Float, second: Float) -> tuple[Index, Index]:
    """Return the nearest row of the first for every row of the second, and vice versa."""
    first, second = first.astype(np.float32), second.astype(np.float32)
    squares = second @ first.T
    squares *= -2
    squares += np.square(first).sum(axis=1)
    to_first = squares.argmin(axis=1)
    squares += np.square(second).sum(axis=1)[:, None]
    return to_first, squares.argmin(axis=0)


def _zoom_out(
    first: CoarseBody, second: CoarseBody, to_first: Index, to_second: Index, features: tuple[Float, Float]
) -> tuple[Index, Index]:
    """Refine a map, with features ``(n, c)`` and ``(n', c)`` kept."""
    largest = min(body.eigenfunctions.shape[1] for body in (first, second))
    for count in range(min(FIRST_EIGENFUNCTIONS, largest), largest + 1, EIGENFUNCTION_STEP):
        a, b = first.eigenfunctions[:, :count], second.eigenfunctions[:, :count]
        pulled_back, pushed_back = second.project(a[to_first], count), first.project(b[to_second], count)
        weight = EIGENFUNCTION_WEIGHT / np.sqrt(2 * count)
        to_first, to_second = _nearest_rows(
            np.concatenate([weight * a, weight * a @ pushed_back, FEATURE_WEIGHT * features[0]], axis=1),
            np.concatenate([weight * b @ pulled_back, weight * b, FEATURE_WEIGHT * features[1]], axis=1),
        )
    return to_first, to_second


PATCH_COUNT, PATCH_SAMPLES = 120, 40  # number of patches, and of sample vertices of each
PATCH_SHARE = 0.1  # share of a body's vertices in a patch


def assess_map(
    first: CoarseBody, second: CoarseBody, pairs: Index, to_first: Index, to_second: Index, poses: PosePair
) -> DenseMap:
    """Compute the score and the orientation of a dense map in the most similar poses."""
    f, g = poses.poses
    vertex_pairs = np.stack([to_first, np.arange(len(to_first))], axis=1)
    posed = replace(first, poses=first.poses[f : f + 1]), replace(second, poses=second.poses[g : g + 1])
    body_residual, tip_residual = (find_pose_pair(*posed, each).residual for each in (vertex_pairs, pairs))
    patch_residual = _patch_residual(first, second, to_first, (f, g)) + _patch_residual(
        second, first, to_second, (g, f)
    )
    score = patch_residual / 2 + body_residual + tip_residual / 2
    orientation = (_preserved_area(first, second, to_first) + _preserved_area(second, first, to_second)) / 2
    return DenseMap(pairs, to_first, to_second, poses, score, orientation)


def _patch_residual(first: CoarseBody, second: CoarseBody, to_first: Index, poses: tuple[int, int]) -> float:
    """Return the mean residual of similarities of patches of the second body, relative to their radii."""
    order = np.argsort(second.distances[second.sample(PATCH_COUNT)], axis=1, kind="stable")
    size = min(max(int(PATCH_SHARE * order.shape[1]), PATCH_SAMPLES), order.shape[1])
    patches = order[:, evenly_spaced(size, PATCH_SAMPLES)]
    x, y = first.poses[poses[0]][to_first[patches]], second.poses[poses[1]][patches]
    x, y = x - x.mean(axis=1, keepdims=True), y - y.mean(axis=1, keepdims=True)
    norms = (x * x).sum(axis=(1, 2)), (y * y).sum(axis=(1, 2))
    squares = _fit_similarities(np.swapaxes(y, 1, 2) @ x, *norms)[2]
    return float(np.sqrt(squares / np.maximum(norms[1], 1e-12)).mean())


def _preserved_area(first: CoarseBody, second: CoarseBody, to_first: Index) -> float:
    """Return the share of the second body's area whose image faces outwards, among triangles that keep an area."""
    faces = second.surface.mesh.topology.faces
    corners = first.surface.points[to_first[faces]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    cosines = np.einsum("fi,fi->f", normals, first.surface.mesh.vertex_normals[to_first[faces]].mean(axis=1))
    areas = second.surface.mesh.face_areas * (np.abs(cosines) > 1e-14)
    return float(areas @ (cosines > 0) / max(float(areas.sum()), 1e-12))


MAX_DENSE_MAPS = 9  # number of ranked maps of tips that become dense maps
MAX_EQUIVALENT_MAPS = 2  # number of dense maps without contradiction, such as maps that leave out different tips
MAX_SYMMETRIES = 6  # number of symmetries of a body by which the best map is changed
MAX_SYMMETRY_COST = 0.2  # largest cost of a map of a body's tips to themselves


def find_best_map(first: CoarseBody, second: CoarseBody) -> tuple[DenseMap, float] | None:
    """Find the dense map of the lowest score and its margin; return None with too few tips."""
    chosen: list[Index] = []
    for pairs in _rank_with_poses(first, second):
        if sum(not contradict(pairs, other) for other in chosen) < MAX_EQUIVALENT_MAPS:
            chosen.append(pairs)
        if len(chosen) == MAX_DENSE_MAPS:
            break
    if not chosen or len(chosen[0]) < MIN_MATCHED_TIPS:
        return None
    maps = {_key(pairs): extend_tip_map(first, second, pairs) for pairs in chosen}
    for _ in range(2):  # maps that differ from the best by a symmetry are its strongest rivals
        best = min(maps.values(), key=lambda each: each.score)
        for pairs in _symmetric_maps(second, best.pairs):
            if _key(pairs) not in maps:
                maps[_key(pairs)] = extend_tip_map(first, second, pairs)
    best = min(maps.values(), key=lambda each: each.score)
    rivals = [each.score for each in maps.values() if contradict(each.pairs, best.pairs)]
    return best, min(rivals, default=np.inf) - best.score


def _key(pairs: Index) -> tuple[tuple[int, int], ...]:
    return tuple(sorted(map(tuple, pairs.tolist())))


def _symmetric_maps(body: CoarseBody, pairs: Index) -> Iterator[Index]:
    """Yield a map of tips with the tips of the second body replaced by their images under its symmetries."""
    symmetries = [
        dict(each.tolist())
        for cost, each in rank_tip_maps(body, body)
        if cost < MAX_SYMMETRY_COST and (each[:, 0] != each[:, 1]).any()
    ]
    for symmetry in symmetries[:MAX_SYMMETRIES]:
        if all(tip in symmetry for tip in pairs[:, 1].tolist()):
            yield np.stack([pairs[:, 0], [symmetry[tip] for tip in pairs[:, 1].tolist()]], axis=1)


MAX_EXCHANGES = 8  # number of ranked exchanges of tips that become dense maps
PAIR_BONUS = 0.03  # bonus of the score for a pair of exchanged tips: limbs are exchanged rather than bent
MAX_ROUND_TRIP_DISTANCE = 0.08  # largest distance of a point from its double mirror image, in roots of the area
MIN_PARTNER_DISTANCE = 0.08  # smallest distance of partners off the middle of the body, in roots of the area
NEIGHBOURHOOD_RINGS = 2  # number of rings of vertices around a point to which a reflection is fitted
MIN_NORMAL_COSINE = 0.5  # smallest cosine between the normal of a partner and the mirrored normal


@dataclass(frozen=True, eq=False)
class Mirror:
    """Mirror map of a body: the partner of every coarse vertex on the opposite side."""

    mesh: TriangleMesh  # mesh of the body
    body: CoarseBody  # coarse body
    partners: Index  # (n,) partner of every vertex of the coarse body

    @classmethod
    def from_poses(cls, poses: FloatArray, topology: Topology) -> Mirror | None:
        """Find the mirror map of a mesh in poses ``(T, V, 3)``; return None if it has no two similar sides."""
        with one_blas_thread():
            body = CoarseBody.from_poses(poses, topology, RUN_VERTEX_COUNTS[0], np.zeros(0, np.int64))
            image = body.mirrored()
            exchanges = [pairs for pairs in _rank_with_poses(body, image) if _is_exchange(pairs)][:MAX_EXCHANGES]
            maps = [extend_tip_map(body, image, pairs) for pairs in exchanges]
        best = min(maps, key=lambda each: each.score - PAIR_BONUS * _exchanged_count(each.pairs) / 2, default=None)
        if best is None or best.score > MAX_SURE_SCORE or best.orientation < MIN_SURE_ORIENTATION:
            return None
        return cls(TriangleMesh(np.asarray(poses[0], np.float64), topology), body, best.to_second)

    def find_partner(self, vertex: int) -> int | None:
        """Return the mirrored vertex, or None if uncertain, in the middle, or outside the largest component."""
        surface, component_of_vertex = self.body.surface, self.mesh.topology.component_of_vertex
        component = component_of_vertex[surface.vertices[self.body.is_own][0]]
        if component_of_vertex[vertex] != component:
            return None
        point = (self.mesh.points[vertex] - surface.centre) / surface.size
        coarse_vertex = int(np.linalg.norm(surface.points - point, axis=1).argmin())
        partner = self.partners[coarse_vertex]
        round_trip, partner_distance = self.body.distances[coarse_vertex, [self.partners[partner], partner]]
        if round_trip > MAX_ROUND_TRIP_DISTANCE or partner_distance < MIN_PARTNER_DISTANCE:
            return None
        mirrored, mirrored_normal = self._mirror_point(coarse_vertex, point, self.mesh.vertex_normals[vertex])
        candidates = np.flatnonzero(component_of_vertex == component)
        is_facing = self.mesh.vertex_normals[candidates] @ mirrored_normal >= MIN_NORMAL_COSINE
        candidates = candidates[is_facing] if is_facing.any() else candidates
        offsets = self.mesh.points[candidates] - (surface.centre + surface.size * mirrored)
        return int(candidates[np.einsum("vi,vi->v", offsets, offsets).argmin()])

    def _mirror_point(self, coarse_vertex: int, point: Float, normal: Float) -> tuple[Float, Float]:
        """Mirror a point near a coarse vertex, and its normal, by a reflection fitted to the neighbourhood."""
        surface, ring = self.body.surface, np.array([coarse_vertex])
        adjacency = surface.mesh.topology.vertex_adjacency
        for _ in range(NEIGHBOURHOOD_RINGS):
            ring = np.unique(np.concatenate([ring, adjacency[ring].indices]))
        rotation, shift = kabsch(-surface.points[ring], surface.points[self.partners[ring]])
        return rotation @ -point + shift, rotation @ -normal


def _is_exchange(pairs: Index) -> bool:
    """Return whether pairs of tips ``(k, 2)`` of one body exchange some of them, and exchange them back."""
    partners = dict(pairs.tolist())
    is_back = all(partners.get(other) == tip for tip, other in partners.items())
    return is_back and _exchanged_count(pairs) > 0


def _exchanged_count(pairs: Index) -> int:
    return int((pairs[:, 0] != pairs[:, 1]).sum())


MAX_SURE_SCORE = 0.65  # largest score of a sure map
MAX_CLEAR_SCORE, MIN_CLEAR_MARGIN = 0.72, 0.08  # largest score of a sure map with a margin, and that margin
MIN_SURE_MARGIN = 0.025  # smallest margin of a sure map, mean of both runs
MIN_SURE_ORIENTATION = 0.7  # smallest share of the area on which a sure map preserves orientation
MIN_MARKERS = 12  # smallest number of proposed markers, with tips
MARKER_SAMPLES = 40  # number of sample vertices that may become markers
MAX_ROUND_TRIP = 0.05  # largest distance of a marker from its image there and back, in roots of the area
MAX_HELD_OUT_DISTANCE = 0.05  # largest distance of a marker from where a registration without it maps it
MAX_TIP_DISTANCE = 0.15  # largest distance of a tip from where a registration without tips maps it
HELD_OUT_STIFFNESS, HELD_OUT_STEPS = 1e-3, 6  # last stiffness, and number of stiffnesses, of these registrations


@dataclass(frozen=True, eq=False)
class Proposal:
    """Proposed markers of two bodies."""

    markers: Markers  # known markers, tips, then points between them; only known markers if there is a doubt
    tip_count: int  # number of markers that are known or at tips
    tips: Index  # (k, 2) best pairs of tips, also if there is a doubt
    poses: tuple[int, int]  # pose of each body in which both are most alike
    score: float  # score of the worse run; infinite if there is none
    margin: float  # mean margin of both runs
    doubt: str  # why the proposal is not sure; empty if it is


Poses = tuple[FloatArray, Topology]
"""Poses ``(T, V, 3)`` of a mesh, and its topology."""


@one_blas_thread()
def propose_markers(first: Poses, second: Poses, known: Markers | None = None) -> Proposal:
    """Propose markers of two bodies, and keep known markers."""
    known = known or Markers.from_pairs([])
    known_pairs = np.stack([known.source, known.target], axis=1)
    for side, (poses, topology) in enumerate((first, second)):
        on_body = np.unique(find_largest_component(np.asarray(poses[0], np.float64), topology))
        known_pairs = known_pairs[np.isin(known_pairs[:, side], on_body)]
        known_pairs = known_pairs[np.sort(np.unique(known_pairs[:, side], return_index=True)[1])]
    bodies, check_bodies = (
        (
            CoarseBody.from_poses(*first, count, known_pairs[:, 0]),
            CoarseBody.from_poses(*second, count, known_pairs[:, 1]),
        )
        for count in RUN_VERTEX_COUNTS
    )
    run, check_run = find_best_map(*bodies), find_best_map(*check_bodies[::-1])
    if run is None or check_run is None:
        doubt = "the bodies have fewer than four limbs in common"
        return Proposal(known, len(known), known_pairs, (0, 0), np.inf, 0.0, doubt)
    (best, margin), (check, check_margin) = run, check_run
    tips = _to_mesh_vertices(bodies, best.pairs)
    unsure = Proposal(
        known, len(known), tips, best.poses.poses, max(best.score, check.score), (margin + check_margin) / 2, ""
    )
    doubt = _find_doubt(best, check, unsure.margin, _count_agreeing_tips(bodies, check_bodies, best, check))
    if doubt:
        return replace(unsure, doubt=doubt)
    pairs, is_tip = sample_markers(*bodies, best)
    if is_tip.sum() < MIN_MATCHED_TIPS or len(pairs) < MIN_MARKERS:
        return replace(unsure, doubt="too few points of the bodies fit each other")
    vertices = _to_mesh_vertices(bodies, pairs)
    is_new = ~np.isin(vertices[:, 0], known.source) & ~np.isin(vertices[:, 1], known.target)
    source, target = np.concatenate([np.stack([known.source, known.target], axis=1), vertices[is_new]]).T
    names = (*known.names, *[""] * int(is_new.sum())) if known.names else ()
    return replace(unsure, markers=Markers(source, target, names), tip_count=len(known) + int((is_tip & is_new).sum()))


def _to_mesh_vertices(bodies: tuple[CoarseBody, CoarseBody], pairs: Index) -> Index:
    """Return the vertices of the meshes for vertices ``(k, 2)`` of coarse surfaces."""
    return np.stack([body.surface.vertices[pairs[:, side]] for side, body in enumerate(bodies)], axis=1)


def _find_doubt(best: DenseMap, check: DenseMap, margin: float, agreement: tuple[int, int]) -> str:
    """Return why the maps of two runs are not sure, or an empty text."""
    agreeing, contradicting = agreement
    if contradicting or agreeing < MIN_MATCHED_TIPS:
        return "limbs could correspond in more than one way"
    if max(best.score, check.score) > (MAX_SURE_SCORE if margin < MIN_CLEAR_MARGIN else MAX_CLEAR_SCORE):
        return "the bodies differ too much in shape or in their poses"
    if margin < MIN_SURE_MARGIN:
        return "left and right, or front and back, could be exchanged"
    if min(best.orientation, check.orientation) < MIN_SURE_ORIENTATION:
        return "no map between the bodies keeps their sides"
    return ""


def _count_agreeing_tips(
    bodies: tuple[CoarseBody, CoarseBody], check_bodies: tuple[CoarseBody, CoarseBody], best: DenseMap, check: DenseMap
) -> tuple[int, int]:
    """Return the numbers of tips of the first run with the same and with other partners in the second run."""
    near = []
    for side, (body, other) in enumerate(zip(bodies, check_bodies, strict=True)):
        tips = body.surface.points[best.pairs[:, side]] * body.surface.size + body.surface.centre
        other_tips = other.surface.points[check.pairs[:, 1 - side]] * other.surface.size + other.surface.centre
        distances = np.linalg.norm(tips[:, None] - other_tips, axis=2) / body.surface.size
        is_nearest = (distances == distances.min(axis=1, keepdims=True)) & (distances == distances.min(axis=0))
        near.append(is_nearest & (distances < SAME_TIP_DISTANCE))
    is_same = near[0] @ near[1].T  # whether a pair of the second run joins a tip to the partner of another
    return int(is_same.diagonal().sum()), int((is_same & ~np.eye(len(is_same), dtype=bool)).sum())


def sample_markers(first: CoarseBody, second: CoarseBody, best: DenseMap) -> tuple[Index, Mask]:
    """Sample a dense map: corresponding vertices ``(n, 2)``, tips first, and the mask ``(n,)`` of tips."""
    # Samples are on the mesh with fewer vertices, the images on the other one.
    side = 1 if first.is_own.all() else 0
    body, to_body, to_other = ((first, best.to_first, best.to_second), (second, best.to_second, best.to_first))[side]
    samples = np.setdiff1d(body.sample(MARKER_SAMPLES, body.is_own), best.pairs[:, side])
    images = to_other[samples]
    round_trips = body.distances[samples, to_body[images]]
    order = np.argsort(round_trips, kind="stable")
    order = order[round_trips[order] < MAX_ROUND_TRIP]
    sampled = np.stack([samples, images] if side == 0 else [images, samples], axis=1)[order]
    sampled = sampled[first.is_own[sampled[:, 0]] & second.is_own[sampled[:, 1]]]
    pairs = np.concatenate([best.pairs, sampled])
    for column in range(2):
        pairs = pairs[np.sort(np.unique(pairs[:, column], return_index=True)[1])]
    is_tip = np.isin(pairs[:, 1], best.pairs[:, 1])
    number = np.cumsum(~is_tip)
    distances = np.full(len(pairs), np.inf)
    for half in range(2):
        is_given = is_tip | (number % 2 == half)
        registered = _register_surfaces(first, second, best.poses.poses, pairs[is_given])
        if registered is None:
            continue
        images = registered[pairs[:, 1]]
        held_out = np.where(images >= 0, first.distances[pairs[:, 0], images], np.inf)
        distances = np.where(is_given & ~is_tip, distances, np.minimum(distances, held_out))
    is_kept = distances < MAX_HELD_OUT_DISTANCE
    between = pairs[is_kept & ~is_tip]
    if len(between) >= MIN_MARKERS:  # tips of a head may be its nose on one body, and an ear on the other one
        registered = _register_surfaces(first, second, best.poses.poses, between)
        if registered is not None:
            images = registered[pairs[:, 1]]
            is_far = (images >= 0) & (first.distances[pairs[:, 0], images] > MAX_TIP_DISTANCE)
            is_kept &= ~(is_tip & is_far)
    is_kept[: len(first.known)] = True
    return pairs[is_kept], is_tip[is_kept]


def _register_surfaces(first: CoarseBody, second: CoarseBody, poses: tuple[int, int], pairs: Index) -> Index | None:
    """Return the vertex of the first body for every vertex of the second, or -1, by a registration with markers."""
    meshes = [
        MeshSequence.from_arrays(body.poses[pose][None], body.surface.mesh.topology.faces)
        for body, pose in zip((first, second), poses, strict=True)
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MixseqWarning)  # of markers that the registration cannot reach
        try:
            correspondence, _ = correspond_and_assess(
                meshes[0], meshes[1], Markers.from_pairs(pairs), last_stiffness=HELD_OUT_STIFFNESS, steps=HELD_OUT_STEPS
            )
        except SettingsError:
            return None
    nearest = correspondence.corners[np.arange(len(correspondence.corners)), correspondence.weights.argmax(axis=1)]
    return np.where(correspondence.matched, nearest, -1)


@public
def suggest_markers(
    source: FileOr[MeshSequence | HasFrames],
    target: FileOr[MeshSequence | HasFrames],
    known: FileOr[Markers] | None = None,
) -> Markers:
    """Suggest markers of two bodies of one kind, such as two humans or two quadrupeds, in any poses.

    All frames of both are used: moving bodies are recognised better.

    Parameters
    ----------
    source : MeshSequence
        Mesh whose motion is transferred.
    target : MeshSequence
        Mesh that receives the motion.
    known : Markers, optional
        Markers that are set already. Two or three (a hand, a foot, the nose) help where the suggestion is not sure.

    Returns
    -------
    Markers
        Known markers, then limbs, tail and head, then points between them. There are only the known markers if
        the suggestion is not sure.

    Raises
    ------
    SettingsError
        If a mesh has no area.

    Examples
    --------
    >>> import mixseq
    >>> markers = mixseq.suggest_markers("arm.usdc", "long.obj")
    >>> len(markers.source) == len(markers.target)
    True
    """
    source = cast("MeshSequence", source)
    target = cast("MeshSequence", target)
    known = cast("Markers | None", known)
    return propose_markers(sample_poses(source), sample_poses(target), known).markers


def sample_poses(sequence: MeshSequence) -> Poses:
    """Return some poses of a sequence with its topology."""
    frames = evenly_spaced(sequence.frame_count, MAX_POSES)
    return sequence.points[frames], Topology(sequence.faces, sequence.vertex_count)
