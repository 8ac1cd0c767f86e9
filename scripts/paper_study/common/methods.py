"""The interpolation methods that are compared, each as a blend of poses that is prepared once.

=====================  ==================================================================================
MSGI                   S_e, patches merged hierarchically (after Winkler et al. 2010)
DSO, from a pose       S_e, Gauss-Newton on the whole mesh that starts from the first pose, as the paper ran it
DSO                    S_e, the same from the linear start (ours)
S_e, steps             S_e, frames averaged and steps by constant matrices (ours)
MixIT, printed         S_m as printed: strips as joints, every joint by itself, registration, stitching
MixIT, whole joints    the same; joints keep their own lengths and angles where they overlap with parts
MixIT, free            S_m, free placement: frames averaged, one back-substitution, steps (ours)
MixIT                  S_m, anchored placement: what `mixseq.interpolate` does (ours)
=====================  ==================================================================================
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mixseq.choices import PlacementName
from mixseq.segmentation.joints import Decomposition, decompose
from mixseq.shells.fitting import Patch, ShellProblem, ShellReport, ShellSettings, fit_shell, rebuild_patch
from mixseq.spaces.edge import EdgeSettings, EdgeSpace
from mixseq.spaces.mixed.assembly import FreeFrame
from mixseq.spaces.mixed.construction import mixed_space
from mixseq.spaces.mixed.mixed_space import MixedSpace
from mixseq.types import Float, Index
from scripts.paper_study.common.poses import Poses, between
from scripts.paper_study.common.registered import PaperSpace
from scripts.paper_study.msgi.multiscale import MultiScale

WIDTH, DSO = 3, EdgeSettings("dso")


class Blended(NamedTuple):
    """A blend ``(V, 3)`` in units of the file, and how the fits went."""

    points: Float
    reports: list[ShellReport]


Seconds = tuple[float, float, float]


class Clock:
    """Processor seconds since it was made or its last lap."""

    def __init__(self) -> None:
        self._last = time.process_time()

    def lap(self) -> float:
        last, self._last = self._last, time.process_time()
        return self._last - last


@dataclass(frozen=True, eq=False)
class Method:
    """A way to blend poses."""

    poses: Poses

    def prepare(self) -> None:
        """Do what is done once; by default with a first blend."""
        self.at(np.full(len(self.poses.points), 1 / len(self.poses.points)))

    def at(self, weights: Float) -> Blended:
        """Blend with weights ``(n,)``."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class Edge(Method):
    """Blends in S_e."""

    settings: EdgeSettings = DSO

    @cached_property
    def space(self) -> EdgeSpace:
        poses, scale = self.poses, self.poses.diagonal
        typical = poses.lengths.mean(axis=0) / scale
        return EdgeSpace(poses.topology, scale, poses.points[0] / scale, typical, self.settings)

    @cached_property
    def vectors(self) -> Float:
        return self.space.encode(self.poses.points)

    def fit(self, shape: Float) -> tuple[Float, list[ShellReport]]:
        """Return rows ``(N, 3)`` with the lengths and angles of a shape, in any pose."""
        return self.space.projection.fit(self.space.targets(shape), self.space.shell)

    def at(self, weights: Float) -> Blended:
        (shape,), (turns,), (centres,) = self.space.split((weights @ self.vectors)[None])
        rows, reports = self.fit(shape)
        return Blended(self.space.place_pieces(rows, turns, centres), reports)


@dataclass(frozen=True, eq=False)
class ManyScales(Edge):
    """Blends in S_e as Winkler et al. (2010) do."""

    @cached_property
    def projection(self) -> MultiScale:
        return MultiScale(self.poses.topology, self.space.pieces)

    def fit(self, shape: Float) -> tuple[Float, list[ShellReport]]:
        return self.projection.fit(self.space.targets(shape))


@dataclass(frozen=True, eq=False)
class FromPose(Edge):
    """Gauss-Newton in S_e that starts from the first pose, of meshes in one piece."""

    def problem(self, shape: Float) -> tuple[ShellProblem, Float]:
        """Return what is to be solved, and the first pose ``(V, 3)`` as a start."""
        space, shell = self.space, self.space.discrete_shell
        (piece,) = (each for each in shell.shell_pieces if each is not None)
        start = space.reference[shell.pieces.vertices[0]]
        return shell.problem(0, piece, space.targets(shape), space.shell), start

    def fit(self, shape: Float) -> tuple[Float, list[ShellReport]]:
        points, report = fit_shell(*self.problem(shape), self.space.shell)
        return points, [report]


@dataclass(frozen=True, eq=False)
class Mixed(Method):
    """Blends in S_m."""

    decomposition: Decomposition

    @property
    def rigid(self) -> NDArray[np.bool_]:
        """Mark the faces ``(F,)`` of parts, whose lengths follow from vertices."""
        raise NotImplementedError

    def timed(self, weights: Float) -> tuple[Blended, Seconds]:
        """Blend; return seconds to a first mesh, of registration and stitching, and of steps from there."""
        raise NotImplementedError

    def align(self) -> None:
        """Register the parts of the poses, which `prepare` does too: to be timed by itself."""
        _ = PaperSpace(self.poses, self.decomposition).aligned

    def at(self, weights: Float) -> Blended:
        return self.timed(weights)[0]


