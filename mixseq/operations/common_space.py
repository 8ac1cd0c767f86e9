"""Two models of one mesh in one space, with the same key shapes, so that their signals can be added."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mixseq.errors import InvalidSequenceError
from mixseq.public import public
from mixseq.signals.curve import Curve
from mixseq.signals.detail import Detail, build, encode
from mixseq.signals.model import Model
from mixseq.signals.pose import PoseMap
from mixseq.spaces.base import ShapeSpace
from mixseq.threads import one_blas_thread


@public
def into(model: Model, space: ShapeSpace) -> Model:
    """Return a model in another shape space of its mesh.

    Its frames are decoded and encoded again, and interpolated by cubic splines in the new space. They are equal as far
    as the new space represents the shapes exactly. A model in that space already is returned as it is.
    The residual layer is encoded with the frames, so the result has none.

    Parameters
    ----------
    model : Model
        The motion.
    space : ShapeSpace
        A space of the same mesh, in the same units.
    """
    if model.space is space:
        return model
    common, _, carry = space.joined(model.space)
    if common is space and carry is not None:
        return replace(model, space=space, shapes=carry(model.shapes))
    with one_blas_thread():
        return build(encode(model.sample(), space), Detail())


def together(first: Model, second: Model) -> tuple[Model, Model]:
    """Return two models of one mesh in one space, with the same pose and shape signals.

    The space is that of the first model. A basis space is extended to the shapes of both, or replaced by the second
    space if that is of another kind. Where key shapes differ, both models get all of them, with their weights as pose
    space.
    """
    _check_meshes(first, second)
    space, *carries = first.space.joined(second.space)
    first, second = (
        into(model, space) if carry is None else replace(model, space=space, shapes=carry(model.shapes))
        for model, carry in zip((first, second), carries, strict=True)
    )
    if _same_shapes(first, second):
        return first, replace(second, pose=first.pose, shapes=first.shapes)
    counts = len(first.shapes), len(second.shapes)
    pose = PoseMap.of_weights(sum(counts))
    shapes = np.concatenate([first.shapes, second.shapes])
    starts = 0, counts[0]
    both = [
        replace(model, pose=pose, shapes=shapes, time=_weights_of(model, start, sum(counts)))
        for model, start in zip((first, second), starts, strict=True)
    ]
    return both[0], both[1]


def _weights_of(model: Model, start: int, count: int) -> Curve:
    """Return the weights of all but the first of `count` key shapes; those of the model begin at index `start`."""
    weights = np.zeros((len(model.time.times), count))
    weights[:, start : start + len(model.shapes)] = model.pose.weights(model.time.values)
    return Curve(model.time.times, weights[:, 1:])


def _same_shapes(first: Model, second: Model) -> bool:
    pairs = (
        (first.shapes, second.shapes),
        (first.pose.offset, second.pose.offset),
        (first.pose.matrix, second.pose.matrix),
    )
    return all(a is b or np.array_equal(a, b) for a, b in pairs)


def _check_meshes(first: Model, second: Model) -> None:
    a, b = first.header, second.header
    if a.vertex_count != b.vertex_count:
        raise InvalidSequenceError(
            f"{a.name!r} has {a.vertex_count} vertices, {b.name!r} {b.vertex_count}; two models of one mesh are needed"
        )
    if a.faces.shape != b.faces.shape or not np.array_equal(a.faces, b.faces):
        raise InvalidSequenceError(
            f"the faces of {a.name!r} and {b.name!r} differ; two models of one mesh, with the same order of vertices "
            "and faces, are needed"
        )
