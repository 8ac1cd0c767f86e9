"""Reader of USD files (.usd, .usda, .usdc, .usdz) as animated meshes in world space.

Values are read from the composed stage, with references, layers, variants and value clips. Several meshes are joined.
Points are float32, as in USD, or float64 if transforms move them far from zero. Frames are at all samples of the
points, transforms, skeletons and blend shapes that move a mesh. If anything other than points is animated, vertices may
move along arcs between samples. Frames at the stage's rate then fill the gaps, as in `UsdSkel.BakeSkinning`.

Specification: https://openusd.org/release/api/class_usd_stage.html (time codes and frames per second)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdShade, UsdSkel

from mixseq.errors import FormatError, InvalidSequenceError, NoMeshError
from mixseq.mesh.surface import FaceSet, Origin
from mixseq.sequence.frame_rates import estimate_frame_rate, format_frame, is_on_frames, snap_rate
from mixseq.sequence.header import FileKeys, SequenceHeader
from mixseq.types import Float, FloatArray
from mixseq_io.reader import AnimationReader, SequenceReader, prefix_errors, warn
from mixseq_io.scene_meshes import (
    MAX_INSERTED_FRAMES,
    TIME_TOLERANCE,
    SceneMesh,
    check_finite,
    common_name,
    find_keys,
    insert_times,
    join_meshes,
    merge_times,
    read_valid_meshes,
    snap_to_frames,
)
from mixseq_io.text.labels import (
    GROUPS_SOURCE,
    LABEL_SUBSET_FAMILY,
    LABELS_SOURCE,
    MATERIALS_SOURCE,
    Markings,
    Skinning,
    concatenate_skinning,
    group_face_sets,
)
from mixseq_io.usd.motion import AnimatedMesh, MeshMotion, Pose, Skeleton, bind_pose, find_skins
from mixseq_io.usd.stage import (
    PART_NUMBER_KEY,
    PrimWarnings,
    absolute_path,
    capture_diagnostics,
    display_name,
    find_meshes,
    is_animated,
    is_spline,
    open_stage,
    scene_objects_of,
    translate_usd_read_errors,
)
from mixseq_io.usd.surface import read_scene_mesh

_MISSING_REPORTS = (
    "Could not open asset",
    "Could not load sublayer",
    "Unresolved reference",
    "Unresolved payload",
    "clip layer",
)
"""Texts of USD about missing files and prims, which `mixseq_io.usd.stage.find_meshes` names."""


def open_usd(path: Path, prim: str | None = None) -> SequenceReader:
    """Open a USD file."""
    warnings = PrimWarnings(path)
    with capture_diagnostics() as reports, translate_usd_read_errors(path), prefix_errors(path):
        stage = open_stage(path)
        meshes, scene_meshes = _read_meshes(path, stage, prim, warnings)
        header = _header(path, stage, meshes, scene_meshes)
        have_velocities = [mesh.has_velocities(warnings) for mesh in meshes]
    others = [report for report in reports if not any(each in report for each in _MISSING_REPORTS)]
    if others:
        warn(f"{path}: USD finds {len(others)} problems in it, which may have been lost; usdchecker lists them")
    warnings.emit()
    if any(have_velocities) and not all(have_velocities):
        warn(f"{path}: only some of its meshes have velocities; they are left out")
    return _UsdReader(path, header, stage, meshes, all(have_velocities))


def open_usd_bind_pose(path: Path, skeleton: str | None) -> SequenceReader:
    """Open the meshes of a skeleton in their bind pose; see `mixseq_io.read_bind_pose`."""
    from mixseq_io.usd.rigs import find_skeleton_prim  # imports the writer

    warnings = PrimWarnings(path)
    with capture_diagnostics(), translate_usd_read_errors(path), prefix_errors(path):
        stage = open_stage(path)
        prim = find_skeleton_prim(path, stage, skeleton)
        motions = _mesh_motions(path, stage, None, warnings)
        motions = [each for each in motions if each.skin and each.skin.skeleton.prim == prim]
        if not motions:
            raise NoMeshError(f"{path} has no mesh on {prim.GetPath()}; export the character with its mesh")
        codes = np.array([stage.GetStartTimeCode()])
        meshes = [AnimatedMesh(motion.mesh, motion.skin, codes) for motion in motions]
        header = _header(path, stage, meshes, [read_scene_mesh(mesh, warnings) for mesh in meshes])
        return _UsdReader(path, header, stage, meshes, has_velocities=False, pose_at=bind_pose)


class _UsdReader(AnimationReader):
    def __init__(
        self,
        path: Path,
        header: SequenceHeader,
        stage: Usd.Stage,
        meshes: Sequence[AnimatedMesh],
        has_velocities: bool,
        pose_at: Callable[[Skeleton, float], Pose] = Skeleton.pose,
    ) -> None:
        moves = any(mesh.animated_attributes for mesh in meshes)
        is_cache = any(is_animated(mesh.mesh.GetPointsAttr()) for mesh in meshes)
        super().__init__(path, header, has_velocities=has_velocities, can_evaluate=moves and not is_cache)
        self._frame_times = meshes[0].codes
        self._code_rate = stage.GetTimeCodesPerSecond()
        self._meshes, self._pose_at = meshes, pose_at
        self._stage: Usd.Stage | None = stage  # keeps the prims of the meshes valid

    def markings(self) -> Markings:
        """Return the families of subsets and the skinning weights of the meshes."""
        with capture_diagnostics(), translate_usd_read_errors(self.path):
            return _read_markings(self.header, self._meshes)

    def close(self) -> None:
        """Release the stage."""
        super().close()
        self._stage, self._meshes = None, ()

    def _read(self, quantity: str, size: int) -> Iterator[FloatArray]:
        for start in range(0, self.header.frame_count, size):
            yield self._sample(quantity, self._frame_times[start : start + size])

    def _points_at(self, times: Float, step_times: Float) -> FloatArray:
        return self._sample("points", times)

    def _sample(self, quantity: str, codes: Float) -> FloatArray:
        sample_frame = self._frame_points if quantity == "points" else self._frame_velocities
        block = np.empty((len(codes), self.header.vertex_count, 3))
        with capture_diagnostics(), translate_usd_read_errors(self.path):
            for row, code in enumerate(codes.tolist()):
                with prefix_errors(f"{self.path}: {_describe_frame(code, self._code_rate, self.header.fps)}"):
                    block[row] = np.concatenate(sample_frame(code))
        with np.errstate(over="ignore", under="ignore"):  # points that are not finite are reported with their vertex
            return self._round(block) if quantity == "points" else block.astype(np.float32)

    def _frame_points(self, code: float) -> list[FloatArray]:
        """Return the points ``(V, 3)`` of each mesh at a time code; each skeleton is posed once."""
        skins = [mesh.skin for mesh in self._meshes]
        poses = {skeleton: self._pose_at(skeleton, code) for skeleton in {skin.skeleton for skin in skins if skin}}
        pairs = zip(self._meshes, skins, strict=True)
        return [mesh.points(code, poses[skin.skeleton] if skin else None) for mesh, skin in pairs]

    def _frame_velocities(self, code: float) -> list[FloatArray]:
        return [mesh.velocities(code) for mesh in self._meshes]


def _mesh_motions(path: Path, stage: Usd.Stage, prim: str | None, warnings: PrimWarnings) -> list[MeshMotion]:
    meshes = find_meshes(path, stage, prim, warnings)
    skins = find_skins(meshes, warnings)
    return [MeshMotion(mesh, skins.get(mesh.GetPath())) for mesh in meshes]


def _read_meshes(
    path: Path, stage: Usd.Stage, prim: str | None, warnings: PrimWarnings
) -> tuple[Sequence[AnimatedMesh], Sequence[SceneMesh]]:
    motions = _mesh_motions(path, stage, prim, warnings)
    objects = scene_objects_of([motion.mesh for motion in motions])
    is_moving = [prim is None and bool(motion.animated_attributes) for motion in motions]
    rate = stage.GetTimeCodesPerSecond()

    def prepare(chosen: list[int]) -> Callable[[int], tuple[AnimatedMesh, SceneMesh]]:
        codes = _frame_codes(path, stage, [motions[index] for index in chosen])
        checked = codes if len(chosen) > 1 else codes[:1]  # a single mesh is refused when its frame is read

        def read(index: int) -> tuple[AnimatedMesh, SceneMesh]:
            animated = AnimatedMesh(motions[index].mesh, motions[index].skin, codes)
            return _read_mesh(animated, rate, checked, warnings)

        return read

    animated_meshes, scene_meshes = zip(*read_valid_meshes(path, objects, is_moving, prepare), strict=True)
    return animated_meshes, scene_meshes


def _read_mesh(
    animated: AnimatedMesh, rate: float, checked: Float, warnings: PrimWarnings
) -> tuple[AnimatedMesh, SceneMesh]:
    """Return a mesh with its surface; check its first frame, and the number of points at time codes ``(n,)``.

    Points in clips are not checked, as their files would all be opened.
    """
    scene_mesh, skin = read_scene_mesh(animated, warnings), animated.skin
    frame_name = _describe_frame(animated.start, rate, rate)
    points = animated.mesh.GetPointsAttr()
    if points.GetResolveInfo(Usd.TimeCode(animated.start)).GetSource() != Usd.ResolveInfoSourceValueClips:
        for code in checked.tolist():
            with prefix_errors(_describe_frame(code, rate, rate)):
                animated.read_points(code)
                animated.to_world(code)
    with prefix_errors(frame_name):
        first_points = animated.points(animated.start, skin.skeleton.pose(animated.start) if skin else None)
    check_finite(first_points, frame_name)
    return animated, scene_mesh


def _describe_frame(code: float, code_rate: float, fps: float) -> str:
    return f"frame {format_frame(code / code_rate, fps)} (time code {code:g})"


def _header(
    path: Path, stage: Usd.Stage, meshes: Sequence[AnimatedMesh], scene_meshes: Sequence[SceneMesh]
) -> SequenceHeader:
    times = meshes[0].codes / stage.GetTimeCodesPerSecond()
    rate = _choose_rate(stage, times)
    polygons, surface = join_meshes(scene_meshes, Origin("USD", absolute_path(path)))
    return SequenceHeader(
        polygons=polygons,
        vertex_count=sum(mesh.vertex_count for mesh in meshes),
        times=snap_to_frames(times, rate),
        fps=rate,
        up_axis=str(UsdGeom.GetStageUpAxis(stage)),
        metres_per_unit=UsdGeom.GetStageMetersPerUnit(stage),
        name=common_name(scene_objects_of([mesh.mesh for mesh in meshes])) or path.stem,
        surface=surface,
        keys=_find_keys(stage, meshes, rate),
    )


def _find_keys(stage: Usd.Stage, meshes: Sequence[AnimatedMesh], rate: float) -> FileKeys | None:
    """Return the frames that are keys of transforms, joints and blend shapes, which USD interpolates linearly."""
    if any(is_animated(mesh.mesh.GetPointsAttr()) for mesh in meshes):
        return None
    code_rate = stage.GetTimeCodesPerSecond()
    samples = dict.fromkeys(tuple(each.GetTimeSamples()) for mesh in meshes for each in mesh.animated_attributes)
    keys = merge_times((np.array(each) / code_rate for each in samples), TIME_TOLERANCE)
    return find_keys(keys, meshes[0].codes / code_rate, rate, is_held=False)


_MAX_CODE_RATE = 240.0
"""Largest number of time codes per second that may be frames; more are ticks."""


def _choose_rate(stage: Usd.Stage, times: Float) -> float:
    """Return the stage's frames per second, or its time codes per second if only these fit the times ``(T,)``."""
    codes = snap_rate(stage.GetTimeCodesPerSecond())
    frames = snap_rate(stage.GetFramesPerSecond()) if stage.HasAuthoredMetadata("framesPerSecond") else 0.0
    if codes > _MAX_CODE_RATE:
        return frames or estimate_frame_rate(times) or codes
    return frames if frames and (is_on_frames(times, frames) or not is_on_frames(times, codes)) else codes


