"""Joints of a UsdSkel skeleton in the bind pose.

Bind transforms are in skeleton space, placed in the world by the skeleton's transform at the start of the stage. USD's
matrices act on row vectors.

Specification: https://openusd.org/release/api/_usd_skel__schemas.html#UsdSkel_Skeleton
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pxr import Sdf, Usd, UsdSkel

from mixseq.errors import FormatError
from mixseq_io.skeletons import choose_skeleton, skeleton_of
from mixseq_io.usd.diagnostics import quiet, reading_usd
from mixseq_io.usd.prims import open_stage, prims_of
from mixseq_io.usd.transforms import Placement

if TYPE_CHECKING:
    from mixseq.rigging.skeletons import Skeleton


def read_skel_joints(path: Path, name: str | None) -> Skeleton:
    """Read the joints of a skeleton; see `mixseq_io.read_skeleton`."""
    with quiet(), reading_usd(path):
        stage = open_stage(path)
        prim = skeleton_prim(path, stage, name)
        skeleton = UsdSkel.Skeleton(prim)
        joints = skeleton.GetJointsAttr().Get() or []
        binds = skeleton.GetBindTransformsAttr().Get() or []
        if not joints or len(binds) != len(joints):
            raise FormatError(
                f"{path}: {prim.GetPath()} has {len(joints)} joints and {len(binds)} bind transforms; as many of "
                "both, and one at least, are expected: export the character again"
            )
        topology = UsdSkel.Topology(joints)
        sound, reason = topology.Validate()
        if not sound:
            raise FormatError(f"{path}: the joints of {prim.GetPath()} are no tree: {reason}")
        parents = [int(each) for each in topology.GetParentIndices()]
        to_world = np.array(Placement(prim).to_world(stage.GetStartTimeCode()))
        bind = (np.array(binds, dtype=np.float64).reshape(-1, 4, 4) @ to_world).swapaxes(1, 2)
        return skeleton_of(_names(skeleton, list(joints)), parents, bind)


def skeleton_prim(path: Path, stage: Usd.Stage, name: str | None) -> Usd.Prim:
    """Return the chosen skeleton; see `mixseq_io.skeletons.choose_skeleton`."""
    prims = [prim for prim in prims_of(path, stage) if UsdSkel.Skeleton(prim)]
    names = [(str(prim.GetPath()), prim.GetName(), prim.GetDisplayName()) for prim in prims]
    return prims[choose_skeleton(path, names, name)]


def _names(skeleton: UsdSkel.Skeleton, joints: list[str]) -> list[str]:
    """Return the display names of joints: their `jointNames`, or the ends of their paths."""
    told = list(skeleton.GetJointNamesAttr().Get() or [])
    return told if len(told) == len(joints) else [Sdf.Path(joint).name for joint in joints]
