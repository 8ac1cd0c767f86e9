"""Transfer one character's motion to another's body."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from mixseq.choices import TRANSFERS, TransferName
from mixseq.errors import SettingsError
from mixseq.mesh.topology import Topology
from mixseq.retargeting.contacts import ContactReport, PlantedTransfer, plant_contacts
from mixseq.retargeting.gradient_transfer import gradient_transfer
from mixseq.retargeting.markers import Correspondence, Markers
from mixseq.retargeting.matching import Mesh, Quality
from mixseq.retargeting.mixed_transfer import MixedTransfer, mixed_transfer
from mixseq.retargeting.parts import PartCorrespondence, PartPoses
from mixseq.retargeting.sources import SourceMotion, source_motion
from mixseq.runtime.parallel import Executor, on_threads, one_blas_thread
from mixseq.runtime.progress import Progress, silent
from mixseq.runtime.public import public
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import Frames, MeshSequence, block_size, check_frames, collect
from mixseq.shells.gauss_newton import ShellSettings
from mixseq.signals.model import Model
from mixseq.types import Float, FloatArray


class TransferMethod(Protocol):
    """A method of transfer, made for two meshes."""

    @property
    def parts(self) -> PartCorrespondence | None:
        """Parts and joints of both meshes; None for methods without parts."""

    def frame(self, x: FloatArray) -> Float:
        """Move the target ``(V', 3)`` as the source is moved in a frame ``(V, 3)``."""


@dataclass(frozen=True, eq=False)
class Transfer:
    """A transfer that is ready to make frames; made by `plan`."""

    header: SequenceHeader  # header of the result: the target's mesh, at the source's times
    source: SourceMotion  # the source: its frames and its shape at rest
    target: Float  # (V', 3) the target at rest
    correspondence: Correspondence  # where the target is on the source
    method: TransferMethod  # method that moves the target
    quality: Quality | None = None  # quality of a correspondence from markers
    # Where the parts go so that contacts do not slide, if there are any.
    planted: PlantedTransfer | None = None

    @property
    def contacts(self) -> ContactReport:
        """Report on the contacts."""
        return ContactReport() if self.planted is None else self.planted.report

    def blocks(self, progress: Progress = silent, workers: Executor | None = None) -> Iterator[Float]:
        """Yield the target's points in blocks ``(B, V', 3)``, from the first frame to the last."""
        done, count, work = 0, len(self.source.points), workers or on_threads()
        size = block_size(max(self.source.header.vertex_count, self.header.vertex_count))
        slices = [slice(start, start + size) for start in range(0, count, size)]
        frames, planted = (self.source.points[some] for some in slices), self.planted
        if planted is None:
            made = work(_moved, self.method, frames)
        else:
            poses = (PartPoses(*(values[some] for values in planted.poses)) for some in slices)
            made = work(_posed, planted.method, zip(frames, poses, strict=True))
        for block in made:
            yield block
            done += len(block)
            progress(done, count, "transferring frames")


def _moved(method: TransferMethod, block: FloatArray) -> Float:
    return np.stack([method.frame(x) for x in block])


def _posed(method: MixedTransfer, item: tuple[FloatArray, PartPoses]) -> Float:
    block, poses = item
    each = zip(block, *poses, strict=True)
    return np.stack([method.frame(x, PartPoses(turns, centres)) for x, turns, centres in each])


def plan(
    source: Frames | Model | SourceMotion,
    target: Frames,
    markers: Markers | ArrayLike | None = None,
    mapping: Correspondence | Callable[[Mesh, Mesh], Correspondence] | None = None,
    method: TransferName = "mixed",
    rest: int | MeshSequence = 0,
    contacts: Mapping[str, ArrayLike] | None = None,
    *,
    parts: int | ArrayLike | None = None,
    joint_width: int = 3,
    shell: ShellSettings | None = None,
    progress: Progress = silent,
    workers: Executor | None = None,
) -> Transfer:
    """Prepare a transfer without making frames; takes and raises what `transfer` does, a `SourceMotion` also."""
    if method not in TRANSFERS:
        raise SettingsError(f"method is {method!r}; {' or '.join(map(repr, TRANSFERS))} is expected")
    if contacts and method != "mixed":
        raise SettingsError(
            "contacts are kept by the poses of parts; leave them out, or choose the method 'mixed'"
        )
    check_frames(target)
    with one_blas_thread():
        motion = source if isinstance(source, SourceMotion) else source_motion(source, rest, parts, progress)
        shape = next(iter(target.blocks(1)))[0].astype(np.float64)
        topology = Topology(target.header.faces, target.header.vertex_count)
        found, quality = correspondence_of(motion, shape, target.header, markers, mapping, progress)
        gradients = gradient_transfer(motion.topology, motion.rest, topology, shape, found)
        header = target.header.with_times(motion.header.times, motion.header.fps)
        if method == "gradients":
            return Transfer(header, motion, shape, found, gradients, quality)
        progress(0, 1, "finding parts")
        labels = motion.part_of_face()
        mixed = mixed_transfer(gradients, motion.points, labels, joint_width, shell or ShellSettings())
        if not contacts:
            return Transfer(header, motion, shape, found, mixed, quality)
        work = workers or on_threads()
        planted = plant_contacts(mixed, motion.points, header, contacts, work, progress)
        return Transfer(header, motion, shape, found, planted.method, quality, planted)


def correspondence_of(
    source: SourceMotion,
    shape: Float,
    header: SequenceHeader,
    markers: Markers | ArrayLike | None,
    mapping: Correspondence | Callable[[Mesh, Mesh], Correspondence] | None,
    progress: Progress = silent,
) -> tuple[Correspondence, Quality | None]:
    """Return the given correspondence, or that of markers or connectivity; for markers also its quality."""
    if markers is not None and mapping is not None:
        raise SettingsError("markers and a map are two ways to say the same; give one of them")
    sizes = tuple((t.vertex_count, len(t.faces)) for t in (source.header, header))
    if mapping is not None:
        if not isinstance(mapping, Correspondence):
            mapping = mapping((source.rest, source.header.faces), (shape, header.faces))
        mapping.check(*sizes)
        return mapping, None
    if markers is not None:
        from mixseq.retargeting.correspond import correspond_and_assess

        given = markers if isinstance(markers, Markers) else Markers.of(markers)
        still = MeshSequence.from_header(source.header.with_times([0.0]), source.rest[None])
        other = MeshSequence.from_header(header.with_times([0.0]), shape[None])
        found = correspond_and_assess(still, other, given, progress=progress)
        return found.correspondence, found.quality
    if not np.array_equal(source.topology.faces, header.faces):
        (vertices, faces), (others, other_faces) = sizes
        raise SettingsError(
            f"the source has {vertices} vertices and {faces} triangles, the target {others} and {other_faces}, or "
            "they are in another order; give markers or a map that tell what corresponds"
        )
    return Correspondence.identity(*sizes[0]), None


@public
def transfer(
    source: Frames | Model,
    target: Frames,
    markers: Markers | ArrayLike | None = None,
    mapping: Correspondence | Callable[[Mesh, Mesh], Correspondence] | None = None,
    method: TransferName = "mixed",
    rest: int | MeshSequence = 0,
    contacts: Mapping[str, ArrayLike] | None = None,
    *,
    parts: int | ArrayLike | None = None,
    joint_width: int = 3,
    shell: ShellSettings | None = None,
    progress: Progress = silent,
    workers: Executor | None = None,
) -> MeshSequence:
    """Move a mesh as another one moves.

    A path does for the source, the target, markers, the map, the rest, contacts and labels of parts.

    Parameters
    ----------
    source : MeshSequence, SequenceReader or Model
        The motion. Of a model, its frames; and its parts, if its space is the mixed one.
    target : MeshSequence
        The mesh to move, in its first frame, in a pose like the source's at rest. With the triangles of the source,
        nothing else is needed.
    markers : Markers or (n, 2) int, optional
        Pairs of corresponding vertices, one of the source and one of the target; see `mixseq.correspond`.
    mapping : Correspondence or callable, optional
        A dense correspondence, or a function that makes one of both meshes at rest (points and triangles), instead of
        markers.
    method : {"mixed", "gradients"}
        Parts, joints and poses (S_m, the default), or deformation gradients (S_f; Sumner and Popović 2004).
    rest : int or MeshSequence
        The frame in which the source is at rest, or the source's mesh at rest (its first frame), in any size.
    contacts : mapping of str to (k,) int, optional
        S_m: vertices of the target that touch the ground together, by the name of each contact. They do not slide
        while the corresponding points of the source rest, and the travel of the body scales with its legs.
    parts : int or (F,) int, optional
        S_m: number of parts, or the part of every triangle of the source; found from the motion if not given.
    joint_width : int
        S_m: largest width of joints, in strips of triangles on each side of a boundary.
    shell : ShellSettings, optional
        S_m: settings of the joint solves.
    progress : callable, optional
        Called for every stage.
    workers : Executor, optional
        Executor for blocks of frames, see `mixseq.runtime.parallel`; by default one thread per core.

    Returns
    -------
    MeshSequence
        The target's mesh in float64, at the times of the source.

    Raises
    ------
    SettingsError
        If a setting is out of range, or the correspondence is missing, given twice, or of other meshes.
    InvalidSequenceError
        If a sequence is none, or the rest has another mesh; or a mesh has no size or no area where they correspond.
    SegmentationError
        If given parts do not fit the source.

    Examples
    --------
    >>> import mixseq
    >>> from mixseq.creature import walk_cycle
    >>> walk = walk_cycle(frames=6)
    >>> tall = mixseq.MeshSequence.from_arrays(walk.points[:1] * [1.0, 1.5, 1.0], walk.faces)
    >>> transfer(walk, tall).points.shape == walk.points.shape
    True
    """
    planned = plan(
        source,
        target,
        markers,
        mapping,
        method,
        rest,
        contacts,
        parts=parts,
        joint_width=joint_width,
        shell=shell,
        progress=progress,
        workers=workers,
    )
    return collect(planned.header, planned.blocks(progress, workers))