def _frame_codes(path: Path, stage: Usd.Stage, motions: Sequence[MeshMotion]) -> NDArray[np.float64]:
    """Return the time codes ``(T,)`` of the frames."""
    attributes = list(dict.fromkeys(each for motion in motions for each in motion.animated_attributes))
    for attribute in attributes:
        if is_spline(attribute):
            raise FormatError(f"{path}: {attribute.GetPath()} is a spline; bake it into time samples")
    samples = dict.fromkeys(tuple(attribute.GetTimeSamples()) for attribute in attributes)
    codes = merge_times(map(np.array, samples), TIME_TOLERANCE * stage.GetTimeCodesPerSecond())
    if not codes.size:  # a static mesh has the time of its point sample, or 0
        return np.array(motions[0].mesh.GetPointsAttr().GetTimeSamples()[:1] or [0.0], dtype=np.float64)
    if all(motion.only_points_are_animated for motion in motions):
        return codes
    inserted, step = _frame_rate_codes(stage, codes[0], codes[-1])
    return insert_times(codes, inserted, step / 2)


def _frame_rate_codes(stage: Usd.Stage, first: float, last: float) -> tuple[NDArray[np.float64], float]:
    """Return the time codes of the stage's frames from `first` to `last`, and their step; empty without valid rate."""
    start, rate = stage.GetStartTimeCode(), stage.GetFramesPerSecond()
    step = stage.GetTimeCodesPerSecond() / rate if rate else 0.0
    if not (stage.HasAuthoredTimeCodeRange() and np.isfinite(step) and step > 0 and np.isfinite(start)):
        return np.empty(0), 0.0
    begin = np.ceil((max(first, start) - start) / step)
    end = np.floor((min(last, stage.GetEndTimeCode()) - start) / step)
    if not end - begin < MAX_INSERTED_FRAMES:
        return np.empty(0), 0.0
    return start + np.arange(begin, end + 1) * step, step