@dataclass(frozen=True, eq=False)
class Anchored(Mixed):
    """Parts placed by poses and neighbours, then lengths and angles are made to agree."""

    placement: ClassVar[PlacementName] = "anchored"

    @cached_property
    def space(self) -> MixedSpace:
        """The space of the poses."""
        poses = self.poses
        return mixed_space(poses.points, poses.topology, self.decomposition, self.placement, "blends")

    @property
    def rigid(self) -> NDArray[np.bool_]:
        """Faces that are no joint faces."""
        return ~self.space.joint_faces

    @cached_property
    def vectors(self) -> Float:
        """The poses."""
        return self.space.encode(self.poses.points)

    def timed(self, weights: Float) -> tuple[Blended, Seconds]:
        """Blend; all of it is one step."""
        clock = Clock()
        points = self.space.decode((weights @ self.vectors)[None])[0]
        return Blended(points, []), (clock.lap(), 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Free(Anchored):
    """The free placement, all at once."""

    placement: ClassVar[PlacementName] = "free"

    def timed(self, weights: Float) -> tuple[Blended, Seconds]:
        """Blend: a first mesh, and steps; there is no stitching."""
        space, assembly, clock = self.space, self.space.assembly, Clock()
        vector = (weights @ self.vectors)[None]
        blocks = space.split(vector)
        frame = FreeFrame(blocks.lengths[0], blocks.angles[0], blocks.rest_vertices[0], space.skin(vector)[0])
        lengths, angles = assembly.targets(frame)
        start = assembly.integrate(frame, lengths, angles)
        first = clock.lap()
        relaxed = assembly.shell.relax(start, lengths, angles, assembly.steps)
        points = assembly.place_components(frame.skinned_vertices, relaxed.points)
        return Blended(points * space.scale, []), (first, 0.0, clock.lap())


@dataclass(frozen=True, eq=False)
class Strips(Free):
    """The free placement with the paper's joints: every vertex follows one part, and only strips are joints."""

    @cached_property
    def space(self) -> MixedSpace:
        cut, topology = self.decomposition, self.poses.topology
        in_joint = cut.joint_of_face >= 0
        part = np.zeros(topology.vertex_count, dtype=np.int64)
        for faces in (in_joint, ~in_joint):  # those of parts last: they count
            part[topology.faces[faces]] = cut.part_of_face[faces, None]
        corners = part[topology.faces]
        places = np.arange(len(part)), part
        whole = mixed_space(self.poses.points, topology, cut, self.placement, "blends")
        return replace(
            whole,
            skinning_weights=sparse.csr_array((np.ones(len(part)), places), whole.skinning_weights.shape),
            joint_faces=in_joint | (corners != corners[:, :1]).any(axis=1),
        )


@dataclass(frozen=True, eq=False)
class Printed(Mixed):
    """S_m as printed, with joints by the linear start and Gauss-Newton (the paper: MSGI); no steps afterwards."""

    complete: bool = False
    """Whether joints have the lengths and angles that a part has as well (`PaperSpace`)."""

    @cached_property
    def space(self) -> PaperSpace:
        """The space of the poses."""
        return PaperSpace(self.poses, self.decomposition, self.complete)

    @property
    def rigid(self) -> NDArray[np.bool_]:
        """Faces that have an edge whose length is that of a part."""
        return np.asarray(~self.space.blended_edges[self.poses.topology.face_edges].all(axis=1))

    @cached_property
    def patches(self) -> tuple[Patch, ...]:
        topology = self.poses.topology
        return tuple(
            Patch.from_joint(topology, joint, np.zeros(len(joint.vertices), dtype=bool))
            for joint in self.decomposition.joints
        )

    def timed(self, weights: Float) -> tuple[Blended, Seconds]:
        """Blend step by step."""
        clock, joints, reports = Clock(), [], []
        typical = self.space.length_weights
        frame = self.space.frame(weights)
        for joint, patch in zip(self.decomposition.joints, self.patches, strict=True):
            wanted = frame.lengths[joint.edge_ids], frame.angles[joint.hinge_ids], typical[joint.edge_ids]
            nowhere = np.zeros((len(patch.fixed_mask), 3))
            points, report = rebuild_patch(patch, *wanted, nowhere, ShellSettings())
            joints.append(points)
            reports.append(report)
        first = clock.lap()
        mesh = self.space.assembled(frame, joints)
        return Blended(mesh * self.poses.diagonal, reports), (first, clock.lap(), 0.0)


STEPS = ("align", "init", "interpolation", "stitching", "settling")


def steps_of(method: Method) -> tuple[list[float], Blended]:
    """Blend two poses half-way; return seconds of `STEPS`, and the blend. Preparing ends with one more, taken off."""
    clock, align = Clock(), 0.0
    if isinstance(method, Mixed):
        method.align()
        align = clock.lap()
    method.prepare()
    init = clock.lap()
    if isinstance(method, Mixed):
        blend, steps = method.timed(between(0.5))
    else:
        blend = method.at(between(0.5))
        steps = (clock.lap(), 0.0, 0.0)
    return [align, max(init - sum(steps), 0.0), *steps], blend


def strips(poses: Poses, labels: Index, width: int = WIDTH, full: bool = False) -> Decomposition:
    """Cut a mesh with the paper's joints; with `full` they are as wide as they can be, wherever little bends."""
    return decompose(poses.topology, labels, width, None if full else poses.points)


METHODS: dict[str, Callable[[Poses, Index], Method]] = {
    "MSGI": lambda poses, _: ManyScales(poses),
    "DSO, from a pose": lambda poses, _: FromPose(poses),
    "DSO": lambda poses, _: Edge(poses),
    "S_e, steps": lambda poses, _: Edge(poses, EdgeSettings("steps")),
    "MixIT, printed": lambda poses, labels: Printed(poses, strips(poses, labels)),
    "MixIT, whole joints": lambda poses, labels: Printed(poses, strips(poses, labels), complete=True),
    "MixIT, free": lambda poses, labels: Free(poses, strips(poses, labels)),
    "MixIT": lambda poses, labels: Anchored(poses, strips(poses, labels)),
}
"""All methods, of poses and the parts ``(F,)`` of the mesh."""
