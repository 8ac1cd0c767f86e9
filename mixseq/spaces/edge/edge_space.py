"""The space S_e of edge lengths and dihedral angles (Winkler et al. 2010; Froehlich and Botsch 2011).

A vector is ``[edge lengths | dihedral angles | volumes | pose]``, in diagonals, radians and cubic diagonals; volumes
are optional. The paper counts ``2 E + 6`` numbers: a closed surface has as many hinges as edges.

Lengths and angles determine a mesh up to its pose, except at triangles without area: their normals are undefined, and
the surface around them may come back bent.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mixseq.arrays import Float
from mixseq.choices import PROJECTIONS, ProjectionName
from mixseq.errors import SettingsError
from mixseq.geometry.lengths_angles import dihedral_angles, edge_lengths, length_weights, unwrap_angles
from mixseq.progress import Progress, silent
from mixseq.shells.fitting import ShellReport, ShellSettings
from mixseq.shells.shell import Relaxation
from mixseq.spaces.edge.discrete_shell import DiscreteShell
from mixseq.spaces.edge.projection import EdgeProjection, Wanted
from mixseq.spaces.edge.relaxed_shell import RelaxedShell
from mixseq.spaces.metric import ANGLE
from mixseq.spaces.posed import PosedSpace
from mixseq.threads import one_blas_thread


@dataclass(frozen=True)
class EdgeSettings:
    """How meshes are found that have nearly given lengths and angles.

    Attributes
    ----------
    projection : {"steps", "dso"}
        A fixed number of steps by constant matrices, or Gauss-Newton until it converges (Froehlich and Botsch 2011).
    volume : float
        DSO: weight of a relative change of volume against that of a length; 0 for no volume term. There are thousands
        of lengths for one volume: half way between poses of animals 10 halves its error, 100 leaves less than 0.1 %.
    shell : ShellSettings, optional
        DSO: weight of the angles, and convergence limits of Gauss-Newton.

    Raises
    ------
    SettingsError
        If a setting is out of range, or does not go with the projection.
    """

    projection: ProjectionName = "steps"
    volume: float = 0.0
    shell: ShellSettings | None = None

    def __post_init__(self) -> None:
        if self.projection not in PROJECTIONS:
            names = " or ".join(map(repr, PROJECTIONS))
            raise SettingsError(f"projection is {self.projection!r}; {names} is expected")
        if not (np.isfinite(self.volume) and self.volume >= 0):
            raise SettingsError(
                f"volume is {self.volume}; a weight of 0 (no volume term) or more is expected"
            )
        if self.volume and self.projection != "dso":
            raise SettingsError(
                f"projection {self.projection!r} has no use for volume; leave it out, or choose 'dso'"
            )


@dataclass(frozen=True, eq=False)
class EdgeSpace(PosedSpace):
    """Shapes by edge lengths and dihedral angles."""

    reference_lengths: Float  # (E,) mean lengths of all edges; their inverses weigh lengths in the fits
    settings: EdgeSettings
    name = "edge"

    @property
    def shell(self) -> ShellSettings:
        """Settings of the fits to lengths and angles."""
        return self.settings.shell or ShellSettings()

    @cached_property
    def projection(self) -> EdgeProjection:
        """The projection of lengths and angles to a mesh."""
        if self.settings.projection == "dso":
            return self.discrete
        return RelaxedShell(self.topology, self.pieces, self.reference_lengths, Relaxation().bending)

    @cached_property
    def discrete(self) -> DiscreteShell:
        """The mesh as a discrete shell, which measures volumes."""
        return DiscreteShell(self.topology, self.pieces)

    @cached_property
    def _volume_weights(self) -> Float:
        """Weights ``(p,)`` of the volumes of all pieces, 0 for sheets; empty without volume terms."""
        told = self.settings.volume > 0
        return self.settings.volume * self.discrete.volume_weights(self.reference) if told else np.zeros(0)

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Numbers of lengths, angles and volumes of a shape."""
        return len(self.topology.edges), len(self.topology.hinges), len(self._volume_weights)

    @property
    def shape_dim(self) -> int:
        """Implement `PosedSpace.shape_dim`."""
        return sum(self.sizes)

    @property
    def paper_dimension(self) -> int:
        """Dimension as the paper counts it: a length and an angle for every edge, and a pose."""
        return 2 * len(self.topology.edges) + 6

    @property
    def shape_metric(self) -> Float:
        """Implement `PosedSpace.shape_metric`; a change of volume moves vertices by its ratio to the area."""
        lengths, volumes = edge_lengths(self.reference, self.topology.edges), np.zeros(0)
        if len(self._volume_weights):
            areas = self.discrete.areas(self.reference)
            volumes = np.divide(1.0, areas, out=np.zeros_like(areas), where=areas > 0)
        return np.concatenate([np.ones(len(lengths)), ANGLE * lengths[self.topology.hinge_edges], volumes])

    def constants(self) -> tuple[object, ...]:
        """Implement `PickledWithoutCaches.constants`."""
        return self.projection, self._volume_weights, self.pieces.radii

    def shape_of(self, x: Float) -> Float:
        """Implement `PosedSpace.shape_of`."""
        volumes = self.discrete.volumes(x) if len(self._volume_weights) else np.zeros(0)
        lengths, angles = edge_lengths(x, self.topology.edges), dihedral_angles(x, self.topology.hinges)
        return np.concatenate([lengths, angles, volumes])

    def unwrap_shapes(self, shapes: Float, previous: Float | None) -> Float:
        """Implement `PosedSpace.unwrap_shapes`."""
        result, start = np.array(shapes), len(self.topology.edges)
        angles = slice(start, start + len(self.topology.hinges))
        before = (
            dihedral_angles(self.reference, self.topology.hinges) if previous is None else previous[angles]
        )
        result[:, angles] = unwrap_angles(result[:, angles], before)
        return result

    def rebuilt(self, shape: Float) -> Float:
        """Implement `PosedSpace.rebuilt`."""
        return self.rebuilt_with_reports(shape)[0]

    def rebuilt_with_reports(
        self, shape: Float, shell: ShellSettings | None = None
    ) -> tuple[Float, list[ShellReport]]:
        """Return the result of `rebuilt`, with optional other settings, and reports of the fits."""
        return self.projection.fit(self.wanted(shape), shell or self.shell)

    def wanted(self, shape: Float) -> Wanted:
        """Return the target lengths, angles and volumes of a shape ``(S,)``."""
        lengths, angles, volumes = np.split(shape, np.cumsum(self.sizes)[:-1])
        weights = length_weights(self.reference_lengths)
        return Wanted(lengths, weights, angles, volumes, self._volume_weights)

    def decode_for_differences(self, vectors: Float) -> Float:
        """Implement `ShapeSpace.decode_for_differences`."""
        return self.decode_with_reports(vectors, shell=self.shell.for_differences())[0]

    def decode_with_reports(
        self, vectors: Float, progress: Progress = silent, shell: ShellSettings | None = None
    ) -> tuple[Float, list[list[ShellReport]]]:
        """Decode vectors ``(T, D)`` to points ``(T, V, 3)``, and return the reports of the fits of every frame."""
        shapes, turns, centres = self.split(np.asarray(vectors, dtype=np.float64))
        points, reports = np.empty((len(shapes), self.topology.vertex_count, 3)), []
        with one_blas_thread():
            for number, shape in enumerate(shapes):
                rows, report = self.rebuilt_with_reports(shape, shell)
                points[number] = self.placed(rows, turns[number], centres[number])
                reports.append(report)
                progress(number + 1, len(shapes), "decoding frames")
        return points, reports