def _read_markings(header: SequenceHeader, meshes: Sequence[AnimatedMesh]) -> Markings:
    """Return the families of subsets and the skinning weights of meshes."""
    is_skinned = any(mesh.skin and mesh.skin.has_joints for mesh in meshes)
    materials = {source: sets for source, sets in group_face_sets(header).items() if source == MATERIALS_SOURCE}
    return Markings(
        sets=_face_sets_by_family(meshes) | materials,
        skinning=concatenate_skinning([_read_skinning(mesh) for mesh in meshes]) if is_skinned else None,
    )


def _face_sets_by_family(meshes: Sequence[AnimatedMesh]) -> dict[str, tuple[FaceSet, ...]]:
    """Return subsets of faces by family, except material subsets; parts written by mixseq are sorted by number."""
    found: dict[str, list[tuple[int, FaceSet]]] = {}
    first_face = 0
    for animated in meshes:
        code = Usd.TimeCode(animated.start)
        face_count = len(animated.mesh.GetFaceVertexCountsAttr().Get(code) or ())
        for subset in UsdGeom.Subset.GetAllGeomSubsets(animated.mesh):
            family = str(subset.GetFamilyNameAttr().Get() or GROUPS_SOURCE)
            if subset.GetElementTypeAttr().Get() != UsdGeom.Tokens.face:
                continue
            if family == UsdShade.Tokens.materialBind:
                continue
            faces = np.array(subset.GetIndicesAttr().Get(code) or (), dtype=np.int32)
            faces = faces[(faces >= 0) & (faces < face_count)]
            number = subset.GetPrim().GetCustomDataByKey(PART_NUMBER_KEY)
            face_set = FaceSet(display_name(subset.GetPrim()), faces + first_face)
            source = LABELS_SOURCE if family == LABEL_SUBSET_FAMILY else family
            found.setdefault(source, []).append((number if isinstance(number, int) else 0, face_set))
        first_face += face_count
    return {
        source: tuple(face_set for _, face_set in sorted(sets, key=lambda pair: pair[0]))
        for source, sets in found.items()
    }


