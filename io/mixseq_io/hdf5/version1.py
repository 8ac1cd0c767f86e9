"""Models of version 1: one vector of the mixed space per frame, and a spline through all of them."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from mixseq.sequence import MeshSequence
from mixseq.signals.detail import Detail, build, encode
from mixseq.signals.model import Model
from mixseq.spaces import mixed_space
from mixseq.threads import one_blas_thread
from mixseq_io.hdf5.arrays import increasing
from mixseq_io.hdf5.files import read_header
from mixseq_io.hdf5.mixed import mixed_blocks, read_untaught
from mixseq_io.hdf5.signals import read_placements, read_shapes


def read_v1(path: Path, file: h5py.File) -> Model:
    """Read a model of version 1, as the exact model of its frames.

    It knew nothing about the time between them, so they are decoded, and encoded again with its parts and joints.
    """
    times = increasing(path, file, "signals/time/times")
    header = read_header(path, file, int(file.attrs["vertex_count"]), times)
    old = read_untaught(path, file, header)
    shapes = read_shapes(path, file, mixed_blocks(old), len(times))
    poses = read_placements(path, file, old, len(times))
    with one_blas_thread():
        points = old.decode(np.concatenate([shapes, poses], axis=1))
        space = mixed_space(points, old.topology, old.decomposition, old.placement, old.settings)
        return build(encode(MeshSequence.from_header(header, points), space), Detail())
