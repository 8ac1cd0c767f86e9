"""What tests of model files have in common: which datasets there are, how models are compared and files changed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from dataclasses import replace as replace_fields
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

import mixseq
from mixseq.operations import key_poses, with_body
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.detail import Detail, build_model, encode_sequence
from mixseq.signals.model import Model
from mixseq.spaces.base import VertexSpace
from mixseq.spaces.mixed.mixed_space import MixedSpace, Projection
from tests.meshes import bar

GOLDEN = Path(__file__).parents[1] / "golden"

COMMON = {
    "polygons/counts",
    "polygons/indices",
    "signals/time/frames",
    "signals/time/times",
    "signals/time/values",
    "signals/pose/offset",
    "signals/pose/matrix",
    "signals/placement/times",
    "signals/placement/rotations",
    "signals/placement/translations",
}

EDGE = COMMON | {
    "space/reference",
    "space/reference_lengths",
    "signals/shape/lengths",
    "signals/shape/angles",
    "signals/shape/volumes",
}

MIXED = COMMON | {
    "segmentation/part_of_face",
    "segmentation/widths",
    "segmentation/parts/vertices",
    "segmentation/parts/sizes",
    "segmentation/joints/faces",
    "segmentation/joints/sizes",
    "space/shapes",
    "space/reference",
    "space/joint_faces",
    "space/skinning/sizes",
    "space/skinning/parts",
    "space/skinning/weights",
    "space/steadiness/turns",
    "space/steadiness/centres",
    "space/steadiness/relation_turns",
    "space/steadiness/relation_points",
    "signals/shape/lengths",
    "signals/shape/angles",
    "signals/shape/unposed",
    "signals/shape/part_rotations",
    "signals/shape/part_centres",
    "signals/shape/relation_rotations",
    "signals/shape/relation_points",
    "signals/correction/times",
    "signals/correction/rotations",
    "signals/correction/translations",
}

DATASETS = {
    "mixed": MIXED,
    "free": MIXED,
    "vertex": COMMON | {"signals/shape/positions"},
    "gradient": COMMON | {"space/reference", "signals/shape/turns", "signals/shape/stretches"},
    "lri": COMMON | {"space/reference", "signals/shape/connections", "signals/shape/ends"},
    "edge": EDGE,
    "volume": EDGE,
}
"""By the names of `models`."""

SETTINGS = {"mixed": {"projection"}, "free": {"projection"}, "edge": {"shell", "edge"}, "volume": {"shell", "edge"}}

EACH_DATASET = [
    (space, name)
    for space, names in DATASETS.items()
    for name in sorted(names)
    if space == "mixed"
    or (space not in ("free", "volume") and name.startswith(("signals/shape", "space")))
    or (space in ("free", "vertex") and name.startswith("signals/placement"))
]
"""Each dataset in each space that reads it in its own way; what all have is read by one function."""

MIXED_SHAPES = [
    "lengths",
    "angles",
    "unposed",
    "part_rotations",
    "part_centres",
    "relation_rotations",
    "relation_points",
]

SHAPES = {
    "mixed": MIXED_SHAPES,
    "free": MIXED_SHAPES,
    "vertex": ["positions"],
    "gradient": ["turns", "stretches"],
    "lri": ["connections", "ends"],
    "edge": ["lengths", "angles", "volumes"],
    "volume": ["lengths", "angles", "volumes"],
}
"""Key shapes: datasets in the order of the vector."""

POSES = {"vertex": [0, 0], "gradient": [0, 1]}
"""How many rotations and translations a placement has; one of each in the other spaces."""

ATTRIBUTES = {
    "format",
    "version",
    "created_by",
    "settings",
    "provenance",
    "space",
    "name",
    "fps",
    "up_axis",
    "metres_per_unit",
    "vertex_count",
}


def jointed(sequence: MeshSequence, detail: Detail) -> Model:
    """Make a model of two parts where lengths and angles move the vertices of joints half of the way."""
    space = mixseq.fit(sequence, parts=2).mixed
    joints = np.asarray((space.rigid_part_of_vertex[space.topology.faces] < 0).all(axis=1))
    space = replace_fields(space, joint_faces=joints, projection=Projection(share=0.5))
    return build_model(encode_sequence(sequence, space), detail)


def herd() -> Model:
    """Make a model of three bars: one has its vertices in another order and parts of its own, one looks elsewhere."""
    model = jointed(bar(5, 13, 6), Detail(step=2.0**-38))
    keys, turn = key_poses(model), np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    order = np.random.default_rng(0).permutation(keys.vertex_count)
    shuffled = MeshSequence.from_arrays(1.5 * keys.points[:, order], np.argsort(order)[keys.faces], fps=1.0)
    corners, middle = keys.faces[0], keys.points[:, keys.faces[0]].mean(axis=1, keepdims=True)
    fan = [[*edge, keys.vertex_count] for edge in zip(corners, np.roll(corners, -1), strict=True)]
    points, faces = np.concatenate([keys.points, middle], axis=1), np.concatenate([keys.faces[1:], fan])
    labels = model.decomposition.part_of_face
    parts = np.append(labels[1:], np.repeat(labels[:1], 3))
    finer = MeshSequence.from_arrays(points @ turn.T, faces, fps=1.0)
    return with_body(with_body(model, shuffled, "shuffled"), finer, "finer", parts, turn)


def assert_equal(first: Model, second: Model) -> None:
    """Check that two models are equal bit by bit."""
    for name in ("time", "placement", *(["correction"] if first.space.correction_dim else [])):
        a, b = getattr(first, name), getattr(second, name)
        np.testing.assert_array_equal(a.times, b.times)
        np.testing.assert_array_equal(a.values, b.values)
    np.testing.assert_array_equal(first.pose.offset, second.pose.offset)
    np.testing.assert_array_equal(first.pose.matrix, second.pose.matrix)
    np.testing.assert_array_equal(first.shapes, second.shapes)
    np.testing.assert_array_equal(first.vectors, second.vectors)
    np.testing.assert_array_equal(first.times, second.times)
    assert first.header.polygons.same_as(second.header.polygons)
    for name in ("vertex_count", "fps", "up_axis", "metres_per_unit", "name"):
        assert getattr(first.header, name) == getattr(second.header, name)
    assert type(first.space) is type(second.space)
    if isinstance(first.space, VertexSpace):
        assert first.space == second.space
    elif isinstance(first.space, MixedSpace):
        assert_equal_spaces(first.space, second.space)
    else:
        assert_equal_fields(first.space, second.space)


def assert_equal_fields(first: Any, second: Any) -> None:
    for field in fields(first):
        if field.name != "topology":
            np.testing.assert_array_equal(getattr(first, field.name), getattr(second, field.name))


def assert_equal_spaces(first: Any, second: Any) -> None:
    for name in ("shapes", "reference", "joint_faces"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
        assert getattr(first, name).dtype == getattr(second, name).dtype
    for name in ("scale", "block_sizes", "projection"):
        assert getattr(first, name) == getattr(second, name)
    for values, others in zip(first.articulation.steadiness, second.articulation.steadiness, strict=True):
        np.testing.assert_array_equal(values, others)
    assert first.skinning_weights.shape == second.skinning_weights.shape
    for name in ("indptr", "indices", "data"):
        np.testing.assert_array_equal(getattr(first.skinning_weights, name), getattr(second.skinning_weights, name))
    a, b = first.decomposition, second.decomposition
    np.testing.assert_array_equal(a.part_of_face, b.part_of_face)
    np.testing.assert_array_equal(a.widths, b.widths)
    for part, other in zip(a.parts, b.parts, strict=True):
        np.testing.assert_array_equal(part, other)
    for joint, other_joint in zip(a.joints, b.joints, strict=True):
        for name in ("vertices", "faces", "face_ids", "edge_ids", "hinge_ids", "free"):
            np.testing.assert_array_equal(getattr(joint, name), getattr(other_joint, name))


def replace(path: Path, name: str, change: Callable[[Any], Any]) -> None:
    """Store other values in place of a dataset's."""
    with h5py.File(path, "r+") as file:
        values = file[name][...]
        values = change(values.astype(np.float64) if values.dtype.kind == "f" else values)
        del file[name]
        file[name] = values


def with_nan(frame: int) -> Callable[[Any], Any]:
    def change(values: Any) -> Any:
        values[frame, ...].flat[0] = np.nan
        return values

    return change


# Edits with h5py ------------------------------------------------------------------------------------------
#
# In the vertex space what they do is a formula; in the mixed space they meet a reconstruction.


def scale(model: Model) -> float:
    """Return the diagonal in the units of the sequence."""
    assert isinstance(model.space, MixedSpace | VertexSpace)
    return model.space.scale


def points_at(model: Model, times: Any) -> NDArray[np.float64]:
    """Decode without what is only for frames."""
    return np.concatenate(list(model.blocks(times)))


INSIDE = np.linspace(0.0, 0.6, 14)


def scaled(factor: float) -> Callable[[Any], Any]:
    return lambda values: values * factor


def with_zeros(values: Any) -> Any:
    """At one knot the body has no rotation."""
    values[3, 0] = 0.0
    return values


def with_more(values: Any) -> Any:
    """One of the weights is larger than it should be, by little."""
    values[7] += 1e-6
    return values