def _read_skinning(animated: AnimatedMesh) -> Skinning:
    skin = animated.skin
    if skin is None or not skin.has_joints:
        return Skinning.rigid(str(animated.mesh.GetPath()), animated.vertex_count)
    from scipy.sparse import csr_array

    names = [str(each) for each in skin.query.GetJointOrder() or skin.skeleton.query.GetJointOrder()]
    point_count, vertex_count = animated.point_count, animated.vertex_count
    influences = skin.query.ComputeVaryingJointInfluences(point_count, Usd.TimeCode(animated.start))
    joints = np.array(influences[0] or (), dtype=np.int64).reshape(point_count, -1)
    weights = np.array(influences[1] or (), dtype=np.float64).reshape(point_count, -1)
    if not joints.size or joints.min() < 0 or joints.max() >= len(names):
        raise InvalidSequenceError(
            f"the joint indices and weights of {animated.mesh.GetPath()} do not fit its {point_count} "
            f"points and {len(names)} joints; export the character again"
        )
    rows = np.repeat(np.arange(vertex_count), joints.shape[1])
    points = animated.weld.point_of_vertex
    matrix = csr_array(
        (weights[points].reshape(-1), (rows, joints[points].reshape(-1))), shape=(vertex_count, len(names))
    )
    root = str(skin.skeleton.prim.GetPath())
    return Skinning(
        matrix,
        tuple(f"{root}/{name}" for name in names),
        tuple(_parent_joint(root, name, skin.skeleton.query) for name in names),
    )


def _parent_joint(root: str, joint: str, skeleton: UsdSkel.SkeletonQuery) -> str:
    """Return the path of a joint's parent joint, "" if it has none."""
    joints = [str(each) for each in skeleton.GetJointOrder()]
    parent = skeleton.GetTopology().GetParent(joints.index(joint)) if joint in joints else -1
    return f"{root}/{joints[parent]}" if parent >= 0 else ""
