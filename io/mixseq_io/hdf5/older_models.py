"""Models in the mixed space of versions 1 to 4: lengths, angles and parts, with rotation vectors.

In the anchored placement versions 2 to 4 had links between parts and offsets of free vertices. Their frames and knots
are decoded as they were, by the fit to lengths and angles that they were made for, and encoded again: there they are
what they were, between them they are predicted as new models are. Links, which poses had to agree with between knots,
are not looked at. Version 1 had a vector for every frame, and no curves.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mixseq.arrays import Float
from mixseq.errors import FormatError
from mixseq.geometry.lengths_angles import length_weights
from mixseq.geometry.rotations import matrices
from mixseq.retargeting.joint_solver import JointFrame, JointSolver
from mixseq.sequence import MeshSequence, SequenceHeader
from mixseq.signals.curve import Curve
from mixseq.signals.detail import Detail, build, encode
from mixseq.signals.model import Model
from mixseq.spaces import MixedSpace, mixed_space
from mixseq.threads import one_blas_thread
from mixseq.topology import Topology
from mixseq_io.hdf5.contents import Contents
from mixseq_io.hdf5.datasets import floats, increasing, read_scale, read_shell
from mixseq_io.hdf5.h5_files import read_header
from mixseq_io.hdf5.model_signals import check_frames, read_placements, read_pose, read_shapes
from mixseq_io.hdf5.stored_mixed import mixed_blocks, read_free, read_placement, read_segmentation
from mixseq_io.hdf5.stored_space import FIRST_WITH_QUATERNIONS

_NEAR = 1e-6  # in frames; times that are nearer are one: most knots are frames, but for rounding


def read_v1(path: Path, file: Contents) -> Model:
    """Read a model of version 1, as the exact model of its frames."""
    times = increasing(path, file, "signals/time/times")
    header = read_header(path, file, int(file.attrs["vertex_count"]), times)
    if read_placement(path, file) == "anchored":
        anchored = _Anchored(path, file, header)
        shapes = read_shapes(path, file, anchored.blocks(), len(times))
        return anchored.model(times, shapes, anchored.poses(path, file, len(times)))
    old = read_free(path, file, header)
    shapes = read_shapes(path, file, mixed_blocks(old), len(times))
    with one_blas_thread():
        points = old.decode(np.concatenate([shapes, read_placements(path, file, old, len(times))], axis=1))
        space = mixed_space(points, old.topology, old.decomposition, "free")
        return build(encode(MeshSequence.from_header(header, points), space), Detail())


def is_old_anchored(path: Path, file: Contents) -> bool:
    """Whether a model is in the anchored placement of versions 2 to 4."""
    mixed = file.text("space") == MixedSpace.name
    old = int(file.attrs["version"]) < FIRST_WITH_QUATERNIONS
    return mixed and old and read_placement(path, file) == "anchored"


def read_anchored(path: Path, file: Contents, header: SequenceHeader) -> Model:
    """Read a model in the anchored placement of versions 2 to 4."""
    anchored = _Anchored(path, file, header)
    pose = read_pose(path, file)
    knots, places = (increasing(path, file, f"signals/{name}/times") for name in ("time", "placement"))
    time = Curve(knots, floats(path, file, "signals/time/values", (len(knots), pose.dim)))
    placement = Curve(places, anchored.poses(path, file, len(places)))
    check_frames(path, header, time=time, placement=placement)
    blocks = {**anchored.blocks(), "offsets": (len(anchored.solver.solved.vertices), 3)}
    shapes = read_shapes(path, file, blocks, len(pose.offset))
    times = _frames_and_knots(header, time, placement)
    return anchored.model(times, pose.weights(time(times)) @ shapes, placement(times))


def _frames_and_knots(header: SequenceHeader, time: Curve, placement: Curve) -> Float:
    """Times ``(N,)`` of frames, and of all knots that the model can be asked for."""
    near = _NEAR / header.fps
    start, end = max(time.start, placement.start), min(time.end, placement.end)
    knots = np.unique(np.concatenate([time.times, placement.times]))
    knots = knots[(knots >= start) & (knots <= end)]
    knots = knots[np.diff(knots, prepend=-np.inf) > near]
    frames = np.append(header.times, np.inf)[np.searchsorted(header.times, knots - near)]
    return np.unique(np.concatenate([header.times, knots[frames - knots > near]]))


class _Anchored:
    """What decodes the frames of an old model."""

    def __init__(self, path: Path, file: Contents, header: SequenceHeader) -> None:
        topology = Topology(header.faces, header.vertex_count)
        decomposition = read_segmentation(path, file, topology)
        self.header, self.scale, self.settings = header, read_scale(path, file), read_shell(path, file)
        self.shapes = floats(path, file, "space/shapes", (sum(map(len, decomposition.parts)), 3))
        reference = floats(path, file, "space/reference", (header.vertex_count, 3))
        self.solver = JointSolver(topology, decomposition, self.shapes, reference)
        solved = self.solver.solved
        self.lengths = floats(path, file, "space/reference_lengths", (len(solved.edge_ids),))
        if (self.lengths < 0).any():
            raise FormatError(f"{path}: space/reference_lengths has lengths below zero")
        self.offset_weights = np.zeros(0)
        if int(file.attrs["version"]) > 1:
            weights = floats(path, file, "space/trust", (len(solved.joints),))
            if (weights <= 0).any():
                raise FormatError(f"{path}: space/trust has weights that are not positive")
            spacing = np.maximum(solved.spacing(self.lengths), np.finfo(np.float64).tiny)
            self.offset_weights = np.repeat(weights, [len(patch.free) for patch in solved.patches]) / spacing

    def blocks(self) -> dict[str, tuple[int, ...]]:
        """Return what a key shape consists of."""
        solved = self.solver.solved
        return {
            "lengths": (len(solved.edge_ids),),
            "angles": (len(solved.hinge_ids),),
            "parts": (len(self.shapes), 3),
        }

    def poses(self, path: Path, file: Contents, count: int) -> Float:
        """Read rotation vectors, then centres ``(count, 6 p)``."""
        shape = (count, len(self.solver.decomposition.parts), 3)
        both = [
            floats(path, file, f"signals/placement/{name}", shape) for name in ("rotations", "translations")
        ]
        return np.concatenate(both, axis=1).reshape(count, -1)

    def model(self, times: Float, shapes: Float, poses: Float) -> Model:
        """Return the model of frames with shapes ``(N, S)`` and poses ``(N, 6 p)`` at times ``(N,)``."""
        solver, header = self.solver, self.header.with_times(times)
        with one_blas_thread():
            points = np.stack([self._frame(*each) for each in zip(shapes, poses, strict=True)]) * self.scale
            space = mixed_space(points, solver.topology, solver.decomposition)
            model = build(encode(MeshSequence.from_header(header, points), space), Detail())
        return Model(self.header, space, model.time, model.pose, model.shapes, model.placement)

    def _frame(self, shape: Float, poses: Float) -> Float:
        sizes = [size for size, *_ in self.blocks().values()]
        lengths, angles, rest = np.split(shape, np.cumsum(sizes[:2]))
        parts, offsets = np.split(rest.reshape(-1, 3), [len(self.shapes)])
        vectors, centres = poses.reshape(2, -1, 3)
        frame = JointFrame(
            lengths=lengths,
            angles=angles,
            weights=length_weights(self.lengths),
            parts=parts,
            rotations=matrices(vectors),
            translations=centres,
            offsets=offsets,
            offset_weights=self.offset_weights,
        )
        return self.solver.solve(frame, self.settings)[0]
