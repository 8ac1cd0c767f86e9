r"""Hinge-connected pieces of a mesh, and shape spaces that store a pose of every piece.

A vector is ``[shape | quaternions | centres]``. The shape is invariant under rigid motions. The pose of a piece is its
rotation from the reference and its centre (the paper's :math:`\mathbb{R}^6`, Section 2.2). The paper orients a mesh by
its first face; instead, all vertices of a piece are registered to their mean shape, which is more robust.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mixseq.mesh.measures import scatter_add
from mixseq.mesh.rigid import aligning_rotations
from mixseq.mesh.rotations import align_quat_signs, matrix_to_quat, quat_to_matrix
from mixseq.mesh.topology import Topology
from mixseq.runtime.jit import compiled
from mixseq.runtime.lazy import cached_property
from mixseq.runtime.parallel import one_blas_thread
from mixseq.runtime.progress import Progress, log_progress
from mixseq.spaces.base import ShapeSpace, flatten_blocks, radii_of_gyration
from mixseq.types import Float, FloatArray, Index, IntArray


@compiled
def measure_parts(x: Float, vertex_ids: Index, ends: Index, shapes: Float) -> tuple[Float, Float]:
    """Return centres ``(p, 3)`` of parts with vertices ``(N,)``, and covariances ``(p, 3, 3)`` with their shapes."""
    centres, covariances = np.zeros((len(ends), 3)), np.zeros((len(ends), 3, 3))
    start = 0
    for part in range(len(ends)):
        for row in range(start, ends[part]):
            for i in range(3):
                centres[part, i] += x[vertex_ids[row], i]
        for i in range(3):
            centres[part, i] /= ends[part] - start
        for row in range(start, ends[part]):
            for i in range(3):
                offset = x[vertex_ids[row], i] - centres[part, i]
                for j in range(3):
                    covariances[part, i, j] += offset * shapes[row, j]
        start = ends[part]
    return centres, covariances


@compiled
def rotate_back(x: Float, vertex_ids: Index, ends: Index, centres: Float, rotations: Float) -> Float:
    """Return vertices ``(N,)`` of parts, centred and rotated by the inverse rotations ``(p, 3, 3)``, as ``(N, 3)``."""
    result = np.empty((len(vertex_ids), 3))
    start = 0
    for part in range(len(ends)):
        r, centre = rotations[part], centres[part]
        for row in range(start, ends[part]):
            point = x[vertex_ids[row]]
            a, b, c = point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
            for i in range(3):
                result[row, i] = a * r[0, i] + b * r[1, i] + c * r[2, i]
        start = ends[part]
    return result


def register_parts(shapes: Float, parts: Sequence[Index], x: FloatArray) -> tuple[Float, Float]:
    """Register parts of a frame to mean shapes ``(N, 3)``; return rotations and centres of parts."""
    ends, points = np.cumsum([len(part) for part in parts]), np.ascontiguousarray(x, dtype=np.float64)
    centres, covariances = measure_parts(points, np.concatenate(parts), ends, shapes)
    return aligning_rotations(covariances), centres


def align_parts(shapes: Float, parts: Sequence[Index], x: FloatArray) -> tuple[Float, Float, Float]:
    """Register parts as `register_parts`; return their aligned vertices ``(N, 3)``, rotations and centres."""
    rotations, centres = register_parts(shapes, parts, x)
    ends, points = np.cumsum([len(part) for part in parts]), np.ascontiguousarray(x, dtype=np.float64)
    return rotate_back(points, np.concatenate(parts), ends, centres, rotations), rotations, centres


MIN_WIDTH_RATIO = 1e-3  # least ratio of width to length of a piece; narrower pieces are lines
ADDED_WIDTH_RATIO = 0.1  # ratio of the width added to a line to the line's length


@dataclass(frozen=True, eq=False)
class Pieces:
    """Hinge-connected pieces of a mesh; lengths and angles do not determine their relative poses.

    Every unused vertex is a separate piece, after all other pieces. Pieces may share vertices, but no edges. Arrays of
    *rows* contain the vertices of all pieces, piece after piece.
    """

    vertices: tuple[Index, ...]  # vertices of every piece, ascending
    faces: tuple[Index, ...]  # faces of every piece, ascending
    shapes: Float  # (N, 3) rows of the reference, centred by piece

    @classmethod
    def from_mesh(cls, topology: Topology, reference: FloatArray) -> Pieces:
        """Find the pieces of a mesh; poses are relative to the reference ``(V, 3)``."""
        component = topology.component_of_face
        order = np.argsort(component, kind="stable")
        faces = np.split(order, np.cumsum(np.bincount(component))[:-1])
        vertices = [np.unique(topology.faces[ids]).astype(np.int64) for ids in faces]
        unused = topology.unused_vertices
        vertices += list(unused[:, None])
        faces += [np.zeros(0, dtype=np.int64)] * len(unused)
        shapes = np.concatenate([reference[ids] - reference[ids].mean(axis=0) for ids in vertices])
        return cls(tuple(vertices), tuple(faces), shapes.astype(np.float64))

    def __len__(self) -> int:
        return len(self.vertices)

    @cached_property
    def vertex_of_row(self) -> Index:
        """Vertex ``(N,)`` of every row."""
        return np.concatenate(self.vertices)

    @cached_property
    def piece_of_row(self) -> Index:
        """Piece ``(N,)`` of every row."""
        return np.repeat(np.arange(len(self)), [len(each) for each in self.vertices])

    def find_rows(self, pieces: Index, vertices: IntArray) -> Index:
        """Return the rows of vertices in pieces; arrays broadcast."""
        count = int(self.vertex_of_row.max(initial=-1)) + 1
        # Rows ascend by piece, then by vertex.
        rows = np.searchsorted(self.piece_of_row * count + self.vertex_of_row, pieces * count + vertices)
        return np.asarray(rows, dtype=np.int64)

    def face_rows(self, topology: Topology) -> Index:
        """Return the rows ``(F, 3)`` of the corners of all faces in their pieces."""
        piece = topology.component_of_face.astype(np.int64)
        return self.find_rows(piece[:, None], topology.faces.astype(np.int64))

    @cached_property
    def row_slices(self) -> list[slice]:
        """Rows of every piece."""
        ends = np.cumsum([len(ids) for ids in self.vertices])
        return [slice(int(end) - len(ids), int(end)) for end, ids in zip(ends, self.vertices, strict=True)]

    @cached_property
    def radii(self) -> Float:
        """Radii of gyration ``(p,)`` in the reference."""
        return radii_of_gyration(self.shapes, self.vertices)

    @cached_property
    def registration_shapes(self) -> Float:
        """Shapes ``(N, 3)`` for registration; lines and points are widened to determine their rotation."""
        return np.concatenate([_with_width(self.shapes[each]) for each in self.row_slices])

    def measure_poses(self, x: FloatArray) -> tuple[Float, Float]:
        """Return rotations ``(p, 3, 3)`` from the reference, and centres ``(p, 3)``, of the pieces of a frame."""
        _, rotations, centres = self._register(self.vertices, x)
        return rotations, centres

    def place(self, rows: Float, rotations: Float, centres: Float) -> Float:
        """Move rows ``(N, 3)`` to rotations ``(p, 3, 3)`` and centres ``(p, 3)``; return vertices ``(V, 3)``."""
        aligned, _, _ = self._register(self._rows_of_pieces, rows)
        pieces = self.piece_of_row
        return self.merge_rows(np.einsum("nij,nj->ni", rotations[pieces], aligned) + centres[pieces])

    def translate(self, rows: Float, centres: Float) -> Float:
        """Translate rows ``(N, 3)`` to centres ``(p, 3)``; return vertices ``(V, 3)``."""
        return self.merge_rows(rows + (centres - self._mean_rows(rows))[self.piece_of_row])

    def measure_centres(self, x: Float) -> Float:
        """Return the centres ``(p, 3)`` of the pieces of a frame ``(V, 3)``."""
        return self._mean_rows(x[self.vertex_of_row])

    def merge_rows(self, rows: Float) -> Float:
        """Return vertices ``(V, 3)`` from rows ``(N, 3)``; a shared vertex is the mean of its rows."""
        return scatter_add(rows, self.vertex_of_row, len(self._row_counts)) / self._row_counts[:, None]

    @cached_property
    def _row_counts(self) -> Index:
        """Number of rows ``(V,)`` of every vertex."""
        return np.bincount(self.vertex_of_row)

    @cached_property
    def _rows_of_pieces(self) -> list[Index]:
        return [np.arange(each.start, each.stop) for each in self.row_slices]

    def _register(self, vertex_ids: Sequence[Index], x: FloatArray) -> tuple[Float, Float, Float]:
        """Register pieces twice, because the first registration of lines is approximate."""
        aligned, rotations, centres = align_parts(self.registration_shapes, vertex_ids, x)
        aligned, refinement, _ = align_parts(self.registration_shapes, self._rows_of_pieces, aligned)
        return aligned, rotations @ refinement, centres

    def _mean_rows(self, rows: Float) -> Float:
        sizes = np.array([len(ids) for ids in self.vertices])
        sums = np.add.reduceat(rows, np.cumsum([0, *sizes[:-1]]), axis=0)
        return np.asarray(sums / sizes[:, None])


def _with_width(shape: Float) -> Float:
    """Add width to a centred shape ``(n, 3)`` that is a line or a point; return other shapes unchanged.

    Offsets have neither a mean nor a moment along the line, so that the pose of a rigidly moving line is exact.
    """
    _, sizes, axes = np.linalg.svd(shape, full_matrices=False)
    if len(shape) < 3 or sizes[1] > MIN_WIDTH_RATIO * sizes[0]:
        return shape
    number = np.arange(len(shape), dtype=np.float64)
    if sizes[0] == 0:  # a point becomes a helix
        helix = np.stack([np.cos(number), np.sin(number), number / len(shape)], axis=1)
        return np.asarray(helix - helix.mean(axis=0))
    along = shape @ axes[0]
    offsets = np.cos(number) - np.cos(number).mean()
    offsets -= along * (along @ offsets) / (along @ along)
    side = np.eye(3)[np.abs(axes[0]).argmin()]
    side -= axes[0] * (axes[0] @ side)
    width = ADDED_WIDTH_RATIO * sizes[0]
    return np.asarray(shape + width * np.outer(offsets, side) / np.linalg.norm(offsets))


@dataclass(frozen=True, eq=False)
class PiecewiseSpace(ShapeSpace):
    """A space with shapes of the pieces of a mesh."""

    topology: Topology  # connectivity of the mesh
    scale: float  # unit of errors, see `reference_diagonal`, in the units of the sequence
    reference: Float  # (V, 3) first frame in diagonals, the origin of rotations and angles

    @cached_property
    def pieces(self) -> Pieces:
        """Hinge-connected pieces of the mesh."""
        return Pieces.from_mesh(self.topology, self.reference)

    @cached_property
    def face_rows(self) -> Index:
        """Rows ``(F, 3)`` of the corners of faces; pieces share no rows."""
        return self.pieces.face_rows(self.topology)

    @property
    def vertex_count(self) -> int:  # type: ignore[override]
        """Implement `ShapeSpace.vertex_count`."""
        return self.topology.vertex_count


@dataclass(frozen=True, eq=False)
class PosedSpace(PiecewiseSpace):
    """A space with shapes that are invariant under rigid motions of the pieces."""

    @property
    @abstractmethod
    def shape_dim(self) -> int:
        """Length S of the shape in a vector."""

    @property
    @abstractmethod
    def shape_metric(self) -> Float:
        """Metric ``(S,)`` of shapes, see `weights`."""

    @abstractmethod
    def measure_shape(self, x: Float) -> Float:
        """Return the shape ``(S,)`` of a frame ``(V, 3)`` in diagonals."""

    @abstractmethod
    def rebuild_rows(self, shape: Float) -> Float:
        """Return rows ``(N, 3)`` of the pieces of a shape ``(S,)``, each in any pose; see `Pieces`."""

    def unwrap_shapes(self, shapes: Float, previous: Float | None) -> Float:
        """Make shapes ``(T, S)`` continuous in time, and with a previous shape or the reference."""
        return shapes

    @property
    def dim(self) -> int:
        """Length D of a vector."""
        return self.shape_dim + self.placement_dim

    @property
    def rotation_count(self) -> int:
        """Implement `ShapeSpace.rotation_count`: one per piece."""
        return len(self.pieces)

    @property
    def weights(self) -> Float:
        """Metric ``(D,)``: a quaternion moves vertices by twice the radius of gyration of its piece."""
        quaternion_weights = np.repeat(2.0 * self.pieces.radii, 4)
        return np.concatenate([self.shape_metric, quaternion_weights, np.ones(3 * len(self.pieces))])

    def encode_independently(self, points: FloatArray) -> Float:
        """Implement `ShapeSpace.encode_independently`."""
        vectors = np.empty((len(points), self.dim))
        for vector, frame in zip(vectors, points, strict=True):
            x = frame.astype(np.float64) / self.scale
            rotations, centres = self.pieces.measure_poses(x)
            blocks = self.measure_shape(x), matrix_to_quat(rotations).reshape(-1), centres.reshape(-1)
            np.concatenate(blocks, out=vector)
        return vectors

    def unwrap(self, vectors: Float, previous: Float | None = None) -> Float:
        """Implement `ShapeSpace.unwrap`."""
        shapes, rotations, centres = self.split(vectors)
        previous_shape = previous_rotations = None
        if previous is not None:
            previous_shape, previous_rotations = (block[0] for block in self.split(previous[None])[:2])
        shapes = self.unwrap_shapes(shapes, previous_shape)
        return flatten_blocks((shapes, align_quat_signs(rotations, previous_rotations), centres))

    def decode(self, vectors: Float, progress: Progress = log_progress) -> Float:
        """Implement `ShapeSpace.decode`."""
        return self._decode_with(vectors, self.rebuild_rows, progress)

    def _decode_with(self, vectors: Float, rebuild: Callable[[Float], Float], progress: Progress) -> Float:
        """Decode vectors ``(T, D)`` by a function from a shape ``(S,)`` to rows ``(N, 3)`` in any pose."""
        shapes, rotations, centres = self.split(np.asarray(vectors, dtype=np.float64))
        points = np.empty((len(shapes), self.topology.vertex_count, 3))
        with one_blas_thread():
            for frame, shape in enumerate(shapes):
                points[frame] = self.place_pieces(rebuild(shape), rotations[frame], centres[frame])
                progress(frame + 1, len(shapes), "decoding frames")
        return points

    def place_pieces(self, rows: Float, rotations: Float, centres: Float) -> Float:
        """Pose rows ``(N, 3)`` in diagonals; return vertices ``(V, 3)`` in units of the sequence."""
        return self.pieces.place(rows, quat_to_matrix(rotations), centres) * self.scale

    def split(self, vectors: Float) -> tuple[Float, Float, Float]:
        """Return shapes ``(T, S)``, quaternions ``(T, p, 4)``, centres ``(T, p, 3)``; raises as `check_vectors`."""
        shapes = self.check_vectors(vectors)[:, : self.shape_dim]
        return shapes, *self.unpack_placements(vectors[:, self.shape_dim :])
