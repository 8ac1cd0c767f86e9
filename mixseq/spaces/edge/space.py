"""The space S_e of edge lengths and dihedral angles (Winkler et al. 2010; Froehlich and Botsch 2011).

A vector is ``[edge lengths | dihedral angles | volumes | the same of the coarse mesh | pose]``, in diagonals, radians
and cubic diagonals; volumes and the coarse mesh are there only where settings ask for them. The paper counts
``2 E + 6`` numbers: a closed surface has as many hinges as edges.

Lengths and angles fix a mesh up to its pose, unless a triangle has no area: its normal is anything, and what it joins
may come back bent.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import SettingsError
from mixseq.geometry.lengths_angles import dihedral_angles, edge_lengths, unwrap_angles
from mixseq.progress import Progress, silent
from mixseq.shells.fitting import ShellReport, ShellSettings
from mixseq.shells.joint import length_weights
from mixseq.spaces.edge.coarse import CoarseShell
from mixseq.spaces.edge.discrete_shell import DiscreteShell, Wanted
from mixseq.spaces.edge.multiscale import MultiScale
from mixseq.spaces.mixed.space import ANGLE
from mixseq.spaces.posed import PosedSpace
from mixseq.threads import one_blas_thread

Float = NDArray[np.float64]
Index = NDArray[np.int64]
ProjectionName = Literal["dso", "msgi"]
PROJECTIONS: tuple[ProjectionName, ...] = get_args(ProjectionName)


@dataclass(frozen=True)
class EdgeSettings:
    """How meshes are found that have nearly given lengths and angles.

    Attributes
    ----------
    projection : {"dso", "msgi"}
        Gauss-Newton on the whole mesh (Froehlich and Botsch 2011), or small patches that are merged hierarchically
        (after Winkler et al. 2010).
    volume : float
        DSO: weight of a relative change of volume against that of a length; 0 for no volume term. There are thousands
        of lengths for one volume: half way between poses of animals 10 halves its error, 100 leaves less than 0.1 %.
    coarse : int, optional
        DSO: solve on a mesh of about so many vertices, at least 4, and carry the solution over.
    steps : int
        With `coarse`: at most so many Gauss-Newton steps on the whole mesh afterwards. The default is ours.

    Raises
    ------
    SettingsError
        If a setting is out of range, or does not go with the projection.
    """

    projection: ProjectionName = "dso"
    volume: float = 0.0
    coarse: int | None = None
    steps: int = 5

    def __post_init__(self) -> None:
        if self.projection not in PROJECTIONS:
            names = " or ".join(map(repr, PROJECTIONS))
            raise SettingsError(f"projection is {self.projection!r}; {names} is expected")
        if not (np.isfinite(self.volume) and self.volume >= 0):
            raise SettingsError(
                f"volume is {self.volume}; a weight of 0 (no volume term) or more is expected"
            )
        if self.coarse is not None and self.coarse < 4:
            raise SettingsError(f"coarse is {self.coarse}; the coarse mesh has at least 4 vertices")
        if self.steps < 0:
            raise SettingsError(f"steps is {self.steps}; 0 or more are expected")
        if self.projection == "msgi":
            for name in ("volume", "coarse"):
                if getattr(self, name):
                    raise SettingsError(
                        f"projection 'msgi' has no use for {name}; leave it out, or choose 'dso'"
                    )


class Level(NamedTuple):
    """The mesh, or its coarse mesh.

    Attributes
    ----------
    shell : DiscreteShell
        Connectivity and pieces.
    vertices : (n,) int64
        The vertices of the mesh that those of the level are.
    weights : (E,) float64
        Weights of the lengths.
    angles : (H,) float64
        Angles of the reference.
    volume_weights : (p,) float64
        Weights of the volumes, 0 where a piece has none; empty where no volumes are told.
    metric : (E + H + p,) float64
        By how many diagonals vertices move when a number of the level changes by one.
    """

    shell: DiscreteShell
    vertices: Index
    weights: Float
    angles: Float
    volume_weights: Float
    metric: Float

    def measured(self, x: Float) -> tuple[Float, Float, Float]:
        """Return lengths, angles and volumes of a frame ``(V, 3)``."""
        own, topology = x[self.vertices], self.shell.topology
        volumes = self.shell.volumes(own) if self.volume_weights.size else np.zeros(0)
        return edge_lengths(own, topology.edges), dihedral_angles(own, topology.hinges), volumes

    def wanted(self, lengths: Float, angles: Float, volumes: Float) -> Wanted:
        """Return what the mesh is fitted to."""
        return Wanted(lengths, angles, self.weights, volumes, self.volume_weights)


@dataclass(frozen=True, eq=False)
class EdgeSpace(PosedSpace):
    """Shapes by their edge lengths and dihedral angles.

    Attributes
    ----------
    reference_lengths : (E,) float64
        Mean lengths of all edges; their inverses weigh lengths in the fits.
    shell : ShellSettings
        Settings of Gauss-Newton.
    settings : EdgeSettings
        Which projection, and what else it is told.
    """

    reference_lengths: Float
    shell: ShellSettings
    settings: EdgeSettings
    name = "edge"

    @cached_property
    def projection(self) -> DiscreteShell | CoarseShell | MultiScale:
        """What turns lengths and angles into a mesh."""
        if self.settings.projection == "msgi":
            return MultiScale(self.topology, self.pieces.vertices, self.pieces.faces)
        if self.settings.coarse is None:
            return self._whole
        return CoarseShell.of(self._whole, self.reference, self.settings.coarse)

    @cached_property
    def _whole(self) -> DiscreteShell:
        return DiscreteShell(self.topology, self.pieces.vertices, self.pieces.faces)

    @cached_property
    def levels(self) -> tuple[Level, ...]:
        """The mesh, and its coarse mesh if there is one."""
        levels = [self._level(self._whole, np.arange(self.topology.vertex_count), self.reference_lengths)]
        if isinstance(self.projection, CoarseShell):
            kept, coarse = self.projection.kept, self.projection.coarse
            levels.append(
                self._level(coarse, kept, edge_lengths(self.reference[kept], coarse.topology.edges))
            )
        return tuple(levels)

    def _level(self, shell: DiscreteShell, vertices: Index, typical: Float) -> Level:
        x, topology = self.reference[vertices], shell.topology
        volume_weights = volume_metric = np.zeros(0)
        if self.settings.volume:
            volume_weights = self.settings.volume * shell.volume_weights(x)
            areas = shell.areas(x)
            volume_metric = np.divide(1.0, areas, out=np.zeros_like(areas), where=areas > 0)
        lengths = edge_lengths(x, topology.edges)
        return Level(
            shell=shell,
            vertices=vertices,
            weights=length_weights(typical),
            angles=dihedral_angles(x, topology.hinges),
            volume_weights=volume_weights,
            metric=np.concatenate(
                [np.ones(len(lengths)), ANGLE * lengths[topology.hinge_edges], volume_metric]
            ),
        )

    @cached_property
    def sizes(self) -> tuple[int, ...]:
        """Numbers of lengths, angles and volumes of every level, one after the other."""
        return tuple(
            size
            for level in self.levels
            for size in (len(level.weights), len(level.angles), len(level.volume_weights))
        )

    @property
    def shape_dim(self) -> int:
        """Implement `PosedSpace.shape_dim`."""
        return sum(self.sizes)

    @property
    def paper_dimension(self) -> int:
        """The dimension as the paper counts it: a length and an angle for every edge, and a pose."""
        return 2 * len(self.topology.edges) + 6

    @property
    def shape_metric(self) -> Float:
        """Implement `PosedSpace.shape_metric`; a volume moves vertices by its change over the area."""
        return np.concatenate([level.metric for level in self.levels])

    def prepare(self) -> None:
        """Implement `ShapeSpace.prepare`."""
        self.projection.prepare()
        self.levels, self.pieces.radii  # noqa: B018 - cached properties

    def shape_of(self, x: Float) -> Float:
        """Implement `PosedSpace.shape_of`."""
        return np.concatenate([block for level in self.levels for block in level.measured(x)])

    def shapes_without_jumps(self, shapes: Float, previous: Float | None) -> Float:
        """Implement `PosedSpace.shapes_without_jumps`."""
        result = np.array(shapes)
        ends = np.cumsum(self.sizes)
        for number, level in enumerate(self.levels):
            angles = slice(ends[3 * number], ends[3 * number + 1])
            before = level.angles if previous is None else previous[angles]
            result[:, angles] = unwrap_angles(result[:, angles], before)
        return result

    def rebuilt(self, shape: Float) -> Float:
        """Implement `PosedSpace.rebuilt`."""
        return self.rebuilt_with_reports(shape)[0]

    def rebuilt_with_reports(
        self, shape: Float, shell: ShellSettings | None = None
    ) -> tuple[Float, list[ShellReport]]:
        """Return what `rebuilt` does, or what other settings make of it, and how the fits went."""
        shell = shell or self.shell
        blocks = np.split(shape, np.cumsum(self.sizes)[:-1])
        whole, *coarse = (
            level.wanted(*blocks[3 * number : 3 * number + 3]) for number, level in enumerate(self.levels)
        )
        projection = self.projection
        if isinstance(projection, CoarseShell):
            return projection.fit(whole, coarse[0], shell, self.settings.steps)
        if isinstance(projection, DiscreteShell):
            return projection.fit(whole, shell)
        return projection.rebuild(whole.lengths, whole.angles, whole.weights, shell)

    def decode_for_differences(self, vectors: Float) -> Float:
        """Implement `ShapeSpace.decode_for_differences`."""
        return self.decode_with_reports(vectors, shell=self.shell.for_differences())[0]

    def decode_with_reports(
        self, vectors: Float, progress: Progress = silent, shell: ShellSettings | None = None
    ) -> tuple[Float, list[list[ShellReport]]]:
        """Decode vectors ``(T, D)`` into points ``(T, V, 3)`` and tell how the fits of every frame went.

        Other settings of the fits may be given.
        """
        shapes, turns, centres = self.split(np.asarray(vectors, dtype=np.float64))
        points, reports = np.empty((len(shapes), self.topology.vertex_count, 3)), []
        with one_blas_thread():
            for number, shape in enumerate(shapes):
                rows, report = self.rebuilt_with_reports(shape, shell)
                points[number] = self.placed(rows, turns[number], centres[number])
                reports.append(report)
                progress(number + 1, len(shapes), "decoding frames")
        return points, reports
