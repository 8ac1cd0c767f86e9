"""Transfer one character's motion to another's body."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, cast

import numpy as np
from numpy.typing import ArrayLike

from mixseq.choices import TRANSFERS, TransferName
from mixseq.compression.numbering import match_headers
from mixseq.errors import MixseqWarning, SettingsError
from mixseq.mesh.topology import Topology
from mixseq.retargeting.checks import MIN_COMPARED_MARKERS, check_marker_vertices
from mixseq.retargeting.contacts import ContactReport, PlantedMotion, plant_contacts
from mixseq.retargeting.correspond import CorrespondenceQuality, RestMesh, correspond_and_assess
from mixseq.retargeting.gradient_transfer import gradient_transfer
from mixseq.retargeting.markers import Correspondence, Markers, check_numbers
from mixseq.retargeting.mixed_transfer import MixedTransfer, mixed_transfer
from mixseq.retargeting.parts import PartCorrespondence, PartPoses
from mixseq.retargeting.proposals import MAX_POSES, Proposal, propose_markers, similarity_residuals
from mixseq.retargeting.sources import Alignment, SourceMotion, prepare_source
from mixseq.runtime.parallel import Executor, one_blas_thread, thread_executor
from mixseq.runtime.progress import Progress, log_progress
from mixseq.runtime.public import FileOr, HasFrames, public
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.provenance import with_other_motion
from mixseq.sequence.sequence import Frames, MeshSequence, block_size, check_frames, join_blocks
from mixseq.shells.fitting import ShellSettings
from mixseq.signals.model import Model
from mixseq.types import Float, FloatArray, Index, evenly_spaced


class TransferMethod(Protocol):
    """Transfer method that is prepared for two meshes at rest."""

    @property
    def parts(self) -> PartCorrespondence | None:
        """Parts and joints of both meshes; None for methods without parts."""

    @property
    def alignment(self) -> Alignment:
        """How the target stands to the source."""

    def transfer_frames(self, points: FloatArray) -> Float:
        """Return the target ``(B, V', 3)`` for frames ``(B, V, 3)`` of the source, independent of each other."""


@dataclass(frozen=True, eq=False)
class TransferSettings:
    """Settings documented in `transfer`; `rest` and `parts` only apply to sources that are not yet prepared."""

    markers: Markers | ArrayLike | None = None
    mapping: Correspondence | Callable[[RestMesh, RestMesh], Correspondence] | None = None
    method: TransferName = "mixed"
    rest: int | MeshSequence = 0
    contacts: Mapping[str, ArrayLike] | None = None
    parts: int | ArrayLike | None = None
    joint_width: int = 3
    shell: ShellSettings | None = None

    def __post_init__(self) -> None:
        if self.method not in TRANSFERS:
            raise SettingsError(f"method is {self.method!r}; {' or '.join(map(repr, TRANSFERS))} is expected")
        if self.contacts and self.method != "mixed":
            raise SettingsError(
                "contacts need the poses of parts; leave out the contacts, or choose the method 'mixed'"
            )
        if self.markers is not None and self.mapping is not None:
            raise SettingsError("both markers and a map are given; give one of them")


@dataclass(frozen=True, eq=False)
class Transfer:
    """A prepared transfer, from `plan_transfer`."""

    header: SequenceHeader  # header of the result, with the target's mesh and the source's times
    source: SourceMotion  # frames and rest shape of the source
    target: Float  # (V', 3) points of the target at rest, with limbs turned into the source's rest pose
    correspondence: Correspondence  # correspondence of source and target
    method: TransferMethod  # method that transfers frames
    quality: CorrespondenceQuality | None = None  # quality of a correspondence from markers
    proposal: Proposal | None = None  # proposed markers, if neither markers nor a map were needed or given
    planted: PlantedMotion | None = None  # motions of the parts after footskate cleanup, if there are contacts
    turned: float = 0.0  # largest rotation of a limb of the target into the source's rest pose, in degrees

    @property
    def contacts(self) -> ContactReport:
        """Report on the contacts; empty without contacts."""
        return ContactReport() if self.planted is None else self.planted.report

    def pose_frames(self, frames: Sequence[int]) -> Float:
        """Return the target ``(n, V', 3)`` in some frames ``(n,)`` of the source."""
        planted = self.planted
        poses = None if planted is None else PartPoses(planted.rotations[frames], planted.centres[frames])
        return _transfer_block(self.method, (self.source.points[np.asarray(frames, dtype=np.int64)], poses))

    def blocks(self, progress: Progress = log_progress, workers: Executor | None = None) -> Iterator[Float]:
        """Yield the target's points in blocks ``(B, V', 3)`` of successive frames."""
        done_count, frame_count, run = 0, len(self.source.points), workers or thread_executor()
        size = block_size(max(self.source.header.vertex_count, self.header.vertex_count))
        slices = [slice(start, start + size) for start in range(0, frame_count, size)]
        frames, planted = (self.source.points[block] for block in slices), self.planted
        poses = (
            None if planted is None else PartPoses(planted.rotations[block], planted.centres[block]) for block in slices
        )
        for block in run(_transfer_block, self.method, zip(frames, poses, strict=True)):
            yield block
            done_count += len(block)
            progress(done_count, frame_count, "transferring frames")


def _transfer_block(method: TransferMethod, block: tuple[FloatArray, PartPoses | None]) -> Float:
    """Transfer frames ``(B, V, 3)``, with planted poses of parts if given."""
    frames, poses = block
    if poses is None or not isinstance(method, MixedTransfer):
        return method.transfer_frames(frames)
    return method.transfer_frames(frames, poses)


def plan_transfer(
    source: Frames | Model | SourceMotion,
    target: Frames,
    settings: TransferSettings | None = None,
    progress: Progress = log_progress,
    workers: Executor | None = None,
) -> Transfer:
    """Prepare a transfer to a target without computing its frames; raises the same errors as `transfer`."""
    settings = settings or TransferSettings()
    check_frames(target)
    with one_blas_thread():
        if not isinstance(source, SourceMotion):
            source = prepare_source(source, settings.rest, settings.parts, progress)
        rest = next(iter(target.blocks(1)))[0].astype(np.float64)
        topology = Topology(target.header.faces, target.header.vertex_count)
        correspondence, quality, proposal = _find_correspondence(source, rest, target.header, settings, progress)
        gradients = gradient_transfer(source.topology, source.rest, topology, rest, correspondence)
        header = target.header.with_times(source.header.times, source.header.fps)
        header = replace(header, provenance=with_other_motion(target.header.provenance))
        poses, turned = compare_rest_poses(source, rest, correspondence), 0.0
        if settings.method == "gradients":
            _warn_of_poses(source, poses)
            return Transfer(header, source, rest, correspondence, gradients, quality, proposal)
        progress(0, 1, "finding parts")
        shell = settings.shell or ShellSettings()
        mixed = mixed_transfer(gradients, source.points, source.part_of_face(), settings.joint_width, shell)
        if poses.residual > MIN_POSE_DIFFERENCE:
            posed = mixed.turned_to_source()
            residual = compare_rest_poses(source, posed, correspondence).residual
            if residual < min(MAX_TURNED_RATIO * poses.residual, poses.frame_residual):
                rest, turned = posed, float(mixed.limb_turns[1].max())
                gradients = gradient_transfer(source.topology, source.rest, topology, rest, correspondence)
                mixed = replace(mixed, gradients=gradients)
            else:
                _warn_of_poses(source, poses)
        planted = None
        if settings.contacts:
            check_numbers(target.header, "contacts are numbers of vertices, and those of the target")
            run = workers or thread_executor()
            mixed, planted = plant_contacts(mixed, source.points, header, settings.contacts, run, progress)
        return Transfer(header, source, rest, correspondence, mixed, quality, proposal, planted, turned)


def _find_correspondence(
    source: SourceMotion, rest: Float, header: SequenceHeader, settings: TransferSettings, progress: Progress
) -> tuple[Correspondence, CorrespondenceQuality | None, Proposal | None]:
    """Find a target's correspondence by map, markers, connectivity or proposed markers: rest ``(V', 3)``.

    The quality is only for markers, which are proposed if nothing is given and the meshes differ.
    """
    sizes = tuple((mesh.vertex_count, len(mesh.faces)) for mesh in (source.header, header))
    mapping, markers = settings.mapping, settings.markers
    if mapping is not None:
        if not isinstance(mapping, Correspondence):
            mapping = mapping((source.rest, source.header.faces), (rest, header.faces))
        mapping.check(*sizes)
        return mapping, None, None
    proposal = None
    if markers is None:
        if np.array_equal(source.topology.faces, header.faces):
            return Correspondence.identity(*sizes[0]), None, None
        numbering = match_headers(source.header, header)
        if numbering is not None:
            face_ids = numbering.renumber_labels(np.arange(sizes[0][1]), source.header.polygons)
            identity = Correspondence.identity(*sizes[0])
            return identity.renumbered(numbering.vertices, np.asarray(face_ids, np.int64)), None, None
        proposal = _propose(source, rest, header, progress)
        markers = proposal.markers
    pairs = markers if isinstance(markers, Markers) else Markers.from_pairs(markers)
    check_marker_vertices(pairs, source.topology, Topology(header.faces, header.vertex_count))
    posed = _most_similar_pose(source, rest, pairs)
    source_mesh = MeshSequence.from_header(source.header.with_times([0.0]), posed[None])
    target_mesh = MeshSequence.from_header(header.with_times([0.0]), rest[None])
    return *correspond_and_assess(source_mesh, target_mesh, pairs, progress=progress), proposal


def _most_similar_pose(source: SourceMotion, rest: Float, markers: Markers) -> Float:
    """Return the source ``(V, 3)`` in the frame whose markers are much more like the target's at rest, or at rest."""
    if len(markers) < MIN_COMPARED_MARKERS:
        return source.rest
    poses = _sample_source(source)[1]
    residuals = similarity_residuals(poses[:, markers.source], rest[markers.target])
    best = int(residuals.argmin())
    is_much_better = residuals[0] > MAX_REGISTERED_RESIDUAL and residuals[best] < MAX_POSE_RATIO * residuals[0]
    return np.asarray(poses[best if is_much_better else 0])


def _sample_source(source: SourceMotion) -> tuple[Index, Float]:
    """Return some frames ``(n,)``, and the poses ``(n + 1, V, 3)`` at rest and in these frames."""
    frames = evenly_spaced(len(source.points), MAX_POSES - 1)
    return frames, np.concatenate([source.rest[None], source.points[frames]])


def _propose(source: SourceMotion, rest: Float, header: SequenceHeader, progress: Progress) -> Proposal:
    """Propose markers of a source and a target at rest ``(V', 3)``; raise SettingsError if they are not sure."""
    progress(0, 1, "proposing markers")
    target_topology = Topology(header.faces, header.vertex_count)
    proposal = propose_markers((_sample_source(source)[1], source.topology), (rest[None], target_topology))
    if proposal.doubt:
        raise SettingsError(
            f"the source has {source.header.vertex_count} vertices and {len(source.header.faces)} triangles, the "
            f"target {header.vertex_count} and {len(header.faces)}, or they are in another order, and markers that "
            f"could be proposed are not sure: {proposal.doubt}; give markers or a map"
        )
    return proposal


MIN_POSE_DIFFERENCE = 0.1  # smallest residual of a rest pose that is warned about, relative to the body's radius
MAX_POSE_RATIO = 0.7  # largest ratio of a frame's residual to that of a rest pose that is warned about
MAX_TURNED_RATIO = 0.5  # largest ratio of the residual of turned limbs to that of a rest pose which they replace
MAX_REGISTERED_RESIDUAL = 0.3  # largest residual of markers with which meshes are registered at rest in any case
POSE_SAMPLES = 500  # number of vertices by which poses are compared


@dataclass(frozen=True)
class PoseComparison:
    """How unlike the poses of source and target at rest are: residuals relative to the body's radius."""

    residual: float  # residual of the rest poses
    frame: int  # frame of the source that is most like the target at rest
    frame_residual: float  # residual of that frame

    @property
    def is_better(self) -> bool:
        """Whether the frame is much more like the target at rest than the source at rest."""
        return self.residual > MIN_POSE_DIFFERENCE and self.frame_residual < MAX_POSE_RATIO * self.residual


def compare_rest_poses(source: SourceMotion, rest: Float, correspondence: Correspondence) -> PoseComparison:
    """Compare the target at rest ``(V', 3)`` with the source at rest and in some frames."""
    vertex_ids = np.flatnonzero(correspondence.matched)
    vertex_ids = vertex_ids[evenly_spaced(len(vertex_ids), POSE_SAMPLES)]
    frames, poses = _sample_source(source)
    corners, weights = correspondence.corners[vertex_ids], correspondence.weights[vertex_ids]
    points = np.einsum("vk,tvkc->tvc", weights, poses[:, corners])
    residuals = similarity_residuals(points, rest[vertex_ids])
    best = int(residuals[1:].argmin())
    return PoseComparison(float(residuals[0]), int(frames[best]), float(residuals[1 + best]))


def _warn_of_poses(source: SourceMotion, poses: PoseComparison) -> None:
    """Warn if a frame of the source is much more like the target at rest than the source at rest."""
    if poses.is_better:
        number = source.header.frame_number(poses.frame)
        warnings.warn(
            f"the source is not at rest in the target's pose: points are {100 * poses.residual:.0f} % of the body's "
            f"radius off, in frame {number} {100 * poses.frame_residual:.0f} %; take that one with rest={number}, or "
            f"--rest {number}",
            MixseqWarning,
            stacklevel=3,
        )


@public
def transfer(
    source: FileOr[Frames | Model],
    target: FileOr[Frames | HasFrames],
    markers: FileOr[Markers | ArrayLike] | None = None,
    mapping: FileOr[Correspondence | Callable[[RestMesh, RestMesh], Correspondence]] | None = None,
    method: TransferName = "mixed",
    rest: FileOr[int | MeshSequence] = 0,
    contacts: FileOr[Mapping[str, ArrayLike]] | None = None,
    *,
    parts: int | ArrayLike | None = None,
    joint_width: int = 3,
    shell: ShellSettings | None = None,
    progress: Progress = log_progress,
    workers: Executor | None = None,
) -> MeshSequence:
    """Transfer the motion of a source mesh to a target mesh.

    File paths are accepted for the source, the target, markers, the map, the rest, contacts and labels of parts.

    Parameters
    ----------
    source : MeshSequence, SequenceReader or Model
        The motion. A model provides its frames, and also its parts if its shape space is mixed.
    target : MeshSequence
        Mesh that receives the motion. Its first frame has a pose like the source at rest.
    markers : Markers or (n, 2) int, optional
        Pairs of a source vertex and the corresponding target vertex; see `mixseq.correspond`. By default they are
        proposed for meshes with other triangles; see `mixseq.suggest_markers`.
    mapping : Correspondence or callable, optional
        Dense correspondence to use instead of markers, or a function that returns it for source and target at rest
        (each as points and triangles).
    method : {"mixed", "gradients"}
        Parts, joints and poses (S_m, the default), or deformation gradients (S_f; Sumner and Popović 2004).
    rest : int or MeshSequence
        Frame in which the source is at rest, or the source's mesh at rest (in its first frame), in any size.
    contacts : mapping of str to (k,) int, optional
        S_m: for the name of each contact, target vertices that touch the ground together. Contacts do not slide while
        the corresponding source points rest on the ground; the travel of the body scales with the target's legs.
    parts : int or (F,) int, optional
        S_m: number of parts, or the part of every source triangle. By default parts are found from the motion.
    joint_width : int
        S_m: largest width of joints, in strips of triangles on each side of a boundary.
    shell : ShellSettings, optional
        S_m: settings of the joint solves.
    progress : callable, optional
        Called with the progress of every stage.
    workers : Executor, optional
        Executor for blocks of frames, see `mixseq.runtime.parallel`; by default one thread per core.

    Returns
    -------
    MeshSequence
        The target's mesh in float64, at the times of the source.

    Raises
    ------
    SettingsError
        If a setting is out of range, the correspondence is given twice or for other meshes, or none is given and
        proposed markers are not sure.
    InvalidSequenceError
        If an argument is not a sequence, the rest has another mesh, or corresponding regions have no size or no area.
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
    source = cast("Frames | Model", source)
    target = cast("Frames", target)
    markers = cast("Markers | ArrayLike | None", markers)
    mapping = cast("Correspondence | Callable[[RestMesh, RestMesh], Correspondence] | None", mapping)
    rest = cast("int | MeshSequence", rest)
    contacts = cast("Mapping[str, ArrayLike] | None", contacts)
    settings = TransferSettings(markers, mapping, method, rest, contacts, parts, joint_width, shell)
    prepared = plan_transfer(source, target, settings, progress, workers)
    return join_blocks(prepared.header, prepared.blocks(progress, workers))
